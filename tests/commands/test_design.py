"""`l3 design`: the same bytes for any number of jobs and after an interruption, and one line for each wrong recipe."""

import contextlib
import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.design import Design, SceneMoments, Truth
from l3cli.artifacts.schema import equal
from l3cli.artifacts.store import load
from l3cli.design import error, task
from l3cli.design.task import BOUNDS
from l3cli.report.design import design_section
from l3cli.report.parts import Table
from l3cli.stages import design as stage
from tests.helpers.calls import L3, Refused
from tests.helpers.cameras import bayer_camera
from tests.helpers.recipes import FEW_CLASSES

SCENES = """
illuminants = ["D65", "A"]
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [40, 40]
count = 3
"""
DESIGN = """
name = "four"
[pixel]
camera = "camera.toml"
bare = "bare.csv"
[filters]
r = { channel = "r" }
g = { centre_nm = 535, sigma_nm = 40 }
b = { file = "blue.csv" }
w = {}
gb = { stack = ["g", "b"] }
[[pattern]]
shape = [2, 2]
filters = ["r", "g", "b", "w"]
[[pattern]]
shape = [2, 4]
counts = { g = 4, r = 2, b = 2 }
[[pattern]]
arrays = [["g r w r", "b g b g"]]
[[level]]
share = 0.9
[[level]]
illuminant = "A"
lux = 10
exposure_s = 0.02
"""


