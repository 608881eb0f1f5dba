"""What PoCL is spared when it compiles: a kernel's code two further times, declarations of what no kernel calls."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.errors import DeviceError, L3Error, RecipeError
from l3cli.frame import RawFrame
from l3cli.rendering import kernels, layout
from l3cli.rendering.display import Display
from l3cli.rendering.opencl import OpenCLRenderer
from l3cli.rendering.opencl_devices import choose_device, pyopencl
from l3cli.rendering.opencl_programs import BUILD_OPTIONS, DECLARES_ALL, Compiler, compiler_of
from l3cli.rendering.renderer import make_ready
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table, with_later, with_tree

FRAME = RawFrame("noise", np.random.default_rng(1).integers(0, 4096, (61, 301), np.uint16), 64, 4095)


def pocl_folders() -> set[Path]:
    return set(Path(kernels._cache().folder).glob("*/*/*/*/*.so"))


TABLES = {"structures": with_later(random_table(BAYER, patch=3), 3), "tree": with_tree(random_table(BAYER, patch=3))}


@pytest.mark.parametrize("name", TABLES)
def test_the_code_of_a_kernel_is_there_once(name: str) -> None:
    if shutil.which("nm") is None or not DECLARES_ALL.search(choose_device("").platform.version):
        pytest.skip("it is PoCL 3.0 that would have it three times")
    before, renderer = pocl_folders(), OpenCLRenderer(TABLES[name])
    renderer.outputs(FRAME)
    renderer.picture(FRAME, Display(np.eye(3), 8))
    made = pocl_folders() - before
    assert made
    for file in made:
        listed = subprocess.run(["nm", "-S", "--defined-only", file], capture_output=True, text=True, check=True).stdout
        sizes = {name: int(size, 16) for size, name in re.findall(r"^\S+ (\S+) [tT] (\S+)$", listed, re.MULTILINE)}
        largest = max(sizes, key=lambda name: sizes[name])
        assert not largest.startswith("_pocl_kernel"), file
        launching = sum(size for name, size in sizes.items() if name.startswith("_pocl_kernel"))
        assert launching < sizes[largest], file


CALLS = {
    "int": ("min(a, b)", "max(a, b)", "clamp(a, -3, 5)", "(int)abs(a)", "(int)abs_diff(a, b)", "any((int2)(a, b) == 3)"),
    "uint": ("min(a, b)", "max(a, b)", "clamp(a, 3u, 5u)"),
    "ulong": ("min(a, b)", "max(a, b)"),
    "float": ("min(a, b)", "max(a, b)", "clamp(a, -0.5f, 0.5f)"),
    "ushort": ("min(a, b)", "max(a, b)"),
}


def test_what_is_declared_is_what_opencl_has() -> None:
    """A program that is built with few declarations computes what it does with all of them."""
    cl, device = pyopencl(), choose_device("")
    context = cl.Context([device])
    queue, compiler = cl.CommandQueue(context), Compiler(context, device)
    source = "\n".join(
        f"__kernel void {kind}_{number}(__global const {kind} *p, __global {kind} *q) {{ const size_t i = get_global_id(0);"
        f" const {kind} a = p[2 * i], b = p[2 * i + 1]; q[i] = {call}; }}"
        for kind, calls in CALLS.items()
        for number, call in enumerate(calls)
    )
    made = {
        "few": compiler.build(source, {}).program,
        "all": cl.Program(context, source).build(list(BUILD_OPTIONS)),
    }
    dtypes = {"int": np.int32, "uint": np.uint32, "ulong": np.uint64, "float": np.float32, "ushort": np.uint16}
    random = np.random.default_rng(3).integers(-9, 9, 64)
    for kind, calls in CALLS.items():
        values = random.astype(dtypes[kind]) / dtypes[kind](4) if kind == "float" else random.astype(dtypes[kind])
        there = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=values)
        back = cl.Buffer(context, 0, values.nbytes)
        for number in range(len(calls)):
            results = []
            for program in made.values():
                result = np.empty(32, values.dtype)
                cl.Kernel(program, f"{kind}_{number}")(queue, (32,), None, there, back)
                cl.enqueue_copy(queue, result, back)
                results.append(result)
            assert np.array_equal(results[0], results[1]), f"{kind} {calls[number]}"


def test_what_is_not_declared_is_refused() -> None:
    """And not taken for a function that gives whole numbers."""
    device = choose_device("")
    if not DECLARES_ALL.search(device.platform.version):
        pytest.skip("the compiler has all declarations")
    assert "sqrt" not in layout.joined_files("builtins.cl")
    cl = pyopencl()
    with pytest.raises(cl.Error, match="sqrt"):
        Compiler(cl.Context([device]), device).build("__kernel void f(__global float *p) { *p = sqrt(*p); }", {})


def test_what_is_made_ready_is_not_built_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Making a renderer builds nothing more, of whatever table, nor does another renderer of it."""
    compiler_of.cache_clear()
    make_ready("opencl")
    built: list[str] = []
    usual = kernels.built

    def counted(known: str, *how: Any) -> kernels.Made:
        built.append(known)
        return usual(known, *how)

    monkeypatch.setattr(kernels, "built", counted)
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
def test_what_cannot_be_made_ready_is_told_as_by_the_renderer(options: dict[str, Any], fault: type[L3Error]) -> None:
    with pytest.raises(fault) as early:
        make_ready("opencl", **options)
    with pytest.raises(fault) as late:
        OpenCLRenderer(TABLES["tree"], **options)
    assert str(early.value) == str(late.value)
