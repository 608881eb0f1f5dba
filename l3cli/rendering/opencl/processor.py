"""Selects a target processor for PyPI's PoCL 3.0 if its compiler does not know the actual processor.

PoCL asks its compiler, LLVM 14 of 2022, for the name of the processor. LLVM calls newer processors "generic", but does not
accept this name as a target, so that no kernel can be built (https://github.com/pocl/pocl/issues/1049). PoCL has no option
or variable for another name. This module therefore changes the name in PoCL's device structure to that of a processor that
LLVM knows and whose instruction sets the actual processor supports (docs/limits.md).
"""

import ctypes
import os
import re
from pathlib import Path
from typing import Any

PLATFORM = "PoCL 3.0"
UNKNOWN_PROCESSOR = re.compile(r" PoCL HSTR: pthread-x86_64-.*-generic$")  # in the version of a device
UNKNOWN = b"generic\0"
NAME_OFFSET = 640  # bytes from the start of the device structure to the pointer to the name
POINTER = ctypes.sizeof(ctypes.c_void_p)
# LLVM's names of processors, starting with the newest, and the CPU flags that each requires, as named by Linux.
HASWELL = frozenset(["avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm"])
PROCESSORS = {
    b"skylake-avx512": HASWELL | frozenset(["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]),
    b"haswell": HASWELL,
    b"x86-64": frozenset[str](),
}
# The device points to one of these buffers, so they must exist as long as the process.
_names = {name: ctypes.create_string_buffer(name) for name in PROCESSORS}


def compiled_for(device: Any) -> str:
    """Return the processor for which kernels of an OpenCL device are compiled, or "" for PoCL's own choice.

    If PoCL's compiler does not know the actual processor, this function first selects a known one. Repeated calls change
    nothing.
    """
    if PLATFORM not in device.platform.version or not UNKNOWN_PROCESSOR.search(device.version):
        return ""
    place, known = int(device.int_ptr) + NAME_OFFSET, {ctypes.addressof(name): name.value for name in _names.values()}
    pointer = int.from_bytes(_read(place, POINTER), "little")
    if pointer not in known and _read(pointer, len(UNKNOWN)) == UNKNOWN:
        abilities = _abilities()
        name = next(_names[name] for name, needed in PROCESSORS.items() if needed <= abilities)
        pointer = ctypes.c_uint64.from_address(place).value = ctypes.addressof(name)
    return known.get(pointer, b"").decode()


def _read(place: int, size: int) -> bytes:
    """Return the bytes at an address, or b"" if it cannot be read. (A direct read would then abort the process.)"""
    with open("/proc/self/mem", "rb", buffering=0) as memory:
        try:
            return os.pread(memory.fileno(), size, place)
        except (OSError, OverflowError):
            return b""


def _abilities() -> frozenset[str]:
    """Return the CPU flags of the processor, as named by Linux."""
    flags = re.search(r"^flags\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8", "replace"), re.MULTILINE)
    return frozenset(flags[1].split() if flags else ())
