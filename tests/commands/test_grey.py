"""Cameras without filters and tables for luminance: training, rendering, evaluation and reports in grey."""

import json
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.cli import run
from l3cli.io.images import read_image
from l3cli.io.video import pyav
from tests.helpers.calls import L3, Refused
from tests.helpers.recipes import small_classes

REFERENCE = ("--backend", "reference")  # saves the compilation of kernels that no other test uses

SCENES = """
exposure_share = [0.9]
{target}
[[scene]]
source = "dead leaves"
size = [48, 56]
count = 2
"""


@pytest.fixture(scope="module", params=["colours", "luminance"])
def trained(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with frames and a table of the camera without filters, for X, Y, Z or for luminance, and its pictures."""
    folder = tmp_path_factory.mktemp(request.param)
    target = '[target]\noutputs = "luminance"' if request.param == "luminance" else ""
    (folder / "scenes.toml").write_text(SCENES.format(target=target))
    (folder / "classes.toml").write_text(small_classes())
    frames, table, pictures = folder / "frames.h5", folder / "table.h5", folder / "pictures"
    for call in (
        ("simulate", folder / "scenes.toml", "--camera", "mono", "-o", frames, "--pictures", pictures),
        ("train", frames, "--classes", folder / "classes.toml", "-o", table),
        ("simulate", folder / "scenes.toml", "--camera", "mono", "-o", folder / "unseen.h5", "--seed", 1),
    ):
        assert run([*map(str, call), "--quiet"]) == 0
    return folder


def test_the_usual_classes_learn_two_layers_of_colours_and_one_of_luminance(trained: Path) -> None:
    table = load(TransformTable, trained / "table.h5")
    assert len(table.later) == (table.outputs == ("X", "Y", "Z"))
    assert table.shows_grey


def test_pictures_and_videos_are_grey(trained: Path, tmp_path: Path, l3: L3) -> None:
    raw = sorted((trained / "pictures").glob("*_raw.tif"))
    for name in ("a.png", "a.jpg"):
        assert l3("render", trained / "table.h5", raw[0], "-o", tmp_path / name)[0] == 0
        picture = read_image(tmp_path / name)[0]
        assert np.ptp(picture) > 100
        assert (picture == picture[..., :1]).all()
    for name in ("a.mkv", "a.mp4"):
        assert l3("render", trained / "table.h5", *raw, "-o", tmp_path / name, "--fps", "25")[0] == 0
        with pyav().open(str(tmp_path / name)) as video:
            shown = np.array([frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]).astype(int)
        assert len(shown) == 2
        assert np.ptp(shown) > 100
        assert np.ptp(shown, axis=3).max() <= 1


def test_evaluation_compares_luminance(trained: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    files = trained / "table.h5", trained / "unseen.h5"
    code, out, _ = l3("evaluate", *files, "--json", *REFERENCE)
    assert code == 0
    document = json.loads(out)
    ours = document["mean"]["ours"]
    if document["outputs"] == ["Y"]:
        assert list(ours) == ["mean_error", "rmse", "psnr", "output_psnr", "ssim"]
        assert 0 < ours["mean_error"] <= ours["rmse"] < 0.2
        levels = document["by_class"]["level"]
        mean = np.average([each["ours"]["mean_error"] for each in levels], weights=[each["pixels"] for each in levels])
        assert mean == pytest.approx(ours["mean_error"])
        refused(2, "evaluate", *files, "--pictures", tmp_path / "pictures")
    else:
        assert ours["mottle"] in (None, pytest.approx(0, abs=1e-3))  # colours that no table could show are not missed
        assert l3("evaluate", *files, "--pictures", tmp_path / "pictures", *REFERENCE)[0] == 0
        for each in (tmp_path / "pictures").glob("*_ideal.png"):
            picture = read_image(each)[0].astype(int)
            assert np.ptp(picture, axis=2).max() <= 1
    assert l3("evaluate", *files, *REFERENCE)[0] == 0


def test_a_report_is_made(trained: Path, tmp_path: Path, l3: L3) -> None:
    assert l3("report", trained / "table.h5", trained / "unseen.h5", "-o", tmp_path / "report.html", *REFERENCE)[0] == 0
    text = (tmp_path / "report.html").read_text()
    grey = load(TransformTable, trained / "table.h5").outputs == ("Y",)
    assert ("Mean error (white is 1) over 2 frames: ours " if grey else "Mean ΔE00 over 2 frames: ours ") in text
    assert "angle (°)" not in text
