"""The interface of all renderers, and functions that create one."""

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

# To add a backend, write a class that implements `Renderer` and accepts a table and `by_noise`, and add a line here. The
# module is imported only when the backend is used.
BACKENDS = {
    "opencl": "l3cli.rendering.opencl.renderer:OpenCLRenderer",
    "reference": "l3cli.rendering.reference:ReferenceRenderer",
}

MAX_HELD = 16  # maximum number of cached renderers, which occupy device memory


class Renderer(Protocol):
    """A renderer for one table. It prepares everything that does not depend on the frame when it is created."""

    @property
    def table(self) -> TransformTable: ...

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        """Return the class map (row, col) of a layer. It is the same for all backends. Layer 0 reads the raw frame."""

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Render a frame to the outputs of the table, (output, row, col)."""

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], Sequence[NDArray[np.integer]]]:
        """Return the outputs and the class maps (row, col) of the first and last layers.

        A table with a single layer has a single class map.
        """

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """Render a frame to a picture (row, col, 3) in uint8 or uint16.

        Raises RecipeError unless the table's outputs are X, Y and Z, only Y, or Stokes parameters.
        """

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Yield the picture of each frame, in order.

        The next picture may be computed while the caller processes the current one.
        """

    def encoded(self, outputs: NDArray[np.float32], display: Display) -> NDArray:
        """Encode outputs (output, row, col), for example after lens correction, as a picture (row, col, 3).

        Raises RecipeError unless the table's outputs are X, Y and Z, only Y, or Stokes parameters.
        """


def make_ready(backend: str, **options: str | None) -> None:
    """Prepare a backend without a table: import modules, find the device, and warm up the compiler.

    This takes about as long as reading a table, and can run at the same time in another thread.

    Parameters
    ----------
    backend : str
        "opencl" or "reference".
    **options
        Options of the backend, as in `make_renderer`.
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
        Table that renders the frames.
    by_noise : bool
        If True, each pixel uses the transforms for its noise after the temporal filter. If False, all pixels use the
        transforms for the camera's full noise.
    **options
        Options of the backend. "opencl" has the options `device` and `variant` (see `OpenCLRenderer`).

    Returns
    -------
    Renderer

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
    """Renderer that adapts its table to the analog gain and noise of each frame.

    In temporally filtered frames, each pixel uses the transforms for its noise after the filter. If the table has no
    transforms for low noise, the class thresholds are instead adapted to the frame's mean noise.

    Parameters
    ----------
    backend, table, **options
        As in `make_renderer`.
    """

    def __init__(self, backend: str, table: TransformTable, **options: str | None) -> None:
        self.table, self._backend, self._options = table, backend, options
        self._renderers: dict[tuple[float, float | None], Renderer] = {}  # result of `_noise` → renderer
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
        """Return the analog gain and noise fraction that determine a frame's transforms.

        The noise fraction is None if each pixel has its own.
        """
        gain = nearest_step(frame.gain)
        by_pixel = frame.noise_left is not None and bool(noise_limits(self._table(gain)))
        return gain, None if by_pixel else frame.noise_share

    def of_frame(self, frame: RawFrame) -> Renderer:
        """Return a renderer with a single set of transforms, for a frame's gain and mean noise fraction."""
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
        """Yield the picture of each frame. Consecutive frames with the same noise share a renderer and are pipelined."""
        shared = ((self._noise(frame), (frame, display)) for frame, display in frames)
        for noise, run in itertools.groupby(shared, key=itemgetter(0)):
            yield from self._of(noise).pictures(each for _, each in run)

    def encoded(self, outputs: NDArray[np.float32], display: Display) -> NDArray:
        return self._of((1.0, 1.0)).encoded(outputs, display)


def _make_room(held: dict[Any, Any]) -> None:
    """Remove the oldest entry of a cache that has `MAX_HELD` entries."""
    if len(held) == MAX_HELD:
        del held[next(iter(held))]
