"""Content of an HDF5 file as l3 and MATLAB write it: within the file itself, and no larger than its storage justifies.

Links that lead elsewhere, data in other files, virtual datasets and unknown filters are how HDF5 reaches beyond itself.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.system.limits import require_values

KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
LARGEST_RATIO = 1100  # deflate cannot expand further than 1032 : 1
SMALL = 4096  # bytes that are believed without looking at what is stored
ENCODING = "utf-8"


def encoded(text: Any) -> NDArray[np.bytes_]:
    """Return text, or an array of it, as it is stored: of one length. Along axes that is two bytes at least, for netCDF
    tools join single bytes to one text."""
    array = np.char.encode(np.asarray(text, dtype=str), ENCODING, "replace")  # names of files need not be text
    length = max(array.dtype.itemsize, 2 if array.ndim else 1)
    return array.astype(h5py.string_dtype(ENCODING, length))


def datasets(root: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield every dataset that lies in the file below `root`, with its name: no soft or external link is followed, and no
    group entered twice."""
    yield from _below(root, "", {root})


def _below(group: h5py.Group, prefix: str, seen: set[h5py.Group]) -> Iterator[tuple[str, h5py.Dataset]]:
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        member = group[name]
        if isinstance(member, h5py.Dataset):
            yield prefix + name, member
        elif isinstance(member, h5py.Group) and member not in seen:
            seen.add(member)
            yield from _below(member, f"{prefix}{name}/", seen)


def is_scale(dataset: h5py.Dataset) -> bool:
    """Return whether a dataset exists only to name an axis of others and is declared by no artifact. No value or
    reference is read."""
    return "CLASS" in dataset.attrs and "axes" not in dataset.attrs


def filters_of(dataset: h5py.Dataset) -> set[int]:
    """Return the numbers of the filters that a dataset passes through."""
    created = dataset.id.get_create_plist()
    return {created.get_filter(index)[0] for index in range(created.get_nfilters())}


def require_within_file(path: Path, dataset: h5py.Dataset) -> None:
    """Raise InputFileError if a dataset lies outside its file or claims more than what is stored can hold."""
    where = (dataset.name or "").lstrip("/")
    if dataset.is_virtual or dataset.external:
        raise InputFileError(f"{path}: dataset {where} lies in another file; give a file that holds it itself")
    claimed, stored = (dataset.size or 0) * dataset.dtype.itemsize, dataset.id.get_storage_size()
    if filters_of(dataset) <= KNOWN_FILTERS and claimed > SMALL + LARGEST_RATIO * stored:
        raise InputFileError(f"{path}: dataset {where} claims more data than the file holds; make the file again")


def require_readable(path: Path, dataset: h5py.Dataset) -> None:
    """Raise InputFileError if a dataset cannot be read as a whole: as `require_within_file`, or more than inputs may
    hold."""
    require_within_file(path, dataset)
    where = (dataset.name or "").lstrip("/")
    require_values(f"{path}: dataset {where}", dataset.shape or (), dataset.dtype.itemsize)
    require_values(f"{path}: a chunk of dataset {where}", dataset.chunks or (), dataset.dtype.itemsize)
