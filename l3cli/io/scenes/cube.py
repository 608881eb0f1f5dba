"""Read spectral cubes from MATLAB, HDF5 and .npy files.

The values of an HDF5 dataset are scaled according to its attributes from the CF conventions (scale_factor, add_offset,
_FillValue, missing_value) or from NEON (Scale_Factor, by which the values are divided, and Data_Ignore_Value). A .npy file
contains only values, without wavelengths and attributes.
"""

from collections.abc import Container, Iterator
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
# Attribute names for the factor of the stored values, for the offset added after scaling, and for the value of a perfect
# white.
SCALE, OFFSET, WHITE = "scale_factor", "add_offset", "Scale_Factor"
MISSING = ("_FillValue", "missing_value", "Data_Ignore_Value")  # attribute names for the value of pixels without data
MATLAB, NPY = ".mat", ".npy"
# Suffix of files that other modules read → value of the key `source` for them.
OTHER_SOURCES = {".tif": "channels", ".tiff": "channels", ".exr": "channels", ".hdr": "envi"}
TITLES = ("NAME", "standard_name", "long_name")  # attribute names for the name of an array (HDF5, CF conventions)
DEEPEST = 16  # maximum nesting of groups or structs


def read(path: Path, variable: str | None, axes: str) -> SpectralCube:
    """Read a cube from a file.

    Parameters
    ----------
    path : Path
        The cube file.
    variable : str or None
        Name of the array that contains the cube, or None for the only array with three axes.
    axes : str
        Names of the stored array's axes in order, separated by spaces, such as "band row col".

    Returns
    -------
    SpectralCube
        The cube, (row, col, band). Its wavelengths are None if the file contains none.

    Raises
    ------
    InputFileError
        If the file cannot be read, if it does not contain the cube, or if it contains different lists of wavelengths.

    Notes
    -----
    A list of wavelengths is an array or attribute with one number per band and a name in `wavelengths.NAMES`. l3 searches
    the cube's attributes first, then its group or struct, then the enclosing groups, and finally the whole file.
    """
    _refuse_other_source(path)
    content = {"values": map_array(path)} if path.suffix.lower() == NPY else read_content(path)
    arrays = dict(_arrays(content))
    if variable is None:
        cubes = [name for name, values in arrays.items() if values.ndim == 3]
        if len(cubes) != 1:
            names = f"{len(cubes)} arrays with three axes ({', '.join(cubes)})" if cubes else "no array with three axes"
            raise InputFileError(f'{path} contains {names}; set the key "variable" to the name of the cube')
        name = cubes[0]
    else:
        name = _path_of(variable)
        if name not in arrays or arrays[name].ndim != 3:
            raise InputFileError(
                f'{path} contains no array "{variable}" with three axes; set the key "variable" to the name of the cube'
            )
    order = axes.split()
    values = arrays[name].transpose([order.index(axis) for axis in ("row", "col", "band")])
    attributes = {} if path.suffix.lower() == NPY else _attributes(path)
    lists = _lists(arrays, attributes, values.shape[2])
    wavelength, good = _wavelengths(path, name, lists, attributes), _good_bands(name, lists)
    return _as_stored(values, wavelength, good, attributes.get(name, {}))


def _as_stored(
    values: NDArray, wavelength: NDArray[np.float64] | None, good: NDArray[np.bool_] | None, attributes: dict[str, Any]
) -> SpectralCube:
    """Scale a dataset's values, (row, col, band), and mark pixels without data, according to its attributes."""
    ignored = None
    for mark in (attributes[name] for name in MISSING if name in attributes):
        found = missing(values, float(np.ravel(mark)[0]), good)
        ignored = found if ignored is None else ignored if found is None else ignored | found
    gain, offset = (float(np.ravel(attributes.get(name, default))[0]) for name, default in ((SCALE, 1.0), (OFFSET, 0.0)))
    made = scaled(values, gain, offset)
    white = float(np.ravel(attributes[WHITE])[0]) if WHITE in attributes else 1.0 if made is not values else None
    return SpectralCube(made, wavelength, white, good, ignored)


def size(path: Path, variable: str | None, axes: str) -> tuple[int, int]:
    """Return the number of rows and columns of the cube that `read` returns.

    The values are read only if the header does not contain the size. Raises the same errors as `read`.
    """
    _refuse_other_source(path)
    shapes = {"values": map_array(path).shape} if path.suffix.lower() == NPY else array_shapes(path)
    wanted = [
        shape for name, shape in shapes.items() if len(shape) == 3 and (variable is None or name == _path_of(variable))
    ]
    if len(wanted) != 1:
        rows, cols, _ = read(path, variable, axes).values.shape  # raises InputFileError if the file is invalid
        return rows, cols
    order = axes.split()
    return wanted[0][order.index("row")], wanted[0][order.index("col")]


def _refuse_other_source(path: Path) -> None:
    """Raise InputFileError if files with this suffix require a different value of the key `source`."""
    if (source := OTHER_SOURCES.get(path.suffix.lower())) is not None:
        raise InputFileError(f'{path} is not a MATLAB, HDF5 or .npy file; set source = "{source}" in the recipe')


def _path_of(variable: str) -> str:
    """Convert a variable name such as "a", "a/b" or "a.b" to a path with "/" as the separator."""
    return variable.replace(".", "/").strip("/")


Lists = dict[tuple[str, str], NDArray[np.float64]]  # (group, name) → list of numbers; all lists have one number per band


def _lists(arrays: dict[str, NDArray], attributes: dict[str, dict[str, Any]], length: int) -> Lists:
    """Return all lists of `length` numbers in a file's arrays and attributes. If `length` is 1, the result is empty.

    The keys of the result are (group, name). For an attribute, the group is the path of the group or array that has the
    attribute.
    """
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


