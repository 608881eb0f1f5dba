"""Files: atomic outputs, identification of inputs by SHA-256, and records of the files that a stage used.

A process that writes a temporary file holds a lock (flock) on it, which the kernel releases even after SIGKILL. A temporary
file without a lock was therefore left by a killed run. Locks on outputs are in locks.py.
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
    read : dict
        For each role, such as "table": the files, with their size and time before they were read, or None if they did not
        exist.
    written : tuple of Path
        Finished output files.
    """

    read: Mapping[str, Mapping[Path, Dated | None]] = field(default_factory=dict)
    written: tuple[Path, ...] = ()

    def and_wrote(self, *paths: Path) -> "FilesUsed":
        """Return the same record with further output files."""
        return replace(self, written=(*self.written, *paths))


def files_to_read(roles: Mapping[str, Iterable[Path]]) -> FilesUsed:
    """Return a record of input files by role. It must be made before the files are read, so that it reveals changes."""
    return FilesUsed({role: {path: dated(path) for path in paths} for role, paths in roles.items()})


def all_files(parts: Iterable[FilesUsed]) -> FilesUsed:
    """Combine the records of several runs."""
    read: dict[str, dict[Path, Dated | None]] = {}
    written: list[Path] = []
    for part in parts:
        for role, files in part.read.items():
            read.setdefault(role, {}).update(files)
        written += part.written
    return FilesUsed(read, tuple(written))


def dated(path: Path) -> Dated | None:
    """Return the size and modification time of a file, or None if it does not exist."""
    try:
        state = os.stat(path)
    except OSError:
        return None
    return [state.st_size, state.st_mtime_ns]


def fingerprint(path: Path) -> tuple[int, ...]:
    """Return size, modification time, change time and inode of a file, which together identify its content across runs.

    The change time cannot be set back, so a copy with the same size and modification time still differs. Raises OSError if
    there is no file.
    """
    state = path.stat()
    return state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino


TEMPORARY = re.compile(r"\.(.*)\.[0-9a-f]{8}\.l3tmp(\.[^.]*)?")
LOCK = ".l3lock"
UNFINISHED = ".l3-unfinished"  # marker file in a picture folder; identifies the run that is still writing to this folder
FINISHED = ".l3-finished"  # marker file in a picture folder; identifies the run that wrote all pictures in this folder
STDIN = Path("-")
LONGEST = 255  # maximum length of a file name, in bytes
LONGEST_SUFFIX = 16  # maximum length of a suffix from which writers derive their format, in bytes
NAMES = {
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "pipe",
    stat.S_IFSOCK: "socket",
}  # nouns in messages for things that are not files
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


# -------------------------------------------------------------------------------------------------------- outputs


def refuse_existing(path: Path, force: bool) -> None:
    """Raise L3Error if `path` exists and must not be replaced."""
    if path.is_dir():
        raise L3Error(f"{path} is a folder; choose a file as the output")
    if path.exists() and not path.is_file():
        raise L3Error(f"{path} is a device or pipe, which l3 cannot replace; choose a file as the output")
    if path.exists() and not force:
        raise L3Error(f"{path} exists; add ‹force› to replace it, or choose another output")


def refuse_filled_folder(path: Path, force: bool) -> None:
    """Raise L3Error if `path` is a file, or is a folder that is not empty and `force` is not set."""
    if path.exists() and not path.is_dir():
        raise L3Error(f"{path} is a file; choose a folder")
    if path.is_dir() and not force and any(not is_ours(each.name) for each in path.iterdir()):
        raise L3Error(f"{path} is not empty; add ‹force› to write into it, or choose another folder")


