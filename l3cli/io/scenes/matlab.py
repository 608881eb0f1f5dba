"""MATLAB and HDF5 files as nested dictionaries of arrays, whatever their version."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.stored import datasets, require_readable
from l3cli.errors import InputFileError
from l3cli.io.isolated import isolated
from l3cli.system.limits import require_values

Content = dict[str, Any]
MATLAB = ".mat"
NUMBERS = ("double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))  # in MATLAB
DEEPEST = 16  # groups or structs within one another


def read_content(path: Path) -> Content:
    """Return the content of a file, MATLAB's by its suffix, HDF5's by any other."""
    return read_matlab(path) if path.suffix == MATLAB else read_hdf5(path)


@isolated("h5py", "scipy.io")
def read_matlab(path: Path) -> Content:
    """Return every variable of a .mat file that is of numbers or text, structs as dictionaries, axes of length 1 dropped, in
    MATLAB's axis order.

    InputFileError if the file is none.
    """
    import h5py

    if h5py.is_hdf5(path):  # -v7.3: HDF5 with its axes reversed
        return _read(path, reverse=True)
    return _load(path)


def _load(path: Path, names: list[str] | None = None) -> Content:
    """Return the variables called `names` (None: all) of a .mat file before 7.3."""
    from scipy.io import loadmat, whosmat

    with _matlab(path):
        for name, shape, _ in whosmat(path):
            require_values(f"{path}: {name}", shape)
        variables = loadmat(path, variable_names=names, simplify_cells=True)
    return _plain({name: value for name, value in variables.items() if not name.startswith("__")})


@contextlib.contextmanager
def _matlab(path: Path) -> Iterator[None]:
    """Whatever scipy stumbles over as InputFileError."""
    try:
        yield
    except (InputFileError, MemoryError):
        raise
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except Exception as error:
        raise InputFileError(f"{path} is not a MATLAB file, or a damaged one; save it again") from error


@isolated("h5py", "scipy.io")
def array_shapes(path: Path) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of numbers in a .mat or HDF5 file by their names ("a", "a/b"), as reading gives them. They are
    taken from headers; only structs of MATLAB files before 7.3 must be read for theirs."""
    import h5py

    if path.suffix != MATLAB or h5py.is_hdf5(path):
        reverse = path.suffix == MATLAB or _is_matlab(path)
        with _hdf5(path) as root:
            stored = {name: data.shape for name, data in datasets(root) if data.dtype.kind in "fiu" and name[0] != "#"}
        return {name: _squeezed(shape[::-1]) if reverse else shape for name, shape in stored.items()}
    from scipy.io import whosmat

    with _matlab(path):
        variables = whosmat(path)
    shapes = {name: _squeezed(shape) for name, shape, kind in variables if kind in NUMBERS}
    structs = [name for name, _, kind in variables if kind == "struct"]
    return shapes | (dict(_shapes(_load(path, structs))) if structs else {})


def _squeezed(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(length for length in shape if length != 1)


def _shapes(content: Content, prefix: str = "") -> Iterator[tuple[str, tuple[int, ...]]]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _shapes(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            yield prefix + name, value.shape


def _plain(content: Content, depth: int = 0) -> Content:
    """Return the fields that are numbers or text."""
    kept: Content = {}
    for name, value in content.items():
        if isinstance(value, dict) and depth < DEEPEST:
            kept[name] = _plain(value, depth + 1)
        elif isinstance(value, str | bool | int | float) or getattr(value, "dtype", np.dtype(object)).kind in "biuf":
            kept[name] = value
    return kept


@isolated("h5py")
def read_hdf5(path: Path) -> Content:
    """Return every dataset of numbers of an HDF5 file, groups as dictionaries; axes as MATLAB shows them where it wrote
    them."""
    return _read(path, _is_matlab(path))


def _is_matlab(path: Path) -> bool:
    """Return whether MATLAB (-v7.3) wrote an HDF5 file."""
    with open(path, "rb") as stream:
        return stream.read(10) == b"MATLAB 7.3"


@contextlib.contextmanager
def _hdf5(path: Path) -> Iterator[Any]:
    """Yield the root of an HDF5 file, whatever the library stumbles over as InputFileError."""
    import h5py

    try:
        with h5py.File(path, "r") as root:
            yield root
    except (OSError, RuntimeError, TypeError) as error:
        raise InputFileError(f"{path} is not an HDF5 file, or a damaged one; save it again") from error


def _read(path: Path, reverse: bool) -> Content:
    content: Content = {}
    with _hdf5(path) as root:
        for name, dataset in datasets(root):
            if name.startswith("#") or dataset.dtype.kind not in "fiub":
                continue
            require_readable(path, dataset)
            *groups, last = name.split("/")
            place = content
            for group in groups:
                place = place.setdefault(group, {})
            place[last] = np.squeeze(dataset[()].T) if reverse else dataset[()]
    return content


def variable_of(content: Content, name: str) -> Any:
    """Return the member that `name` ("a", "a/b" or "a.b") leads to, or None."""
    value: Any = content
    for step in name.replace(".", "/").strip("/").split("/"):
        value = value.get(step) if isinstance(value, dict) else None
    return value