def _titles(attributes: dict[str, Any]) -> Iterator[str]:
    """Yield the names of an array in its attributes, such as the value of "long_name"."""
    for key in TITLES:
        if isinstance(title := attributes.get(key), str):
            yield title.removeprefix("radiation_")  # as in the CF standard name "radiation_wavelength"


def _nearest(
    cube: str, lists: Lists, names: tuple[str, ...], titled: Container[tuple[str, str]] = ()
) -> list[tuple[str, str]]:
    """Return the keys of the lists that are nearest to a cube in the hierarchy of the file.

    Only lists in `titled` and lists with a name in `names` are considered. The cube's attributes are nearest, followed by
    its group, the enclosing groups from the inside out, and all other groups.
    """
    usual = [key for key in lists if key in titled or is_named(key[1], names)]
    places = [cube]
    while places[-1]:
        places.append(places[-1].rpartition("/")[0])
    for place in places:
        if here := [key for key in usual if key[0] == place]:
            return here
    return usual


def _wavelengths(path: Path, cube: str, lists: Lists, attributes: dict[str, dict[str, Any]]) -> NDArray[np.float64] | None:
    """Return each band's wavelength in nm, or None if the file contains no list of wavelengths.

    The unit is the list's attribute "unit" or "units", or the last word of its name. Otherwise, l3 infers the unit from the
    numbers. Raises InputFileError if a list is invalid, or if several lists are equally near to the cube but differ.
    """
    found = []
    titled = {key for key in lists if any(map(is_named, _titles(attributes.get("/".join(key).strip("/"), {}))))}
    for group, name in _nearest(cube, lists, NAMES, titled):
        about = attributes.get(f"{group}/{name}".strip("/"), {})
        unit = next((str(value) for key, value in about.items() if key.lower() in ("unit", "units")), "") or unit_in(name)
        with raised_as(InputFileError, f"{path}: {name}"):
            if (wavelength := in_nm(lists[group, name], unit)) is not None:
                found.append((f"{group}/{name}".strip("/"), wavelength))
    if any(not np.allclose(wavelength, found[0][1]) for _, wavelength in found[1:]):
        names = ", ".join(name for name, _ in found)
        raise InputFileError(
            f'{path} contains several different lists of wavelengths ({names}); set "wavelengths_nm" in the recipe'
        )
    return found[0][1] if found else None


def _good_bands(cube: str, lists: Lists) -> NDArray[np.bool_] | None:
    """Return a mask of the good bands, or None if the file contains no list of good bands.

    A list is used only if all of its values are 0 or 1, and at least one of them is 1.
    """
    for key in _nearest(cube, lists, GOOD_NAMES):
        if np.isin(lists[key], (0, 1)).all() and lists[key].any():
            return np.asarray(lists[key] == 1)
    return None


# ------------------------------------------------------------------------------------------ MATLAB and HDF5 files


def read_content(path: Path) -> Content:
    """Read all numeric arrays in a MATLAB file (suffix .mat) or an HDF5 file (any other suffix).

    Groups and structs become nested dictionaries. Arrays from MATLAB keep MATLAB's order of axes, without axes of length 1.
    Strings are read only from MATLAB files before version 7.3. Raises InputFileError if the file cannot be read.
    """
    return read_matlab(path) if path.suffix.lower() == MATLAB else _read_hdf5(path)


@isolated("h5py", "scipy.io")
def read_matlab(path: Path) -> Content:
    """Read a MATLAB file with any suffix, as `read_content` does."""
    import h5py

    return _stored(path, reverse=True) if h5py.is_hdf5(path) else _loaded(path)  # version 7.3 is HDF5, with reversed axes


@isolated("h5py")
def _read_hdf5(path: Path) -> Content:
    return _stored(path, _is_matlab(path))


@isolated("h5py", "scipy.io")
def array_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Return the shapes of the arrays that `read_content` returns. The keys are paths in the file, such as "a" or "a/b".

    Only headers are read, except for structs in MATLAB files older than version 7.3, which must be read completely.
    """
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
    """Yield (path, values) for every numeric array in nested dictionaries. A path looks like "a/b"."""
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _arrays(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            yield prefix + name, value


def _loaded(path: Path, names: list[str] | None = None) -> Content:
    """Read variables, or all variables if `names` is None, from a MATLAB file before version 7.3."""
    from scipy.io import loadmat, whosmat

    for name, shape, _ in whosmat(path):
        require_values(f"{path}: {name}", shape)
    variables = loadmat(path, variable_names=names, simplify_cells=True)
    return _plain({name: value for name, value in variables.items() if not name.startswith("__")})


def _plain(content: Content, depth: int = 0) -> Content:
    """Remove all fields that are not numbers, text or structs, and all structs nested more than DEEPEST levels deep."""
    fields: Content = {}
    for name, value in content.items():
        if isinstance(value, dict) and depth < DEEPEST:
            fields[name] = _plain(value, depth + 1)
        elif isinstance(value, str | bool | int | float) or getattr(value, "dtype", np.dtype(object)).kind in "biuf":
            fields[name] = value
    return fields


def _is_matlab(path: Path) -> bool:
    """Return whether an HDF5 file is a MATLAB version 7.3 file."""
    with open(path, "rb") as stream:
        return stream.read(10) == b"MATLAB 7.3"


@isolated("h5py")
def _attributes(path: Path) -> dict[str, dict[str, Any]]:
    """Return the numeric and text attributes of all groups and datasets in an HDF5 file, by path ("" for the root).

    Groups and datasets without such attributes are omitted. The result is empty if the file is not an HDF5 file.
    """
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
    """Return an attribute if it is a string or an array of at most a million numbers, otherwise None."""
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
