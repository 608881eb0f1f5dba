"""Find OpenCL devices, explain why a device is missing, and choose the folder of PoCL's kernel cache.

PoCL trusts all files in its cache, and aborts the process if it cannot write to it. The folder must therefore be writable
only by this user, and must be on a disk with enough space. Otherwise, a temporary folder is used. docs/limits.md describes
what happens if a cached file is damaged. Other drivers have their own caches. The cache of pyopencl is disabled, because
pyopencl unpickles its files.
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

MIN_FREE_BYTES = 16 << 20  # required free space, several times the size of one table's kernels
MAX_EMPTY_FILE_SECONDS = 86400  # older empty cache files are removed, because each process with PoCL 3.0 leaves one
INSTALL = 'install a driver with: pip install "pyopencl[pocl]"'
LINKER = "ld"  # PoCL calls this linker, and aborts the process if it or the libraries of a C compiler are missing
REFUSES_PROCESSOR = "unknown target CPU"  # text in the error message of PoCL's compiler if the processor is too new
DAMAGED = "INVALID_KERNEL_NAME"  # PoCL's error for a program from a damaged cache file
FORKED = (
    "this process was forked from a process that uses OpenCL, and OpenCL would hang here; start processes with "
    'multiprocessing.get_context("spawn"), and create renderers in the new processes'
)


@functools.cache
def prepare_cache() -> str:
    """Set the folder of PoCL's cache. Must be called before the first OpenCL function.

    If necessary, the folder is created, with access only for this user. If other users can write to it, or if the disk is
    full, a temporary folder is used instead.

    Returns
    -------
    str
        Why the folder is temporary, or "" if it is permanent.

    Raises
    ------
    DeviceError
        If no disk has enough space.
    """
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    folder = _user_folder()
    if folder is None:
        os.environ["POCL_CACHE_DIR"] = _temporary_folder()
        return "the user has no home folder"
    try:
        # New parent folders also get safe permissions, because whoever can write to a parent could replace the folder.
        for each in (*reversed(folder.parents), folder):
            each.mkdir(mode=stat.S_IRWXU, exist_ok=True)
        state = folder.stat()
        if state.st_uid != os.geteuid() or state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            raise PermissionError(errno.EPERM, "other users can write to this folder; run chmod go-w on it")
        _require_room(folder)
        _remove_empty(folder)
    except OSError as error:
        os.environ["POCL_CACHE_DIR"] = _temporary_folder()
        return f"{folder}: {error.strerror}"
    os.environ["POCL_CACHE_DIR"] = str(folder)
    return ""


def cache_warning() -> str:
    """Return a warning if PoCL's cache folder is temporary, otherwise ""."""
    if not prepare_cache.cache_info().currsize or not (reason := prepare_cache()):
        return ""
    return (
        f"compiled kernels cannot be cached ({reason}), so every l3 command spends some seconds compiling them; set "
        "XDG_CACHE_HOME to a writable folder on a disk with free space"
    )


def _user_folder() -> Path | None:
    """Return the user's folder for PoCL's cache, or None if the user has no home folder.

    If POCL_CACHE_DIR is set, it is this folder, otherwise a folder inside XDG_CACHE_HOME or ~/.cache.
    """
    chosen, caches = Path(os.environ.get("POCL_CACHE_DIR", "")), Path(os.environ.get("XDG_CACHE_HOME", ""))
    if chosen.is_absolute():
        return chosen
    home = Path(os.path.expanduser("~"))
    if not caches.is_absolute() and home.is_absolute() and os.environ.get("HOME") != "":
        caches = home / ".cache"
    return caches / "l3cli" / "pocl" if caches.is_absolute() else None


def _require_room(folder: Path) -> None:
    """Raise OSError unless compiled kernels fit into a folder and can be executed there."""
    if os.statvfs(folder).f_flag & os.ST_NOEXEC:
        raise PermissionError(errno.EACCES, "programs in this folder cannot be run (noexec)")
    with tempfile.TemporaryFile(dir=folder) as room:
        os.posix_fallocate(room.fileno(), 0, MIN_FREE_BYTES)


def _remove_empty(folder: Path) -> None:
    for file in os.scandir(folder):
        with contextlib.suppress(OSError):
            state = file.stat(follow_symlinks=False)
            if stat.S_ISREG(state.st_mode) and not state.st_size and time.time() - state.st_mtime > MAX_EMPTY_FILE_SECONDS:
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
        f"none of the folders {', '.join(places)} has {MIN_FREE_BYTES >> 20} MB of free space for compiled kernels; free "
        "some space, or set TMPDIR to another folder"
    )


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


