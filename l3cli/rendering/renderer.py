"""The common interface of all renderers, and functions that create a renderer."""

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

# To add a backend, write a class whose constructor takes a TransformTable, and add a line here. A module is imported only if
# its backend is used.
BACKENDS = {
    "opencl": "l3cli.rendering.opencl.renderer:OpenCLRenderer",
    "reference": "l3cli.rendering.reference:ReferenceRenderer",
}

MAX_HELD = 16  # largest number of cached renderers; each renderer stores its transforms on the device


class Renderer(Protocol):
    """A renderer for one table. Everything that does not depend on the frame is prepared once."""

    @property
    def table(self) -> TransformTable: ...

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        """Return the class of every pixel as an array (row, col). Layers are counted from 0.

        All backends return the same classes.
        """

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Render a frame, and return the outputs of the table as an array (output, row, col)."""

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], Sequence[NDArray[np.integer]]]:
        """Return the outputs, and a list with the class maps (row, col) of the first and the last layer.

        For a table with a single layer, the list contains one class map.
        """

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """Render a frame as a picture (row, col, 3) in uint8 or uint16.

        Raises a RecipeError unless the outputs of the table are X, Y and Z, only Y, or Stokes parameters.
        """

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Yield the picture of each frame, in the order of the frames.

        While the caller uses a picture, the next picture may already be computed.
        """

    def encoded(self, outputs: NDArray[np.float32], display: Display) -> NDArray:
        """Encode outputs that were changed after rendering, such as filtered outputs, as a picture.

        Raises a RecipeError unless the outputs of the table are X, Y and Z, only Y, or Stokes parameters.
        """


def make_ready(backend: str, **options: str | None) -> None:
    """Prepare a backend before the table is known: import modules, find the device, and start the compiler.

    This takes about as long as reading a table, and can be done at the same time in another thread.

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
        Whether to choose the set of transforms pixel by pixel. If a temporal filter has reduced the noise of a pixel, the
        pixel is then rendered with transforms that were trained at a similarly low noise.
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
    """Renderer for frames with any analog gain and any noise.

    Each frame is rendered with the transforms for its analog gain. If a temporal filter has reduced the noise of the frame,
    each pixel is rendered with the transforms for its remaining noise. If the table has no transforms that were trained at
    lower noise, the class edges are adapted to the mean noise of the frame.

    Parameters
    ----------
    backend, table, **options
        The same as for `make_renderer`.
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
        """Return the analog gain and the noise fraction that determine the transforms for a frame.

        The noise fraction is None if the transforms are chosen for each pixel.
        """
        gain = nearest_step(frame.gain)
        by_pixel = frame.noise_left is not None and bool(noise_limits(self._table(gain)))
        return gain, None if by_pixel else frame.noise_share

    def of_frame(self, frame: RawFrame) -> Renderer:
        """Return a renderer with a single set of transforms, which match the gain and the mean noise fraction of a frame."""
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
        """Yield the picture of each frame. Consecutive frames with the same noise are processed in parallel."""
        shared = ((self._noise(frame), (frame, display)) for frame, display in frames)
        for noise, run in itertools.groupby(shared, key=itemgetter(0)):
            yield from self._of(noise).pictures(each for _, each in run)

    def encoded(self, outputs: NDArray[np.float32], display: Display) -> NDArray:
        return self._of((1.0, 1.0)).encoded(outputs, display)


def _make_room(held: dict[Any, Any]) -> None:
    """Remove the oldest entry if the cache contains `MAX_HELD` entries."""
    if len(held) == MAX_HELD:
        del held[next(iter(held))]
