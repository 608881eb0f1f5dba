"""The one interface of everything that renders, and the backends behind it."""

import importlib
from collections.abc import Iterable, Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError, suggestion
from l3cli.frames.frame import RawFrame
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

    `by_noise`: pixels of which a filter in time has left little noise are rendered by the table's quiet set, which must be
    there. `options` are the backend's: of "opencl" `device` and `variant` (OpenCLRenderer).
    """
    if backend not in BACKENDS:
        raise RecipeError(f'backend "{backend}" is unknown; {suggestion(backend, BACKENDS)}')
    module, _, name = BACKENDS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table, by_noise=by_noise, **options)