LINKS_BY_PROGRAM = re.compile(r"OpenCL \d+\.\d+ PoCL [1-3]\.")  # versions of PoCL that call the linker; PyPI has 3.0


_owner: int | None = None  # id of the process that first used OpenCL


def pyopencl() -> Any:
    """Import pyopencl on first use, and return the module.

    Raises
    ------
    DeviceError
        If OpenCL is not installed, or if this process was forked from a process that uses OpenCL. In a forked process, the
        first OpenCL call would wait forever, because the driver's threads do not exist.
    """
    global _owner
    if _owner not in (None, os.getpid()):
        raise DeviceError(FORKED)
    prepare_cache()
    _owner = os.getpid()
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(f"cannot load OpenCL ({error}); {INSTALL}") from error
    return pyopencl


def devices() -> list[Any]:
    """Return all OpenCL devices, in the order of the numbers for --device and L3_DEVICE."""
    return [device for _, shown, _ in _platforms() for device in shown]


def survey() -> list[str]:
    """Describe all devices, and all platforms without devices, one line each.

    If there is no device, the lines explain what is missing and how to install it.
    """
    lines, number = [], 0
    platforms = _platforms()
    for name, shown, why in platforms:
        for device in shown:
            kind = next(
                (kind for kind in ("GPU", "CPU") if device.type & getattr(pyopencl().device_type, kind)), "accelerator"
            )
            taken = compiled_for(device)
            as_another = f"; compiles for {taken}, because this PoCL is older than the processor" if taken else ""
            lines.append(f"{number}: {device.name.strip()} ({kind}, {device.max_compute_units} units; {name}{as_another})")
            number += 1
        if not shown:
            lines.append(f"the OpenCL platform {name} provides no device: {why}")
    return lines or [f"no OpenCL driver (ICD) is installed; {INSTALL}"]


def _platforms() -> list[tuple[str, list[Any], str]]:
    """Return each platform's name, its devices and, if it has none, the reason."""
    cl = pyopencl()
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # no driver is installed
        return []
    described = []
    for platform in platforms:
        try:
            shown, why = platform.get_devices(), "the driver found no device"
        except cl.Error as error:
            shown, why = [], " ".join(str(error).split())[:200]
        if LINKS_BY_PROGRAM.match(platform.version) and not shutil.which(LINKER, path=os.environ.get("PATH", "")):
            shown, why = [], f'PoCL needs the linker "{LINKER}", which is not in PATH; install the package gcc'
        described.append((platform.name.strip(), shown, why))
    return described


def choose_device(wanted: str) -> Any:
    """Choose an OpenCL device by number or by name.

    Parameters
    ----------
    wanted : str
        Number of the device, or part of its name. If it is empty, the first GPU is chosen or, if there is no GPU, the first
        device.

    Raises
    ------
    DeviceError
        If no device matches.
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
        raise DeviceError(f'no OpenCL device is called "{shortened(wanted)}"; set ‹device› or L3_DEVICE to one of {names}')
    return named[0]


@contextlib.contextmanager
def refusals(device: Any) -> Iterator[None]:
    """Convert an OpenCL error in the `with` block to a DeviceError with a one-line message.

    The message suggests a fix if the device has too little memory, if PoCL is too old for the processor, or if the kernel
    cache is damaged. For any other error, it quotes the driver.
    """
    cl = pyopencl()
    try:
        yield
    except cl.MemoryError as error:
        raise DeviceError(
            f"{device.name.strip()} has too little memory for this table and frame; choose another device with ‹device›"
        ) from error
    except cl.Error as error:
        if REFUSES_PROCESSOR in str(error):
            raise DeviceError(
                f"{device.name.strip()}: this version of PoCL is too old for the processor; install a newer PoCL (Debian, "
                "Ubuntu: pocl-opencl-icd; conda: pocl) and choose its device with ‹device›"
            ) from error
        if DAMAGED in str(error):
            raise DeviceError(
                f"{os.environ['POCL_CACHE_DIR']} contains damaged kernels; remove this folder, and l3 will compile the "
                "kernels again"
            ) from error
        reason = " ".join(str(error).split())[:300]
        raise DeviceError(f"{device.name.strip()} failed: {reason}; choose another device with ‹device›") from error
