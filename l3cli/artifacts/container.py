"""Self-contained HDF5 files with a checksum.

The first 512 bytes of such a file are the HDF5 user block, which contains the SHA-256 digest of all bytes that follow. l3
verifies the digest before it opens the file with the HDF5 library, because the library may crash on damaged metadata. HDF5's
own checksums protect only dataset values.

Links, external storage, virtual datasets and unknown filters can make the HDF5 library read other files or load plug-ins, so
l3 rejects files with these features. l3 also rejects a dataset if its declared size is larger than its stored bytes allow.
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
BLOCK = 512  # size in bytes of the user block, which precedes the signature
TITLE = b"l3 artifact, SHA-256 of the bytes after the first 512: "
KNOWN_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
MAX_COMPRESSION = 1100  # largest plausible compression ratio; deflate reaches at most 1032
SMALL_BYTES = 4096  # a dataset's declared size may exceed the MAX_COMPRESSION limit by this much
ENCODING = "utf-8"


class _Sink(io.RawIOBase):
    """File object to which HDF5 writes. It keeps exceptions away from HDF5.

    An exception in one of these methods would crash HDF5, or HDF5 would ignore it and lose data. Write errors are therefore
    stored in `error`, which the caller raises after HDF5 has closed the file, and signals are delayed.
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
    """Create an HDF5 file in a `with` block.

    The file is written under a temporary name. If the block ends without an error, l3 adds the digest and renames the file
    to `path`. Otherwise no file remains.
    """
    with atomic_output(path) as temporary, open(temporary, "r+b", buffering=0) as raw:
        sink = _Sink(raw.fileno())
        with h5py.File(sink, "w", libver=("earliest", "v110"), track_order=False, userblock_size=BLOCK) as root:
            yield root
        if sink.error is not None:
            raise sink.error
        os.pwrite(raw.fileno(), _block(raw), 0)


def seal(path: Path) -> None:
    """Compute the digest of an HDF5 file and write it to the file's user block."""
    with open(path, "r+b", buffering=0) as raw:
        os.pwrite(raw.fileno(), _block(raw), 0)


def check(path: Path, made_by: str) -> None:
    """Verify a file against the digest in its user block.

    Parameters
    ----------
    path : Path
        The file.
    made_by : str
        Command that writes such files, for error messages.

    Raises
    ------
    InputFileError
        If the file cannot be read, is not an artifact, or has changed since it was written.
    """
    try:
        with open_regular(path, f"use a file written by {made_by}") as raw:
            head = raw.read(BLOCK + len(SIGNATURE))
            has_title = head.startswith(TITLE)
            if not has_title and SIGNATURE not in (head[: len(SIGNATURE)], head[BLOCK:]):
                raise InputFileError(f"{path} is not an HDF5 file; use a file written by {made_by}")
            if has_title and head[:BLOCK] == _block(raw):
                return
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror}; use a file written by {made_by}") from error
    what = (
        "is truncated or damaged, because its checksum is wrong"
        if has_title
        else "is an HDF5 file but not an l3 artifact, or is damaged"
    )
    raise InputFileError(f"{path} {what}; copy the file again, or create it again with {made_by}")


def open_file(path: Path) -> h5py.File:
    """Open an HDF5 file for reading, without a lock. Raises OSError if HDF5 cannot open the file.

    A lock is unnecessary, because l3 never changes a finished file, and some network file systems do not support locks.
    """
    return h5py.File(path, "r", locking=False)


def open_content(content: bytes) -> h5py.File:
    """Open the bytes of an HDF5 file for reading. Raises ValueError if they do not match the digest in the user block."""
    if content[:BLOCK] != _user_block(hashlib.sha256(memoryview(content)[BLOCK:]).hexdigest()):
        raise ValueError("the contents do not match the digest in the user block")
    return h5py.File(io.BytesIO(content), "r")


def _block(raw: io.BufferedReader | io.FileIO) -> bytes:
    """Return the user block of a file, which contains the SHA-256 digest of all bytes after the block."""
    raw.seek(BLOCK)
    return _user_block(hashlib.file_digest(raw, "sha256").hexdigest())


def _user_block(digest: str) -> bytes:
    return (TITLE + digest.encode()).ljust(BLOCK - 1) + b"\n"


def encoded(text: Any) -> NDArray[np.bytes_]:
    """Convert a string or an array of strings to fixed-length UTF-8 for HDF5. Invalid characters are replaced by "?".

    Array elements have at least two bytes, because netCDF tools would join an array of single bytes into one string.
    """
    array = np.char.encode(np.asarray(text, dtype=str), ENCODING, "replace")  # file names may contain invalid characters
    length = max(array.dtype.itemsize, 2 if array.ndim else 1)
    return array.astype(h5py.string_dtype(ENCODING, length))


def datasets(root: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """Iterate over all datasets below `root`, each with its path. Soft links and external links are not followed."""
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
    """Return whether a dataset is only an HDF5 dimension scale instead of an artifact's data."""
    return "CLASS" in dataset.attrs and "axes" not in dataset.attrs


class Stored(NamedTuple):
    """Path, type, size and filters of a dataset in a file."""

    where: str  # path of the dataset in the file
    shape: tuple[int, ...]
    dtype: np.dtype
    size: int  # bytes in the file, after compression
    created: h5py.h5p.PropDCID  # creation properties, such as layout and filters

    @property
    def filters(self) -> set[int]:
        """HDF5 identifiers of the filters that encode the data, such as compression."""
        return {self.created.get_filter(index)[0] for index in range(self.created.get_nfilters())}


def require_within_file(path: Path, dataset: h5py.h5d.DatasetID) -> Stored:
    """Check that a dataset is stored in the file itself, and return its type and size.

    Raises
    ------
    InputFileError
        If the data are in a different file, or if the dataset declares more values than its stored bytes can contain.
    """
    where, created = (h5py.h5i.get_name(dataset) or b"").decode().lstrip("/"), dataset.get_create_plist()
    if created.get_layout() == h5py.h5d.VIRTUAL or created.get_external_count():
        raise InputFileError(
            f"{path}: the values of dataset {where} are stored in a different file; use a file that contains its values"
        )
    stored = Stored(where, dataset.shape, dataset.dtype, dataset.get_storage_size(), created)
    claimed = prod(stored.shape) * stored.dtype.itemsize
    if claimed > SMALL_BYTES + MAX_COMPRESSION * stored.size and stored.filters <= KNOWN_FILTERS:
        raise InputFileError(f"{path}: dataset {where} declares more values than the file contains; create the file again")
    return stored


def require_readable(path: Path, dataset: h5py.h5d.DatasetID) -> Stored:
    """Check that a dataset is small enough to be read into memory, and return its type and size.

    Raises
    ------
    InputFileError
        If `require_within_file` fails, or if the dataset or a chunk exceeds the size limit for inputs.
    """
    stored = require_within_file(path, dataset)
    chunk = stored.created.get_chunk() if stored.created.get_layout() == h5py.h5d.CHUNKED else ()
    require_values(f"{path}: dataset {stored.where}", stored.shape, stored.dtype.itemsize)
    require_values(f"{path}: a chunk of dataset {stored.where}", chunk, stored.dtype.itemsize)
    return stored
