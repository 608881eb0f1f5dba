"""Start of `l3 render` with one frame: no unnecessary imports, compilations or processes."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.desk import make_desk
from tests.helpers.paths import PYTHONPATH

UNNEEDED = {"asyncio", "av", "colour", "concurrent.futures", "dask", "distributed", "jinja2", "multiprocessing", "rawpy"}
UNNEEDED |= {"numpy.ma", "rich", "scipy", "ssl", "tifffile", "l3cli.parallel.cluster", "l3cli.simulation", "l3cli.training"}
UNNEEDED |= {"matplotlib"}
PROGRAM = """
import json, sys
from l3cli.cli import run
code = run(sys.argv[1:])
from l3cli.io import isolated
print(json.dumps({"code": code, "modules": sorted(sys.modules), "isolated": isolated._child is not None}))
"""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("desk")
    make_desk(folder)
    return folder


def rendered(desk: Path, cache: Path, frame: str) -> dict[str, Any]:
    """What a process says of itself that has rendered a frame."""
    known = {name: value for name, value in os.environ.items() if name not in ("POCL_CACHE_DIR", "L3_TRUST")}
    known |= {"PYTHONPATH": PYTHONPATH, "XDG_CACHE_HOME": str(cache)}
    call = [sys.executable, "-c", PROGRAM, "render", f"{desk}/table.h5", f"{desk}/{frame}", "-o", f"{desk}/x.png", "--force"]
    ended = subprocess.run(call, env=known, capture_output=True, text=True, check=True)
    words: dict[str, Any] = json.loads(ended.stdout)
    assert words["code"] == 0, ended.stderr
    return words


def cached(cache: Path) -> dict[Path, int]:
    """When each file below a folder was written that holds something."""
    return {path: path.stat().st_mtime_ns for path in cache.rglob("*") if path.is_file() and path.stat().st_size}


def test_one_frame_needs_one_process_few_libraries_and_few_programs(desk: Path, tmp_path: Path) -> None:
    first = rendered(desk, tmp_path, "raw.tif")
    assert not UNNEEDED & set(first["modules"])
    assert not first["isolated"]
    left = cached(tmp_path)
    assert (
        sum(path.name == "program.bc" for path in left) == 2
    )  # classes and transforms of a layer; what encodes their outputs
    made = (desk / "x.png").read_bytes()
    second = rendered(desk, tmp_path, "raw.tif")
    assert set(second["modules"]) <= set(first["modules"])
    assert cached(tmp_path) == left
    assert (desk / "x.png").read_bytes() == made


def test_nothing_is_reported_when_all_is_done(desk: Path) -> None:
    """Libraries tell of their objects that are still there when Python ends, of a picture's file among them."""
    call = [sys.executable, "-m", "l3cli", "render", "table.h5", "raw.tif", "-o", "y.exr", "--force", "--quiet"]
    ended = subprocess.run(call, cwd=desk, capture_output=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, b"", b"")


def test_a_foreign_file_is_read_by_the_isolated_process(desk: Path, tmp_path: Path) -> None:
    import OpenImageIO as oiio

    from l3cli.io.pictures.openimageio import encoded
    from l3cli.io.raw.tiff import read_by_library

    values = read_by_library(desk / "raw.tif")["values"]
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], 1, "uint16")
    spec.attribute("compression", "zip")
    (desk / "packed.tif").write_bytes(encoded("packed.tif", spec, values[..., None]))
    assert rendered(desk, tmp_path, "packed.tif")["isolated"]
