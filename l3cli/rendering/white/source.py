"""Sources of a scene's white: the file, a grey or a chart in the frame, or the whole frame (docs/method.md#scene-white)."""

import re
from typing import Protocol

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError, shortened
from l3cli.frames.frame import RawFrame
from l3cli.physics.display import scene_white
from l3cli.rendering.white.auto import AutoWhite
from l3cli.rendering.white.balance import WhiteBalance, plain_balance
from l3cli.rendering.white.chart import ChartWhite
from l3cli.rendering.white.grey import Square
from l3cli.rendering.white.scene_white import SceneWhite, Whites
from l3cli.system.text import NoSuchNumber, Quantity

CAMERA, AUTO, CHART = "camera", "auto", "chart"
USUAL_SIZE = 32  # pixels
PLACE, SIZE = Quantity(0, 1_000_000, "pixels", whole=True), Quantity(2, 1000, "pixels", whole=True)


class WhiteSource(Protocol):
    """Source of each frame's white."""

    @property
    def about(self) -> str:
        """Return the origin of the white, for messages."""
        ...

    @property
    def held(self) -> bool:
        """Return whether a sequence keeps the white of its first frame."""
        ...

    def white(self, frame: RawFrame) -> SceneWhite | None:
        """White of a frame, None where there is nothing to tell it by; InputFileError if it cannot be taken from it."""
        ...


class CameraWhite:
    """White that the camera took, as the file states it."""

    about, held = "as the file states it", False

    def __init__(self, table: TransformTable) -> None:
        self._whites = Whites(table)
        self._made: dict[tuple[float, ...], SceneWhite] = {}

    def white(self, frame: RawFrame) -> SceneWhite:
        if frame.neutral is None:
            raise InputFileError(
                f"{frame.name} does not state what its camera took for white; give ‹white› as auto, as chart, as the "
                "ROW,COL of a grey, or name the light"
            )
        if frame.neutral not in self._made:
            self._made[frame.neutral] = self._whites.of_neutral(np.array(frame.neutral))
        return self._made[frame.neutral]


class SquareWhite:
    """A square of the frame that shows something grey."""

    held = True

    def __init__(self, table: TransformTable, square: Square) -> None:
        self.about = f"of {square.size}×{square.size} pixels about row {square.row}, column {square.col}"
        self._whites, self._square = Whites(table), square

    def white(self, frame: RawFrame) -> SceneWhite:
        return self._whites.of_greys(frame, [self._square.within(frame)])


def white_source(text: str | None, table: TransformTable, estimated_by: TransformTable | None = None) -> WhiteSource | None:
    """Return the source that "camera", "auto", "chart" or "ROW,COL[,SIZE]" asks for; None where `text` is a white by
    itself, a name or "x,y"; None: the table's.
    `estimated_by`: the statistics of estimates; None: the table's (docs/method.md#several-lights)."""
    if text is None:
        return None
    if text == CAMERA:
        return CameraWhite(table)
    if text == AUTO:
        return AutoWhite(Whites(estimated_by or table), Whites(table))
    if text == CHART:
        return ChartWhite(table)
    parts = text.split(",")
    if not (2 <= len(parts) <= 3 and (len(parts) == 3 or all(re.fullmatch(r"[+-]?\d+", part) for part in parts))):
        return None
    try:
        row, col = (int(PLACE.read(part)) for part in parts[:2])
        size = int(SIZE.read(parts[2])) if len(parts) == 3 else USUAL_SIZE
    except NoSuchNumber as error:
        raise RecipeError(
            f'white "{shortened(text)}" is no place of a grey: {error}; give it as ROW,COL or ROW,COL,SIZE in pixels'
        ) from None
    return SquareWhite(table, Square(row, col, size))


def given_white(text: str | None, table: TransformTable) -> SceneWhite | None:
    """The white that a name or "x,y" means; None: that of the table. RecipeError if it is neither."""
    if text is None:
        return None
    return Whites(table).of_chromaticity(scene_white(text)) if "," in text else Whites(table).of_light(text)


def usual_balance(table: TransformTable) -> WhiteBalance:
    """Return the balance of scenes under the light of training."""
    return plain_balance(table.white_point, len(table.channels))
