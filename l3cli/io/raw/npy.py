"""Read raw frames from memory-mapped .npy files. An array is one frame, (row, col), or a stack, (frame, row, col)."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.io.raw.axes import frame_axes
from l3cli.system.files import require_regular
from l3cli.system.limits import require_picture


def map_array(path: Path) -> NDArray[Any]:
    """Memory-map the array in a .npy file.

    Raises InputFileError if the file is not a complete .npy file, or if it contains Python objects.
    """
    require_regular(path, "use a .npy file")
    try:
        with np.errstate(over="ignore"):  # the shape in a damaged header may be huge, and is rejected below
            values = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise InputFileError(f"{path} cannot be read: {error.strerror or error}; use a readable .npy file") from error
    except Exception as error:  # numpy parses the header as Python code, so a damaged header can raise anything
        raise InputFileError(f"{path} is not a complete .npy file; write it with numpy.save(file, array)") from error
    if not isinstance(values, np.ndarray):
        values.close()
        raise InputFileError(f"{path} is a numpy archive (.npz); save a single array with numpy.save")
    return values


def read(path: Path) -> RawContent:
    """Read a file with a single frame. Raises InputFileError for any other content."""
    shape = map_array(path).shape
    if len(shape) == 3:
        raise InputFileError(
            f"{path} contains {shape[0]} frames; specify this file as the only input, or use files with one frame each"
        )
    return RawContent(values=np.array(_mapped(path, 2)))


def stack(path: Path) -> MultiFrameFile | None:
    """Open an array with three axes as a stack. Return None for any other array."""
    shape = map_array(path).shape
    if len(shape) != 3:
        return None
    frame_axes(str(path), shape)

    def frame(number: int) -> RawContent:
        # Map the file again for each frame, because the pages of a permanent mapping would count as used memory.
        return RawContent(values=np.array(_mapped(path, 3)[number]))

    return MultiFrameFile(len(_mapped(path, 3)), frame, numbered=False)


def _mapped(path: Path, axes: int) -> NDArray:
    """Memory-map an array. Raises InputFileError if it is not numeric, is too large, or does not have `axes` axes."""
    values = map_array(path)
    if values.ndim != axes or values.dtype.kind not in "iuf":
        found = f"a {values.ndim}-dimensional array of {values.dtype}"
        raise InputFileError(f"{path} contains {found}; save a uint16 array (row, col) or (frame, row, col)")
    require_picture(str(path), *values.shape[-2:])
    return values
