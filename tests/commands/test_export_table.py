"""l3 export of transform tables: what is written, what is refused."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from tests.helpers.artifacts import some_sums
from tests.helpers.calls import L3, Refused
from tests.helpers.tables import random_table, with_later, with_quiet

C_FILES = ["Makefile", "README.md", "l3.c", "l3.h", "l3_table.c", "l3_table.h", "test.c", "test_labels.bin",
           "test_outputs.bin", "test_raw.bin"]  # fmt: skip


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("table") / "table.h5"
    save(with_later(random_table([[0, 1], [1, 2]], contrasts=()), 3), path)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_c_is_what_a_table_becomes_unless_it_is_told_otherwise(table: Path, tmp_path: Path, l3: L3) -> None:
    code, out, err = l3("export", table, "-o", tmp_path / "c")
    assert (code, out) == (0, "")
    assert "l3_table.c" in err
    assert sorted(contents(tmp_path / "c")) == C_FILES
    code, out, _ = l3("export", table, "-o", tmp_path / "again", "--to", "c", "--json", "--quiet")
    assert sorted(json.loads(out)["files"]) == C_FILES
    assert contents(tmp_path / "again") == contents(tmp_path / "c")
    assert "$" not in contents(tmp_path / "c")["README.md"].decode()


def test_a_dry_run_names_the_files_and_writes_none(table: Path, tmp_path: Path, l3: L3) -> None:
    code, out, err = l3("export", table, "-o", tmp_path / "c", "--dry-run")
    assert code == 0
    assert all(name in out + err for name in C_FILES)
    assert not (tmp_path / "c").exists()


def test_a_folder_is_written_alike_twice(table: Path, tmp_path: Path, l3: L3) -> None:
    for name in ("one", "two"):
        assert l3("export", table, "-o", tmp_path / name, "--to", "folder", "--quiet")[0] == 0
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    named = {each["file"] for each in json.loads((tmp_path / "one" / "table.json").read_text())["arrays"]}
    assert named | {"table.json"} == set(contents(tmp_path / "one"))


def test_an_onnx_graph_is_written_alike_twice(table: Path, tmp_path: Path, l3: L3) -> None:
    for name in ("one", "two"):
        assert l3("export", table, "-o", tmp_path / name, "--to", "onnx", "--quiet")[0] == 0
    assert contents(tmp_path / "one") == contents(tmp_path / "two")
    assert sorted(contents(tmp_path / "one")) == [
        "README.md", "table.onnx", "test_labels.bin", "test_outputs.bin", "test_raw.bin"
    ]  # fmt: skip


def test_either_set_of_a_table_of_two_is_exported(table: Path, tmp_path: Path, l3: L3) -> None:
    two = with_quiet(load(TransformTable, table))
    assert two.quiet is not None
    save(two, tmp_path / "two.h5")
    save(replace(two, first=two.quiet.first, later=two.quiet.later, quiet=None), tmp_path / "alone.h5")
    for form in ("c", "onnx"):
        err = l3("export", tmp_path / "two.h5", "-o", tmp_path / form, "--to", form)[2]
        assert "the usual set of transforms is written, --set quiet writes that for frames filtered in time" in err
        err = l3("export", table, "-o", tmp_path / f"{form}1", "--to", form)[2]
        assert "--set" not in err
        assert contents(tmp_path / form) == contents(tmp_path / f"{form}1")
        to = ("--to", form, "--quiet")
        assert l3("export", tmp_path / "two.h5", "-o", tmp_path / f"{form}2", *to, "--set", "quiet")[0] == 0
        assert l3("export", tmp_path / "alone.h5", "-o", tmp_path / f"{form}3", *to)[0] == 0
        quiet, alone = contents(tmp_path / f"{form}2"), contents(tmp_path / f"{form}3")
        assert quiet.pop("README.md").startswith(alone.pop("README.md") + b"\n## The quiet set\n")
        assert quiet == alone
        assert quiet["test_outputs.bin"] != contents(tmp_path / form)["test_outputs.bin"]


def test_a_set_that_is_not_there_is_refused(table: Path, tmp_path: Path, refused: Refused) -> None:
    line = refused(2, "export", table, "-o", tmp_path / "o", "--set", "quiet")
    assert "has one set of transforms; leave --set out" in line
    line = refused(2, "export", table, "-o", tmp_path / "o", "--to", "folder", "--set", "quiet")
    assert "a folder of arrays holds both sets; leave --set out" in line
    assert not (tmp_path / "o").exists()


def test_without_onnx_its_extra_is_named(
    table: Path, tmp_path: Path, refused: Refused, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    line = refused(2, "export", table, "-o", tmp_path / "o", "--to", "onnx")
    assert 'install it with: pip install "l3cli[onnx]"' in line
    assert not (tmp_path / "o").exists()


def test_words_are_of_c_source(table: Path, bayer: CameraModel, tmp_path: Path, l3: L3, refused: Refused) -> None:
    assert l3("export", table, "-o", tmp_path / "c", "--words", "int16", "--quiet")[0] == 0
    assert sorted(contents(tmp_path / "c")) == C_FILES
    assert "typedef int16_t L3Output;" in (tmp_path / "c" / "l3_table.h").read_text()
    assert "$" not in contents(tmp_path / "c")["README.md"].decode()
    assert "--words is for C source" in refused(
        2, "export", table, "-o", tmp_path / "f", "--to", "folder", "--words", "int16"
    )
    save(bayer, tmp_path / "camera.h5")
    assert "--words is for transform" in refused(
        2, "export", tmp_path / "camera.h5", "-o", tmp_path / "f", "--words", "int16"
    )
    assert "'half'; there are float32, int16" in refused(2, "export", table, "-o", tmp_path / "f", "--words", "half")
    assert not (tmp_path / "f").exists()


def test_wrong_artifacts_and_forms_are_refused(table: Path, bayer: CameraModel, tmp_path: Path, refused: Refused) -> None:
    save(bayer, tmp_path / "camera.h5")
    line = refused(2, "export", tmp_path / "camera.h5", "-o", tmp_path / "c", "--to", "c")
    assert "--to is for transform tables" in line
    assert "camera.h5" in line
    save(some_sums(bayer)[0], tmp_path / "sums.h5")
    line = refused(3, "export", tmp_path / "sums.h5", "-o", tmp_path / "c")
    assert "sums; give a camera model or recipe, or a transform table" in line
    assert "'halide'; there are c, folder, onnx" in refused(2, "export", table, "-o", tmp_path / "c", "--to", "halide")
    assert "is a file; name a folder" in refused(1, "export", table, "-o", table)
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
