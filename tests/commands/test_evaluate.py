"""`l3 evaluate`: documented keys, pictures, bands, classes, and one line for each wrong call."""

import contextlib
import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet, open_training_set, write_training_set
from l3cli.classes.chroma import chroma_centres
from l3cli.classes.decide import label_mosaic
from l3cli.cli import run
from l3cli.evaluation.evaluation import ClassErrors, Evaluation
from l3cli.io.images import read_image
from tests.helpers.calls import L3, Refused

QUALITY = {
    "mean_delta_e",
    "median_delta_e",
    "p95_delta_e",
    "scielab",
    "mottle",
    "visual_noise",
    "psnr",
    "output_psnr",
    "ssim",
}


SCENES = """
exposure_share = [0.9, 0.1]
illuminants = ["D65", "A"]
[[scene]]
source = "dead leaves"
size = [48, 56]
count = 2
"""
CLASSES = "[classes]\npatch = 5\nlevels = 8\nchromas = 4\n[learning]\npatches = 4000\n"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, bayer_recipe: Path) -> Path:
    """A folder with training.h5 of a Bayer camera under two lights and two levels, and table.h5 learned from it."""
    folder = tmp_path_factory.mktemp("evaluate")
    (folder / "scenes.toml").write_text(SCENES)
    (folder / "classes.toml").write_text(CLASSES)
    _make(folder, bayer_recipe)
    return folder


def _make(folder: Path, camera: Path) -> None:
    for arguments in (
        ("simulate", folder / "scenes.toml", "--camera", camera, "-o", folder / "training.h5", "--quiet"),
        ("train", folder / "training.h5", "--classes", folder / "classes.toml", "-o", folder / "table.h5", "--quiet"),
    ):
        assert run([str(argument) for argument in arguments]) == 0


def rewritten(source: Path, path: Path, outputs: tuple[str, ...], frames: Callable[[TrainingFrame], TrainingFrame]) -> None:
    with open_training_set(source) as reader:
        head: TrainingSet = dataclasses.replace(reader.head, outputs=outputs)
        with write_training_set(path, head) as writer:
            for frame in reader:
                assert isinstance(frame, TrainingFrame)
                writer.append(frames(frame))


@pytest.fixture(scope="module")
def document(trained: Path) -> dict[str, Any]:
    """What an evaluation of the table prints; its pictures are in pictures/."""
    call = ["evaluate", trained / "table.h5", trained / "training.h5", "--json", "--pictures", trained / "pictures"]
    call += ["--backend", "reference"]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        assert run([*map(str, call), "--quiet"]) == 0
    assert err.getvalue() == ""
    found: dict[str, Any] = json.loads(out.getvalue())
    return found


