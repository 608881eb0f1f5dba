"""HDF5 files in which a changed byte is detected, and whose content lies within the file and is no larger than its storage
justifies: links, data in other files, virtual datasets and unknown filters are how HDF5 reaches beyond itself.

The first 512 bytes, HDF5's user block, hold the SHA-256 of all that follows. A file is compared with it before HDF5 reads
it: the library may crash on damaged metadata, and its checksums cover only the values of datasets.
"""

import contextlib
import hashlib
import io
import os
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.system.files import atomic_output, open_regular
from l3cli.system.limits import require_values
from l3cli.system.signals import uninterrupted

SIGNATURE = b"\x89HDF\r\n\x1a\n"  # of HDF5
BLOCK = 512  # bytes before it
TITLE = b"l3 artifact, SHA-256 of the bytes after the first 512: "
KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
LARGEST_RATIO = 1100  # deflate cannot expand further than 1032 : 1
SMALL = 4096  # bytes that are believed without looking at what is stored
ENCODING = "utf-8"


class _Sink(io.RawIOBase):
    """The file that HDF5 writes to. HDF5 crashes when it cannot write, so errors are kept from it, and raised afterwards;
    and signals: an exception out of one of these methods crashes it, or is forgotten and what was to be written with it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._position = descriptor, 0
        self.error: OSError | None = None

    @uninterrupted
    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position}.get(whence)
        self._position = offset + (os.fstat(self._descriptor).st_size if start is None else start)
        return self._position

    @uninterrupted
    def tell(self) -> int:
        return self._position

    @uninterrupted
    def readinto(self, buffer: Any) -> int:
        content = os.pread(self._descriptor, len(buffer), self._position)
        buffer[: len(content)] = content
        self._position += len(content)
        return len(content)

    @uninterrupted
    def write(self, content: Any) -> int:
        rest = memoryview(content).cast("B")
        length = len(rest)
        while len(rest) and self.error is None:
            try:
                written = os.pwrite(self._descriptor, rest, self._position + length - len(rest))
            except OSError as error:
                self.error = error
            else:
                rest = rest[written:]
        self._position += length
        return length

    @uninterrupted
    def truncate(self, size: int | None = None) -> int:
        size = self._position if size is None else size
        try:
            os.ftruncate(self._descriptor, size)
        except OSError as error:
            self.error = self.error or error
        return size


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[h5py.File]:
    """Yield an HDF5 file open for writing that gets its digest, and its name `path`, when the block ends without error."""
    with atomic_output(path) as temporary, open(temporary, "r+b", buffering=0) as raw:
        sink = _Sink(raw.fileno())
        with h5py.File(sink, "w", libver=("earliest", "v110"), track_order=False, userblock_size=BLOCK) as root:
            yield root
        if sink.error is not None:
            raise sink.error
        os.pwrite(raw.fileno(), _block(raw), 0)


def seal(path: Path) -> None:
    """Give an HDF5 file with a user block the digest of what it holds now."""
    with open(path, "r+b", buffering=0) as raw:
        os.pwrite(raw.fileno(), _block(raw), 0)


def check(path: Path, made_by: str) -> bool:
    """Compare a file with the digest it carries. False if it is an HDF5 file without one, as format version 1 wrote them, or
    of someone else; InputFileError if it is another kind of file, or not what was written."""
    try:
        with open_regular(path, f"give the file written by {made_by}") as raw:
            head = raw.read(BLOCK + len(SIGNATURE))
            if head.startswith(SIGNATURE):
                return False
            block, ours = head[:BLOCK], head.startswith(TITLE)
            if not ours and head[BLOCK:] != SIGNATURE:
                raise InputFileError(f"{path} is not an HDF5 file; give the file written by {made_by}")
            if ours and block == _block(raw):
                return True
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror}; give the file written by {made_by}") from error
    what = "is truncated or damaged (checksum)" if ours else "is an HDF5 file but no l3 artifact, or damaged"
    raise InputFileError(f"{path} {what}; copy it again, or make it again with {made_by}")


def open_file(path: Path) -> h5py.File:
    """Open a file for reading; OSError if HDF5 cannot. Files are never changed in place, so no lock is asked for, which some
    shared storage refuses."""
    return h5py.File(path, "r", locking=False)


def _block(raw: io.BufferedReader | io.FileIO) -> bytes:
    """Return the first 512 bytes that belong to what follows them."""
    raw.seek(BLOCK)
    digest = hashlib.file_digest(raw, "sha256").hexdigest().encode()
    return (TITLE + digest).ljust(BLOCK - 1) + b"\n"


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


class Stored(NamedTuple):
    """Storage of a dataset."""

    where: str  # its name
    shape: tuple[int, ...]
    dtype: np.dtype
    size: int  # bytes in the file
    created: h5py.h5p.PropDCID

    @property
    def filters(self) -> set[int]:
        """Return the numbers of the filters that it passes through."""
        return {self.created.get_filter(index)[0] for index in range(self.created.get_nfilters())}


def require_within_file(path: Path, dataset: h5py.h5d.DatasetID) -> Stored:
    """Return how a dataset is stored; InputFileError if it lies outside its file or claims more than that can hold."""
    where, created = (h5py.h5i.get_name(dataset) or b"").decode().lstrip("/"), dataset.get_create_plist()
    if created.get_layout() == h5py.h5d.VIRTUAL or created.get_external_count():
        raise InputFileError(f"{path}: dataset {where} lies in another file; give a file that holds it itself")
    stored = Stored(where, dataset.shape, dataset.dtype, dataset.get_storage_size(), created)
    claimed = prod(stored.shape) * stored.dtype.itemsize
    if claimed > SMALL + LARGEST_RATIO * stored.size and stored.filters <= KNOWN_FILTERS:
        raise InputFileError(f"{path}: dataset {where} claims more data than the file holds; make the file again")
    return stored


def require_readable(path: Path, dataset: h5py.h5d.DatasetID) -> Stored:
    """Return how a dataset is stored; InputFileError if it cannot be read whole: as `require_within_file`, or more than
    inputs may hold."""
    stored = require_within_file(path, dataset)
    chunk = stored.created.get_chunk() if stored.created.get_layout() == h5py.h5d.CHUNKED else ()
    require_values(f"{path}: dataset {stored.where}", stored.shape, stored.dtype.itemsize)
    require_values(f"{path}: a chunk of dataset {stored.where}", chunk, stored.dtype.itemsize)
    return stored
