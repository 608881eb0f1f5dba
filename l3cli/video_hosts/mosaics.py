"""Common part of every host: a table that is open for mosaics of one size."""

import functools
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from l3cli.api import Renderer
from l3cli.errors import RecipeError
from l3cli.frames.correction import CameraFile, correction_in
from l3cli.frames.frame import RawFrame
from l3cli.io.raw.cfa_codes import codes_of
from l3cli.io.raw.files import RawOverrides, frame_of
from l3cli.rendering.raw_checks import beyond_converter
from l3cli.rendering.temporal.chunks import AnyOrder, filters
from l3cli.system.files import sha256
from l3cli.system.text import NoSuchNumber, Quantity

PIXELS = Quantity(0, 1_000_000, "pixels", whole=True)


@dataclass(frozen=True)
class Asked:
    """Options of a host that concern its frames, each as the option of `l3 render`; None: the default there."""

    black_level: float | None = None  # DN
    white_level: float | None = None  # DN
    phase: tuple[int, int] | None = None  # CFA row and column of pixel (0, 0)
    size: tuple[int, int] | None = None  # rows, columns of the frames; None: those of the table
    camera: str | None = None  # file of a model whose defects and flat field are corrected
    backend: str = "opencl"
    device: str | None = None


class Mosaics:
    """A table that is open for frames of one size. RecipeError, InputFileError or DeviceError if it cannot be."""

    def __init__(self, table: str, asked: Asked) -> None:
        self.renderer = Renderer(table, backend=asked.backend, device=asked.device)
        device = {} if asked.device is None else {"device": asked.device}
        self._filters = functools.partial(filters, asked.backend, self.renderer.table, **device)
        sensor = self.renderer.table
        self._size = asked.size or (sensor.rows, sensor.cols)
        model = None if asked.camera is None else CameraFile(Path(asked.camera).absolute(), sha256(Path(asked.camera)))
        correction = None if model is None else correction_in(model, sensor)
        self._known = RawOverrides(asked.black_level, asked.white_level, asked.phase, correction=correction)

    def require_size(self, rows: int, cols: int) -> None:
        """Raise RecipeError unless frames have the size that is expected: others may begin at another site of the array."""
        if (rows, cols) != self._size:
            raise RecipeError(
                f"frames of {rows}×{cols} pixels (rows × columns) are not of the {self._size[0]}×{self._size[1]} "
                f"expected; if they are meant, give ‹size› {rows}x{cols}, and ‹phase› if they begin at another CFA site"
            )

    def in_time(self, read: Callable[[int], RawFrame], cache: int) -> AnyOrder:
        """Return a temporal filter of frames that are asked for in any order; `read`: gives the raw frame of a number.
        RecipeError if the table does not know its camera's noise."""
        return AnyOrder(self._filters(), read, cache)

    def frame(self, values: NDArray[Any], order: str | None = None) -> RawFrame:
        """Return the raw frame of values (row, col) in DN. `order`: colours of a Bayer array from its first pixel on,
        "rggb", as the host states them, None: the table's. InputFileError if they do not fit."""
        pattern = {} if order is None else {"pattern": codes_of(order).reshape(2, 2)}
        table = self.renderer.table
        frame = frame_of("the frame", {"values": values, **pattern}, table, self._known)  # type: ignore[typeddict-item]
        if text := beyond_converter(frame, table):
            warnings.warn(f"{frame.name}: {text}", stacklevel=2)
        return frame


def pair(text: str, separator: str, name: str) -> tuple[int, int] | None:
    """Return two whole numbers, "720x1280" or "0,1"; None where there is no text. RecipeError if it is something else."""
    if not text:
        return None
    try:
        first, second = (int(PIXELS.read(part)) for part in text.split(separator))
    except (NoSuchNumber, ValueError):
        raise RecipeError(f'{name} "{text}" is not two whole numbers with "{separator}" between them') from None
    return first, second
