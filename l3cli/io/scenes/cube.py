"""Spectral cubes as arrays of MATLAB, HDF5 and .npy files, of which the last name no wavelengths; and files of MATLAB and
HDF5 as nested dictionaries of arrays, whatever their version."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.container import datasets, require_readable
from l3cli.errors import InputFileError
from l3cli.frames.scene import SpectralCube
from l3cli.io.isolated import isolated
from l3cli.io.raw.npy import map_array
from l3cli.system.limits import require_values

Content = dict[str, Any]
WAVELENGTH_NAMES = ("wave", "wavelength", "wavelengths", "wavelength_nm", "wavelengths_nm", "lambda", "wl", "bands", "wlens")
MATLAB, NPY = ".mat", ".npy"
DEEPEST = 16  # groups or structs within one another


def read(path: Path, variable: str | None, axes: str) -> SpectralCube:
    """Return the cube `variable` (None: the only one) of a file whose axes are those named by `axes`."""
    content = {"values": map_array(path)} if path.suffix.lower() == NPY else read_content(path)
    arrays = dict(_arrays(content))
    if variable is None:
        cubes = [name for name, values in arrays.items() if values.ndim == 3]
        if len(cubes) != 1:
            names = ", ".join(cubes) or "none"
            raise InputFileError(f"{path} must hold one cube of three axes or variable name it (there: {names})")
        values = arrays[cubes[0]]
    else:
        found = arrays.get(_path_of(variable))
        if found is None or found.ndim != 3:
            raise InputFileError(f'{path} holds no cube "{variable}" of three axes; name another variable')
        values = found
    order = axes.split()
    values = values.transpose([order.index(axis) for axis in ("row", "col", "band")])
    return SpectralCube(values, _wavelengths(content))


def size(path: Path, variable: str | None, axes: str) -> tuple[int, int]:
    """Return (rows, cols) of what `read` reads, from headers where they hold it; InputFileError as there."""
    shapes = {"values": map_array(path).shape} if path.suffix.lower() == NPY else array_shapes(path)
    wanted = [
        shape for name, shape in shapes.items() if len(shape) == 3 and (variable is None or name == _path_of(variable))
    ]
    if len(wanted) != 1:
        rows, cols, _ = read(path, variable, axes).values.shape  # which says what is wrong
        return rows, cols
    order = axes.split()
    return wanted[0][order.index("row")], wanted[0][order.index("col")]


def _path_of(variable: str) -> str:
    """Return the path of a variable that is named "a", "a/b" or "a.b"."""
    return variable.replace(".", "/").strip("/")


def _wavelengths(content: Content) -> NDArray[np.float64] | None:
    """Return the first list of numbers under one of the usual names."""
    for name, value in content.items():
        if name.lower() in WAVELENGTH_NAMES and np.size(value) > 1 and np.asarray(value).dtype.kind in "fiu":
            return np.asarray(value, float).ravel()
    return None


# ------------------------------------------------------------------------------------------ MATLAB and HDF5 files


def read_content(path: Path) -> Content:
    """Return all numbers and texts of a file, MATLAB's by its suffix, HDF5's by any other: groups and structs as
    dictionaries; what MATLAB wrote in its axis order, axes of length 1 dropped. InputFileError if the file is none."""
    return read_matlab(path) if path.suffix == MATLAB else _read_hdf5(path)


@isolated("h5py", "scipy.io")
def read_matlab(path: Path) -> Content:
    """Return the content of a .mat file."""
    import h5py

    return _stored(path, reverse=True) if h5py.is_hdf5(path) else _loaded(path)  # -v7.3: HDF5 with its axes reversed


@isolated("h5py")
def _read_hdf5(path: Path) -> Content:
    return _stored(path, _is_matlab(path))


@isolated("h5py", "scipy.io")
def array_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Return shapes of the arrays of numbers in a .mat or HDF5 file by their names ("a", "a/b"), as reading gives them.
    They are taken from headers; only structs of MATLAB files before 7.3 must be read for theirs."""
    import h5py

    if path.suffix != MATLAB or h5py.is_hdf5(path):
        reverse = path.suffix == MATLAB or _is_matlab(path)
        with h5py.File(path, "r") as root:
            stored = {name: data.shape for name, data in datasets(root) if data.dtype.kind in "fiu" and name[0] != "#"}
        return {name: _squeezed(shape[::-1]) if reverse else shape for name, shape in stored.items()}
    from scipy.io import whosmat

    variables = whosmat(path)
    structs = [name for name, _, kind in variables if kind == "struct"]
    shapes = {name: _squeezed(shape) for name, shape, kind in variables if "int" in kind or kind in ("double", "single")}
    return shapes | ({name: values.shape for name, values in _arrays(_loaded(path, structs))} if structs else {})


def _squeezed(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(length for length in shape if length != 1)


def _arrays(content: Content, prefix: str = "") -> Iterator[tuple[str, NDArray]]:
    """Yield the path and values of every array of numbers."""
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _arrays(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            yield prefix + name, value


def _loaded(path: Path, names: list[str] | None = None) -> Content:
    """Return the variables called `names` (None: all) of a .mat file before 7.3."""
    from scipy.io import loadmat, whosmat

    for name, shape, _ in whosmat(path):
        require_values(f"{path}: {name}", shape)
    variables = loadmat(path, variable_names=names, simplify_cells=True)
    return _plain({name: value for name, value in variables.items() if not name.startswith("__")})


def _plain(content: Content, depth: int = 0) -> Content:
    """Return the fields that are numbers or text."""
    fields: Content = {}
    for name, value in content.items():
        if isinstance(value, dict) and depth < DEEPEST:
            fields[name] = _plain(value, depth + 1)
        elif isinstance(value, str | bool | int | float) or getattr(value, "dtype", np.dtype(object)).kind in "biuf":
            fields[name] = value
    return fields


def _is_matlab(path: Path) -> bool:
    """Return whether MATLAB (-v7.3) wrote an HDF5 file."""
    with open(path, "rb") as stream:
        return stream.read(10) == b"MATLAB 7.3"


def _stored(path: Path, reverse: bool) -> Content:
    import h5py

    content: Content = {}
    with h5py.File(path, "r") as root:
        for name, dataset in datasets(root):
            if name.startswith("#") or dataset.dtype.kind not in "fiub":
                continue
            require_readable(path, dataset.id)
            *groups, last = name.split("/")
            place = content
            for group in groups:
                place = place.setdefault(group, {})
            place[last] = np.squeeze(dataset[()].T) if reverse else dataset[()]
    return content
