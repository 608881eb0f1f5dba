"""Read frames in MATLAB files: a variable (row, col) or (row, col, frame), with scipy or, for version 7.3, as HDF5.

MATLAB users store stacks as (row, col, frame). Files of version 5 written by Python (scipy.io.savemat) keep numpy's order
(frame, row, col). The text at the beginning of a file states the platform that wrote it.
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

OF_PYTHON = (b"Platform: posix", b"Platform: nt")
HDF5_VERSION = b"MATLAB 7.3 MAT-file"
TEXT = 116  # bytes of text at the beginning, which name the program that wrote the file
COUNTS, NUMBERS = ("uint8", "uint16"), ("uint8", "uint16", "int16", "int32", "uint32", "single", "double")
BYTES = {"uint8": 1, "int16": 2, "uint16": 2, "double": 8}  # bytes per value; 4 for all other types
LEAST_SIDE = 8  # smallest number of rows and columns; smaller variables are settings

_loaded: dict[tuple[Any, ...], NDArray] = {}  # the last array, with the identity of its file as key


def stack(path: Path, dataset: str | None) -> MultiFrameFile:
    """Return the frames of a variable: the array named `dataset`, or the only array in the file."""
    with open_regular(path) as stream:
        text = stream.read(TEXT)
    if text.startswith(HDF5_VERSION):
        return hdf5.stack(path, dataset)
    of_python = any(platform in text for platform in OF_PYTHON)
    name, count = find_variable(path, dataset, of_python)
    return MultiFrameFile(count, lambda number: RawContent(values=frame(path, name, of_python, number)), numbered=False)


@isolated("scipy.io")
def find_variable(path: Path, dataset: str | None, of_python: bool) -> tuple[str, int]:
    """Return the name of a variable and its number of frames.

    Raises InputFileError if it does not exist, or if it is a picture with several channels.
    """
    import scipy.io

    held = {name: (shape, kind) for name, shape, kind in scipy.io.whosmat(path)}
    name = _only_variable(path, held) if dataset is None else dataset
    shape, kind = held.get(name, ((), "no variable"))
    if kind not in NUMBERS or len(shape) not in (2, 3):
        raise InputFileError(f"{path}: {name} is {kind} {shape}; name with ‹dataset› an array (row, col, frame)")
    axes = _axes(path, name, shape, of_python)
    require_picture(f"{path}: {name}", shape[axes.row], shape[axes.col])
    require_values(f"{path}: {name}", shape, BYTES.get(kind, 4))
    return name, 1 if axes.frame is None else shape[axes.frame]


@isolated("scipy.io")
def frame(path: Path, name: str, of_python: bool, number: int) -> NDArray:
    """Read a frame (row, col) of a variable found by `find_variable`."""
    import scipy.io

    key = (str(path), *stamp(path), name)
    if key not in _loaded:
        _loaded.clear()
        _loaded[key] = scipy.io.loadmat(path, variable_names=[name])[name]
    values = _loaded[key]
    axes = _axes(path, name, values.shape, of_python)
    one = values if axes.frame is None else np.take(values, number, axes.frame)
    return np.ascontiguousarray(one, one.dtype.newbyteorder("="))


def _axes(path: Path, name: str, shape: tuple[int, ...], of_python: bool) -> Axes:
    if of_python or len(shape) == 2:
        return frame_axes(f"{path}: {name}", shape)
    if shape[2] == 3:
        raise InputFileError(f"{path}: {name} holds {shape} values, as a picture of 3 channels; give the mosaic")
    return Axes(2, 0, 1)


def _only_variable(path: Path, held: dict[str, tuple[tuple[int, ...], str]]) -> str:
    """Return the only array of integers of at most 16 bits or, without one, of any numbers."""
    arrays = sorted(name for name, (shape, kind) in held.items() if kind in NUMBERS and _is_stack(shape))
    chosen = [name for name in arrays if held[name][1] in COUNTS] or arrays
    if len(chosen) != 1:
        content = f"{len(chosen)} arrays ({', '.join(chosen[:4])})" if chosen else "no array (row, col, frame)"
        raise InputFileError(f"{path} holds {content}; name one with ‹dataset›")
    return chosen[0]


def _is_stack(shape: tuple[int, ...]) -> bool:
    return len(shape) in (2, 3) and sorted(shape)[-2] >= LEAST_SIDE
