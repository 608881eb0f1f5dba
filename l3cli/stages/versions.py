"""Versions of l3 and its libraries, OpenCL devices and the decoder, also where a library cannot be loaded."""

import platform
import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from l3cli import __version__
from l3cli.errors import DeviceError, L3Error
from l3cli.io.confinement import LANDLOCK, SECCOMP
from l3cli.io.decoder_process import measures
from l3cli.rendering.opencl.devices import survey
from l3cli.system.limits import trusted


def versions() -> dict[str, Any]:
    """Return the versions for a report of a fault: l3, Python, libraries (None: an extra not installed), OpenCL devices."""
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
        "decoding": _decoding(),
    }


def _decoding() -> str:
    """Return the decoding of foreign files on this machine, in words."""
    try:
        if trusted():
            return "process without limits, l3's own (L3_TRUST)"
        holds = measures(Path(sys.executable))
    except L3Error as error:
        return str(error)
    missing = [name for name in (LANDLOCK, SECCOMP) if name not in holds]
    if not missing:
        return f"sandboxed process ({LANDLOCK}, {SECCOMP}), with limits of time and memory"
    partly = "".join(f" and {name}" for name in holds)
    return f"isolated process with limits of time and memory{partly}; {' and '.join(missing)} missing in this kernel"


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None
