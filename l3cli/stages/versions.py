"""What this l3 is made of: versions of libraries and the OpenCL devices. It works where a library cannot be loaded."""

import platform
import re
from importlib import metadata
from typing import Any

from l3cli import __version__
from l3cli.errors import DeviceError
from l3cli.rendering.opencl_devices import survey


def versions() -> dict[str, Any]:
    """What a report of a fault should hold: l3, Python, libraries (None: an extra not installed), OpenCL devices."""
    try:
        required = metadata.requires("l3cli") or []
    except metadata.PackageNotFoundError:  # sources on a path, not installed
        required = []
    used = [each for each in required if not re.search(r"""extra == ['"](dev|docs|fuzz|peers)['"]""", each)]
    names = sorted({re.split(r"[^\w.-]", each)[0] for each in used}, key=str.lower)
    try:
        devices = survey()
    except DeviceError as error:
        devices = [str(error)]
    return {
        "l3": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "libraries": {name: _version(name) for name in names},
        "devices": devices,
    }


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None
