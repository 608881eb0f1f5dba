"""Files as every command treats them: outputs appear whole or not at all, one run at a time writes them, and inputs are
known by their SHA-256.

Whoever writes holds a lock (flock) that the kernel lets go of however the process ends, be it SIGKILL: on a hidden file
beside the output for as long as the run lasts, and on each temporary file. A temporary file that nobody holds is what a
killed run left.
"""

import contextlib
import errno
import fcntl
import functools
import hashlib
import io
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from l3cli.errors import InputFileError, L3Error
from l3cli.interrupts import uninterrupted

TEMPORARY = re.compile(r"\.(.*)\.[0-9a-f]{8}\.l3tmp(\.[^.]*)?")
LOCK = ".l3lock"
NAMES = {stat.S_IFDIR: "folder", stat.S_IFIFO: "pipe", stat.S_IFSOCK: "socket"}  # of what is no file
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


# -------------------------------------------------------------------------------------------------------- outputs


def refuse_existing(path: Path, force: bool) -> None:
    """Raise L3Error before any work if `path` exists and may not be replaced."""
    if path.is_dir():
        raise L3Error(f"{path} is a folder; name a file as the output")
    if path.exists() and not path.is_file():
        raise L3Error(f"{path} is a device or pipe, which cannot be replaced by a whole file; name a file as the output")
    if path.exists() and not force:
        raise L3Error(f"{path} exists; add --force to replace it or name another output")


def refuse_filled_folder(path: Path, force: bool) -> None:
    """Raise L3Error before any work if `path` is a file, or a folder that holds something and may not be written into."""
    if path.exists() and not path.is_dir():
        raise L3Error(f"{path} is a file; name a folder")
    if path.is_dir() and not force and any(not is_ours(each.name) for each in path.iterdir()):
        raise L3Error(f"{path} is not empty; add --force to write into it or name another folder")


