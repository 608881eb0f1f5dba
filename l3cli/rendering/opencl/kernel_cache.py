"""The folder in which PoCL caches compiled kernels.

PoCL believes whatever it finds there, and ends the process where it cannot write: so the folder is this user's alone and on
a disk with room, or else a temporary one. What a damaged file in it does: docs/limits.md. Other drivers keep their kernels
themselves; pyopencl's cache, which unpickles what it finds and leaves PoCL alone, is not used.
"""

import atexit
import contextlib
import errno
import functools
import os
import shutil
import stat
import tempfile
import time
from pathlib import Path

from l3cli.errors import DeviceError

ROOM = 16 << 20  # bytes, several times what the kernels of a table need while they are compiled
LEFT = 86400  # seconds after which an empty file is nobody's: each process that uses PoCL 3.0 leaves one


@functools.cache
def prepare() -> str:
    """Choose PoCL's folder, before the first device is asked for: return why it is a temporary one, empty if it is not.
    DeviceError if no disk has room."""
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    folder = _user_folder()
    if folder is None:
        os.environ["POCL_CACHE_DIR"] = _temporary_folder()
        return "there is no home folder"
    try:
        folder.mkdir(mode=stat.S_IRWXU, parents=True, exist_ok=True)
        state = folder.stat()
        if state.st_uid != os.geteuid() or state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise PermissionError(errno.EPERM, "other users may write to it, which chmod go-w mends")
        _require_room(folder)
        _remove_empty(folder)
    except OSError as error:
        os.environ["POCL_CACHE_DIR"] = _temporary_folder()
        return f"{folder}: {error.strerror}"
    os.environ["POCL_CACHE_DIR"] = str(folder)
    return ""


def cache_warning() -> str:
    """Return a warning of kernels that could not be cached; empty if they could, or if none were needed."""
    if not prepare.cache_info().currsize or not (reason := prepare()):
        return ""
    return (
        f"compiled kernels cannot be cached ({reason}), so each run compiles them anew, which takes seconds; "
        "set XDG_CACHE_HOME to a folder with room that can be written to"
    )


def _user_folder() -> Path | None:
    """Return POCL_CACHE_DIR, else a folder below XDG_CACHE_HOME or the home folder; None without any."""
    chosen, caches = Path(os.environ.get("POCL_CACHE_DIR", "")), Path(os.environ.get("XDG_CACHE_HOME", ""))
    if chosen.is_absolute():
        return chosen
    home = Path(os.path.expanduser("~"))
    if not caches.is_absolute() and home.is_absolute() and os.environ.get("HOME") != "":
        caches = home / ".cache"
    return caches / "l3cli" / "pocl" if caches.is_absolute() else None


def _require_room(folder: Path) -> None:
    """Raise OSError unless compiled kernels can be written to a folder, and loaded from it as programs are."""
    if os.statvfs(folder).f_flag & os.ST_NOEXEC:
        raise PermissionError(errno.EACCES, "programs cannot be run from it")
    with tempfile.TemporaryFile(dir=folder) as room:
        os.posix_fallocate(room.fileno(), 0, ROOM)


def _remove_empty(folder: Path) -> None:
    for file in os.scandir(folder):
        with contextlib.suppress(OSError):
            state = file.stat(follow_symlinks=False)
            if stat.S_ISREG(state.st_mode) and not state.st_size and time.time() - state.st_mtime > LEFT:
                os.unlink(file)


def _temporary_folder() -> str:
    """Return a new folder that is removed when this process ends. DeviceError if no disk has room."""
    places = [place for place in (os.environ.get("TMPDIR"), "/tmp", "/var/tmp", "/dev/shm") if place]
    for place in places:
        with contextlib.suppress(OSError):
            _require_room(Path(place))
            folder = tempfile.mkdtemp(prefix="l3-kernels-", dir=place)
            atexit.register(_remove, folder, os.getpid())
            return folder
    raise DeviceError(
        f"no disk has {ROOM >> 20} MB to compile kernels in ({', '.join(places)}); free some space or set TMPDIR"
    )


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)
