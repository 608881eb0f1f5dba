"""Frames of another camera than a table was trained for are noticed, whatever the cameras are called; the same camera
measured twice is not taken for another."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.evaluation.likeness import MOST_COLOUR, colour_difference, noise_ratio, unlike
from tests.helpers.cameras import bayer_camera

TWIN = bayer_camera()
OTHERS = {  # what is changed in the recipe, and what is said of it
    "colour": ("centre_nm = 600", "centre_nm = 640", "colours by ΔE00"),
    "sensitivity": ("f_number = 2.8", "f_number = 4.0", "sensitivity by a factor of 0.49"),
    "noise": ("read_noise_e = 4.0", "read_noise_e = 12.0", "noise by a factor of 2."),
}


@pytest.fixture(scope="module")
def frames(pipeline: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A set of unseen frames of every other camera, all of which bear the same name."""
    folder, artifacts = tmp_path_factory.mktemp("others"), {}
    (folder / "scenes.toml").write_text('exposure_share = [0.8]\n[[scene]]\nsource = "grey ramp"\nsize = [32, 48]\n')
    for name, (old, new, _) in OTHERS.items():
        assert old in TWIN
        (folder / f"{name}.toml").write_text(TWIN.replace(old, new))
        artifacts[name] = folder / f"{name}.h5"
        arguments = (
            "simulate",
            folder / "scenes.toml",
            "--camera",
            folder / f"{name}.toml",
            "-o",
            artifacts[name],
            "--quiet",
        )
        assert run([str(argument) for argument in arguments]) == 0
    return artifacts


@pytest.mark.parametrize("name", OTHERS)
def test_frames_of_another_camera_are_warned_of(name: str, pipeline: Path, frames: dict[str, Path], l3: Callable) -> None:
    code, out, err = l3("evaluate", pipeline / "table.h5", frames[name], "--json")
    assert code == 0
    assert err.count("\n") == 1
    assert "table.h5 was trained for another camera" in err
    assert OTHERS[name][2] in err
    assert json.loads(out)["frames"]
    assert l3("evaluate", pipeline / "table.h5", frames[name], "--json", "--quiet")[2] == ""


def test_the_camera_measured_or_described_is_the_same(pipeline: Path, l3: Callable) -> None:
    assert l3("evaluate", pipeline / "table.h5", pipeline / "unseen.h5", "--json")[2] == ""
    one, other = load_camera(pipeline / "camera.toml"), load(CameraModel, pipeline / "camera.h5")
    assert colour_difference(one, other) < 0.3
    assert noise_ratio(one, other) == pytest.approx(1, abs=0.05)


def test_what_two_calibrations_differ_by_is_no_other_camera(bayer: CameraModel) -> None:
    moved = np.array([np.interp(bayer.wavelength - 1.0, bayer.wavelength, curve) for curve in bayer.responsivity])
    again = dataclasses.replace(bayer, name="B", responsivity=moved * np.array([1.05, 1.03, 1.02])[:, None])
    again = dataclasses.replace(again, noise=dataclasses.replace(bayer.noise, read_noise=4.4), gain=bayer.gain * 1.02)
    assert 0.1 < colour_difference(bayer, again) < MOST_COLOUR
    assert unlike(bayer, again) == unlike(again, bayer) == ""
    assert "colours" in unlike(bayer, dataclasses.replace(bayer, responsivity=bayer.responsivity[[1, 0, 2]]))


def test_a_table_that_does_not_hold_its_camera_knows_its_sensitivity(
    pipeline: Path, frames: dict[str, Path], tmp_path: Path, l3: Callable
) -> None:
    table = load(TransformTable, pipeline / "table.h5")
    assert table.camera is not None
    assert table.camera.fit is None
    with pytest.raises(ValueError, match="another CFA"):
        dataclasses.replace(table, camera=dataclasses.replace(table.camera, cfa=table.cfa[::-1]))
    save(dataclasses.replace(table, camera=None), tmp_path / "old.h5")
    assert l3("evaluate", tmp_path / "old.h5", pipeline / "unseen.h5", "--json")[2] == ""
    assert "factor of 0.49" in l3("evaluate", tmp_path / "old.h5", frames["sensitivity"], "--json")[2]


def test_a_report_says_so_too(pipeline: Path, frames: dict[str, Path], tmp_path: Path, l3: Callable) -> None:
    out = ("-o", tmp_path / "report.html", "--force", "--backend", "reference")
    code, _, err = l3("report", pipeline / "camera.h5", pipeline / "table.h5", frames["colour"], *out)
    assert code == 0
    assert "warning: table.h5 was trained for another camera" in err
    page = (tmp_path / "report.html").read_text()
    assert page.count("table.h5 was trained for another camera") == 2  # above all, and above the evaluation
    save(load_camera(frames["noise"].with_suffix(".toml")), tmp_path / "noisy.h5")
    for first in ("table.h5", "camera.h5", "unseen.h5"):
        err = l3("report", pipeline / first, tmp_path / "noisy.h5", *out)[2]
        assert "noisy.h5" in err
        assert "another camera than" in err
        assert "another camera" not in l3("report", pipeline / first, pipeline / "camera.h5", *out)[2]
