"""The common interface of all renderers, and the choice of the backend."""

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

# To add a backend, write a class that is constructed from a TransformTable, and add a line here. Its module is imported only
# if the backend is used.
BACKENDS = {
    "opencl": "l3cli.rendering.opencl.renderer:OpenCLRenderer",
    "reference": "l3cli.rendering.reference:ReferenceRenderer",
}

MAX_HELD = 16  # largest number of renderers that are kept, one per gain, each with its transforms on the device


class Renderer(Protocol):
    """A renderer for one table. It keeps everything that does not change from frame to frame."""

    @property
    def table(self) -> TransformTable: ...

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        """Return the class (row, col) of every pixel in a layer of the table. It is the same for all backends."""

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Return the outputs (output, row, col) of the table, at the size of the frame."""

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], Sequence[NDArray[np.integer]]]:
        """Return the outputs, and the classes of the first layer and, if there are several layers, of the last layer."""

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """Return the frame as a picture (row, col, 3) in uint8 or uint16.

        Raises RecipeError unless the outputs are X, Y, Z or GREY.
        """

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Return the picture of each frame, in order. The next picture may be computed while the caller uses one."""


def make_ready(backend: str, **options: str | None) -> None:
    """Prepare a backend for any table: import modules, find the device, start its compiler.

    This takes about as long as reading a table, and may run in parallel with it. Errors are left to `make_renderer`, which
    takes the same `options`.
    """
    importlib.import_module(BACKENDS[backend].partition(":")[0])
    if backend == "opencl":
        from l3cli.rendering.opencl import programs

        programs.make_ready(**options)


def make_renderer(backend: str, table: TransformTable, by_noise: bool = False, **options: str | None) -> Renderer:
    """Return a renderer for a table.

    Parameters
    ----------
    backend : str
        "opencl" or "reference".
    table : TransformTable
    by_noise : bool
        Whether pixels with less noise, after a temporal filter, are rendered with the table's transforms for less noise.
    **options
        Options of the backend: `device` and `variant` for "opencl" (see OpenCLRenderer).

    Raises
    ------
    RecipeError
        If the backend is unknown.
    DeviceError
        If no device is found.
    """
    if backend not in BACKENDS:
        raise RecipeError(f'backend "{backend}" is unknown; {suggestion(backend, BACKENDS)}')
    module, _, name = BACKENDS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table, by_noise=by_noise, **options)


class NoiseRenderer:
    """Renderer for frames with any analog gain and noise.

    A frame is rendered with the transforms for its analog gain. After a temporal filter, each pixel is rendered with the
    transforms for its remaining noise. If the table has no transforms for less noise, the class edges are adjusted to the
    frame's fraction of noise instead.
    """

    def __init__(self, backend: str, table: TransformTable, **options: str | None) -> None:
        self.table, self._backend, self._options = table, backend, options
        self._renderers: dict[tuple[float, float | None], Renderer] = {}  # by gain and noise fraction (None: per pixel)
        self._tables: dict[float, TransformTable] = {}  # gain → table
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
        """Return the gain and the noise fraction for which a frame is rendered. The fraction is None if it is per pixel."""
        gain = nearest_step(frame.gain)
        by_pixel = frame.noise_left is not None and bool(noise_limits(self._table(gain)))
        return gain, None if by_pixel else frame.noise_share

    def of_frame(self, frame: RawFrame) -> Renderer:
        """Return a renderer with a single set of transforms, for the gain and the mean noise fraction of a frame."""
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
        """Yield the picture of each frame. On the device, the work of consecutive frames with equal noise overlaps."""
        shared = ((self._noise(frame), (frame, display)) for frame, display in frames)
        for noise, run in itertools.groupby(shared, key=itemgetter(0)):
            yield from self._of(noise).pictures(each for _, each in run)


def _make_room(held: dict[Any, Any]) -> None:
    """Drop the oldest entry if there are too many."""
    if len(held) == MAX_HELD:
        del held[next(iter(held))]
