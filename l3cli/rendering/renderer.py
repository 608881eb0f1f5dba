"""The one interface of everything that renders, and the backends behind it."""

import importlib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from operator import itemgetter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError, suggestion
from l3cli.frames.frame import RawFrame
from l3cli.rendering.conditions import at_gain, nearest_step, noise_limits, with_edges_for
from l3cli.rendering.display import Display

# A new backend is one class, made from a TransformTable, and one line here; its module is imported when it is asked for.
BACKENDS = {
    "opencl": "l3cli.rendering.opencl.renderer:OpenCLRenderer",
    "reference": "l3cli.rendering.reference:ReferenceRenderer",
}

MOST_HELD = 16  # renderers, each with its transforms on the device: gains that a sequence goes through


class Renderer(Protocol):
    """Renderer of frames through the table it was made from, which keeps whatever is the same from frame to frame."""

    @property
    def table(self) -> TransformTable: ...

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        """Return class (row, col) of every pixel in a layer of the table, equal for every backend."""

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Return outputs of the table, (output, row, col), of the frame's size."""

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], Sequence[NDArray[np.integer]]]:
        """Return `outputs`, and `labels` of the first layer and, if there are more, of the last."""

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """Return the frame as sRGB (row, col, 3), uint8 or uint16 as the display says. RecipeError unless outputs are X, Y,
        Z."""

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Return the picture of each frame, in order; while the caller uses one the next may be computed."""


def make_ready(backend: str, **options: str | None) -> None:
    """Prepare what a renderer of any table takes: import what it needs, find its device, wake the device's compiler. It
    takes as long as reading a table, beside which it can be done; whatever is wrong is said by `make_renderer`, whose
    `options` these are."""
    importlib.import_module(BACKENDS[backend].partition(":")[0])
    if backend == "opencl":
        from l3cli.rendering.opencl import programs

        programs.make_ready(**options)


def make_renderer(backend: str, table: TransformTable, by_noise: bool = False, **options: str | None) -> Renderer:
    """Return the renderer called `backend` for a table. RecipeError if there is none, DeviceError if it finds no device.

    `by_noise`: pixels of which a filter in time has left little noise are rendered by the table's transforms for that.
    `options` are the backend's: of "opencl" `device` and `variant` (OpenCLRenderer).
    """
    if backend not in BACKENDS:
        raise RecipeError(f'backend "{backend}" is unknown; {suggestion(backend, BACKENDS)}')
    module, _, name = BACKENDS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table, by_noise=by_noise, **options)


class NoiseRenderer:
    """Renderer of a backend (`make_renderer`) for frames of any noise.

    A frame is rendered by the transforms for its analog gain. One that a filter in time has left less noise is so by those
    that the noise of each pixel asks for or, of a table that has none for less, with class edges that its share of noise
    asks for.
    """

    def __init__(self, backend: str, table: TransformTable, **options: str | None) -> None:
        self.table, self._backend, self._options = table, backend, options
        self._renderers: dict[tuple[float, float | None], Renderer] = {}  # by gain and share of noise; None: by pixel
        self._tables: dict[float, TransformTable] = {}  # by gain
        self._of((1.0, 1.0))

    def _table(self, gain: float) -> TransformTable:
        if gain not in self._tables:
            _make_room(self._tables)
            self._tables[gain] = at_gain(self.table, gain)
        return self._tables[gain]

    def _of(self, noise: tuple[float, float | None]) -> Renderer:
        if noise not in self._renderers:
            gain, share = noise
            table = self._table(gain) if share in (None, 1.0) else with_edges_for(self._table(gain), share)
            _make_room(self._renderers)
            self._renderers[noise] = make_renderer(self._backend, table, share is None, **self._options)
        return self._renderers[noise]

    def _noise(self, frame: RawFrame) -> tuple[float, float | None]:
        """Return what a frame is rendered by."""
        gain = nearest_step(frame.gain)
        by_pixel = frame.noise_left is not None and bool(noise_limits(self._table(gain)))
        return gain, None if by_pixel else frame.noise_share

    def of_frame(self, frame: RawFrame) -> Renderer:
        """Return the renderer by the one set of transforms for the gain and the mean share of noise of a frame."""
        return self._of((nearest_step(frame.gain), frame.noise_share))

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        return self._of(self._noise(frame)).labels(frame, layer)

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        return self._of(self._noise(frame)).outputs(frame)

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], Sequence[NDArray[np.integer]]]:
        return self._of(self._noise(frame)).classified(frame)

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        return self._of(self._noise(frame)).picture(frame, display)

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Yield the picture of each frame; those that follow one another with the same noise overlap on the device."""
        shared = ((self._noise(frame), (frame, display)) for frame, display in frames)
        for noise, run in itertools.groupby(shared, key=itemgetter(0)):
            yield from self._of(noise).pictures(each for _, each in run)


def _make_room(held: dict[Any, Any]) -> None:
    """Drop the oldest of what is held by gain, if there are too many."""
    if len(held) == MOST_HELD:
        del held[next(iter(held))]
