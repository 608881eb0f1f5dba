"""Kernels are compiled on processors that PoCL's compiler does not know, for one that can do no more."""

import ctypes
from types import SimpleNamespace

import pytest

from l3cli.errors import DeviceError
from l3cli.rendering.opencl import devices, processor, programs
from l3cli.rendering.opencl.devices import choose_device, pyopencl, refusals, survey
from l3cli.rendering.opencl.processor import HASWELL, PROCESSORS, compiled_for

ZEN_5 = "fpu sse2 avx avx2 bmi1 bmi2 f16c fma movbe abm avx512f avx512bw avx512cd avx512dq avx512vl avx512_vnni"
UNKNOWN = "OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic"


class Device:
    """Memory like that of PoCL's device: words, some of which point to a name; none of the others to anything."""

    def __init__(self, version: str, names: dict[int, bytes], platform: str = "OpenCL 3.0 PoCL 3.0-rc2") -> None:
        self.version, self.platform = version, SimpleNamespace(version=platform)
        self._words = (ctypes.c_uint64 * 256)(*range(256))
        self._names = {place: ctypes.create_string_buffer(name) for place, name in names.items()}
        for place, name in self._names.items():
            self._words[place] = ctypes.addressof(name)
        self.int_ptr = ctypes.addressof(self._words)

    def named(self, place: int) -> bytes:
        return ctypes.string_at(self._words[place])


@pytest.fixture
def zen_5(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processor, "_abilities", lambda: frozenset(ZEN_5.split()))


@pytest.mark.usefixtures("zen_5")
def test_a_processor_that_is_unknown_is_called_by_the_name_of_one_that_can_do_no_more() -> None:
    device = Device(UNKNOWN, {5: b"pthread", 80: b"generic", 200: b"generic"})
    for _ in range(2):
        assert compiled_for(device) == "skylake-avx512"
        assert [device.named(place) for place in (5, 80, 200)] == [b"pthread", b"skylake-avx512", b"generic"]


@pytest.mark.parametrize(
    ("version", "names", "platform"),
    [
        (UNKNOWN.replace("generic", "znver3"), {80: b"generic"}, "PoCL 3.0"),  # a processor that is known
        (UNKNOWN.replace("x86_64", "aarch64"), {80: b"generic"}, "PoCL 3.0"),  # for which "generic" is a processor
        ("OpenCL 3.0 CUDA", {80: b"generic"}, "PoCL 3.0"),
        (UNKNOWN, {80: b"generic"}, "PoCL 3.1"),
        (UNKNOWN, {81: b"generic"}, "PoCL 3.0"),
        (UNKNOWN, {80: b"generic-gpu"}, "PoCL 3.0"),
        (UNKNOWN, {}, "PoCL 3.0"),
    ],
)
@pytest.mark.usefixtures("zen_5")
def test_a_device_is_left_as_it_is_where_its_name_is_known_or_not_to_be_found(
    version: str, names: dict[int, bytes], platform: str
) -> None:
    device = Device(version, names, platform)
    assert compiled_for(device) == ""
    assert {place: device.named(place) for place in names} == names


@pytest.mark.parametrize(
    ("abilities", "name"),
    [(HASWELL, "haswell"), (HASWELL | {"avx512f"}, "haswell"), ({"sse2"}, "x86-64"), (set(), "x86-64")],
)
def test_no_processor_is_taken_for_one_that_can_do_more(
    abilities: set[str], name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processor, "_abilities", lambda: frozenset(abilities))
    assert compiled_for(Device(UNKNOWN, {80: b"generic"})) == name
    assert PROCESSORS[name.encode()] <= frozenset(abilities)


def test_the_processor_that_kernels_are_compiled_for_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "compiled_for", lambda device: "haswell")
    assert "; kernels for haswell, since this PoCL is older than the processor)" in survey()[0]


def test_a_compiler_that_does_not_know_the_processor_is_one_line() -> None:
    device = SimpleNamespace(name="pthread-Some Processor")
    with pytest.raises(DeviceError, match=r"older than the processor.*pocl-opencl-icd"), refusals(device):
        raise pyopencl().RuntimeError("clBuildProgram failed: error: unknown target CPU 'generic'")


def test_what_is_compiled_for_another_processor_is_another_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two machines that share a home folder may both have processors that PoCL calls by the same name."""
    device = choose_device("")
    compiled_for(device)
    compiler = programs.Compiler(pyopencl().Context([device]), device)
    built = []
    for name in ("skylake-avx512", "haswell"):
        monkeypatch.setattr(programs, "compiled_for", lambda device, name=name: name)
        program = compiler.build("__kernel void f(__global int *a) { *a = 7; }", {})
        built.append(program.get_build_info(device, pyopencl().program_build_info.OPTIONS))
    assert built[0] != built[1]
