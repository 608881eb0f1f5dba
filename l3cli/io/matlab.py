"""MATLAB and HDF5 files as nested dictionaries of arrays, whatever their version."""

from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError

Content = dict[str, Any]


def read_matlab(path: Path) -> Content:
    """Every variable of a .mat file, structs as dictionaries, axes of length 1 dropped, in MATLAB's axis order.

    InputFileError if the file is none.
    """
    import h5py

    try:
        if h5py.is_hdf5(path):  # -v7.3: HDF5 with its axes reversed
            return read_hdf5(path, reverse=True)
        from scipy.io import loadmat

        found = loadmat(path, simplify_cells=True)
    except InputFileError:
        raise
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # scipy raises whatever it stumbles over
        raise InputFileError(f"{path} is not a MATLAB file, or a damaged one; save it again") from error
    return {name: value for name, value in found.items() if not name.startswith("__")}


def read_hdf5(path: Path, reverse: bool | None = None) -> Content:
    """Every dataset of an HDF5 file, groups as dictionaries. `reverse`: axes as MATLAB shows them (None: if it wrote
    them)."""
    import h5py

    try:
        with h5py.File(path, "r") as root:
            if reverse is None:
                with open(path, "rb") as stream:
                    reverse = stream.read(10) == b"MATLAB 7.3"
            return _members(root, reverse)
    except (OSError, RuntimeError, TypeError) as error:
        raise InputFileError(f"{path} is not an HDF5 file, or a damaged one; save it again") from error


def _members(group: Any, reverse: bool) -> Content:
    import h5py

    content: Content = {}
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink) or name.startswith("#"):
            continue
        member = group[name]
        if isinstance(member, h5py.Group):
            content[name] = _members(member, reverse)
        elif member.dtype.kind in "fiub":
            content[name] = np.squeeze(member[()].T) if reverse else member[()]
    return content


def look_up(content: Content, name: str) -> Any:
    """The member that `name` ("a", "a/b" or "a.b") leads to, or None."""
    found: Any = content
    for step in name.replace(".", "/").strip("/").split("/"):
        found = found.get(step) if isinstance(found, dict) else None
    return found
