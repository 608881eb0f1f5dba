"""Locks that prevent two runs from writing the same output at the same time, and a lock for the threads of a process.

A run locks a hidden file next to the output with flock. The kernel releases the lock when the process ends, even after
SIGKILL.
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
    """A lock between the threads of a process, which is always free at the start of a forked child process.

    If another thread holds an ordinary lock during a fork, the lock is never released in the child, because the thread that
    holds it does not exist in the child.
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
    """Context manager that prevents other runs from writing a file, and removes leftover temporary files of killed runs.

    Yields
    ------
    bool
        False if the file system does not support locks. Then other runs can write the file at the same time.

    Raises
    ------
    L3Error
        If another run is writing the file, or if its folder is not writable.
    """
    with _locked(path, path.with_name(_lock_name(path.name))) as locked:
        if locked:
            sweep(path.parent, path)
        yield locked


@contextlib.contextmanager
def sole_writer_of_folder(folder: Path, name: str = "", inside: tuple[str, ...] = ()) -> Iterator[bool]:
    """Context manager that prevents other runs from writing into a folder, or only the files in it that match a pattern.

    The folder is created if necessary, and removed at the end if it is empty. Leftover temporary files of killed runs and
    worker processes are removed at the start and at the end.

    Parameters
    ----------
    folder : Path
        The folder.
    name : str
        Pattern of the output file names that this run writes. Runs with different patterns may write into the folder at the
        same time. [default: lock the whole folder]
    inside : tuple of str
        Names of subfolders from which leftover temporary files are also removed.

    Yields
    ------
    bool
        False if the file system does not support locks. Then other runs can write into the folder at the same time.

    Raises
    ------
    L3Error
        If another run is writing into the folder, or if the folder is not writable.
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
    """Hold a lock file during the block. Yields False if the file system does not support locks.

    Folders that are created for the lock file are removed at the end if they are empty.
    """
    refuse_protected(lock)  # the lock file is removed at the end, so it must not be an input
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
    """Create the lock file if necessary, and lock it.

    Returns its descriptor, or None if the file system does not support locks. Raises L3Error if another run holds the lock.
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
            continue  # another run removed the lock file before this run opened it
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
        os.close(descriptor)  # another run removed the lock file before this run locked it


def _existing(lock: Path) -> int | None:
    """Open an existing lock file, and return its descriptor, or None if the file no longer exists.

    In a shared folder, a symbolic link or a pipe may have the name of the lock file. The call therefore neither follows
    symbolic links nor blocks. Raises L3Error if the file is not accessible or not a regular file.
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
        raise L3Error(f"{lock} is not an l3 lock file; remove it, or choose another output") from error


def _let_go(lock: Path, descriptor: int) -> None:
    """Remove a lock file, and close its descriptor, which releases the lock."""
    with contextlib.suppress(FileNotFoundError, PermissionError):  # in some folders, only the owner may remove a file
        lock.unlink()
    os.close(descriptor)
