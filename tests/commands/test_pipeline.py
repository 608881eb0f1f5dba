"""The whole pipeline by its commands, and what every command promises about outputs, seeds and mistakes."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import COMMANDS
from l3cli.io.images import read_image
from tests.helpers.recipes import CLASSES


def test_an_unseen_scene_comes_out_better_than_by_the_basic_pipeline(pipeline: Path, l3: Callable) -> None:
    code, out, err = l3("evaluate", pipeline / "table.h5", pipeline / "unseen.h5", "--json")
    assert (code, err) == (0, "")
    figures = json.loads(out)["mean"]
    ours, basic = figures["ours"], figures["basic"]  # of the same frames
    assert ours["mean_delta_e"] < 0.85 * basic["mean_delta_e"]  # in fact 0.76
    assert ours["scielab"] < 0.95 * basic["scielab"]  # in fact 0.87
    assert ours["psnr"] > basic["psnr"] + 3  # in fact 4.5 dB
    picture, _ = read_image(pipeline / "picture.png")
    ideal, _ = read_image(next((pipeline / "unseen").glob("*_ideal.png")))
    assert picture.shape == ideal.shape == (160, 240, 3)
    assert np.corrcoef(picture.ravel().astype(float), ideal.ravel().astype(float))[0, 1] > 0.95


def test_the_history_names_every_stage(pipeline: Path) -> None:
    table = load(TransformTable, pipeline / "table.h5")
    camera = load(CameraModel, pipeline / "camera.h5")
    assert [stage.command for stage in table.history] == ["calibrate", "simulate", "train"]
    assert table.history[0] == camera.history[0]
    assert table.history[2].recipe == CLASSES
    text = json.dumps([stage.__dict__ for stage in table.history])
    assert str(pipeline) not in text


def test_an_existing_output_is_refused_before_any_work(pipeline: Path, refused: Callable) -> None:
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    for arguments in (
        ("lab", pipeline / "camera.toml", "-o", pipeline / "lab"),
        ("calibrate", pipeline / "lab/MEASUREMENTS.toml", "-o", pipeline / "camera.h5"),
        ("simulate", pipeline / "scenes.toml", "--camera", pipeline / "camera.h5", "-o", pipeline / "training.h5"),
        ("train", pipeline / "training.h5", "-o", pipeline / "table.h5"),
        ("render", pipeline / "table.h5", raw, "-o", pipeline / "picture.png"),
    ):
        before = {path: path.stat().st_mtime_ns for path in pipeline.rglob("*")}
        assert "--force" in refused(1, *arguments)
        assert {path: path.stat().st_mtime_ns for path in pipeline.rglob("*")} == before


def test_artifacts_of_the_wrong_kind_name_the_right_one(pipeline: Path, tmp_path: Path, refused: Callable) -> None:
    out = tmp_path / "out.h5"
    table, camera, training = pipeline / "table.h5", pipeline / "camera.h5", pipeline / "training.h5"
    assert 'holds a transform table; give the file written by "l3 simulate"' in refused(3, "train", table, "-o", out)
    wrong = ("simulate", pipeline / "scenes.toml", "--camera", training, "-o", out)
    assert 'holds a training set; give the file written by "l3 calibrate"' in refused(3, *wrong)
    raw = next((pipeline / "unseen").glob("*_raw.tif"))
    assert "holds a camera model" in refused(3, "render", camera, raw, "-o", tmp_path / "out.png")
    assert "holds a camera model" in refused(3, "evaluate", camera, training)


@pytest.mark.parametrize("command", list(COMMANDS))
def test_every_command_explains_itself_with_an_example(command: str, l3: Callable) -> None:
    code, out, err = l3(command, "--help")
    assert (code, err) == (0, "")
    assert f"Example: l3 {command}" in out


def test_a_wrong_call_points_to_the_help(refused: Callable) -> None:
    assert 'see "l3 --help"' in refused(2, "paint")
    assert 'see "l3 train --help"' in refused(2, "train")
    assert 'see "l3 info --help"' in refused(2, "info", "--colour", "x.h5")


def test_an_interrupt_is_one_line_and_130(monkeypatch: pytest.MonkeyPatch, l3: Callable, tmp_path: Path) -> None:
    def interrupted(path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("l3cli.stages.information.describe", interrupted)
    code, out, err = l3("info", tmp_path / "x.h5")
    assert (code, out, err.strip()) == (130, "", "l3: interrupted")
