"""PoCL compiles the code of a kernel once, and a process each program."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.errors import DeviceError, L3Error, RecipeError
from l3cli.frames.frame import RawFrame
from l3cli.rendering.display import Display
from l3cli.rendering.opencl.devices import choose_device, pyopencl
from l3cli.rendering.opencl.programs import compiler_of
from l3cli.rendering.opencl.renderer import OpenCLRenderer
from l3cli.rendering.renderer import make_ready
from tests.helpers.cameras import BAYER
from tests.helpers.paths import ROOT
from tests.helpers.tables import random_table, with_later, with_tree

FRAME = RawFrame("noise", np.random.default_rng(1).integers(0, 4096, (61, 301), np.uint16), 64, 4095)


TABLES = {"structures": with_later(random_table(BAYER, patch=3), 3), "tree": with_tree(random_table(BAYER, patch=3))}


def render(name: str) -> None:
    renderer = OpenCLRenderer(TABLES[name])
    renderer.outputs(FRAME)
    renderer.picture(FRAME, Display(np.eye(3), 8))


@pytest.mark.parametrize("name", TABLES)
def test_the_code_of_a_kernel_is_there_once(name: str, tmp_path: Path) -> None:
    if shutil.which("nm") is None or "PoCL 3.0" not in choose_device("").platform.version:
        pytest.skip("it is PoCL 3.0 that would have it three times")
    call = [sys.executable, "-c", f"from {__name__} import render; render({name!r})"]
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
def test_what_cannot_be_made_ready_is_told_as_by_the_renderer(options: dict[str, Any], fault: type[L3Error]) -> None:
    with pytest.raises(fault) as early:
        make_ready("opencl", **options)
    with pytest.raises(fault) as late:
        OpenCLRenderer(TABLES["tree"], **options)
    assert str(early.value) == str(late.value)
