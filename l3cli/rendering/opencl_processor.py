"""The processor that PoCL compiles for, where its compiler does not know the one at hand.

PoCL asks its compiler, LLVM, what the processor is called, and has kernels compiled for that name. LLVM knows no processor
that came later than itself: it calls it "generic", a name that it then refuses as a target, so that nothing can be built
(https://github.com/pocl/pocl/issues/1049; LLVM 14 of the wheels, of 2022, refuses AMD's Zen 5). The name stands in the
structure of PoCL's device and there alone: it is replaced by that of a processor LLVM knows, which can do no more than the
one at hand.
"""

import ctypes
import functools
import os
import re
from pathlib import Path
from typing import Any

UNKNOWN_PROCESSOR = re.compile(r" PoCL HSTR: pthread-x86_64-.*-generic$")  # versions of devices
UNKNOWN = b"generic\0"
DEVICE_BYTES = (
    2048  # of the structure of PoCL's device, or of what follows it, where PoCL now and then leaves the name once more
)
USUAL_PLACE = 640  # byte of the name in PoCL 3.0
POINTER = ctypes.sizeof(ctypes.c_void_p)
# Names for LLVM, the newest first, and what a processor must be able to do for each, as Linux calls it.
HASWELL = frozenset(["avx2", "bmi1", "bmi2", "f16c", "fma", "movbe", "abm"])
PROCESSORS = (
    ("skylake-avx512", HASWELL | frozenset(["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"])),
    ("haswell", HASWELL),
    ("x86-64", frozenset[str]()),
)


def compiled_for(device: Any) -> str:
    """Have kernels of an OpenCL device compiled for a processor that its compiler knows: its name; empty where PoCL's own
    choice stands. Nothing is changed twice."""
    if not UNKNOWN_PROCESSOR.search(device.version):
        return ""
    return _renamed(int(device.int_ptr))


@functools.cache
def _renamed(address: int) -> str:
    """The name that now stands in the device at `address`; empty if no name was found there, or several, none of them where
    it usually is."""
    memory = os.open("/proc/self/mem", os.O_RDONLY)  # reading what may not be read fails there, and does not end the process
    try:
        places = [place for place in range(address, address + DEVICE_BYTES, POINTER) if _unknown(memory, place)]
    finally:
        os.close(memory)
    if address + USUAL_PLACE in places:
        places = [address + USUAL_PLACE]
    if len(places) != 1:
        return ""
    name = _name(_abilities())
    ctypes.c_void_p.from_address(places[0]).value = ctypes.cast(_kept(name), ctypes.c_void_p).value
    return name


def _unknown(memory: int, place: int) -> bool:
    """Whether a pointer to UNKNOWN is at an address."""
    pointer = int.from_bytes(_read(memory, place, POINTER), "little")
    return bool(pointer) and _read(memory, pointer, len(UNKNOWN)) == UNKNOWN


def _read(memory: int, place: int, size: int) -> bytes:
    """What is at an address; nothing where nothing can be."""
    try:
        return os.pread(memory, size, place)
    except (OSError, OverflowError):
        return b""


@functools.cache
def _kept(name: str) -> "ctypes.Array[ctypes.c_char]":
    """A C string that lasts as long as the process, as does the device that names it."""
    return ctypes.create_string_buffer(name.encode())


def _name(abilities: frozenset[str]) -> str:
    return next(name for name, needed in PROCESSORS if needed <= abilities)


def _abilities() -> frozenset[str]:
    """What Linux says that the processor can do."""
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    flags = next((line.partition(":")[2] for line in lines if line.startswith("flags")), "")
    return frozenset(flags.split())
