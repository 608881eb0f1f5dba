"""`l3 export` of transform tables: written files and rejected calls."""

import ctypes
import dataclasses
import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.io.images import read_image
from l3cli.io.raw.files import read_raw
from l3cli.physics.display import exposure_scale
from l3cli.rendering.display import Display, encode
from l3cli.rendering.exposure import still_scale
from tests.helpers.artifacts import some_sums
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import contents
from tests.helpers.tables import random_table, with_low_noise, with_refinement

C_FILES = ["CMakeLists.txt", "Makefile", "README.md", "l3.c", "l3.h", "l3_picture.c", "l3_picture.h", "l3_table.c",
           "l3_table.h", "page.html", "test.c", "test_labels.bin", "test_outputs.bin", "test_raw.bin"]  # fmt: skip
CC = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
needs_compiler = pytest.mark.skipif(CC is None, reason="there is no C compiler (cc, gcc or CC)")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("table") / "table.h5"
    save(with_refinement(random_table([[0, 1], [1, 2]], contrasts=()), 3), path)
    return path


def test_c_is_what_a_table_becomes_unless_it_is_reported_otherwise(table: Path, tmp_path: Path, l3: L3) -> None:
    code, out, err = l3("export", table, "-o", tmp_path / "c")
    assert (code, out) == (0, "")
    assert "l3_table.c" in err
    assert sorted(contents(tmp_path / "c")) == C_FILES
    code, out, _ = l3("export", table, "-o", tmp_path / "again", "--to", "c", "--json", "--quiet")
    assert sorted(json.loads(out)["files"]) == C_FILES
    assert contents(tmp_path / "again") == contents(tmp_path / "c")
    assert "$" not in contents(tmp_path / "c")["README.md"].decode()


def test_a_folder_is_written_alike_twice(table: Path, tmp_path: Path, l3: L3) -> None:
    for name in ("one", "two"):
        assert l3("export", table, "-o", tmp_path / name, "--to", "folder", "--quiet")[0] == 0
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    named = {each["file"] for each in json.loads((tmp_path / "one" / "table.json").read_text())["arrays"]}
    assert named | {"table.json"} == set(contents(tmp_path / "one"))


def test_either_set_of_a_table_of_two_is_exported(table: Path, tmp_path: Path, l3: L3) -> None:
    two = with_low_noise(load(TransformTable, table))
    save(two, tmp_path / "two.h5")
    save(two.under(two.conditions[0]), tmp_path / "alone.h5")
    err = l3("export", tmp_path / "two.h5", "-o", tmp_path / "c")[2]
    assert "to export the set for temporally filtered frames, use --set low-noise" in err
    err = l3("export", table, "-o", tmp_path / "c1")[2]
    assert "--set" not in err
    assert contents(tmp_path / "c") == contents(tmp_path / "c1")
    assert l3("export", tmp_path / "two.h5", "-o", tmp_path / "c2", "--quiet", "--set", "low-noise")[0] == 0
    assert l3("export", tmp_path / "alone.h5", "-o", tmp_path / "c3", "--quiet")[0] == 0
    quiet, alone = contents(tmp_path / "c2"), contents(tmp_path / "c3")
    assert quiet.pop("README.md").startswith(alone.pop("README.md") + b"\n## Low-noise transforms\n")
    assert quiet == alone
    assert quiet["test_outputs.bin"] != contents(tmp_path / "c")["test_outputs.bin"]


def test_a_set_that_is_not_there_is_refused(table: Path, tmp_path: Path, refused: Refused) -> None:
    assert "--set" in refused(2, "export", table, "-o", tmp_path / "o", "--set", "low-noise")
    assert not (tmp_path / "o").exists()


class White(ctypes.Structure):
    """L3White of three channels."""

    _fields_ = (("gain", ctypes.c_double * 3), ("luminance", ctypes.c_float), ("matrix", ctypes.c_float * 9))


