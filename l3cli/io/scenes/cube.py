"""Spectral cubes as arrays of MATLAB, HDF5 and .npy files, of which the last name no wavelengths."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.scene import SpectralCube
from l3cli.io.raw.npy import map_array
from l3cli.io.scenes.matlab import Content, array_shapes, read_content, variable_of

WAVELENGTH_NAMES = ("wave", "wavelength", "wavelengths", "wavelength_nm", "wavelengths_nm", "lambda", "wl", "bands", "wlens")


def read(path: Path, variable: str | None, axes: str) -> SpectralCube:
    """Return the cube `variable` (None: the only one) of a file whose axes are those named by `axes`."""
    content: Content = {"values": map_array(path)} if _is_npy(path) else read_content(path)
    if variable is None:
        cubes = _cubes(content)
        if len(cubes) != 1:
            names = ", ".join(cubes) or "none"
            raise InputFileError(f"{path} must hold one cube of three axes or variable name it (there: {names})")
        values = next(iter(cubes.values()))
    else:
        values = variable_of(content, variable)
    if not isinstance(values, np.ndarray) or values.ndim != 3 or values.dtype.kind not in "fiu":
        raise InputFileError(f'{path} holds no cube "{variable}" of three axes; name another variable')
    order = axes.split()
    values = values.transpose([order.index(axis) for axis in ("row", "col", "band")])
    return SpectralCube(values, _wavelengths(content))


def size(path: Path, variable: str | None, axes: str) -> tuple[int, int]:
    """(rows, cols) of what `read` reads, from headers where they hold it; InputFileError as there."""
    shapes = {"values": map_array(path).shape} if _is_npy(path) else array_shapes(path)
    shape = _size_in(shapes, variable, axes)
    if shape is None:
        rows, cols, _ = read(path, variable, axes).values.shape  # which says what is wrong
        return rows, cols
    return shape


def _is_npy(path: Path) -> bool:
    return path.suffix.lower() == ".npy"


def _size_in(shapes: dict[str, tuple[int, ...]], variable: str | None, axes: str) -> tuple[int, int] | None:
    """(rows, cols) of the cube among arrays of these shapes; None if they do not say."""
    wanted = (variable or "").replace(".", "/").strip("/")
    candidates = [shape for name, shape in shapes.items() if len(shape) == 3 and (variable is None or name == wanted)]
    if len(candidates) != 1:
        return None
    order = axes.split()
    return candidates[0][order.index("row")], candidates[0][order.index("col")]


def _cubes(content: Content, prefix: str = "") -> dict[str, NDArray]:
    cubes: dict[str, NDArray] = {}
    for name, value in content.items():
        if isinstance(value, dict):
            cubes |= _cubes(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and value.ndim == 3 and value.dtype.kind in "fiu":
            cubes[prefix + name] = value
    return cubes


def _wavelengths(content: Content) -> NDArray[np.float64] | None:
    """Return the first list of numbers under one of the usual names."""
    for name, value in content.items():
        if name.lower() in WAVELENGTH_NAMES and np.size(value) > 1 and np.asarray(value).dtype.kind in "fiu":
            return np.asarray(value, float).ravel()
    return None
