"""Read raw frames from numpy's .npy files: one frame (row, col) or several (frame, row, col). Files are memory-mapped."""

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
    """Map the array of a .npy file.

    Raises InputFileError if the file is not a complete .npy file, or if it contains objects, which would be unpickled.
    """
    require_regular(path, "give a .npy file")
    try:
        with np.errstate(over="ignore"):  # an absurdly large shape is rejected anyway
            values = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # a damaged header makes Python's tokenizer raise various exceptions
        raise InputFileError(f"{path} is not a whole .npy file; write it with numpy.save(file, array)") from error
    if not isinstance(values, np.ndarray):
        values.close()
        raise InputFileError(f"{path} is an archive; give one .npy array")
    return values


def read(path: Path) -> RawContent:
    """Read the frame of a file that contains one."""
    shape = map_array(path).shape
    if len(shape) == 3:
        raise InputFileError(f"{path} holds {shape[0]} frames; give it alone, or give files of one frame each")
    return RawContent(values=np.array(_mapped(path, 2)))


def stack(path: Path) -> MultiFrameFile | None:
    """Return the frames of a file with three axes."""
    shape = map_array(path).shape
    if len(shape) != 3:
        return None
    frame_axes(str(path), shape)

    def frame(number: int) -> RawContent:
        # Mapped anew, because pages of a kept mapping count as memory.
        return RawContent(values=np.array(_mapped(path, 3)[number]))

    return MultiFrameFile(len(_mapped(path, 3)), frame, numbered=False)


def _mapped(path: Path, axes: int) -> NDArray:
    """Map the array of a .npy file. Raises InputFileError unless it has `axes` axes of numbers with acceptable sizes."""
    values = map_array(path)
    if values.ndim != axes or values.dtype.kind not in "iuf":
        held = f"{values.ndim}-dimensional {values.dtype}"
        raise InputFileError(f"{path} holds {held}; give a uint16 array of rows × columns, or of frames × rows × columns")
    require_picture(str(path), *values.shape[-2:])
    return values
