"""Spectral cubes as arrays of MATLAB, HDF5 and .npy files, of which the last name no wavelengths; and files of MATLAB and
HDF5 as nested dictionaries of arrays, whatever their version.

Attributes of HDF5 datasets say how values are stored: those of the CF conventions (scale_factor, add_offset, _FillValue,
missing_value), and those of NEON (Scale_Factor, by which values are divided, and Data_Ignore_Value).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.container import datasets, require_readable
from l3cli.errors import InputFileError, raised_as
from l3cli.frames.marks import missing, scaled
from l3cli.frames.scene import SpectralCube
from l3cli.io.isolated import isolated
from l3cli.io.raw.npy import map_array
from l3cli.io.scenes.wavelengths import GOOD_NAMES, NAMES, in_nm, is_named, unit_in
from l3cli.system.limits import require_values

Content = dict[str, Any]
SCALE, OFFSET, WHITE = "scale_factor", "add_offset", "Scale_Factor"  # attributes: multiply, add, a perfect white
MISSING = ("_FillValue", "missing_value", "Data_Ignore_Value")  # attributes of pixels without data
MATLAB, NPY = ".mat", ".npy"
DEEPEST = 16  # groups or structs within one another


def read(path: Path, variable: str | None, axes: str) -> SpectralCube:
    """Return the cube `variable` (None: the only one) of a file whose axes are those named by `axes`.

    Wavelengths are a list of as many numbers as there are bands under one of the usual names: an attribute of the cube, else
    a list or attribute beside it, in the groups or structs about it, or anywhere else if only one is there. InputFileError
    if there is no such cube, or several lists differ.
    """
    content = {"values": map_array(path)} if path.suffix.lower() == NPY else read_content(path)
    arrays = dict(_arrays(content))
    if variable is None:
        cubes = [name for name, values in arrays.items() if values.ndim == 3]
        if len(cubes) != 1:
            names = ", ".join(cubes) or "none"
            raise InputFileError(f"{path} must hold one cube of three axes or variable name it (there: {names})")
        name = cubes[0]
    else:
        name = _path_of(variable)
        if name not in arrays or arrays[name].ndim != 3:
            raise InputFileError(f'{path} holds no cube "{variable}" of three axes; name another variable')
    order = axes.split()
    values = arrays[name].transpose([order.index(axis) for axis in ("row", "col", "band")])
    attributes = {} if path.suffix.lower() == NPY else _attributes(path)
    lists = _lists(arrays, attributes, values.shape[2])
    wavelength, good = _wavelengths(path, name, lists, attributes), _good_bands(name, lists)
    return _as_stored(values, wavelength, good, attributes.get(name, {}))


def _as_stored(
    values: NDArray, wavelength: NDArray[np.float64] | None, good: NDArray[np.bool_] | None, attributes: dict[str, Any]
) -> SpectralCube:
    """Return the cube of stored values (row, col, band), whose dataset's attributes may scale them and mark missing data."""
    ignored = None
    for mark in (attributes[name] for name in MISSING if name in attributes):
        found = missing(values, float(np.ravel(mark)[0]), good)
        ignored = found if ignored is None else ignored if found is None else ignored | found
    gain, offset = (float(np.ravel(attributes.get(name, default))[0]) for name, default in ((SCALE, 1.0), (OFFSET, 0.0)))
    made = scaled(values, gain, offset)
    white = float(np.ravel(attributes[WHITE])[0]) if WHITE in attributes else 1.0 if made is not values else None
    return SpectralCube(made, wavelength, white, good, ignored)


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


Lists = dict[tuple[str, str], NDArray[np.float64]]  # (group, name) of lists of numbers, of one length


