"""Finds OpenCL devices, explains why there are none, and chooses the folder in which PoCL caches compiled kernels.

PoCL trusts all files in its cache, and aborts the process if it cannot write there. The cache folder must therefore be
writable only by this user, and be on a disk with enough space. Otherwise a temporary folder is used. docs/limits.md
describes the effect of a damaged file in the cache. Other drivers have their own caches. The cache of pyopencl is not used,
because it unpickles its files.
"""

import atexit
import contextlib
import errno
import functools
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from l3cli.errors import DeviceError, shortened
from l3cli.rendering.opencl.processor import compiled_for

MIN_FREE_BYTES = 16 << 20  # bytes that must be free, several times what the compilation of a table's kernels needs
LEFT = 86400  # seconds after which empty files are removed, because each process with PoCL 3.0 leaves one
INSTALL = 'install one, on any processor with: pip install "pyopencl[pocl]"'
LINKER = "ld"  # linker that PoCL uses, together with the libraries of a C compiler; without them PoCL aborts the process
REFUSES_PROCESSOR = "unknown target CPU"  # message of PoCL's compiler
DAMAGED = "INVALID_KERNEL_NAME"  # PoCL's error for a program that comes from a damaged cache file
FORKED = (
    "this process was forked from one that uses OpenCL, which would hang here; start processes by "
    '"spawn", multiprocessing.get_context("spawn"), and make renderers within them'
)


@functools.cache
def prepare_cache() -> str:
    """Choose the folder of PoCL's cache, before the first device is requested.

    Returns
    -------
    str
        The reason why the folder is temporary, or "" if it is permanent.

    Raises
    ------
    DeviceError
        If no disk has enough space.
    """
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    folder = _user_folder()
    if folder is None:
        os.environ["POCL_CACHE_DIR"] = _temporary_folder()
        return "there is no home folder"
    try:
        # Parents are created one by one with safe permissions, because anybody who can write there can exchange the folder.
        for each in (*reversed(folder.parents), folder):
            each.mkdir(mode=stat.S_IRWXU, exist_ok=True)
        state = folder.stat()
        if state.st_uid != os.geteuid() or state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise PermissionError(errno.EPERM, "other users may write to it, which chmod go-w ends")
        _require_room(folder)
        _remove_empty(folder)
    except OSError as error:
        os.environ["POCL_CACHE_DIR"] = _temporary_folder()
        return f"{folder}: {error.strerror}"
    os.environ["POCL_CACHE_DIR"] = str(folder)
    return ""


def cache_warning() -> str:
    """Return a warning if compiled kernels could not be cached, otherwise ""."""
    if not prepare_cache.cache_info().currsize or not (reason := prepare_cache()):
        return ""
    return (
        f"compiled kernels cannot be cached ({reason}), so each run takes seconds to compile them; "
        "set XDG_CACHE_HOME to a writable folder on a disk with space"
    )


def _user_folder() -> Path | None:
    """Return POCL_CACHE_DIR if set, otherwise a folder below XDG_CACHE_HOME or the home folder. None if there is neither."""
    chosen, caches = Path(os.environ.get("POCL_CACHE_DIR", "")), Path(os.environ.get("XDG_CACHE_HOME", ""))
    if chosen.is_absolute():
        return chosen
    home = Path(os.path.expanduser("~"))
    if not caches.is_absolute() and home.is_absolute() and os.environ.get("HOME") != "":
        caches = home / ".cache"
    return caches / "l3cli" / "pocl" if caches.is_absolute() else None


def _require_room(folder: Path) -> None:
    """Raise OSError unless compiled kernels can be written to a folder and loaded from it."""
    if os.statvfs(folder).f_flag & os.ST_NOEXEC:
        raise PermissionError(errno.EACCES, "programs cannot be run from it")
    with tempfile.TemporaryFile(dir=folder) as room:
        os.posix_fallocate(room.fileno(), 0, MIN_FREE_BYTES)


def _remove_empty(folder: Path) -> None:
    for file in os.scandir(folder):
        with contextlib.suppress(OSError):
            state = file.stat(follow_symlinks=False)
            if stat.S_ISREG(state.st_mode) and not state.st_size and time.time() - state.st_mtime > LEFT:
                os.unlink(file)


def _temporary_folder() -> str:
    """Create a folder that is removed when this process ends. Raises DeviceError if no disk has enough space."""
    places = [place for place in (os.environ.get("TMPDIR"), "/tmp", "/var/tmp", "/dev/shm") if place]
    for place in places:
        with contextlib.suppress(OSError):
            _require_room(Path(place))
            folder = tempfile.mkdtemp(prefix="l3-kernels-", dir=place)
            atexit.register(_remove, folder, os.getpid())
            return folder
    raise DeviceError(
        f"no disk has {MIN_FREE_BYTES >> 20} MB to compile kernels in ({', '.join(places)}); free some space or set TMPDIR"
    )


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


