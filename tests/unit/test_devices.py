"""OpenCL devices: choice by index and name, one line if there is no device, and kernels that are compiled once."""

import ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from l3cli.errors import DeviceError, L3Error, RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.rendering.display import Display
from l3cli.rendering.opencl import devices as opencl_devices
from l3cli.rendering.opencl import processor, programs
from l3cli.rendering.opencl.devices import choose_device, devices, pyopencl, refusals, survey
from l3cli.rendering.opencl.processor import HASWELL, PROCESSORS, compiled_for
from l3cli.rendering.opencl.programs import compiler_of
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.renderer import make_ready, make_renderer
from tests.helpers import rendered
from tests.helpers.cameras import BAYER
from tests.helpers.paths import ROOT
from tests.helpers.tables import random_table


def test_device_is_chosen_by_index_and_name() -> None:
    first = devices()[0]
    assert choose_device("0") == first
    assert choose_device(first.name[2:8].lower()) == first
    for wrong in ("99", "no such device"):
        with pytest.raises(DeviceError, match="‹device›"):
            choose_device(wrong)


def test_no_device_states_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opencl_devices, "_platforms", list)
    with pytest.raises(DeviceError, match=r'pip install "pyopencl\[pocl\]"'):
        OpenCLRenderer(random_table(BAYER))


def test_variant_follows_the_device_unless_chosen() -> None:
    table = random_table(BAYER, patch=3)
    gpu = OpenCLRenderer(table).device.type & 4
    assert OpenCLRenderer(table).variant == ("graphics" if gpu else "processor")
    chosen = make_renderer("opencl", table, device="0", variant="graphics")
    assert isinstance(chosen, OpenCLRenderer)
    assert chosen.variant == "graphics"
    with pytest.raises(RecipeError, match="processor, graphics"):
        OpenCLRenderer(table, variant="vector")


def test_survey_states_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    assert opencl_devices.survey()[0].startswith("0: ")
    monkeypatch.setattr(opencl_devices, "_platforms", list)
    assert opencl_devices.survey() == [f"no OpenCL driver (ICD) is installed; {opencl_devices.INSTALL}"]


def test_a_processor_without_a_linker_shows_no_device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The PoCL of the wheels would end the process at its first kernel."""
    platforms = {device.platform.version for device in devices()}
    if not all(opencl_devices.LINKS_BY_PROGRAM.match(version) for version in platforms):
        pytest.skip("there is a device that needs no linker")
    for nowhere in (str(tmp_path), ""):
        monkeypatch.setenv("PATH", nowhere)
        assert devices() == []
        with pytest.raises(DeviceError, match=r'no OpenCL device: .* the linker "ld", .* install .* gcc'):
            choose_device("")


def test_unknown_backend_is_refused() -> None:
    with pytest.raises(RecipeError, match="opencl, reference"):
        make_renderer("cuda", random_table(BAYER))


def test_pocl_works_with_an_unwritable_home() -> None:
    """PoCL without a folder for its cache finds no device at all."""
    script = (
        "import os; from l3cli.rendering.opencl.devices import choose_device\n"
        "choose_device(''); print(os.environ['POCL_CACHE_DIR'])"
    )
    left = {key: value for key, value in os.environ.items() if key not in ("POCL_CACHE_DIR", "XDG_CACHE_HOME")}
    done = subprocess.run(
        [sys.executable, "-c", script], env={**left, "HOME": "/proc"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "l3-kernels-" in done.stdout
    assert not Path(done.stdout.strip()).exists()


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


def test_the_processor_that_kernels_are_compiled_for_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opencl_devices, "compiled_for", lambda device: "haswell")
    assert "; compiles for haswell, because this PoCL is older than the processor)" in survey()[0]


def test_a_compiler_that_does_not_know_the_processor_is_one_line() -> None:
    device = SimpleNamespace(name="pthread-Some Processor")
    with pytest.raises(DeviceError, match=r"too old for the processor.*pocl-opencl-icd"), refusals(device):
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


FRAME = RawFrame("noise", np.random.default_rng(1).integers(0, 4096, (61, 301), np.uint16), 64, 4095)


TABLES = {"structures": rendered.TABLES["two layers"](), "tree": rendered.TABLES["tree of one leaf"]()}


def render_tree() -> None:
    OpenCLRenderer(TABLES["tree"]).picture(FRAME, Display(np.eye(3), 8))


def test_the_code_of_a_kernel_is_there_once(tmp_path: Path) -> None:
    if shutil.which("nm") is None or "PoCL 3.0" not in choose_device("").platform.version:
        pytest.skip("it is PoCL 3.0 that would have it three times")
    call = [sys.executable, "-c", f"from {__name__} import render_tree; render_tree()"]
    subprocess.run(call, cwd=ROOT, env={**os.environ, "POCL_CACHE_DIR": str(tmp_path)}, check=True)
    made = list(tmp_path.rglob("*.so"))
    assert made
    for file in made:
        listed = subprocess.run(["nm", "-S", "--defined-only", file], capture_output=True, text=True, check=True).stdout
        sizes = {name: int(size, 16) for size, name in re.findall(r"^\S+ (\S+) [tT] (\S+)$", listed, re.MULTILINE)}
        largest = max(sizes, key=lambda name: sizes[name])
        assert not largest.startswith("_pocl_kernel"), file
        launching = sum(size for name, size in sizes.items() if name.startswith("_pocl_kernel"))
        assert launching < sizes[largest], file


def test_what_is_made_ready_is_not_built_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Making a renderer builds nothing more, of whatever table, nor does another renderer of it."""
    compiler_of.cache_clear()
    make_ready("opencl")
    built: list[str] = []
    usual = pyopencl().Program

    def counted(context: Any, source: str) -> Any:
        built.append(source)
        return usual(context, source)

    monkeypatch.setattr(pyopencl(), "Program", counted)
    for table in TABLES.values():
        OpenCLRenderer(table)
    assert not built
    OpenCLRenderer(TABLES["tree"]).outputs(FRAME)
    count = len(built)
    OpenCLRenderer(TABLES["tree"]).outputs(FRAME)
    assert count
    assert len(built) == count


@pytest.mark.parametrize(
    ("options", "fault"), [({"device": "nobody's"}, DeviceError), ({"variant": "neither"}, RecipeError)]
)
def test_what_cannot_be_made_ready_is_reported_as_by_the_renderer(options: dict[str, Any], fault: type[L3Error]) -> None:
    with pytest.raises(fault) as early:
        make_ready("opencl", **options)
    with pytest.raises(fault) as late:
        OpenCLRenderer(TABLES["tree"], **options)
    assert str(early.value) == str(late.value)
