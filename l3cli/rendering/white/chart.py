"""The white of a frame by the greys of a ColorChecker in it (docs/method.md#scene-white)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError
from l3cli.frames.chart import corner_cells, through
from l3cli.frames.frame import RawFrame, shifted_cfa
from l3cli.physics import charts
from l3cli.rendering.white.grey import Grey
from l3cli.rendering.white.scene_white import SceneWhite, Whites

if TYPE_CHECKING:
    from l3cli.frames.chart import Located

NEUTRALS = range(18, 24)  # patches, from white to black
CORE = 0.25  # half the side of the square of a patch that is measured, in patches: their frames stay out
WAVELENGTH = np.arange(400.0, 701.0, 10.0)  # nm
SURE = 0.95  # R² of a chart; 48 pictures without one reach at most 0.83, two with one 0.998


@dataclass(frozen=True)
class ChartSceneWhite(SceneWhite):
    """The white of a chart."""

    place: str  # of the chart in the upright picture
    stated: SceneWhite | None  # what the file says

    def __str__(self) -> str:
        return f"{super().__str__()}; {self.place}"


class ChartWhite:
    """The greys of a ColorChecker in the frame."""

    about, held = "of the greys of a ColorChecker", True

    def __init__(self, table: TransformTable) -> None:
        self._whites, self._table = Whites(table), table
        self._reflectance = charts.chart("classic", WAVELENGTH)[1]

    def white(self, frame: RawFrame) -> ChartSceneWhite:
        """The white of a frame; InputFileError if there is no chart in it, or no grey of one can be measured."""
        from l3cli.frames.chart import locate

        table, (rows, cols) = self._table, charts.CLASSIC
        mosaic = frame.shading_corrected().values - (frame.black_level + frame.dark)
        located = locate(mosaic, shifted_cfa(table.cfa, frame.phase), self._reflectance, charts.CLASSIC)
        if located is None or located.fit < SURE:
            raise InputFileError(
                f"{frame.name}: no ColorChecker of {rows}×{cols} patches is found in it; give ‹white› as the ROW,COL of a "
                "grey, or photograph the chart sharp, larger and evenly lit"
            )
        greys = list(_greys(frame, located))
        usable = [grey for grey in greys if self._whites.grey.usable(frame, grey)]
        made = self._whites.of_greys(frame, usable or greys)
        stated = None if frame.neutral is None else self._whites.of_neutral(np.array(frame.neutral))
        return ChartSceneWhite(made.balance, made.light, made.modelled, _place(frame, located), stated)


def _greys(frame: RawFrame, located: "Located") -> Iterator[Grey]:
    """The squares in the middle of neutral patches."""
    for patch in NEUTRALS:
        row, col = divmod(patch, charts.CLASSIC[1])
        middle = np.array([col + 0.5, row + 0.5])
        around = through(located.to_pixels, middle + CORE * np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]]))
        half = int(np.hypot(*(around[1:] - around[0]).T).min())
        left, top = (int(place) - half for place in np.rint(around[0]))
        where = slice(max(top, 0), max(top, 0) + 2 * half), slice(max(left, 0), max(left, 0) + 2 * half)
        yield Grey(f"{frame.name}: patch {patch + 1} of its ColorChecker", where)


def _place(frame: RawFrame, located: "Located") -> str:
    """Rows and columns of a chart in the upright picture."""
    corners = through(located.to_pixels, corner_cells(*charts.CLASSIC))
    cols, rows = (_turned(corners[:, axis], frame, axis) for axis in (0, 1))
    if frame.orientation & 4:
        rows, cols = cols, rows
    return f"rows {rows.min():.0f}–{rows.max():.0f}, columns {cols.min():.0f}–{cols.max():.0f}"


def _turned(places: NDArray[np.floating], frame: RawFrame, axis: int) -> NDArray[np.floating]:
    """Columns (axis 0) or rows of the sensor, mirrored as the picture is."""
    return frame.values.shape[1 - axis] - 1 - places if frame.orientation & (1, 2)[axis] else places
