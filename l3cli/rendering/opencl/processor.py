"""The processor that PyPI's PoCL, 3.0, compiles for, where its compiler does not know the one at hand.

PoCL asks its compiler, LLVM 14 of 2022, what the processor is called. LLVM calls a later one "generic", a name that it then
refuses as a target, so that nothing can be built (https://github.com/pocl/pocl/issues/1049), and no option or variable of
PoCL's names another. So the name is replaced where it stands, in the structure of PoCL's device, by that of a processor
which LLVM knows and which can do no more than the one at hand. docs/limits.md
"""

import ctypes
import os
import re
from pathlib import Path
from typing import Any

PLATFORM = "PoCL 3.0"
UNKNOWN_PROCESSOR = re.compile(r" PoCL HSTR: pthread-x86_64-.*-generic$")  # versions of devices
UNKNOWN = b"generic\0"
PLACE = 640  # bytes from the structure's beginning to the pointer to the name
POINTER = ctypes.sizeof(ctypes.c_void_p)
# Names for LLVM, the newest first, and what a processor must be able to do for each, as Linux calls it.
HASWELL = frozenset(["avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm"])
PROCESSORS = {
    b"skylake-avx512": HASWELL | frozenset(["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]),
    b"haswell": HASWELL,
    b"x86-64": frozenset[str](),
}
# They live as long as the process, as the device that names one.
_names = {name: ctypes.create_string_buffer(name) for name in PROCESSORS}


def compiled_for(device: Any) -> str:
    """Return for which processor kernels of an OpenCL device are compiled, after choosing one that its compiler knows; empty
    where PoCL's own choice stands. Nothing is changed twice."""
    if PLATFORM not in device.platform.version or not UNKNOWN_PROCESSOR.search(device.version):
        return ""
    place, known = int(device.int_ptr) + PLACE, {ctypes.addressof(name): name.value for name in _names.values()}
    pointer = int.from_bytes(_read(place, POINTER), "little")
    if pointer not in known and _read(pointer, len(UNKNOWN)) == UNKNOWN:
        abilities = _abilities()
        name = next(_names[name] for name, needed in PROCESSORS.items() if needed <= abilities)
        pointer = ctypes.c_uint64.from_address(place).value = ctypes.addressof(name)
    return known.get(pointer, b"").decode()


def _read(place: int, size: int) -> bytes:
    """Return the bytes at an address; none where nothing can be read, which so does not end the process."""
    with open("/proc/self/mem", "rb", buffering=0) as memory:
        try:
            return os.pread(memory.fileno(), size, place)
        except (OSError, OverflowError):
            return b""


def _abilities() -> frozenset[str]:
    """Return the processor's abilities as Linux names them."""
    flags = re.search(r"^flags\s*: (.*)$", Path("/proc/cpuinfo").read_text("utf-8", "replace"), re.MULTILINE)
    return frozenset(flags[1].split() if flags else ())