LINKS_BY_PROGRAM = re.compile(r"OpenCL \d+\.\d+ PoCL [1-3]\.")  # versions that need the linker; the wheels contain 3.0


_owner: int | None = None  # process id of the process that first used OpenCL


def pyopencl() -> Any:
    """Import pyopencl on first use, and return the module.

    Raises
    ------
    DeviceError
        If OpenCL is not installed, or if this process was forked from a process that uses OpenCL. A fork does not copy the
        threads of the driver, so the first call would wait forever.
    """
    global _owner
    if _owner not in (None, os.getpid()):
        raise DeviceError(FORKED)
    prepare_cache()
    _owner = os.getpid()
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(f"OpenCL cannot be loaded ({error}); {INSTALL}") from error
    return pyopencl


def devices() -> list[Any]:
    """Return all OpenCL devices, in the order of their numbers for --device and L3_DEVICE."""
    return [device for _, shown, _ in _platforms() for device in shown]


def survey() -> list[str]:
    """Return one line per device, with its number, and one line per platform without devices.

    If there are no devices, the lines explain what is missing and how to install it.
    """
    lines, number = [], 0
    platforms = _platforms()
    for name, shown, why in platforms:
        for device in shown:
            kind = next(
                (kind for kind in ("GPU", "CPU") if device.type & getattr(pyopencl().device_type, kind)), "accelerator"
            )
            taken = compiled_for(device)
            as_another = f"; kernels for {taken}, since this PoCL is older than the processor" if taken else ""
            lines.append(f"{number}: {device.name.strip()} ({kind}, {device.max_compute_units} units; {name}{as_another})")
            number += 1
        if not shown:
            lines.append(f"{name} shows no device: {why}")
    return lines or [f"no OpenCL driver (ICD) is installed; {INSTALL}"]


def _platforms() -> list[tuple[str, list[Any], str]]:
    """Return the name and the devices of every platform, and if it has no devices the reason."""
    cl = pyopencl()
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the OpenCL loader finds no driver
        return []
    described = []
    for platform in platforms:
        try:
            shown, why = platform.get_devices(), "it has none"
        except cl.Error as error:
            shown, why = [], " ".join(str(error).split())[:200]
        if LINKS_BY_PROGRAM.match(platform.version) and not shutil.which(LINKER, path=os.environ.get("PATH", "")):
            shown, why = [], f'it needs the linker "{LINKER}", which is not in PATH; install the system\'s package gcc'
        described.append((platform.name.strip(), shown, why))
    return described


def choose_device(wanted: str) -> Any:
    """Return an OpenCL device.

    Parameters
    ----------
    wanted : str
        Number of the device, or a part of its name. If empty, the first GPU is chosen, or the first device without a GPU.

    Raises
    ------
    DeviceError
        If there is no such device.
    """
    available = devices()
    if not available:
        raise DeviceError(f"there is no OpenCL device: {'; '.join(survey())}")
    if not wanted:
        gpu = pyopencl().device_type.GPU
        return next((device for device in available if device.type & gpu), available[0])
    if wanted in (numbers := list(map(str, range(len(available))))):
        return available[numbers.index(wanted)]
    named = [device for device in available if wanted.lower() in device.name.lower()]
    if not named or wanted.isdecimal():
        names = ", ".join(f"{index}: {device.name.strip()}" for index, device in enumerate(available))
        raise DeviceError(f'no OpenCL device is called "{shortened(wanted)}"; ‹device› or L3_DEVICE must be one of {names}')
    return named[0]


@contextlib.contextmanager
def refusals(device: Any) -> Iterator[None]:
    """Convert errors of OpenCL within the block to a DeviceError with a message of one line."""
    cl = pyopencl()
    try:
        yield
    except cl.MemoryError as error:
        raise DeviceError(f"{device.name.strip()} has too little memory for this table and frame") from error
    except cl.Error as error:
        if REFUSES_PROCESSOR in str(error):
            raise DeviceError(
                f"{device.name.strip()}: the compiler of this PoCL is older than the processor and does not know it; "
                "install a newer one (Debian, Ubuntu: pocl-opencl-icd; conda: pocl) and choose it with ‹device›"
            ) from error
        if DAMAGED in str(error):
            raise DeviceError(
                f"{os.environ['POCL_CACHE_DIR']} holds damaged kernels; remove that folder, and they are compiled again"
            ) from error
        reason = " ".join(str(error).split())[:300]
        raise DeviceError(f"{device.name.strip()} failed: {reason}; choose another with ‹device›") from error
