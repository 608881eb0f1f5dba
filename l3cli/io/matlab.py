"""MATLAB and HDF5 files as nested dictionaries of arrays, whatever their version."""

from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.stored import datasets, require_readable
from l3cli.errors import InputFileError
from l3cli.io.apart import apart
from l3cli.limits import require_values

Content = dict[str, Any]
DEEPEST = 16  # groups or structs within one another


@apart
def read_matlab(path: Path) -> Content:
    """Every variable of a .mat file that is of numbers or text, structs as dictionaries, axes of length 1 dropped, in
    MATLAB's axis order.

    InputFileError if the file is none.
    """
    import h5py

    if h5py.is_hdf5(path):  # -v7.3: HDF5 with its axes reversed
        return _read(path, reverse=True)
    from scipy.io import loadmat, whosmat

    try:
        for name, shape, _ in whosmat(path):
            require_values(f"{path}: {name}", shape)
        found = loadmat(path, simplify_cells=True)
    except (InputFileError, MemoryError):
        raise
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # scipy raises whatever it stumbles over
        raise InputFileError(f"{path} is not a MATLAB file, or a damaged one; save it again") from error
    return _plain({name: value for name, value in found.items() if not name.startswith("__")})


def _plain(content: Content, depth: int = 0) -> Content:
    """What is of numbers or text."""
    kept: Content = {}
    for name, value in content.items():
        if isinstance(value, dict) and depth < DEEPEST:
            kept[name] = _plain(value, depth + 1)
        elif isinstance(value, str | bool | int | float) or getattr(value, "dtype", np.dtype(object)).kind in "biuf":
            kept[name] = value
    return kept


@apart
def read_hdf5(path: Path) -> Content:
    """Every dataset of numbers of an HDF5 file, groups as dictionaries; axes as MATLAB shows them where it wrote them."""
    with open(path, "rb") as stream:
        reverse = stream.read(10) == b"MATLAB 7.3"
    return _read(path, reverse)


def _read(path: Path, reverse: bool) -> Content:
    import h5py

    content: Content = {}
    try:
        with h5py.File(path, "r") as root:
            for name, dataset in datasets(root):
                if name.startswith("#") or dataset.dtype.kind not in "fiub":
                    continue
                require_readable(path, dataset)
                *groups, last = name.split("/")
                place = content
                for group in groups:
                    place = place.setdefault(group, {})
                place[last] = np.squeeze(dataset[()].T) if reverse else dataset[()]
    except (OSError, RuntimeError, TypeError) as error:
        raise InputFileError(f"{path} is not an HDF5 file, or a damaged one; save it again") from error
    return content


def look_up(content: Content, name: str) -> Any:
    """The member that `name` ("a", "a/b" or "a.b") leads to, or None."""
    found: Any = content
    for step in name.replace(".", "/").strip("/").split("/"):
        found = found.get(step) if isinstance(found, dict) else None
    return found
