"""The one interface of everything that renders, and the backends behind it."""

import importlib
import itertools
from collections.abc import Iterable, Iterator
from operator import itemgetter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError, suggestion
from l3cli.frames.frame import RawFrame
from l3cli.rendering.conditions import with_edges_for
from l3cli.rendering.display import Display

# A new backend is one class, made from a TransformTable, and one line here; its module is imported when it is asked for.
BACKENDS = {
    "opencl": "l3cli.rendering.opencl.renderer:OpenCLRenderer",
    "reference": "l3cli.rendering.reference:ReferenceRenderer",
}


class Renderer(Protocol):
    """Renders frames through the table it was made from; keeps whatever is the same from frame to frame."""

    @property
    def table(self) -> TransformTable: ...

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        """Class (row, col) of every pixel in a layer of the table, equal for every backend."""

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Outputs of the table, (output, row, col), of the frame's size."""

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """The frame as sRGB (row, col, 3), uint8 or uint16 as the display says.

        RecipeError unless the table's outputs are X, Y, Z.
        """

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """The picture of each frame, in order; while the caller uses one the next may be computed."""


def make_ready(backend: str, **options: str | None) -> None:
    """Do what making a renderer takes for any table: import what it needs, find its device, wake the device's compiler. It
    takes as long as reading a table, beside which it can be done; whatever is wrong is said by `make_renderer`, whose
    `options` these are."""
    importlib.import_module(BACKENDS[backend].partition(":")[0])
    if backend == "opencl":
        from l3cli.rendering.opencl import programs

        programs.make_ready(**options)


def make_renderer(backend: str, table: TransformTable, by_noise: bool = False, **options: str | None) -> Renderer:
    """The renderer called `backend` for a table. RecipeError if there is none, DeviceError if it finds no device.

    `by_noise`: pixels of which a filter in time has left little noise are rendered by the table's transforms for that.
    `options` are the backend's: of "opencl" `device` and `variant` (OpenCLRenderer).
    """
    if backend not in BACKENDS:
        raise RecipeError(f'backend "{backend}" is unknown; {suggestion(backend, BACKENDS)}')
    module, _, name = BACKENDS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table, by_noise=by_noise, **options)


class NoiseRenderer:
    """Renderer of a backend (`make_renderer`) for frames of any noise.

    A frame of all its camera's noise is rendered as if there were no other transforms; one that a filter in time has left
    less by those that the noise of each pixel asks for or, of a table that has none for less, with class edges that its
    share of noise asks for.
    """

    def __init__(self, backend: str, table: TransformTable, **options: str | None) -> None:
        self.table, self._backend, self._options = table, backend, options
        self._renderers: dict[float | None, Renderer] = {}  # by share of noise; None: by pixel
        self._of(1.0)

    def _of(self, share: float | None) -> Renderer:
        if share not in self._renderers:
            table = self.table if share in (None, 1.0) else with_edges_for(self.table, share)
            self._renderers[share] = make_renderer(self._backend, table, share is None, **self._options)
        return self._renderers[share]

    def _share(self, frame: RawFrame) -> float | None:
        """Return what a frame is rendered by."""
        return None if self.table.noises and frame.noise_left is not None else frame.noise_share

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.integer]:
        return self._of(self._share(frame)).labels(frame, layer)

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        return self._of(self._share(frame)).outputs(frame)

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        return self._of(self._share(frame)).picture(frame, display)

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """The picture of each frame; those that follow one another with the same noise overlap on the device."""
        shared = ((self._share(frame), (frame, display)) for frame, display in frames)
        for share, run in itertools.groupby(shared, key=itemgetter(0)):
            yield from self._of(share).pictures(each for _, each in run)
