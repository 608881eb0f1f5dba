"""Select a target processor for PoCL 3.0 from PyPI if its compiler is too old for the actual processor.

PoCL gets the processor name from its compiler, LLVM 14 from 2022. LLVM calls newer processors "generic", but does not accept
this name as a target, so no kernel can be compiled (https://github.com/pocl/pocl/issues/1049). PoCL has no option to change
the name. This module therefore overwrites the name in PoCL's device structure with the name of an older processor. LLVM
supports this older processor, and the actual processor has all of its instruction sets (docs/limits.md).
"""

import ctypes
import os
import re
from pathlib import Path
from typing import Any

PLATFORM = "PoCL 3.0"
UNKNOWN_PROCESSOR = re.compile(r" PoCL HSTR: pthread-x86_64-.*-generic$")  # matches the device version
UNKNOWN = b"generic\0"
NAME_OFFSET = 640  # byte offset of the pointer to the name in the device structure
POINTER = ctypes.sizeof(ctypes.c_void_p)
# Required CPU flags (as named by Linux) of processors, by LLVM's processor name. The newest processor comes first.
HASWELL = frozenset(["avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm"])
PROCESSORS = {
    b"skylake-avx512": HASWELL | frozenset(["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]),
    b"haswell": HASWELL,
    b"x86-64": frozenset[str](),
}
# PoCL's device structure will point to one of these buffers, so they must exist until the process ends.
_names = {name: ctypes.create_string_buffer(name) for name in PROCESSORS}


def compiled_for(device: Any) -> str:
    """Select a target processor for PoCL's compiler if it does not support the actual one, and return the target's name.

    If PoCL chooses the target itself, the result is "". Repeated calls return the same name.
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
    """Read memory at an address. If the address is invalid, return b"" instead of crashing."""
    with open("/proc/self/mem", "rb", buffering=0) as memory:
        try:
            return os.pread(memory.fileno(), size, place)
        except (OSError, OverflowError):
            return b""


def _abilities() -> frozenset[str]:
    """Return the CPU flags, as named by Linux."""
    flags = re.search(r"^flags\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8", "replace"), re.MULTILINE)
    return frozenset(flags[1].split() if flags else ())