def test_json_holds_the_keys_it_promises(trained: Path, document: dict[str, Any]) -> None:
    assert set(document) == {
        "format", "camera", "outputs", "viewing", "border", "pipelines", "frames", "mean", "better", "by_level",
        "by_illuminant", "by_gain", "by_patch", "by_band", "by_class", "worst_classes", "standards", "run",
    }  # fmt: skip
    assert (document["format"], document["viewing"], document["outputs"]) == (3, 50.0, ["X", "Y", "Z"])
    assert (document["border"], document["by_band"], document["by_gain"]) == (2, [], [])
    pipelines = document["pipelines"]
    assert pipelines[:2] == ["ours", "basic"]
    assert set(pipelines[2:]) in ({"malvar", "menon"}, set())
    with open_training_set(trained / "training.h5") as reader:
        assert len(document["frames"]) == len(reader)
    for frame in document["frames"]:
        assert set(frame) == {"scene", "illuminant", "luminance", "level", "exposure", "clipped", "shown", *pipelines}
        assert all(set(frame[name]) == QUALITY for name in pipelines)
    assert {group["illuminant"] for group in document["by_illuminant"]} == {"D65", "A"}
    for groups in (document["by_level"], document["by_illuminant"]):
        assert sum(group["frames"] for group in groups) == len(document["frames"])
        total = sum(group["frames"] * group["basic"]["scielab"] for group in groups) / len(document["frames"])
        assert total == pytest.approx(document["mean"]["basic"]["scielab"])
    for group in document["by_level"]:
        members = [f["ours"]["psnr"] for f in document["frames"] if group["from"] <= f["level"] < group["to"]]
        assert np.mean(members) == pytest.approx(group["ours"]["psnr"])
    counts = [sum(entry["pixels"] for entry in entries) for entries in document["by_class"].values()]
    chroma = sum(entry["pixels"] for entry in document["by_class"]["chroma"])
    assert counts[0] == counts[1] == counts[3] == len(document["frames"]) * 44 * 52
    assert chroma == next(entry["pixels"] for entry in document["by_class"]["saturation"] if entry["case"] == 0)
    levels = document["by_class"]["level"]
    mean = sum(entry["pixels"] * entry["ours"]["mean_delta_e"] for entry in levels) / counts[0]
    assert mean == pytest.approx(document["mean"]["ours"]["mean_delta_e"])
    worst = [entry["ours"]["mean_delta_e"] for entry in document["worst_classes"]]
    assert worst == sorted(worst, reverse=True)
    assert 1 <= len(worst) <= 10
    better = sum(f["ours"]["psnr"] > f["basic"]["psnr"] for f in document["frames"])
    assert document["better"]["basic"]["psnr"] == better > 0


def test_further_away_less_is_seen(trained: Path, document: dict[str, Any], l3: L3) -> None:
    files = (trained / "table.h5", trained / "training.h5", "--json", "--backend", "reference")
    close, far = document["mean"]["ours"], json.loads(l3("evaluate", *files, "--viewing", 120)[1])["mean"]["ours"]
    assert far["scielab"] < close["scielab"]
    assert far == close | {"scielab": far["scielab"]}


def test_pictures_of_every_frame(trained: Path, document: dict[str, Any], refused: Refused) -> None:
    folder = trained / "pictures"
    names = [*document["pipelines"], "ideal", "error"]
    assert len(list(folder.iterdir())) == len(document["frames"]) * len(names)
    shown = {name: read_image(next(folder.glob(f"00000_*_{name}.png")))[0].astype(float) for name in names}
    assert {picture.shape for picture in shown.values()} == {(48, 56, 3)}
    error = [np.mean((shown[name] / 255 - shown["ideal"] / 255)[2:-2, 2:-2] ** 2) for name in ("ours", "basic")]
    expected = [document["frames"][0][name]["psnr"] for name in ("ours", "basic")]
    assert -10 * np.log10(error) == pytest.approx(expected, abs=0.1)
    other = trained / "table.h5", trained / "training.h5", "--viewing", 60, "--quiet"  # not what has made them
    assert folder.name in refused(1, "evaluate", *other, "--pictures", folder)


BANDS = ("450 nm", "550 nm", "650 nm")


@pytest.fixture(scope="module")
def of_bands(trained: Path) -> tuple[Path, Path]:
    """The table and the frames as if their targets were three bands."""
    table, frames = trained / "bands_table.h5", trained / "bands.h5"
    rewritten(trained / "training.h5", frames, BANDS, lambda frame: frame)
    assert run(["train", str(frames), "--classes", str(trained / "classes.toml"), "-o", str(table), "--quiet"]) == 0
    return table, frames


