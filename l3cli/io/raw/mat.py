"""Read frames from MATLAB files: a variable (row, col) or (row, col, frame).

Version 7.3 files are read as HDF5, and earlier versions with scipy. MATLAB users store stacks in the order (row, col,
frame), whereas version 5 files written by Python (scipy.io.savemat) use the order (frame, row, col). The text at the
beginning of a file names the program that wrote it.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.isolated import isolated
from l3cli.io.raw import MultiFrameFile, RawContent, hdf5
from l3cli.io.raw.axes import Axes, frame_axes
from l3cli.system.files import open_regular, stamp
from l3cli.system.limits import require_picture, require_values

PYTHON_PLATFORMS = (b"Platform: posix", b"Platform: nt")
HDF5_VERSION = b"MATLAB 7.3 MAT-file"
TEXT = 116  # length in bytes of the text at the beginning of a file, which names the program that wrote it
COUNTS, NUMBERS = ("uint8", "uint16"), ("uint8", "uint16", "int16", "int32", "uint32", "single", "double")
BYTES = {"uint8": 1, "int16": 2, "uint16": 2, "double": 8}  # type → bytes per value; all other types have 4 bytes
LEAST_SIDE = 8  # minimum number of rows and columns in a frame, because smaller variables contain settings

_loaded: dict[tuple[Any, ...], NDArray] = {}  # identity of the last file and name of the last variable → values


def stack(path: Path, dataset: str | None) -> MultiFrameFile:
    """Open the frames in the variable `dataset` or, if this is None, in the only array of frames."""
    with open_regular(path) as stream:
        text = stream.read(TEXT)
    if text.startswith(HDF5_VERSION):
        return hdf5.stack(path, dataset)
    from_python = any(platform in text for platform in PYTHON_PLATFORMS)
    name, count = find_variable(path, dataset, from_python)
    return MultiFrameFile(count, lambda number: RawContent(values=frame(path, name, from_python, number)), numbered=False)


@isolated("scipy.io")
def find_variable(path: Path, dataset: str | None, from_python: bool) -> tuple[str, int]:
    """Return the name of the variable with the frames, and its number of frames.

    Parameters
    ----------
    path : Path
        MATLAB file of a version before 7.3.
    dataset : str or None
        Name of the variable. If None, the file must contain only one array of frames.
    from_python : bool
        Whether Python wrote the file. Files from MATLAB have a different order of axes.

    Raises
    ------
    InputFileError
        If the variable does not exist, is not an array of frames, is too large, or contains a picture with several channels.
    """
    import scipy.io

    variables = {name: (shape, kind) for name, shape, kind in scipy.io.whosmat(path)}
    name = _only_variable(path, variables) if dataset is None else dataset
    if name not in variables:
        raise InputFileError(f'{path} contains no variable "{name}"; set ‹dataset› to an array (row, col, frame)')
    shape, kind = variables[name]
    if kind not in NUMBERS or len(shape) not in (2, 3):
        raise InputFileError(
            f'{path}: the variable "{name}" is {kind} of shape {shape}; set ‹dataset› to an array (row, col, frame)'
        )
    axes = _axes(path, name, shape, from_python)
    require_picture(f"{path}: {name}", shape[axes.row], shape[axes.col])
    require_values(f"{path}: {name}", shape, BYTES.get(kind, 4))
    return name, 1 if axes.frame is None else shape[axes.frame]


@isolated("scipy.io")
def frame(path: Path, name: str, from_python: bool, number: int) -> NDArray:
    """Read frame `number` (counted from 0) in the variable that `find_variable` returned, as an array (row, col)."""
    import scipy.io

    key = (str(path), *stamp(path), name)
    if key not in _loaded:
        _loaded.clear()
        _loaded[key] = scipy.io.loadmat(path, variable_names=[name])[name]
    values = _loaded[key]
    axes = _axes(path, name, values.shape, from_python)
    one = values if axes.frame is None else np.take(values, number, axes.frame)
    return np.ascontiguousarray(one, one.dtype.newbyteorder("="))


def _axes(path: Path, name: str, shape: tuple[int, ...], from_python: bool) -> Axes:
    if from_python or len(shape) == 2:
        return frame_axes(f"{path}: {name}", shape)
    if shape[2] == 3:
        raise InputFileError(
            f'{path}: the variable "{name}" has shape {shape}, which looks like a picture with 3 channels; use the mosaic'
        )
    return Axes(2, 0, 1)


def _only_variable(path: Path, variables: dict[str, tuple[tuple[int, ...], str]]) -> str:
    """Return the name of the only array of type uint8 or uint16 or, if there is none, of any numeric type.

    Raises InputFileError if the file contains no suitable array, or more than one.
    """
    arrays = sorted(name for name, (shape, kind) in variables.items() if kind in NUMBERS and _is_stack(shape))
    chosen = [name for name in arrays if variables[name][1] in COUNTS] or arrays
    if len(chosen) != 1:
        content = f"{len(chosen)} arrays ({', '.join(chosen[:4])})" if chosen else "no array (row, col, frame)"
        raise InputFileError(f"{path} contains {content}; select the variable with ‹dataset›")
    return chosen[0]


def _is_stack(shape: tuple[int, ...]) -> bool:
    return len(shape) in (2, 3) and sorted(shape)[-2] >= LEAST_SIDE