def _lists(arrays: dict[str, NDArray], attributes: dict[str, dict[str, Any]], length: int) -> Lists:
    """Return the lists of `length` numbers in a file: arrays by the group that they are in, attributes by the group or
    array that they are of."""
    found: Lists = {}
    for path, values in arrays.items():
        if values.size == length and length > 1 and max(values.shape) == length:
            group, _, name = path.rpartition("/")
            found[group, name] = np.asarray(values, float).ravel()
    for place, named in attributes.items():
        for name, value in named.items():
            values = np.asarray(value)
            if values.size == length and length > 1 and values.dtype.kind in "fiu":
                found[place, name] = values.astype(float).ravel()
    return found


def _nearest(cube: str, lists: Lists, names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return the lists under one of the usual names that are nearest to a cube: its attributes, what lies beside it, in the
    groups about it, or anywhere."""
    usual = [key for key in lists if is_named(key[1], names)]
    places = [cube]
    while places[-1]:
        places.append(places[-1].rpartition("/")[0])
    for place in places:
        if here := [key for key in usual if key[0] == place]:
            return here
    return usual


def _wavelengths(path: Path, cube: str, lists: Lists, attributes: dict[str, dict[str, Any]]) -> NDArray[np.float64] | None:
    """Return the wavelengths in nm; their unit is in the list's name, its attribute "units", or told by their size."""
    found = []
    for group, name in _nearest(cube, lists, NAMES):
        about = attributes.get(f"{group}/{name}".strip("/"), {})
        unit = next((str(value) for key, value in about.items() if key.lower() in ("unit", "units")), "") or unit_in(name)
        with raised_as(InputFileError, f"{path}: {name}"):
            if (wavelength := in_nm(lists[group, name], unit)) is not None:
                found.append((f"{group}/{name}".strip("/"), wavelength))
    if any(not np.allclose(wavelength, found[0][1]) for _, wavelength in found[1:]):
        names = ", ".join(name for name, _ in found)
        raise InputFileError(f"{path} holds several lists of wavelengths ({names}); give wavelengths_nm in the recipe")
    return found[0][1] if found else None


def _good_bands(cube: str, lists: Lists) -> NDArray[np.bool_] | None:
    """Return the bands (band) that a list of 0 and 1 calls good; None if there is none."""
    for key in _nearest(cube, lists, GOOD_NAMES):
        if np.isin(lists[key], (0, 1)).all() and lists[key].any():
            return np.asarray(lists[key] == 1)
    return None


# ------------------------------------------------------------------------------------------ MATLAB and HDF5 files


def read_content(path: Path) -> Content:
    """Return all numbers and texts of a file, MATLAB's by its suffix, HDF5's by any other: groups and structs as
    dictionaries; what MATLAB wrote in its axis order, axes of length 1 dropped. InputFileError if the file is none."""
    return read_matlab(path) if path.suffix.lower() == MATLAB else _read_hdf5(path)


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

    if path.suffix.lower() != MATLAB or h5py.is_hdf5(path):
        reverse = path.suffix.lower() == MATLAB or _is_matlab(path)
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


@isolated("h5py")
def _attributes(path: Path) -> dict[str, dict[str, Any]]:
    """Return the attributes, numbers and texts, of every group and dataset of an HDF5 file by its path; the root's is "".
    Empty of any other file."""
    import h5py

    found: dict[str, dict[str, Any]] = {}
    if not h5py.is_hdf5(path):
        return found
    with h5py.File(path, "r") as root:
        places = {"": root}
        for name, dataset in datasets(root):
            places[name] = dataset
            for end in (at for at, letter in enumerate(name) if letter == "/"):
                places[name[:end]] = root[name[:end]]
        for name, place in places.items():
            for key in place.attrs:
                if (value := _plain_attribute(place.attrs, key)) is not None:
                    found.setdefault(name, {})[key] = value
    return found


def _plain_attribute(attributes: Any, key: str) -> Any:
    """Return an attribute that is text or a list of up to a million numbers; None of any other kind."""
    kind, shape = attributes.get_id(key).dtype, attributes.get_id(key).shape
    if kind.kind in "fiu" and np.prod(shape, dtype=float) <= 1e6:
        return np.asarray(attributes[key])
    if shape == () and kind.kind in "SO" and isinstance(value := attributes[key], str | bytes):
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return None


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
