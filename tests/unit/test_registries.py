"""The registries of raw and scene files: what their lines say is there, and a format that is added is read."""

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import get_args

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.scene import SpectralCube
from l3cli.io.raw import registry as raw
from l3cli.io.raw.files import read_raw
from l3cli.io.scenes import registry as scenes
from l3cli.simulation import sources


def test_every_suffix_of_raw_files_has_one_format() -> None:
    suffixes = [suffix for each in raw.FORMATS for suffix in each.suffixes]
    assert len(suffixes) == len(set(suffixes)) == len(raw.BY_SUFFIX)
    assert all(suffix == suffix.lower() and suffix[0] == "." for suffix in suffixes)


@pytest.mark.parametrize("line", raw.FORMATS, ids=lambda line: line.suffixes[0])
def test_modules_of_raw_formats_do_what_their_lines_say(line: raw.RawFormat) -> None:
    assert hasattr(line._reader, "read") == line.holds_frame
    assert hasattr(line._reader, "rate") == line.has_rate
    assert hasattr(line._reader, "stack") or not line.stackable


@pytest.mark.parametrize("line", scenes.FORMATS, ids=lambda line: line.module)
def test_modules_of_scene_formats_do_what_their_lines_say(line: scenes.SceneFormat) -> None:
    assert callable(line._reader.read)
    assert callable(line._reader.size)
    assert hasattr(line._reader, "files") == line.has_files


def test_every_source_of_files_has_a_format() -> None:
    for source in get_args(sources.Source):
        if issubclass(source, sources.FileSource):
            line = scenes.format_of(source.__struct_config__.tag, Path("any.suffix"))
            assert set(line.keys) <= set(source.__struct_fields__)


def test_a_raw_format_is_a_module_and_a_line(fiveband: CameraModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("l3cli.io.raw.text")
    module.read = lambda path: {"values": np.loadtxt(path, np.uint16), "exposure": 0.5}  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(raw.BY_SUFFIX, ".txt", raw.RawFormat((".txt",), "text", isolated=False))
    values = np.random.default_rng(0).integers(64, 1000, (8, 12))
    np.savetxt(tmp_path / "a.txt", values, "%d")
    frame = read_raw(tmp_path / "a.txt", fiveband)
    assert np.array_equal(frame.values, values)
    assert (frame.exposure, frame.black_level) == (0.5, fiveband.black_level)
    assert raw.is_frame(tmp_path / "a.txt")
    assert not raw.needs_isolation(tmp_path / "a.txt")


def test_a_scene_format_is_a_module_and_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cube = SpectralCube(np.ones((3, 4, 5)), None)
    module = ModuleType("l3cli.io.scenes.mine")
    module.read = lambda path, variable, axes: replace(cube, white=float(variable))  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    line = scenes.SceneFormat("cube", "mine", (".mine",), keys=("variable", "axes"))
    monkeypatch.setattr(scenes, "FORMATS", (line, *scenes.FORMATS))
    content = scenes.format_of("cube", tmp_path / "a.MINE").read(tmp_path / "a.MINE", variable="7", axes="")
    assert isinstance(content, SpectralCube)
    assert content.white == 7
