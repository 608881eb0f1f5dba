"""Write outputs atomically, protect and identify inputs, and record the files that a stage reads and writes.

A process locks its temporary files with flock. The kernel releases the locks when the process ends, even after SIGKILL. An
unlocked temporary file is therefore left over from a killed process. Locks on the outputs themselves are in locks.py.
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
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from l3cli.errors import InputFileError, L3Error, RecipeError

Dated = list[int]  # size in bytes, modification time in ns


@dataclass(frozen=True)
class FilesUsed:
    """The files that a stage has read and written.

    Attributes
    ----------
    read : dict of str to dict
        For each role, such as "table": the input files, with their size in bytes and their modification time in ns before
        they were read (None if a file did not exist).
    written : tuple of Path
        Finished output files.
    """

    read: Mapping[str, Mapping[Path, Dated | None]] = field(default_factory=dict)
    written: tuple[Path, ...] = ()

    def and_wrote(self, *paths: Path) -> "FilesUsed":
        """Return a copy of this record with additional output files."""
        return replace(self, written=(*self.written, *paths))


def files_to_read(roles: Mapping[str, Iterable[Path]]) -> FilesUsed:
    """Record the input files of each role, with their current sizes and modification times.

    Call this function before the files are read, so that changes during the run can be detected.
    """
    return FilesUsed({role: {path: dated(path) for path in paths} for role, paths in roles.items()})


def all_files(parts: Iterable[FilesUsed]) -> FilesUsed:
    """Merge several records. For an input in several records, the size and time from the last record are used."""
    read: dict[str, dict[Path, Dated | None]] = {}
    written: list[Path] = []
    for part in parts:
        for role, files in part.read.items():
            read.setdefault(role, {}).update(files)
        written += part.written
    return FilesUsed(read, tuple(written))


def dated(path: Path) -> Dated | None:
    """Return a file's [size in bytes, modification time in ns], or None if the file is not accessible."""
    try:
        state = os.stat(path)
    except OSError:
        return None
    return [state.st_size, state.st_mtime_ns]


def fingerprint(path: Path) -> tuple[int, ...]:
    """Return a file's size, modification time, change time and inode, from which a later run can detect changes.

    The change time is included because programs can reset the modification time. Raises OSError if the file does not exist.
    """
    state = path.stat()
    return state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino


TEMPORARY = re.compile(r"\.(.*)\.[0-9a-f]{8}\.l3tmp(\.[^.]*)?")
LOCK = ".l3lock"
# Marker files in an output folder. UNFINISHED contains the key of the run that is writing the folder, and FINISHED contains
# the key of the run that has completed it.
UNFINISHED = ".l3-unfinished"
FINISHED = ".l3-finished"
STDIN = Path("-")
LONGEST = 255  # maximum length of a file name, in bytes
LONGEST_SUFFIX = 16  # maximum length, in bytes, of a suffix that can identify a file format
NAMES = {  # file type → its name in messages, for files that are not regular files
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "pipe",
    stat.S_IFSOCK: "socket",
}
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # the disk is full, the quota is exceeded, or the file is too large


# -------------------------------------------------------------------------------------------------------- outputs


def refuse_existing(path: Path, force: bool) -> None:
    """Raise L3Error if `path` is a folder or a device, or if it is a file and `force` is not set."""
    if path.is_dir():
        raise L3Error(f"{path} is a folder; choose a file as the output")
    if path.exists() and not path.is_file():
        raise L3Error(f"{path} is a device or pipe, which l3 cannot replace; choose a file as the output")
    if path.exists() and not force:
        raise L3Error(f"{path} exists; add ‹force› to replace it, or choose another output")


def refuse_filled_folder(path: Path, force: bool) -> None:
    """Raise L3Error if `path` is a file, or if it is a non-empty folder and `force` is not set.

    l3's own locks, markers and temporary files do not count as contents.
    """
    if path.exists() and not path.is_dir():
        raise L3Error(f"{path} is a file; choose a folder")
    if path.is_dir() and not force and any(not is_ours(each.name) for each in path.iterdir()):
        raise L3Error(f"{path} is not empty; add ‹force› to write into it, or choose another folder")


