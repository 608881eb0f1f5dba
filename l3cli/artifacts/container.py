"""HDF5 files with a checksum, which cannot make HDF5 read other files.

The first 512 bytes, HDF5's user block, contain the SHA-256 of all bytes that follow. l3 compares a file with its digest
before HDF5 opens it, because the library may crash on damaged metadata and its checksums cover only the values of datasets.

Links, external storage, virtual datasets and unknown filters let a file refer to other files or to plug-ins, so all are
refused. So is a dataset that claims to be larger than its stored bytes can be.
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
from l3cli.system.signals import held_back_in

SIGNATURE = b"\x89HDF\r\n\x1a\n"  # first bytes of HDF5
BLOCK = 512  # bytes of the user block, before the signature
TITLE = b"l3 artifact, SHA-256 of the bytes after the first 512: "
KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
MAX_COMPRESSION = 1100  # deflate cannot compress further than 1032 : 1
SMALL_BYTES = 4096  # datasets up to this size are not compared with their stored size
ENCODING = "utf-8"


class _Sink(io.RawIOBase):
    """The file object that HDF5 writes to.

    HDF5 crashes if a write fails, so errors are stored and raised after HDF5 has closed the file. Signals are held back,
    too: an exception from within one of these methods would crash HDF5, or be swallowed together with the data to be
    written.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor, self._position = descriptor, 0
        self.error: OSError | None = None

    @held_back_in
    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position}.get(whence)
        self._position = offset + (os.fstat(self._descriptor).st_size if start is None else start)
        return self._position

    @held_back_in
    def tell(self) -> int:
        return self._position

    @held_back_in
    def readinto(self, buffer: Any) -> int:
        content = os.pread(self._descriptor, len(buffer), self._position)
        buffer[: len(content)] = content
        self._position += len(content)
        return len(content)

    @held_back_in
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

    @held_back_in
    def truncate(self, size: int | None = None) -> int:
        size = self._position if size is None else size
        try:
            os.ftruncate(self._descriptor, size)
        except OSError as error:
            self.error = self.error or error
        return size


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[h5py.File]:
    """Yield an HDF5 file open for writing; it gets its digest, and the name `path`, when the block ends without an error."""
    with atomic_output(path) as temporary, open(temporary, "r+b", buffering=0) as raw:
        sink = _Sink(raw.fileno())
        with h5py.File(sink, "w", libver=("earliest", "v110"), track_order=False, userblock_size=BLOCK) as root:
            yield root
        if sink.error is not None:
            raise sink.error
        os.pwrite(raw.fileno(), _block(raw), 0)


def seal(path: Path) -> None:
    """Write the digest of an HDF5 file's current content into its user block."""
    with open(path, "r+b", buffering=0) as raw:
        os.pwrite(raw.fileno(), _block(raw), 0)


def check(path: Path, made_by: str) -> None:
    """Compare a file with the digest that it carries.

    Parameters
    ----------
    path : Path
    made_by : str
        The command that writes such files, for messages.

    Raises
    ------
    InputFileError
        If the file is no artifact, or differs from what was written.
    """
    try:
        with open_regular(path, f"give the file written by {made_by}") as raw:
            head = raw.read(BLOCK + len(SIGNATURE))
            has_title = head.startswith(TITLE)
            if not has_title and SIGNATURE not in (head[: len(SIGNATURE)], head[BLOCK:]):
                raise InputFileError(f"{path} is not an HDF5 file; give the file written by {made_by}")
            if has_title and head[:BLOCK] == _block(raw):
                return
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror}; give the file written by {made_by}") from error
    what = "is truncated or damaged (checksum)" if has_title else "is an HDF5 file but not an l3 artifact, or damaged"
    raise InputFileError(f"{path} {what}; copy it again, or make it again with {made_by}")


def open_file(path: Path) -> h5py.File:
    """Open an HDF5 file for reading; OSError if HDF5 cannot.

    No lock is requested: some network file systems refuse locks, and finished files are never changed in place.
    """
    return h5py.File(path, "r", locking=False)


def _block(raw: io.BufferedReader | io.FileIO) -> bytes:
    """Return the user block that belongs to the bytes after it."""
    raw.seek(BLOCK)
    digest = hashlib.file_digest(raw, "sha256").hexdigest().encode()
    return (TITLE + digest).ljust(BLOCK - 1) + b"\n"


def encoded(text: Any) -> NDArray[np.bytes_]:
    """Return text, or an array of texts, as fixed-length bytes for HDF5.

    Arrays have at least two bytes per text, because netCDF tools join arrays of single bytes into one text.
    """
    array = np.char.encode(np.asarray(text, dtype=str), ENCODING, "replace")  # file names need not be valid text
    length = max(array.dtype.itemsize, 2 if array.ndim else 1)
    return array.astype(h5py.string_dtype(ENCODING, length))


def datasets(root: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """Yield the name of every dataset stored below `root`, and the dataset. Soft and external links are skipped."""
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
    """Return whether a dataset is only a dimension scale, and not declared by an artifact. It is recognised by its
    attributes.
    """
    return "CLASS" in dataset.attrs and "axes" not in dataset.attrs


class Stored(NamedTuple):
    """How a dataset is stored."""

    where: str  # its path in the file
    shape: tuple[int, ...]
    dtype: np.dtype
    size: int  # bytes in the file
    created: h5py.h5p.PropDCID

    @property
    def filters(self) -> set[int]:
        """Return the HDF5 numbers of the filters that the data pass through."""
        return {self.created.get_filter(index)[0] for index in range(self.created.get_nfilters())}


def require_within_file(path: Path, dataset: h5py.h5d.DatasetID) -> Stored:
    """Return how a dataset is stored.

    Raises
    ------
    InputFileError
        If its data lie outside the file, or it claims more data than the file can hold.
    """
    where, created = (h5py.h5i.get_name(dataset) or b"").decode().lstrip("/"), dataset.get_create_plist()
    if created.get_layout() == h5py.h5d.VIRTUAL or created.get_external_count():
        raise InputFileError(f"{path}: dataset {where} lies in another file; give a file that contains it")
    stored = Stored(where, dataset.shape, dataset.dtype, dataset.get_storage_size(), created)
    claimed = prod(stored.shape) * stored.dtype.itemsize
    if claimed > SMALL_BYTES + MAX_COMPRESSION * stored.size and stored.filters <= KNOWN_FILTERS:
        raise InputFileError(f"{path}: dataset {where} claims more data than the file holds; make the file again")
    return stored


def require_readable(path: Path, dataset: h5py.h5d.DatasetID) -> Stored:
    """Return how a dataset is stored, after checking that it can be read as a whole.

    Raises
    ------
    InputFileError
        As from `require_within_file`, or if the dataset or a chunk exceeds the limit on inputs.
    """
    stored = require_within_file(path, dataset)
    chunk = stored.created.get_chunk() if stored.created.get_layout() == h5py.h5d.CHUNKED else ()
    require_values(f"{path}: dataset {stored.where}", stored.shape, stored.dtype.itemsize)
    require_values(f"{path}: a chunk of dataset {stored.where}", chunk, stored.dtype.itemsize)
    return stored
