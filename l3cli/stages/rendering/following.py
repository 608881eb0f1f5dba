"""Display of frames in memory: exposure and white as given, or as those of a rendered sequence."""

import itertools
from fractions import Fraction
from numbers import Real
from typing import TYPE_CHECKING

from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.io.pictures.registry import FLOAT_BITS
from l3cli.rendering.display import require_xyz
from l3cli.rendering.exposure import LightMeter, SteadyExposure
from l3cli.rendering.white.balance import SteadyWhite, WhiteBalance
from l3cli.rendering.white.source import WhiteSource, given_white, usual_balance
from l3cli.stages.rendering.chart_white import source_of
from l3cli.stages.rendering.frame_whites import FrameWhites
from l3cli.stages.rendering.rendition import Rendition, chosen_space
from l3cli.system.locks import ThreadLock

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable
    from l3cli.rendering.temporal.chunks import Chunks

ANY_RATE = Fraction(30)  # frames/s, where only one frame is measured
LEAST, MOST = 1e-9, 1e9  # times Y, of an exposure
DEPTHS = (8, 16, FLOAT_BITS)


def shown_as(
    table: "TransformTable", exposure: float | None, white: str | None, space: str, bits: int,
    estimated_by: "TransformTable | None" = None,
) -> tuple[Rendition, WhiteSource | None]:  # fmt: skip
    """Return the rendition of pictures, and the source of the frames' white; None: all have that of the rendition.
    `estimated_by`: as of source_of. RecipeError if there is no such exposure, white, space or depth, or the table's outputs
    are not X, Y, Z."""
    if exposure is not None and not (isinstance(exposure, Real) and LEAST <= exposure <= MOST):
        given_as = f"{exposure:g}" if isinstance(exposure, Real) else f'"{exposure}"'
        raise RecipeError(f"exposure {given_as} is not within {LEAST:g}…{MOST:g} times Y; leave it out: automatic")
    if bits not in DEPTHS:
        raise RecipeError(f"{bits} bits is not a depth of pictures; ask for 8, 16 or {FLOAT_BITS}")
    require_xyz(table.outputs)
    source = source_of(white, table, estimated_by) if white is not None else None
    given = None if source else given_white(white, table)
    shown = given.balance if given else usual_balance(table)
    return Rendition(shown, exposure, bits, chosen_space(space, bits == FLOAT_BITS)), source


class Following:
    """Frames in order, each with exposure scale and white balance. `source`: of the white, None: the rendition's; `rate`:
    frames/s at which both follow what is measured, None: both stay those of the first frame; `temporal`: what filters the
    frames in time."""

    def __init__(
        self, table: "TransformTable", rendition: Rendition, source: WhiteSource | None, rate: Fraction | None,
        temporal: "Chunks | None" = None,
    ) -> None:  # fmt: skip
        self._held, self._temporal = rate is None, temporal
        self._rate = rate or ANY_RATE
        self._fixed = rendition.exposure
        self._meter = LightMeter(table) if rendition.measures_exposure else None
        self._steady = SteadyExposure(self._rate)
        self._whites = FrameWhites(source, SteadyWhite(self._rate)) if source else None
        self._alone = ThreadLock()
        self._places = itertools.count()
        self._first: tuple[float, WhiteBalance | None] | None = None

    def shown(self, frame: RawFrame) -> tuple[RawFrame, float, WhiteBalance | None]:
        """The next frame, filtered, its scale, and its balance, None: the rendition's. InputFileError if its white cannot be
        taken."""
        with self._alone:
            measured = self._first if self._held and self._first is not None else self._measured(frame)
            return (self._temporal.filtered(next(self._places), frame) if self._temporal else frame), *measured

    def _measured(self, frame: RawFrame) -> tuple[float, WhiteBalance | None]:
        if self._whites:
            self._whites.measured(frame)
        balance = self._whites.balance if self._whites else None
        scale = self._steady.scale(self._meter.brightness(frame, balance)) if self._meter else self._fixed or 0.0
        self._first = scale, balance
        return self._first