@contextlib.contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """Write a file atomically: yield the path of a temporary file, which is renamed to `path` if the block succeeds.

    If the block fails, the temporary file is removed. The temporary file is in the same folder as `path`, and the folder is
    created if necessary. The temporary file also has the same suffix, from which libraries derive the format. The block
    must write into the temporary file and must not replace it. The content is flushed to disk before the file is renamed.
    Each call creates a new temporary file, so several processes may write the same output.

    Raises
    ------
    L3Error
        If `path` cannot be written, or if the disk is full.
    RecipeError
        If `path` is a protected input.
    """
    refuse_protected(path)
    temporary, descriptor = None, None
    try:
        with blamed_on(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            # The name is known before the file exists, so that the file is also removed if a signal interrupts its creation.
            temporary = _temporary_name(path)
            while descriptor is None:
                descriptor = _new_locked(temporary, initial_mode(path))
        with blamed_on(path, FULL):  # other errors may concern inputs that the block reads
            yield temporary
        with blamed_on(path):
            _put_in_place(temporary, path)
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if descriptor is not None:
            os.close(descriptor)


def write_whole(path: Path, content: bytes | memoryview | str) -> None:
    """Write a file atomically, replacing any existing file. Text is encoded as UTF-8."""
    with atomic_output(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def _temporary_name(path: Path) -> Path:
    stem, suffix = _hidden_name(path)
    return path.with_name(f".{stem}.{os.urandom(4).hex()}.l3tmp{suffix}")


def _new_locked(temporary: Path, mode: int) -> int | None:
    """Create an empty file, lock it, and return its descriptor, or None if another run removed it before it was locked."""
    descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, mode)
    with contextlib.suppress(OSError):  # on storage without locks, `sweep` removes no temporary files either
        fcntl.flock(descriptor, fcntl.LOCK_EX)
    if os.fstat(descriptor).st_nlink:
        return descriptor
    os.close(descriptor)
    return None


def _hidden_name(path: Path) -> tuple[str, str]:
    """Return the stem and the suffix that the names of all temporary files of an output share."""
    stem, suffix = (path.stem, path.suffix) if len(os.fsencode(path.suffix)) <= LONGEST_SUFFIX else (path.name, "")
    return shortened(stem, len(f"..01234567.l3tmp{suffix}")), suffix


def shortened(name: str, more: int) -> str:
    """Shorten a file name so that `more` bytes can be added without exceeding the file system's limit.

    If the name is too long, a digest of the whole name replaces its end. Otherwise, the name is returned unchanged.
    """
    coded, longest = os.fsencode(name), LONGEST - more
    if len(coded) <= longest:
        return name
    digest = hashlib.sha256(coded).hexdigest()[:16]
    return coded[: longest - len(digest)].decode(errors="ignore") + digest


def initial_mode(output: Path) -> int:
    """Return the permissions, before the umask, for an output's new files.

    A file that replaces an existing file gets no wider permissions than the existing file, except that its owner can always
    read and write it.
    """
    try:
        return 0o666 & (output.stat().st_mode | 0o600)
    except OSError:
        return 0o666


def _put_in_place(temporary: Path, path: Path) -> None:
    """Rename a file, and flush its content and the new name to disk."""
    _flush(temporary)
    os.replace(temporary, path)
    try:
        _flush(path.parent)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EACCES):  # the storage cannot flush folders, or the folder is unreadable
            raise


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def blamed_on(path: Path, numbers: tuple[int, ...] | None = None) -> Iterator[None]:
    """Convert an OSError in the block to an L3Error which says that `path` cannot be written.

    If `numbers` is not None, only errors with these `errno` values are converted.
    """
    try:
        yield
    except OSError as error:
        if numbers is not None and error.errno not in numbers:
            raise
        cure = (
            "free some space and run again" if error.errno in FULL else "choose another output or make its folder writable"
        )
        raise L3Error(f"{path} cannot be written: {error.strerror}; {cure}") from error


# ----------------------------------------------------------------------------------------------- temporary files