def library_of(folder: Path, prefix: str) -> Any:
    """The C source of a folder, compiled as strictly as its Makefile does."""
    sources = (folder / f"{prefix}{end}.c" for end in ("", "_table", "_picture"))
    warnings = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror")
    built = folder / "library.so"
    subprocess.run([str(CC), *warnings, "-O1", "-fPIC", "-shared", *sources, "-o", built], check=True)
    return ctypes.CDLL(str(built))


@needs_compiler
@pytest.mark.parametrize(("white", "exposure"), [(None, None), ("0.37,0.37", "0.7")])
def test_c_source_shows_what_l3_render_shows(
    pipeline: Path, tmp_path: Path, l3: L3, white: str | None, exposure: str | None
) -> None:
    """Within one code, under symbols of one's own. Colours outside of sRGB may differ by two: moving them inside magnifies
    the fraction of a DN of dark current that codes cannot take off."""
    options = ("--white", white) if white else ()
    assert l3("export", pipeline / "table.h5", "-o", tmp_path / "c", "--prefix", "eye_2", *options, "--quiet")[0] == 0
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    shown = ("--exposure", exposure) if exposure else ()
    assert l3("render", pipeline / "table.h5", raw, "-o", tmp_path / "p.png", *options, *shown, "--quiet")[0] == 0
    expected = read_image(tmp_path / "p.png")[0]
    table = load(TransformTable, pipeline / "table.h5")
    frame = read_raw(raw, table)
    eye, (rows, columns) = library_of(tmp_path / "c", "eye_2"), frame.values.shape
    eye.eye_2_workspace_bytes.restype = ctypes.c_size_t
    eye.eye_2_auto_scale.restype = ctypes.c_float
    values, workspace = frame.values.copy(), np.empty(eye.eye_2_workspace_bytes(rows, columns), np.uint8)
    labels = np.empty((len(table.layers), rows, columns), np.uint32)
    outputs, picture = np.empty((3, rows, columns), np.float32), np.empty((rows, columns, 3), np.uint8)
    of = [ctypes.c_void_p(each.ctypes.data) for each in (values, workspace, labels, outputs, picture)]
    shows = White.in_dll(eye, "eye_2_white")
    zero = ctypes.c_double(frame.black_level + frame.dark)
    eye.eye_2_balance(of[0], rows, columns, *frame.phase, zero, ctypes.byref(shows), of[0])
    assert eye.eye_2_render(of[0], rows, columns, *frame.phase, *of[1:4]) == 0
    scale = float(exposure) * shows.luminance if exposure else eye.eye_2_auto_scale(of[0], of[3], rows, columns)
    eye.eye_2_picture(of[3], rows, columns, ctypes.c_float(scale), ctypes.byref(shows), of[4])
    difference = np.abs(picture.astype(int) - expected)
    assert difference.max() <= 2
    assert (difference > 1).mean() < 1e-3
    # 1 % of the values differ by dark current, a fraction of a DN that codes cannot take off, 0.5 % by the kernels' curve.
    assert difference.mean() < 0.02
    outputs[:] = np.random.default_rng(1).uniform(-0.1, 1.4, outputs.shape)  # colours of which most are outside of sRGB
    eye.eye_2_picture(of[3], rows, columns, ctypes.c_float(1.0), ctypes.byref(shows), of[4])
    truth = encode(outputs, Display(np.reshape(shows.matrix, (3, 3)).astype(np.float64), 8))
    assert np.abs(picture.astype(int) - truth).max() <= 1
    values[: rows // 2] = table.white_level  # clipped pixels are averaged for the automatic exposure
    scale = still_scale(outputs[1], dataclasses.replace(frame, values=values), table)
    assert eye.eye_2_auto_scale(of[0], of[3], rows, columns) == pytest.approx(scale, rel=1e-6)
    assert scale != pytest.approx(exposure_scale(outputs[1]), rel=1e-3)
    texts = [path.read_text() for path in (tmp_path / "c").glob("*.[ch]")]
    assert not re.search(r"\bl3_|\bL3[_A-Z]", "".join(re.sub('(?m)^".*$', "", text) for text in texts))


@needs_compiler
@pytest.mark.skipif(shutil.which("cmake") is None, reason="there is no CMake")
def test_c_source_builds_by_cmake_for_any_processor(table: Path, tmp_path: Path, l3: L3) -> None:
    assert l3("export", table, "-o", tmp_path / "c", "--prefix", "eye", "--quiet")[0] == 0
    subprocess.run(["cmake", "-S", tmp_path / "c", "-B", tmp_path / "b"], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", tmp_path / "b"], check=True, capture_output=True)
    assert subprocess.run(["ctest", "--test-dir", tmp_path / "b"], capture_output=True).returncode == 0
    for name in ("CMakeLists.txt", "Makefile"):
        assert "-march" not in re.sub("(?m)^#.*", "", (tmp_path / "c" / name).read_text())


def test_a_white_far_from_training_is_reported_as_by_l3_render(table: Path, tmp_path: Path, l3: L3) -> None:
    err = l3("export", table, "-o", tmp_path / "c", "--white", "0.45,0.41")[2]
    assert "--white 0.45,0.41 is far from the mean training illuminant" in err


def test_a_prefix_begins_symbols_of_c_source_alone(table: Path, tmp_path: Path, refused: Refused) -> None:
    for wrong in ("9eyes", "my eye", "Eye", "e" * 32, ""):
        assert f'"{wrong}"' in refused(2, "export", table, "-o", tmp_path / "o", "--prefix", wrong)


def test_words_are_of_c_source(table: Path, bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused) -> None:
    assert l3("export", table, "-o", tmp_path / "c", "--words", "int16", "--quiet")[0] == 0
    assert sorted(contents(tmp_path / "c")) == C_FILES
    assert "typedef int16_t L3Output;" in (tmp_path / "c" / "l3_table.h").read_text()
    assert "$" not in contents(tmp_path / "c")["README.md"].decode()
    assert "--words applies only to C source" in refused(
        2, "export", table, "-o", tmp_path / "f", "--to", "folder", "--words", "int16"
    )
    save(bayer, tmp_path / "camera.h5")
    assert "--words works only for transform" in refused(
        2, "export", tmp_path / "camera.h5", "-o", tmp_path / "f", "--words", "int16"
    )
    assert "'half'; use one of float32, int16" in refused(2, "export", table, "-o", tmp_path / "f", "--words", "half")
    assert not (tmp_path / "f").exists()


def test_wrong_artifacts_and_forms_are_refused(table: Path, bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    save(bayer, tmp_path / "camera.h5")
    line = refused(2, "export", tmp_path / "camera.h5", "-o", tmp_path / "c", "--to", "c")
    assert "--to works only for transform tables" in line
    assert "camera.h5" in line
    save(some_sums(bayer)[0], tmp_path / "sums.h5")
    line = refused(3, "export", tmp_path / "sums.h5", "-o", tmp_path / "c")
    assert "sums, which cannot be exported; use a camera model, a camera recipe or a transform table" in line
    assert "'halide'; use one of c, folder" in refused(2, "export", table, "-o", tmp_path / "c", "--to", "halide")
    assert "is a file; choose a folder" in refused(1, "export", table, "-o", table)
    assert not (tmp_path / "c").exists()


def test_nothing_is_replaced_without_force_and_the_table_never(
    table: Path, tmp_path: Path, refused: Refused, l3: L3
) -> None:
    folder = tmp_path / "c"
    folder.mkdir()
    (folder / "l3.h").write_text("mine")
    assert "l3.h exists; add --force" in refused(1, "export", table, "-o", folder)
    assert [path.name for path in folder.iterdir()] == ["l3.h"]
    os.link(table, folder / "test.c")
    before = table.read_bytes()
    assert "test.c" in refused(2, "export", table, "-o", folder, "--force")
    assert table.read_bytes() == before
    assert (folder / "l3.h").read_text() == "mine"
    (folder / "test.c").unlink()
    assert l3("export", table, "-o", folder, "--force", "--quiet")[0] == 0
    assert sorted(contents(folder)) == C_FILES
