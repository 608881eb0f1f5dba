"""numpy's .npy files of one frame (row, col) or several (frame, row, col)."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.arrays import map_array
from l3cli.io.raw.content import RawContent, Request, Stack
from l3cli.limits import require_picture

MOST_CHANNELS = 4  # of a picture; no frame is so narrow


def read(path: Path, _: Request) -> RawContent:
    """The frame of a file that holds one."""
    return RawContent(values=np.array(_mapped(path, 2)))


def stack(path: Path, _: Request) -> Stack | None:
    """The frames of a file with three axes."""
    shape = map_array(path).shape
    if len(shape) != 3:
        return None
    if shape[2] <= MOST_CHANNELS:
        raise InputFileError(
            f"{path} holds {shape[0]}×{shape[1]}×{shape[2]} values, as a picture of {shape[2]} channels; give a mosaic, "
            "rows × columns, or frames × rows × columns"
        )

    def frame(number: int) -> RawContent:
        return RawContent(values=np.array(_mapped(path, 3)[number]))  # pages of a mapping that is kept count as memory

    return Stack(len(_mapped(path, 3)), frame, numbered=False)


def _mapped(path: Path, axes: int) -> NDArray:
    """The array of a .npy file, mapped. InputFileError unless it has `axes` axes of DN, and frames of a size that may be."""
    values = map_array(path)
    if values.ndim != axes or values.dtype.kind != "u" or values.dtype.itemsize > 2:
        held = f"{values.ndim}-dimensional {values.dtype}"
        raise InputFileError(f"{path} holds {held}; give a uint16 array of rows × columns, or of frames × rows × columns")
    require_picture(str(path), *values.shape[-2:])
    return values
