"""`l3 report`: which artifacts it takes, what it says of each, and what it refuses."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load, save
from l3cli.artifacts.training_set import open_training_set, write_training_set


@pytest.mark.parametrize(
    ("names", "sections", "lead"),
    [
        (["camera"], ["Camera", "History"], "nothing is evaluated"),
        (["table"], ["Table", "History"], "Add a training set that the table was not trained on"),
        (["training"], ["Camera", "Training set", "History"], "without a transform table"),
        (["training", "table"], ["Camera", "Training set", "Table", "History"], "add frames that it has not seen"),
        (
            ["table", "unseen"],
            ["Pictures", "Camera", "Training set", "Table", "Evaluation", "History"],
            "Mean ΔE00 over 1 frame: ours ",
        ),
        (["camera", "camera"], ["Camera", "History"], "1 artifact,"),
    ],
)
def test_a_report_shows_what_it_is_given(
    names: list[str], sections: list[str], lead: str, pipeline: Path, tmp_path: Path, l3: Callable
) -> None:
    out = tmp_path / "report.html"
    assert l3("report", *(pipeline / f"{name}.h5" for name in names), "-o", out)[0] == 0
    text = out.read_text()
    assert [re.split("[:<]", heading)[0] for heading in re.findall(r'<h2 id="section-\d+">([^\n]*)', text)] == sections
    assert lead in text


def test_a_described_camera_and_odd_outputs_are_shown(bayer: CameraModel, tmp_path: Path, l3: Callable) -> None:
    save(bayer, tmp_path / "camera.h5")
    bands = 'exposure_share = [0.5]\n[target]\noutputs = "camera"\n[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\n'
    (tmp_path / "bands.toml").write_text(bands)
    simulate = ("simulate", tmp_path / "bands.toml", "--camera", tmp_path / "camera.h5", "-o", tmp_path / "bands.h5")
    assert l3(*simulate)[0] == 0
    assert l3("report", tmp_path / "camera.h5", tmp_path / "bands.h5", "-o", tmp_path / "report.html")[0] == 0
    text = (tmp_path / "report.html").read_text()
    assert "Described by a recipe, not measured" in text
    assert "there are no pictures to show" in text


def test_a_table_of_bands_is_judged_by_angles(pipeline: Path, tmp_path: Path, l3: Callable) -> None:
    scenes = '[target]\noutputs = "camera"\n[[scene]]\nsource = "dead leaves"\nsize = [96, 96]\ncount = 2\nseed = {}\n'
    for name in ("training", "unseen"):
        (tmp_path / "scenes.toml").write_text("exposure_share = [0.5]\n" + scenes.format(len(name)))
        simulate = ("simulate", tmp_path / "scenes.toml", "--camera", pipeline / "camera.h5", "-o", tmp_path / f"{name}.h5")
        assert l3(*simulate)[0] == 0
    train = ("train", tmp_path / "training.h5", "--classes", pipeline / "classes.toml", "-o", tmp_path / "table.h5")
    assert l3(*train)[0] == 0
    assert l3("report", tmp_path / "table.h5", tmp_path / "unseen.h5", "-o", tmp_path / "report.html")[0] == 0
    assert "Mean spectral angle (°) over 2 frames: ours " in (tmp_path / "report.html").read_text()


def test_a_camera_that_was_accepted_although_it_falls_short_says_so(pipeline: Path, tmp_path: Path, l3: Callable) -> None:
    camera = load(CameraModel, pipeline / "camera.h5")
    assert camera.fit is not None
    assert camera.fit.chart is not None
    assert camera.fit.noise is not None
    chart = replace(camera.fit.chart, relative_rmse=np.array([0.01, 0.05, 0.01]))
    noise = camera.fit.noise
    line = noise.conversion_gain * noise.photon_transfer_mean + (noise.conversion_gain * noise.read_noise) ** 2
    line[-1, 0] /= 2  # where a channel saturates
    noise = replace(noise, white_level_reached=False, photon_transfer_variance=line)
    save(replace(camera, fit=replace(camera.fit, chart=chart, noise=noise)), tmp_path / "camera.h5")
    assert l3("report", tmp_path / "camera.h5", "-o", tmp_path / "report.html")[0] == 0
    text = (tmp_path / "report.html").read_text()
    assert "It falls short: channel g is predicted with" in text
    assert "No white frame saturates" in text
    assert " 1 saturated point, of less variance, lies below them." in text
    assert l3("report", pipeline / "camera.h5", "-o", tmp_path / "sound.html")[0] == 0
    assert "falls short" not in (tmp_path / "sound.html").read_text()


# ------------------------------------------------------------------------------------------------------- refusals


def test_what_is_no_report_is_refused(pipeline: Path, tmp_path: Path, refused: Callable, l3: Callable) -> None:
    out, camera = tmp_path / "report.html", pipeline / "camera.h5"
    assert "ARTIFACT.h5" in refused(2, "report", "-o", out)
    assert "ends in .html" in refused(2, "report", camera, "-o", tmp_path / "report.pdf")
    assert "does not exist" in refused(3, "report", tmp_path / "none.h5", "-o", out)
    (tmp_path / "text.h5").write_text("no artifact")
    assert "is not an HDF5 file" in refused(3, "report", camera, tmp_path / "text.h5", "-o", out)
    shard = ("train", pipeline / "training.h5", "--classes", pipeline / "classes.toml", "--shard", "1/2")
    assert l3(*shard, "-o", tmp_path / "sums.h5")[0] == 0
    assert "give camera models, training sets or transform tables" in refused(3, "report", tmp_path / "sums.h5", "-o", out)
    out.write_text("mine")
    assert "--force" in refused(1, "report", camera, "-o", out)
    assert out.read_text() == "mine"
    assert l3("report", camera, "-o", out, "--force")[0] == 0


def test_a_table_and_frames_of_different_outputs_are_refused(pipeline: Path, tmp_path: Path, refused: Callable) -> None:
    with open_training_set(pipeline / "unseen.h5") as reader:
        head, frame = replace(reader.head, outputs=("a", "b", "c")), reader.frame(0)
    with write_training_set(tmp_path / "bands.h5", head) as writer:
        writer.append(frame)
    line = refused(3, "report", pipeline / "table.h5", tmp_path / "bands.h5", "-o", tmp_path / "report.html")
    assert "have different outputs" in line
