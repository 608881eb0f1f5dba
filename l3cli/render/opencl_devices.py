"""Finding OpenCL devices, and saying why there are none."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

from l3cli.errors import DeviceError

INSTALL = 'install one, on any processor with: pip install "pyopencl[pocl]"'


def pyopencl() -> Any:
    """pyopencl, imported when first needed; DeviceError if there is no OpenCL at all."""
    _ensure_pocl_cache()
    try:
        import pyopencl
    except ImportError as error:
        raise DeviceError(f"OpenCL cannot be loaded ({error}); {INSTALL}") from error
    return pyopencl


def devices() -> list[Any]:
    """Every OpenCL device there is, in the order that --device and L3_DEVICE count."""
    cl = pyopencl()
    try:
        return [device for platform in cl.get_platforms() for device in platform.get_devices()]
    except cl.Error:  # no driver at all
        return []


def choose_device(wanted: str) -> Any:
    """The device that `wanted` names by index or part of its name; else the first GPU, else the first of any kind.

    DeviceError if there is none.
    """
    found = devices()
    if not found:
        raise DeviceError(f"no OpenCL device was found; {INSTALL}")
    if not wanted:
        gpu = pyopencl().device_type.GPU
        return next((device for device in found if device.type & gpu), found[0])
    if wanted.isdecimal() and int(wanted) < len(found):
        return found[int(wanted)]
    named = [device for device in found if wanted.lower() in device.name.lower()]
    if not named or wanted.isdecimal():
        names = ", ".join(f"{index}: {device.name.strip()}" for index, device in enumerate(found))
        raise DeviceError(f'no OpenCL device is called "{wanted}"; --device or L3_DEVICE must be one of {names}')
    return named[0]


def _ensure_pocl_cache() -> None:
    """Give PoCL a folder that it can write to: without one it finds no device, and says nothing."""
    if "POCL_CACHE_DIR" in os.environ:
        return
    try:
        caches = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
        folder = Path(caches, "l3cli", "pocl")
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError):  # RuntimeError: there is no home at all
        folder = Path(tempfile.mkdtemp(prefix="l3-pocl-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["POCL_CACHE_DIR"] = str(folder)
