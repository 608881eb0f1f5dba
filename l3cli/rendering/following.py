"""Exposure and white of frames in their order: as given, or as they follow what is measured."""

import itertools
from fractions import Fraction
from typing import TYPE_CHECKING

from l3cli.frames.frame import RawFrame
from l3cli.rendering.exposure import LightMeter, SteadyExposure
from l3cli.rendering.rendition import Rendition
from l3cli.rendering.white.balance import SteadyWhite, WhiteBalance
from l3cli.rendering.white.scene_white import SceneWhite
from l3cli.rendering.white.source import WhiteSource
from l3cli.system.locks import ThreadLock

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable
    from l3cli.rendering.temporal.chunks import Chunks

ANY_RATE = Fraction(30)  # frames/s, where only one frame is measured


class FrameWhites:
    """Measures frames in their order. `steady`: the balance follows from frame to frame, or stays that of the first one if
    the source is held; without it each frame has its own."""

    def __init__(self, source: WhiteSource, steady: SteadyWhite | None) -> None:
        self._source, self._steady = source, steady
        self._first: SceneWhite | None = None
        self.balance: WhiteBalance | None = None  # of the last frame measured; None: there was nothing to tell it by

    def measured(self, frame: RawFrame) -> SceneWhite | None:
        """White of the next frame, None where there is nothing to tell it by; InputFileError if it cannot be taken."""
        if self._steady is None:
            white = self._source.white(frame)
            self.balance = white.balance if white else None
            return white
        if self._first is not None and self._source.held:
            return self._first
        white = self._source.white(frame)
        self._first = self._first or white
        self.balance = self._steady.balance(white.balance if white else None)
        return white


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