@contextlib.contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` to write to; flushed to disk and renamed into place on success, removed on failure.

    The temporary file keeps the suffix of `path`, since writers choose their format by it; it must be written in place, not
    replaced. No two processes ever write to the same one. L3Error if `path` cannot be written, or the disk is full.
    """
    temporary, held = None, None
    try:
        with _blamed_on(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary, held = _new_temporary(path)
        with _blamed_on(path, FULL):  # of what goes wrong inside: inputs may be read there
            yield temporary
        with _blamed_on(path):
            _put_in_place(temporary, path)
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if held is not None:
            os.close(held)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write `content` (text as UTF-8) to `path` whole or not at all."""
    with atomic_output(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


@uninterrupted
def _new_temporary(path: Path) -> tuple[Path, int]:
    """A new, empty, locked temporary file beside `path`, and the descriptor that holds the lock."""
    while True:
        temporary = path.with_name(f".{path.stem}.{os.urandom(4).hex()}.l3tmp{path.suffix}")
        held = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        with contextlib.suppress(OSError):  # storage without locks: nobody can take it for a dead run's
            fcntl.flock(held, fcntl.LOCK_EX)
        if os.fstat(held).st_nlink:
            return temporary, held
        os.close(held)  # swept between the two calls


def _put_in_place(temporary: Path, path: Path) -> None:
    """Give a file its name, both on the disk."""
    _flush(temporary)
    os.replace(temporary, path)
    try:
        _flush(path.parent)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EACCES):  # storage that cannot, a folder that we may not look into
            raise


def _flush(path: Path) -> None:
    """Make sure that a file's content, or a folder's names, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def _blamed_on(path: Path, numbers: tuple[int, ...] | None = None) -> Iterator[None]:
    """Errors of the system (those `numbers`, if given) as L3Error that says that `path` cannot be written."""
    try:
        yield
    except OSError as error:
        if numbers is not None and error.errno not in numbers:
            raise
        cure = "free some space and run again" if error.errno in FULL else "name another output or mend its folder"
        raise L3Error(f"{path} cannot be written: {error.strerror}; {cure}") from error


# --------------------------------------------------------------------------------------------------- one run at a time


@contextlib.contextmanager
def sole_writer_of_file(path: Path) -> Iterator[bool]:
    """Keep other runs off the file `path` while the block lasts, and remove what a killed run left half-written of it.

    Yields whether the storage knows locks at all. L3Error if another run writes the file, or its folder cannot be written.
    """
    with _claim(path, path.with_name(f".{path.name}{LOCK}")) as locked:
        if locked:
            sweep(path.parent, path)
        yield locked


@contextlib.contextmanager
def sole_writer_of_folder(folder: Path, name: str = "", inside: tuple[str, ...] = ()) -> Iterator[bool]:
    """`sole_writer_of_file` for the files of a folder and of those `inside` it; with `name` (of a pattern) for those files
    alone that it stands for.

    The folder is made; it is removed again if it is empty in the end. What worker processes left that were ended goes, too.
    """
    with _claim(folder / name, folder / (f".{name}{LOCK}" if name else LOCK)) as locked:
        swept = [folder, *(folder / each for each in inside)] if locked else []
        for each in swept:
            sweep(each)
        try:
            yield locked
        finally:
            for each in swept:
                sweep(each)


@contextlib.contextmanager
def _claim(output: Path, lock: Path) -> Iterator[bool]:
    """Hold `lock` while the block lasts; folders that had to be made for it go again if they stay empty."""
    made = [folder for folder in (lock.parent, *lock.parent.parents) if not folder.exists()]
    try:
        held = _take(lock, output)
        try:
            yield held is not None
        finally:
            if held is not None:
                _let_go(lock, held)
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()


@uninterrupted
def _take(lock: Path, output: Path) -> int | None:
    """The descriptor that holds the lock; None where the storage knows no locks."""
    while True:
        with _blamed_on(output):
            lock.parent.mkdir(parents=True, exist_ok=True)
            held = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        with contextlib.suppress(OSError):  # if another user's run is killed, we must be able to take it
            os.fchmod(held, 0o666)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(held)
            raise L3Error(f"{output} is being written by another run; wait until it ends or name another output") from error
        except OSError:
            os.close(held)
            lock.unlink(missing_ok=True)
            return None
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.stat(lock), os.fstat(held)):
                return held
        os.close(held)  # its holder has ended and removed it between the two calls


@uninterrupted
def _let_go(lock: Path, held: int) -> None:
    lock.unlink(missing_ok=True)
    os.close(held)


def sweep(folder: Path, output: Path | None = None) -> None:
    """Remove the temporary files in `folder` (those of `output`, if given) whose writer is dead."""
    for name in os.listdir(folder) if folder.is_dir() else ():
        found = TEMPORARY.fullmatch(name)
        if not found or (output is not None and (found[1], found[2] or "") != (output.stem, output.suffix)):
            continue
        with contextlib.suppress(OSError):  # a living writer's, or gone already
            held = os.open(folder / name, os.O_RDWR)
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(folder / name)
            finally:
                os.close(held)


def is_ours(name: str) -> bool:
    """Whether a file of this name is a lock or temporary."""
    return name.endswith(LOCK) or TEMPORARY.fullmatch(name) is not None


# --------------------------------------------------------------------------------------------------------- inputs


def require_regular(path: Path, cure: str = "give a file") -> None:
    """InputFileError, with this cure, unless there is a regular file: a folder has no bytes, and whoever opens a pipe or
    device may wait for ever. Looked up by name; nothing is opened."""
    try:
        _require_regular(path, path.stat().st_mode, cure)
    except OSError as error:
        missing = isinstance(error, FileNotFoundError | NotADirectoryError)
        what = "does not exist" if missing else f"cannot be read: {error.strerror}"
        raise InputFileError(f"{path} {what}; {cure}") from error


def _require_regular(path: Path, mode: int, cure: str) -> None:
    if not stat.S_ISREG(mode):
        raise InputFileError(f"{path} is a {NAMES.get(stat.S_IFMT(mode), 'device')}; {cure}")


def open_regular(path: Path, cure: str = "give a file") -> io.BufferedReader:
    """A regular file open for reading; InputFileError, as by `require_regular`, if it is none, also if it has become none
    since it was looked at."""
    require_regular(path, cure)
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    except OSError as error:
        raise InputFileError(f"{path} cannot be read: {error.strerror}; {cure}") from error
    try:
        _require_regular(path, os.fstat(descriptor).st_mode, cure)
        os.set_blocking(descriptor, True)
        return open(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    try:
        with open_regular(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror}") from error


def stamp(path: Path) -> tuple[int, ...]:
    """What tells a file from another that takes its name: number on the disk, size, time. Empty if it is not there."""
    try:
        state = path.stat()
    except OSError:
        return ()
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns


def require_same(path: Path, digest: str) -> None:
    """InputFileError unless the file has this SHA-256: on another machine, another file may have its name. It is read once
    as long as its size and time stay."""
    try:
        state = path.stat()
    except OSError as error:
        raise InputFileError(
            f"{path} cannot be read by a worker ({error.strerror}); put it on storage that all share"
        ) from error
    if _known_sha256(path, state.st_size, state.st_mtime_ns) != digest:
        raise InputFileError(f"{path} is another file for a worker than here; put it on storage that all share")


@functools.lru_cache(10_000)
def _known_sha256(path: Path, size: int, changed: int) -> str:
    return sha256(path)