def test_bands_are_judged_as_spectra(
    trained: Path, of_bands: tuple[Path, Path], l3: L3, refused: Refused, tmp_path: Path
) -> None:
    code, out, _ = l3("evaluate", *of_bands, "--json", "--backend", "reference")
    assert code == 0
    document = json.loads(out)
    assert document["pipelines"] == ["ours"]
    angles = {"mean_angle", "median_angle", "p95_angle", "gfc"}
    assert set(document["mean"]["ours"]) == angles | {"rmse", "psnr", "output_psnr", "ssim"}
    assert [entry["band"] for entry in document["by_band"]] == document["outputs"]
    assert 0 < document["mean"]["ours"]["mean_angle"] < 20
    assert l3("evaluate", *of_bands, "--backend", "reference")[0] == 0
    assert "450 nm, 550 nm, 650 nm" in refused(3, "evaluate", of_bands[0], trained / "training.h5")
    assert "450 nm, 550 nm, 650 nm" in refused(2, "evaluate", *of_bands, "--pictures", tmp_path / "pictures")


def test_black_areas_have_no_angle_and_no_class(trained: Path, of_bands: tuple[Path, Path], l3: L3, tmp_path: Path) -> None:
    def half_black(frame: TrainingFrame) -> TrainingFrame:
        return dataclasses.replace(frame, target=frame.target * (np.arange(frame.target.shape[2]) < 28))

    rewritten(trained / "training.h5", tmp_path / "black.h5", BANDS, half_black)
    code, out, _ = l3("evaluate", of_bands[0], tmp_path / "black.h5", "--border", "0", "--json", "--backend", "reference")
    assert code == 0
    document = json.loads(out)
    assert sum(entry["pixels"] for entry in document["by_class"]["level"]) == len(document["frames"]) * 48 * 28
    assert 0 < document["mean"]["ours"]["mean_angle"] < 20
    assert max(entry["ours"]["mean_angle"] for entry in document["by_class"]["contrast"]) < 20


BAND_SCENES = """
exposure_share = [0.9]
illuminants = ["A", "D65"]
sensor.noise = "none"
target.outputs = "camera"
[[scene]]
source = "dead leaves"
size = [64, 72]
"""


@pytest.mark.parametrize("relit", [False, True])
def test_bands_of_the_camera_have_baselines(relit: bool, bayer_recipe: Path, l3: L3, tmp_path: Path) -> None:
    light = 'target.illuminant = "FL2"\n' if relit else ""
    (tmp_path / "scenes.toml").write_text(light + BAND_SCENES)
    (tmp_path / "classes.toml").write_text(CLASSES)
    _make(tmp_path, bayer_recipe)
    files = ("evaluate", tmp_path / "table.h5", tmp_path / "training.h5", "--backend", "reference")
    document = json.loads(l3(*files, "--json")[1])
    assert document["pipelines"][1] == "bilinear"
    assert [entry["band"] for entry in document["by_band"]] == document["outputs"] == ["r", "g", "b"]
    for name in document["pipelines"]:
        assert document["mean"][name]["psnr"] > 15  # a wrong unit or balance gives less
        by_band = np.mean([entry[name]["ssim"] for entry in document["by_band"]])
        assert by_band == pytest.approx(document["mean"][name]["ssim"])
    narrow = json.loads(l3(*files, "--json", "--border", "20")[1])
    assert (narrow["border"], document["border"]) == (20, 2)
    assert sum(entry["pixels"] for entry in narrow["by_class"]["level"]) == 2 * 24 * 32


def test_wrong_calls_are_one_line(trained: Path, refused: Refused, l3: L3, tmp_path: Path) -> None:
    table, frames = trained / "table.h5", trained / "training.h5"
    five = load(TransformTable, table)
    save(dataclasses.replace(five, cfa=five.cfa[::-1], camera=None), tmp_path / "other.h5")
    with open_training_set(frames) as reader, write_training_set(tmp_path / "empty.h5", reader.head):
        pass

    def small(frame: TrainingFrame) -> TrainingFrame:
        corner = np.s_[..., :4, :40]
        parts = {name: getattr(frame, name)[corner] for name in ("electrons", "raw", "target")}
        return dataclasses.replace(frame, **parts)

    rewritten(frames, tmp_path / "small.h5", ("X", "Y", "Z"), small)
    assert "CFAs" in refused(3, "evaluate", tmp_path / "other.h5", frames)
    assert "empty.h5" in refused(3, "evaluate", table, tmp_path / "empty.h5")
    assert "4×40" in refused(3, "evaluate", table, tmp_path / "small.h5")
    code, out, err = l3("evaluate", table, frames, "--border", "24")
    assert (code, out) == (3, "")
    assert "(48×56 pixels) is too small for a border of 24 pixels" in err
    assert "--border" in refused(2, "evaluate", table, frames, "--border", "-1")
    assert "--viewing" in refused(2, "evaluate", table, frames, "--viewing", "0")
    assert "--backend" in refused(2, "evaluate", table, frames, "--backend", "abacus")