@pytest.fixture(autouse=True, scope="module")
def few_spectra() -> Iterator[None]:
    """Scenes have 5 and 3 principal spectra instead of 7 and 6, so that files of moments are a third as large."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(error, "KEPT_POWER", 0.999)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from l3cli.cli import run as command

    made = tmp_path_factory.mktemp("design")
    (made / "camera.toml").write_text(bayer_camera() + "[gain]\niso = 100\ngains = [8.0]\nread_noise_e = [2.5]\n")
    (made / "scenes.toml").write_text(SCENES)
    (made / "design.toml").write_text(DESIGN)
    (made / "bare.csv").write_text("nm,bare (e-/photon)\n380,0.5\n720,0.6\n")
    (made / "blue.csv").write_text("nm,b\n380,0.7\n440,0.9\n500,0.2\n560,0\n720,0\n")
    gathering = ["--camera", "design.toml", "--patches", "2000", "-o", "scenes.h5", "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        assert command(["design", "moments", "scenes.toml", *gathering]) == 0
        with contextlib.redirect_stdout(io.StringIO()) as shown:
            assert command(["design", "design.toml", "--moments", "scenes.h5", "-o", "design.h5", "--quiet"]) == 0
    (made / "shown.txt").write_text(shown.getvalue())
    return made


def test_a_run_that_goes_on_in_two_processes_makes_the_same_bytes(
    folder: Path, tmp_path: Path, l3: L3, refused: Refused, same_workers: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    call = ("design", "moments", "scenes.toml", "--camera", "design.toml", "--patches", 2000, "-o", tmp_path / "m.h5")
    saved: list[Path] = []
    write = stage.write_whole

    def stop(path: Path, content: bytes) -> None:
        if len(saved) == 4:
            raise KeyboardInterrupt
        saved.append(path)
        write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(stage, "write_whole", stop)
        assert l3(*call)[0] == 130
    assert len(list((tmp_path / "m.h5.parts").glob("*.npz"))) == 4
    assert "--resume" in refused(2, *call, "--resume", "--seed", 1)
    saved.clear()
    with monkeypatch.context() as patch:
        patch.setattr(stage, "write_whole", stop)
        assert l3(*call, "--resume", "--jobs", 2)[0] == 0
    assert [path.name for path in saved] == ["scenes-00001.npz", "scenes-00002.npz"]  # of three scenes two parts each
    assert (tmp_path / "m.h5").read_bytes() == (folder / "scenes.h5").read_bytes()
    ranking = ("design", "design.toml", "--moments", "scenes.h5", "-o", tmp_path / "d.h5", "--json", "--jobs", 2)
    code, out, err = l3(*ranking)
    assert code == 0, err
    assert (tmp_path / "d.h5").read_bytes() == (folder / "design.h5").read_bytes()
    assert json.loads(out)["arrays"][0]["array"] == load(Design, tmp_path / "d.h5").patterns[0]
    for finished, file in ((call, tmp_path / "m.h5"), (ranking, tmp_path / "d.h5")):  # again: nothing is left to do
        made = file.stat().st_mtime_ns
        code, _, err = l3(*finished, "--resume")
        assert (code, str(file) in err) == (0, True)
        assert file.stat().st_mtime_ns == made
        code, _, err = l3(*finished, "--resume", "--seed", 1)  # another run
        assert (code, str(file) in err) == (1, True)
    assert not list(tmp_path.glob("*.parts"))


def test_a_design_ranks_arrays_beside_bayer_of_their_filters(folder: Path, l3: L3) -> None:
    made = load(Design, folder / "design.h5")
    assert load(SceneMoments, folder / "scenes.h5").light[0].patches.size == len(made.groups) == 30
    assert made.levels == ("white at 0.9", "10 lx, 0.02 s A")
    assert (np.diff(np.log(made.score)) > -1e-8).all()
    assert "g r w r / b g b g" in made.patterns
    bayer = made.patterns[made.bayer]
    first, second = (row.split() for row in bayer.split(" / "))
    assert first[0] == second[1] or first[1] == second[0]
    assert len({*first, *second}) == 3
    assert "r b r b / g g g g" not in made.patterns  # of a shorter period
    place = made.patterns.index("g r w r / b g b g")
    assert (made.dyes[place] > 0).all()
    assert np.allclose(made.dyes[made.bayer], made.predicted[made.bayer])
    out = (folder / "shown.txt").read_text()
    assert "to Bayer" in out.splitlines()[2]
    assert f"{bayer} (Bayer)\n" in out
    assert made.verdict[0].startswith("white at 0.9: ")
    assert f"{bayer} (Bayer)" in made.verdict[0]
    assert made.verdict[0] in out
    assert l3("info", folder / "design.h5")[0] == 0
    code, out, _ = l3("check", folder / "design.toml")
    assert (code, "levels: white at 0.9; 10 lx, 0.02 s A" in out) == (0, True)


def test_a_design_keeps_the_best_of_each_level(
    folder: Path, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(task, "LISTED_ARRAYS", 1)
    call = ("design", folder / "design.toml", "--moments", folder / "scenes.h5", "-o", tmp_path / "d.h5")
    assert l3(*call)[0] == 0
    few, made = load(Design, tmp_path / "d.h5"), load(Design, folder / "design.h5")
    assert len(few.patterns) <= 1 + 1 + len(few.levels) < len(made.patterns)
    assert (np.diff(np.log(few.score)) > -1e-8).all()
    assert few.verdict == made.verdict


def test_filters_are_tuned_and_arrays_trained_on_the_same_scenes(
    folder: Path, tmp_path: Path, l3: L3, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = {"[180, 320]": "[80, 80]", "[160, 160]": "[48, 48]", "count = 24": "count = 2", "count = 2\n": "count = 1\n"}
    for name in ("EVALUATION_SCENES", "TRAINING_SCENES"):
        for old, new in small.items():
            monkeypatch.setattr(stage, name, getattr(stage, name).replace(old, new))
    monkeypatch.setattr(stage, "find_recipe", lambda name, kind: folder / "classes.toml")
    monkeypatch.setattr(stage, "TUNING_STARTS", 2)
    (folder / "classes.toml").write_text(FEW_CLASSES)
    recipe = folder / "truth.toml"
    pattern = DESIGN.index("[[pattern]]"), DESIGN.index("[[level]]")
    few = '[[pattern]]\narrays = [["g r", "b g"]]\n[optimise]\npattern = ["g r", "b g"]\n'
    recipe.write_text('rivals = [["g r", "r b"]]' + DESIGN[: pattern[0]] + few + DESIGN[pattern[1] :])
    code, out, err = l3("design", recipe, "--moments", folder / "scenes.h5", "-o", tmp_path / "d.h5", "--truth", 1)
    assert code == 0, err
    made = load(Design, tmp_path / "d.h5")
    tuned, trained = made.tuned, made.truth
    assert tuned is not None
    assert trained is not None
    assert tuned.tuned_filters == ("g",)  # the only Gaussian
    assert np.log(tuned.after).mean() < np.log(tuned.before).mean()
    assert ((tuned.parameters >= BOUNDS[:, 0]) & (tuned.parameters <= BOUNDS[:, 1])).all()
    assert trained.trained[0] == made.patterns[0]
    assert trained.trained[-3:] == ("g r / r b", "g r / b g", "g r / b g (tuned)")
    assert trained.measured.shape == (len(trained.trained), 2, 3)
    assert np.isfinite(trained.measured).all()
    assert trained.crops.shape == (len(trained.trained), 2, 72, 72, 3)
    assert 0 < np.abs(trained.crops - trained.ideals.astype(float)).mean() < 60
    assert -1 <= trained.correlation(0) <= 1
    assert "rank correlation" in out
    centre, sigma, peak = tuned.parameters[0]
    assert f"tuned filters of g r / b g: g {centre:.0f} nm σ {sigma:.0f} nm peak {peak:.2f}." in out
    page = tmp_path / "page.html"
    assert l3("report", tmp_path / "d.h5", "-o", page)[0] == 0
    text = page.read_text()
    for words in ("Design: four", "Error by exposure", "Error by group", "shifted by 5 nm", "tuned", "rank correlation"):
        assert words in text
    assert made.verdict[0].partition(";")[0] in text
    rows = re.findall(r"<t[dh][^>]*>(plain|edge|dark|bright|neutral|blue)</t[dh]>", text)
    assert rows[:4] == ["plain", "edge", "dark", "bright"]
    assert text.count("at 4×") == 2 * (1 + len(trained.trained))
    assert "trained arrays, evaluated on the same unseen scenes" in out


def test_the_best_array_becomes_a_folder_of_recipes(folder: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    made, mine = load(Design, folder / "design.h5"), tmp_path / "mine"
    code, _, err = l3("init", "--from", folder / "design.h5", mine)
    assert (code, f"{made.patterns[0]}, the best of {made.tried} CFAs in the design; next: make -C" in err) == (0, True)
    camera, pixel = load_camera(mine / "camera.toml"), load_camera(folder / "camera.toml")
    assert [[camera.channels[site] for site in row] for row in camera.cfa] == [
        row.split() for row in made.patterns[0].split(" / ")
    ]
    assert camera.absolute
    used = [made.filters.index(name) for name in camera.channels]
    np.testing.assert_allclose(camera.responsivity, made.efficiency[used], atol=1e-6)
    assert (camera.noise, camera.optics, camera.gain) == (pixel.noise, pixel.optics, pixel.gain)
    assert pixel.gains is not None
    assert equal(camera.gains, pixel.gains)
    assert "CAMERA ?= camera.toml" in (mine / "Makefile").read_text()
    assert str(mine) in refused(1, "init", "--from", folder / "design.h5", mine)
    assert "--from" in refused(2, "init", "--from", folder / "design.h5", "--from", folder / "design.h5", tmp_path / "a")
    assert "--phase" in refused(2, "init", "--from", folder / "design.h5", "--phase", "0,1", tmp_path / "a")
    assert "scenes.h5" in refused(3, "init", "--from", folder / "scenes.h5", tmp_path / "a")


def test_pairs_are_in_order_beyond_ties() -> None:
    crops, ideals = np.zeros((5, 1, 2, 2, 3), np.uint8), np.zeros((1, 2, 2, 3), np.uint8)
    measured = np.array([[[3.0, 31.0]], [[3.03, 30.95]], [[4.0, 28.0]], [[3.5, 29.0]], [[3.3, 29.6]]])
    expected = np.array([[1.0], [1.3], [2.0], [3.0], [3.01]])
    truth_of = Truth(tuple("abcde"), expected, ("mean_delta_e", "output_psnr"), measured, crops, ideals, "")
    # Ties: a and b as measured, d and e as predicted. c is exchanged with d and e.
    assert truth_of.in_order(0) == truth_of.in_order(0, 1) == 6 / 8
    assert truth_of.correlation(0) == truth_of.correlation(0, 1) == pytest.approx(0.6)
    (line,) = truth_of.agreement(["light"])
    assert line.endswith("by more than 2%): mean_delta_e 0.60 (75%), output_psnr 0.60 (75%).")
    assert replace(truth_of, trained=("a",), expected=expected[:1], measured=measured[:1], crops=crops[:1]).agreement(
        ["light"]
    ) == ["A single array cannot be ranked."]


def test_a_report_has_no_error_of_patches_that_a_light_does_not_show(folder: Path) -> None:
    made = load(Design, folder / "design.h5")
    share = made.share.copy()
    share[1, ["edge" in group for group in made.groups]] = 0
    section = design_section(replace(made, share=share), "d.h5", lambda picture, quality: b"")
    (table,) = next(part.blocks for part in section.parts if part.title == "Error by group of patches")
    assert isinstance(table, Table)
    (edge,) = (row for row in table.rows if row[0] == "edge")
    assert [each == "–" for each in edge[1:]] == [level == made.levels[1] for level in made.levels for _ in made.best(1)]


WRONG = """
    shape = [2, 2]                      | shape = [2, 9]                     | 2 | shape[2] is 9; use at most 8
    arrays = [["g r w r", "b g b g"]]   | arrays = [["g r", "r g"]]          | 2 | fewer than 3 independent outputs
    arrays = [["g r w r", "b g b g"]]   | arrays = [["g r", "b x"]]          | 2 | "x" is not a filter
    counts = { g = 4, r = 2, b = 2 }    | counts = { g = 4, r = 2 }          | 2 | the counts add up to 6, but
    counts = { g = 4, r = 2, b = 2 }    | counts = { g = 4, r = 4 }          | 2 | fewer than 3 independent outputs
    g = { centre_nm = 535, sigma_nm = 40 } | g = { centre_nm = 535 }         | 2 | set both centre_nm and sigma_nm
    g = { centre_nm = 535, sigma_nm = 40 } | g = { centre_nm = 900, sigma_nm = 9, floor = 0 } | 2 | filter g is opaque
    r = { channel = "r" }               | "r\\tx" = {}                       | 2 | contains a blank or a slash
    r = { channel = "r" }               | r = { channel = "q" }              | 2 | channel "q" does not exist
    r = { channel = "r" }               | r = { stack = ["g", "gb"] }        | 2 | stack contains gb
    [[level]]                           | [optimise]; pattern = ["r b"]; [[level]] | 2 | contains no Gaussian filter
    name = "four"                       | name = "four"; rivals = [["r x"]]  | 2 | "x" is not a filter
    lux = 10                            | lux = 1e9                          | 2 | clip behind every filter
    lux = 10                            | luminance_cd_m2 = 1; lux = 10      | 2 | luminance_cd_m2 and lux exclude each other
    illuminant = "A"                    | illuminant = "F2"                  | 2 | needs scene moments for the illuminant F2
    share = 0.9                         | name = "x"                         | 2 | needs either share
    bare = "bare.csv"                   | bare = 1.5                         | 2 | between 0 and 1
    bare = "bare.csv"                   | pitch_um = 2.0                     | 3 | run "l3 design moments" with --camera
    file = "blue.csv"                   | file = "none.csv"                  | 3 | none.csv
"""


@pytest.mark.parametrize("line", [line for line in WRONG.splitlines() if line.strip()])
def test_wrong_designs_are_refused(line: str, folder: Path, tmp_path: Path, refused: Refused) -> None:
    old, new, code, words = (part.strip() for part in line.split("|"))
    assert old in DESIGN
    recipe = folder / "wrong.toml"
    recipe.write_text(DESIGN.replace(old, new.replace("; ", "\n"), 1))
    call = ("design", recipe, "--moments", folder / "scenes.h5", "-o", tmp_path / "d.h5")
    assert words in refused(int(code), *call)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('["D65", "A"]', '["D65", "scene"]', "scene"),
        ("[[scene]]", "[lens]\ntransmittance = 0.9\n[[scene]]", "lens.transmittance"),
    ],
)
def test_wrong_moments_are_refused(old: str, new: str, words: str, folder: Path, tmp_path: Path, refused: Refused) -> None:
    recipe = folder / "wrong_scenes.toml"
    recipe.write_text(SCENES.replace(old, new))
    assert words in refused(2, "design", "moments", recipe, "--camera", "bayer", "-o", tmp_path / "m.h5")
    assert "--moments" in refused(2, "design", folder / "design.toml", "-o", tmp_path / "d.h5")