def open_quietly(path: Path) -> int:
    """Open a regular file for locking, and return its descriptor.

    The file is opened for writing if permitted, because locks over NFS need write access, and otherwise for reading. The
    call never blocks and does not follow symbolic links. Raises OSError if the file cannot be opened or is not a regular
    file.
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except PermissionError:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
    return descriptor


def sweep(folder: Path, output: Path | None = None) -> None:
    """Remove leftover temporary files from a folder. Files that a running process has locked are kept.

    If `output` is not None, only this output's temporary files are removed. Inputs of the command are never removed. The
    folder need not exist.
    """
    wanted = None if output is None else _hidden_name(output)
    for name in os.listdir(folder) if folder.is_dir() else ():
        match = TEMPORARY.fullmatch(name)
        if not match or wanted not in (None, (match[1], match[2] or "")):
            continue
        if identity(folder / name) in _protected:
            continue
        with contextlib.suppress(OSError):  # the file is in use, already removed, or not a file of l3
            descriptor = open_quietly(folder / name)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(folder / name)
            finally:
                os.close(descriptor)


def is_ours(name: str) -> bool:
    """Return whether a file with this name is a lock, a marker or a temporary file of l3."""
    return name.endswith((LOCK, UNFINISHED, FINISHED)) or TEMPORARY.fullmatch(name) is not None


# --------------------------------------------------------------------------------------------------------- inputs

Identity = tuple[int, int]  # device and inode of a file; all hard and symbolic links to a file have the same identity
_protected: dict[Identity, Path] = {}  # input file of the command → path that the user specified


@contextlib.contextmanager
def protecting(paths: Iterable[Path]) -> Iterator[None]:
    """Protect input files during the block, so that `refuse_protected` rejects every output path that refers to them.

    The path "-" stands for the file that is redirected to stdin. Paths that are not regular files are ignored.
    """
    named = ((identity(0 if path == STDIN else path), path) for path in paths)
    added = {key: path for key, path in named if key is not None and key not in _protected}
    _protected.update(added)
    try:
        yield
    finally:
        for key in added:
            del _protected[key]


def refuse_protected(output: Path | int) -> None:
    """Raise RecipeError if an output (a path or a file descriptor) is a protected input file."""
    key = identity(output) if _protected else None
    if key is None or key not in _protected:
        return
    source = _protected[key]
    name, other = "stdout" if isinstance(output, int) else str(output), "stdin" if source == STDIN else str(source)
    same = "" if name == other else f" (the same file as {other})"
    raise RecipeError(f"{name} is an input{same}; choose another output")


def identity(file: Path | int) -> Identity | None:
    """Return a file's device and inode, or None if it is not a regular file. Symbolic links are followed."""
    try:
        state = os.stat(file)
    except OSError:
        return None
    return (state.st_dev, state.st_ino) if stat.S_ISREG(state.st_mode) else None


def require_regular(path: Path, cure: str = "specify an existing file") -> None:
    """Raise InputFileError if `path` is not a regular file. The message ends with `cure`, the suggested correction.

    The file is not opened, because opening a pipe or a device may block forever.
    """
    try:
        _require_regular(path, path.stat().st_mode, cure)
    except OSError as error:
        missing = isinstance(error, FileNotFoundError | NotADirectoryError)
        what = "does not exist" if missing else f"cannot be read: {error.strerror}"
        raise InputFileError(f"{path} {what}; {cure}") from error


def _require_regular(path: Path, mode: int, cure: str) -> None:
    if not stat.S_ISREG(mode):
        raise InputFileError(f"{path} is a {NAMES.get(stat.S_IFMT(mode), 'device')}; {cure}")


def open_regular(path: Path, cure: str = "specify an existing file") -> io.BufferedReader:
    """Open a regular file for reading.

    Raises InputFileError if this fails or if the file is not a regular file. The message ends with `cure`, the suggested
    correction.
    """
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


@contextlib.contextmanager
def naming(path: Path, cure: str = "") -> Iterator[None]:
    """Convert an OSError in the block to an InputFileError with a message that starts with `path` and ends with `cure`."""
    try:
        yield
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}{f'; {cure}' if cure else ''}") from error


def sha256(path: Path) -> str:
    """Return a file's SHA-256 digest in hexadecimal. Raises InputFileError if the file cannot be read."""
    with naming(path), open_regular(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def stamp(path: Path) -> tuple[int, ...]:
    """Return a file's device, inode, size and modification time, or () if the file is not accessible."""
    try:
        state = path.stat()
    except OSError:
        return ()
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns


def require_same(path: Path, digest: str) -> None:
    """Raise InputFileError if a file's SHA-256 digest is not `digest`.

    Workers call this function, because the same path may refer to a different file on another machine. Each process hashes a
    file only once, unless the file changes.
    """
    try:
        known = fingerprint(path)
    except OSError as error:
        raise InputFileError(
            f"{path} cannot be read by a worker ({error.strerror}); put it on storage that all workers share"
        ) from error
    if _known_sha256(path, known) != digest:
        raise InputFileError(f"{path} differs on the machine of a worker; put it on storage that all workers share")


@functools.lru_cache(10_000)
def _known_sha256(path: Path, _: tuple[int, ...]) -> str:
    return sha256(path)
