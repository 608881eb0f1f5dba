"""Choice of the processor that PyPI's PoCL 3.0 compiles for, if its compiler does not know the actual processor.

PoCL asks its compiler, LLVM 14 of 2022, for the name of the processor. LLVM calls newer processors "generic", a name that
it then refuses as a target, so that nothing can be built (https://github.com/pocl/pocl/issues/1049). PoCL has no option or
variable for another name. The name is therefore replaced within the structure of PoCL's device, by that of a processor that
LLVM knows and whose abilities the actual processor has (docs/limits.md).
"""

import ctypes
import os
import re
from pathlib import Path
from typing import Any

PLATFORM = "PoCL 3.0"
UNKNOWN_PROCESSOR = re.compile(r" PoCL HSTR: pthread-x86_64-.*-generic$")  # in the version of a device
UNKNOWN = b"generic\0"
NAME_OFFSET = 640  # bytes from the start of the structure to the pointer to the name
POINTER = ctypes.sizeof(ctypes.c_void_p)
# LLVM's names of processors, the newest first, and the abilities that each requires, as named by Linux.
HASWELL = frozenset(["avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm"])
PROCESSORS = {
    b"skylake-avx512": HASWELL | frozenset(["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]),
    b"haswell": HASWELL,
    b"x86-64": frozenset[str](),
}
# These buffers must live as long as the device that points to one, which is as long as the process.
_names = {name: ctypes.create_string_buffer(name) for name in PROCESSORS}


def compiled_for(device: Any) -> str:
    """Return the name of the processor that kernels of an OpenCL device are compiled for, or "" if PoCL's own choice
    applies.

    If PoCL's compiler does not know the processor, a known one is chosen first. Repeated calls change nothing.
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
    """Return the bytes at an address, or none if the address cannot be read. (A plain read would end the process.)"""
    with open("/proc/self/mem", "rb", buffering=0) as memory:
        try:
            return os.pread(memory.fileno(), size, place)
        except (OSError, OverflowError):
            return b""


def _abilities() -> frozenset[str]:
    """Return the processor's abilities, as named by Linux."""
    flags = re.search(r"^flags\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8", "replace"), re.MULTILINE)
    return frozenset(flags[1].split() if flags else ())
