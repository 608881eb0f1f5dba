"""Kernels are compiled on processors that PoCL's compiler does not know, for one that can do no more."""

import ctypes
from types import SimpleNamespace

import pytest

from l3cli.errors import DeviceError
from l3cli.rendering import kernels, opencl_processor, opencl_programs
from l3cli.rendering.opencl_devices import choose_device, pyopencl, refusals
from l3cli.rendering.opencl_processor import DEVICE_BYTES, HASWELL, PROCESSORS, compiled_for

ZEN_5 = "fpu sse2 avx avx2 bmi1 bmi2 f16c fma movbe abm avx512f avx512bw avx512cd avx512dq avx512vl avx512_vnni"
UNKNOWN = "OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic"


class Device:
    """Memory like that of PoCL's device: words, some of which point to a name; none of the others to anything."""

    def __init__(self, version: str, names: dict[int, bytes]) -> None:
        self.version, self.name = version, "pthread-Some Processor"
        self._words = (ctypes.c_uint64 * (2 * DEVICE_BYTES // 8))(*range(2 * DEVICE_BYTES // 8))
        self._names = {place: ctypes.create_string_buffer(name) for place, name in names.items()}
        for place, name in self._names.items():
            self._words[place] = ctypes.addressof(name)
        self._words[3] = 2**64 - 1
        self.int_ptr = ctypes.addressof(self._words)

    def named(self, place: int) -> bytes:
        return ctypes.string_at(self._words[place])


@pytest.fixture(autouse=True)
def zen_5(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opencl_processor, "_abilities", lambda: frozenset(ZEN_5.split()))
    monkeypatch.setattr(opencl_processor, "_renamed", opencl_processor._renamed.__wrapped__)


def test_a_processor_that_is_unknown_is_called_by_the_name_of_one_that_can_do_no_more() -> None:
    device = Device(UNKNOWN, {5: b"pthread", 80: b"generic"})
    assert compiled_for(device) == "skylake-avx512"
    assert device.named(80) == b"skylake-avx512"
    assert device.named(5) == b"pthread"


def test_what_lies_behind_the_device_may_be_the_name_once_more() -> None:
    """As it is left there by PoCL itself, now and then."""
    device = Device(UNKNOWN, {80: b"generic", 90: b"generic"})
    assert compiled_for(device) == "skylake-avx512"
    assert device.named(80) == b"skylake-avx512"
    assert device.named(90) == b"generic"


@pytest.mark.parametrize(
    ("version", "names"),
    [
        (UNKNOWN.replace("generic", "znver3"), {80: b"generic"}),  # a processor that is known
        (UNKNOWN.replace("x86_64", "aarch64"), {80: b"generic"}),  # for which "generic" is a processor
        ("OpenCL 3.0 CUDA", {80: b"generic"}),
        (UNKNOWN, {70: b"generic", 90: b"generic"}),  # of which either may be another thing
        (UNKNOWN, {80: b"generic-gpu"}),
        (UNKNOWN, {}),
    ],
)
def test_a_device_is_left_as_it_is_where_its_name_is_known_or_not_to_be_found(version: str, names: dict[int, bytes]) -> None:
    device = Device(version, names)
    assert compiled_for(device) == ""
    assert {place: device.named(place) for place in names} == names


@pytest.mark.parametrize(
    ("abilities", "name"),
    [(HASWELL, "haswell"), (HASWELL | {"avx512f"}, "haswell"), ({"sse2"}, "x86-64"), (set(), "x86-64")],
)
def test_no_processor_is_taken_for_one_that_can_do_more(
    abilities: set[str], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opencl_processor, "_abilities", lambda: frozenset(abilities))
    assert compiled_for(Device(UNKNOWN, {80: b"generic"})) == name
    assert dict(PROCESSORS)[name] <= frozenset(abilities)


def test_a_compiler_that_does_not_know_the_processor_is_one_line() -> None:
    device = SimpleNamespace(name="pthread-Some Processor")
    with pytest.raises(DeviceError, match=r"older than the processor.*pocl-opencl-icd"), refusals(device):
        raise pyopencl().RuntimeError("clBuildProgram failed: error: unknown target CPU 'generic'")


def test_what_is_compiled_for_another_processor_is_kept_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two machines that share a home folder may both have processors that PoCL calls by the same name."""
    identities = []
    monkeypatch.setattr(kernels, "built", lambda identity, *_: identities.append(identity))
    for name in ("skylake-avx512", "haswell"):
        monkeypatch.setattr(opencl_programs, "compiled_for", lambda device, name=name: name)
        opencl_programs.Compiler(None, choose_device("")).build("", {})
    assert identities[0] != identities[1]