# ---------------------------------------------------------------------------------------------------- classes


def test_errors_are_counted_in_their_class(trained: Path) -> None:
    table = load(TransformTable, trained / "table.h5")
    with open_training_set(trained / "training.h5") as reader:
        frame = reader.frame(0)
    labels = label_mosaic(frame.raw, table.first.rule, table.cfa, len(table.channels))
    shape = (table.cfa.size, table.first.rule.levels, table.first.rule.contrasts, table.first.rule.kinds)
    _, level, contrast, kind = np.unravel_index(labels, shape)
    errors = ClassErrors(table, ("ours",))
    errors.add(labels, {"ours": level.astype(float)})
    for entry in errors.by_feature("mean_delta_e")["level"]:
        assert entry["ours"]["mean_delta_e"] == pytest.approx(entry["level"])
        assert entry["from"] < entry["to"]
        assert entry["pixels"] == (level == entry["level"]).sum()
    for entry in errors.by_feature("mean_delta_e")["contrast"]:
        assert entry["pixels"] == (contrast == entry["contrast"]).sum()
    for entry in errors.by_feature("mean_delta_e")["chroma"]:
        assert entry["pixels"] == (kind == entry["chroma"]).sum()
    centres = chroma_centres(table.first.rule)
    assert centres.shape == (4, 3)
    assert centres.sum(axis=1) == pytest.approx(np.ones(4), abs=0.01)


def test_an_evaluation_needs_no_file(trained: Path) -> None:
    table = load(TransformTable, trained / "table.h5")
    with open_training_set(trained / "training.h5") as reader:
        evaluation, frame = Evaluation(table, reader.head), reader.frame(0)
    labels = label_mosaic(frame.raw, table.first.rule, table.cfa, len(table.channels))
    perfect = frame.target * frame.exposure / table.output_unit
    planes = evaluation.planes(frame, perfect)
    evaluation.add(frame, planes, labels)
    assert planes["ours"] == pytest.approx(np.asarray(frame.target), rel=1e-5)
    document = evaluation.document()
    assert document["mean"]["ours"]["mean_delta_e"] < 1e-3
    assert document["better"]["basic"] == dict.fromkeys(QUALITY - {"mottle", "visual_noise"}, 1)  # it has no plain patches


def test_errors_are_laid_to_the_class_of_their_pixel(trained: Path) -> None:
    table = load(TransformTable, trained / "table.h5")
    with open_training_set(trained / "training.h5") as reader:
        evaluation, frame = Evaluation(table, reader.head), reader.frame(0)
    labels = label_mosaic(frame.raw, table.first.rule, table.cfa, len(table.channels))
    level = labels % table.first.rule.classes_per_site // (table.first.rule.contrasts * table.first.rule.kinds)
    spoilt = np.bincount(level[2:-2, 2:-2].ravel()).argmax()
    planes = frame.target * np.where(level == spoilt, 0.7, 1.0)
    evaluation.add(frame, evaluation.planes(frame, planes * frame.exposure / table.output_unit), labels)
    for entry in evaluation.document()["by_class"]["level"]:
        assert (entry["ours"]["mean_delta_e"] > 1) == (entry["level"] == spoilt)
