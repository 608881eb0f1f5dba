"""Files as every command treats them: outputs appear whole or not at all, inputs are known by their SHA-256."""

import contextlib
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

from l3cli.errors import InputFileError, L3Error


def refuse_existing(path: Path, force: bool) -> None:
    """Raise L3Error before any work if `path` exists and may not be replaced."""
    if path.is_dir():
        raise L3Error(f"{path} is a folder; name a file as the output")
    if path.exists() and not force:
        raise L3Error(f"{path} exists; add --force to replace it or name another output")


@contextlib.contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to; flushed to disk and renamed into place on success, removed on failure.

    The temporary file keeps the suffix of `path`, since writers choose their format by it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        yield temporary
        with open(temporary, "rb") as written:
            os.fsync(written.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    if path.exists() and not path.is_file():
        raise InputFileError(f"{path} is no regular file; give one")
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror}") from error


def refuse_filled_folder(path: Path, force: bool) -> None:
    """Raise L3Error before any work if `path` is a file, or a folder that holds something and may not be written into."""
    if path.exists() and not path.is_dir():
        raise L3Error(f"{path} is a file; name a folder")
    if path.is_dir() and any(path.iterdir()) and not force:
        raise L3Error(f"{path} is not empty; add --force to write into it or name another folder")
