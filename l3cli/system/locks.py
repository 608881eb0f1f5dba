"""Locks that allow only one run at a time to write an output.

A run holds a lock (flock) on a hidden file in the folder of the output. The kernel releases the lock when the process ends,
even after SIGKILL. The module also contains a lock for the threads of a process.
"""

import contextlib
import fcntl
import os
import threading
from collections.abc import Iterator
from pathlib import Path

from l3cli.errors import L3Error
from l3cli.system.files import LOCK, blamed_on, initial_mode, open_quietly, refuse_protected, shortened, sweep


class ThreadLock:
    """A lock between the threads of a process. In a forked child, the lock is free.

    A thread of the parent that holds the lock does not exist in the child and would never release it.
    """

    def __init__(self) -> None:
        self._of_process: dict[int, threading.Lock] = {}

    def __enter__(self) -> None:
        self._of_this_process().acquire()

    def __exit__(self, *exception: object) -> None:
        self._of_this_process().release()

    def _of_this_process(self) -> threading.Lock:
        return self._of_process.setdefault(os.getpid(), threading.Lock())


@contextlib.contextmanager
def sole_writer_of_file(path: Path) -> Iterator[bool]:
    """Keep other runs from writing `path` during the block, and remove temporary files that killed runs left.

    Yields
    ------
    bool
        Whether the storage supports locks.

    Raises
    ------
    L3Error
        If another run is writing the file, or if its folder cannot be written.
    """
    with _locked(path, path.with_name(_lock_name(path.name))) as locked:
        if locked:
            sweep(path.parent, path)
        yield locked


@contextlib.contextmanager
def sole_writer_of_folder(folder: Path, name: str = "", inside: tuple[str, ...] = ()) -> Iterator[bool]:
    """Do the same as `sole_writer_of_file` for the files in a folder and in its subfolders `inside`.

    If `name` is set to a pattern, only files that match the pattern are locked. The folder is created if necessary, and
    removed if it is empty at the end. Temporary files of killed worker processes are also removed.
    """
    with _locked(folder / name, folder / (_lock_name(name) if name else LOCK)) as locked:
        swept = [folder, *(folder / each for each in inside)] if locked else []
        for each in swept:
            sweep(each)
        try:
            yield locked
        finally:
            for each in swept:
                sweep(each)


def _lock_name(name: str) -> str:
    return f".{shortened(name, len(f'.{LOCK}'))}{LOCK}"


@contextlib.contextmanager
def _locked(output: Path, lock: Path) -> Iterator[bool]:
    """Hold `lock` during the block. Folders that are created for the lock are removed if they stay empty."""
    refuse_protected(lock)  # the lock file is removed at the end
    made = [folder for folder in (lock.parent, *lock.parent.parents) if not folder.exists()]
    try:
        descriptor = _take(lock, output)
        try:
            yield descriptor is not None
        finally:
            if descriptor is not None:
                _let_go(lock, descriptor)
    finally:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _busy(output: Path) -> L3Error:
    return L3Error(f"{output} is being written by another run; wait until that run ends, or choose another output")


def _take(lock: Path, output: Path) -> int | None:
    """Create the lock file if necessary and lock it. Return its descriptor, or None if the storage does not support locks.

    Raises L3Error if another run holds the lock.
    """
    while True:
        with blamed_on(output):
            lock.parent.mkdir(parents=True, exist_ok=True)
            descriptor: int | None
            try:
                descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_EXCL, initial_mode(output))
            except FileExistsError:
                descriptor = _existing(lock)
        if descriptor is None:
            continue  # another run has just removed the lock file
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(descriptor)
            raise _busy(output) from error
        except OSError:
            _let_go(lock, descriptor)
            return None
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.lstat(lock), os.fstat(descriptor)):
                return descriptor
        os.close(descriptor)  # another run removed the lock file between the two calls


def _existing(lock: Path) -> int | None:
    """Open an existing lock file, or return None if it no longer exists.

    Raises L3Error if the file is not a lock file of l3 or is not accessible. Symbolic links are not followed, nothing is
    created, and opening never blocks, because a shared folder may contain anything.
    """
    try:
        return open_quietly(lock)
    except FileNotFoundError:
        return None
    except PermissionError as error:
        raise L3Error(
            f"{lock} belongs to another user; remove it if that user has no run in progress, or choose another output"
        ) from error
    except OSError as error:
        raise L3Error(f"{lock} is not a lock file of l3; remove it, or choose another output") from error


def _let_go(lock: Path, descriptor: int) -> None:
    """Remove a lock file, and release the lock by closing its descriptor."""
    with contextlib.suppress(FileNotFoundError, PermissionError):  # only the owner may be allowed to remove the file
        lock.unlink()
    os.close(descriptor)