@contextlib.contextmanager
def atomic_output(path: Path) -> Iterator[Path]:
    """Yield a temporary path, which is renamed to `path` if the block succeeds and removed otherwise.

    The temporary file is in the folder of `path` and has the same suffix, because writers derive their format from it. The
    content is flushed to disk before the file is renamed. The block must write into the file without replacing it. Every
    process has its own temporary file.

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
            temporary, descriptor = _new_temporary(path)
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
    """Write `content` to `path`, which appears only when it is complete. Text is encoded as UTF-8."""
    with atomic_output(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def _new_temporary(path: Path) -> tuple[Path, int]:
    """Return a new, empty, locked temporary file in the folder of `path`, and the descriptor that holds its lock."""
    stem, suffix = _hidden_name(path)
    while True:
        temporary = path.with_name(f".{stem}.{os.urandom(4).hex()}.l3tmp{suffix}")
        descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL, initial_mode(path))
        with contextlib.suppress(OSError):  # if locks are not supported, no run removes temporary files of other runs
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        if os.fstat(descriptor).st_nlink:
            return temporary, descriptor
        os.close(descriptor)  # another run removed the file between the two calls


def _hidden_name(path: Path) -> tuple[str, str]:
    """Return the stem and suffix from which the names of the temporary files of `path` are built."""
    stem, suffix = (path.stem, path.suffix) if len(os.fsencode(path.suffix)) <= LONGEST_SUFFIX else (path.name, "")
    return shortened(stem, len(f"..01234567.l3tmp{suffix}")), suffix


def shortened(name: str, more: int) -> str:
    """Return `name` or, if `name` and `more` further bytes are too long for a file name, its beginning and a digest."""
    coded, longest = os.fsencode(name), LONGEST - more
    if len(coded) <= longest:
        return name
    digest = hashlib.sha256(coded).hexdigest()[:16]
    return coded[: longest - len(digest)].decode(errors="ignore") + digest


def initial_mode(output: Path) -> int:
    """Return the mode, before the umask, of files that are created for an output.

    It grants no more access than the mode of the file that the output replaces.
    """
    try:
        return 0o666 & (output.stat().st_mode | 0o600)
    except OSError:
        return 0o666


def _put_in_place(temporary: Path, path: Path) -> None:
    """Rename a file, and make sure that the content and the new name are on disk."""
    _flush(temporary)
    os.replace(temporary, path)
    try:
        _flush(path.parent)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EACCES):  # storage without fsync of folders, or an unreadable folder
            raise


def _flush(path: Path) -> None:
    """Flush the content of a file, or the names in a folder, to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def blamed_on(path: Path, numbers: tuple[int, ...] | None = None) -> Iterator[None]:
    """Convert system errors in the block to an L3Error that says that `path` cannot be written.

    If `numbers` is set, only errors with these error numbers (errno) are converted.
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
    """Open a regular file so that it can be locked, and return its descriptor. Raises OSError if that is not possible.

    Write access is only needed for locks over NFS, so a read-only file of another user is opened for reading.
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
    """Remove temporary files in `folder` that no running process has locked.

    If `output` is set, only temporary files of this output are removed. Temporary files that are inputs of the command are
    kept.
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
    """Whether a file with this name is a lock, a checkpoint or a temporary file of l3."""
    return name.endswith((LOCK, UNFINISHED, FINISHED)) or TEMPORARY.fullmatch(name) is not None


# --------------------------------------------------------------------------------------------------------- inputs

Identity = tuple[int, int]  # device and inode, which are the same for every name, symbolic link and hard link of a file
_protected: dict[Identity, Path] = {}  # files that the command reads, with the names under which the user specified them


@contextlib.contextmanager
def protecting(paths: Iterable[Path]) -> Iterator[None]:
    """Keep outputs of this process from replacing these files, by any name, during the block. "-" is stdin."""
    named = ((identity(0 if path == STDIN else path), path) for path in paths)
    added = {key: path for key, path in named if key is not None and key not in _protected}
    _protected.update(added)
    try:
        yield
    finally:
        for key in added:
            del _protected[key]


def refuse_protected(output: Path | int) -> None:
    """Raise RecipeError if an output, which is a path or a descriptor, is a protected input."""
    key = identity(output) if _protected else None
    if key is None or key not in _protected:
        return
    source = _protected[key]
    name, other = "stdout" if isinstance(output, int) else str(output), "stdin" if source == STDIN else str(source)
    same = "" if name == other else f" (the same file as {other})"
    raise RecipeError(f"{name} is an input{same}; choose another output")


def identity(file: Path | int) -> Identity | None:
    """Return the identity of a regular file, or None if it does not exist or is not a regular file. Links are followed."""
    try:
        state = os.stat(file)
    except OSError:
        return None
    return (state.st_dev, state.st_ino) if stat.S_ISREG(state.st_mode) else None


def require_regular(path: Path, cure: str = "use a file") -> None:
    """Raise InputFileError, ending with `cure`, unless `path` is a regular file.

    The file is not opened, because opening a pipe or device may block forever.
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


def open_regular(path: Path, cure: str = "use a file") -> io.BufferedReader:
    """Open a regular file for reading. Raises InputFileError, like `require_regular`, if it is not a regular file."""
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
    """Convert system errors to InputFileErrors that name the file and end with `cure`."""
    try:
        yield
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}{f'; {cure}' if cure else ''}") from error


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits."""
    with naming(path), open_regular(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def stamp(path: Path) -> tuple[int, ...]:
    """Return device, inode, size and modification time of a file, or () if it does not exist."""
    try:
        state = path.stat()
    except OSError:
        return ()
    return state.st_dev, state.st_ino, state.st_size, state.st_mtime_ns


def require_same(path: Path, digest: str) -> None:
    """Raise InputFileError unless a file has the given SHA-256, because its name may mean another file on another machine.

    A file that has not changed is read only once.
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
