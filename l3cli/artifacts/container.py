"""HDF5 files in which a changed byte is detected.

The first 512 bytes, HDF5's user block, hold the SHA-256 of all that follows. A file is compared with it before HDF5 reads
it: the library may crash on damaged metadata, and its checksums cover only the values of datasets.
"""

import contextlib
import hashlib
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py

from l3cli.errors import InputFileError
from l3cli.system.files import atomic_output, open_regular
from l3cli.system.signals import uninterrupted

SIGNATURE = b"\x89HDF\r\n\x1a\n"  # of HDF5
BLOCK = 512  # bytes before it
TITLE = b"l3 artifact, SHA-256 of the bytes after the first 512: "


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
    """Yield an HDF5 file open for writing that gets its digest, and appears at `path`, when the block ends without an
    error."""
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
