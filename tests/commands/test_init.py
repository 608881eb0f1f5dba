"""`l3 init`: created files, and a small picture from the folder of every camera recipe."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.training_set import open_training_set
from l3cli.evaluation.demosaic import interpolate
from l3cli.evaluation.quality import psnr
from l3cli.io.images import read_image
from l3cli.recipes.builtin import CLASSES, COMMON, known_benchmarks, known_recipes
from l3cli.recipes.load import load_recipe
from l3cli.training.recipe import TrainingRecipe
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS
from tests.helpers.recipes import SMALL

CAMERAS = known_recipes("cameras")
NAMES = sorted(CAMERAS)
BANDS = '\n[target]\noutputs = "camera"\n'
# A kind each: without filter, infrared, complements, two exposures, six by six; of sixteen bands all are judged below.
# `make soak` has the others.
KINDS = {"rgbir", "cmy", "quad_bayer_hdr"}


def array(name: str) -> np.ndarray:
    """The colour filter array of a recipe, as names of channels."""
    camera = load_camera(CAMERAS[name])
    return np.array(camera.channels)[camera.cfa]


def small_folder(name: str, folder: Path, l3: L3) -> Path:
    """The folder that l3 init makes, with small scenes and classes put in."""
    assert l3("init", name, folder)[0] == 0
    patch = "patch = 7" if name == "nona_bayer_hdr" else "patch = 5"  # which must reach every channel
    for recipe, text in SMALL.items():
        (folder / f"{recipe}.toml").write_text(text.replace("patch = 5", patch))
    return folder


def without_lights(recipe: str) -> str:
    """A recipe of a folder as the one that comes with l3, which is for one light."""
    kept = [line for line in recipe.splitlines(keepends=True) if not line.startswith("lights = ")]
    return "".join(kept).replace('illuminants = ["A", "D65"]', 'illuminants = ["D65"]')


# ------------------------------------------------------------------------------------------------------ l3 init


def test_without_arguments_the_recipes_are_listed(l3: L3) -> None:
    code, out, err = l3("init")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == [*NAMES, *known_benchmarks()]
    assert all(len(line) <= 120 and "…" not in line for line in out.splitlines())
    assert "l3 init bayer demo" in err


@pytest.mark.parametrize(("typo", "meant"), [("quadbayer", '"quad_bayer"'), ("X-Trans", '"xtrans"'), ("rgb-ir", '"rgbir"')])
def test_a_typo_brings_the_recipe_that_was_meant(typo: str, meant: str, refused: Refused, tmp_path: Path) -> None:
    assert meant in refused(2, "init", typo, tmp_path / "demo").partition("or")[0]


def test_wrong_calls(refused: Refused, tmp_path: Path, l3: L3) -> None:
    assert "zzz" in refused(2, "init", "zzz", tmp_path / "demo")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.toml").write_text("")
    assert "full" in refused(1, "init", "bayer", tmp_path / "full")
    assert l3("init", "bayer", tmp_path / "full", "--force")[0] == 0
    assert (tmp_path / "full/mine.toml").exists()
    assert "mine.toml" in refused(1, "init", "bayer", tmp_path / "full/mine.toml")


def test_a_folder_holds_the_recipes_as_they_are(tmp_path: Path, l3: L3) -> None:
    code, out, err = l3("init", "xtrans", tmp_path / "demo")
    assert (code, out) == (0, "")
    assert f"make -C {tmp_path}/demo" in err
    for name, source in {**COMMON, "camera.toml": "cameras/xtrans.toml"}.items():
        assert without_lights((tmp_path / "demo" / name).read_text()) == (CONFIGS / source).read_text()
    assert {path.name for path in (tmp_path / "demo").iterdir()} == {*COMMON, "camera.toml"}
    assert (tmp_path / "demo/slurm.sh").stat().st_mode & 0o777 == 0o755


def test_a_folder_trains_for_daylight_and_lamps(tmp_path: Path, l3: L3) -> None:
    (tmp_path / "own.toml").write_text(CAMERAS["bayer"].read_text())
    calls = [("rgbw",), ("from_curves",), ("--from", tmp_path / "own.toml"), ("arri_d21",)]
    for number, call in enumerate(calls):
        folder = tmp_path / str(number)
        assert l3("init", *call, folder)[0] == 0
        assert tomllib.loads((folder / "scenes.toml").read_text())["illuminants"] == ["A", "D65"]
        assert load_recipe(folder / "classes.toml", TrainingRecipe).learning.lights == ("A", "D65")


def test_a_camera_of_curves_needs_no_lab_and_states_where_they_go(tmp_path: Path, l3: L3) -> None:
    code, _, err = l3("init", "from_curves", tmp_path / "a camera")
    assert code == 0
    assert "next: put your curves into from_curves.csv" in err
    assert err.endswith(f"make -C '{tmp_path}/a camera'\n")
    assert "CAMERA ?= camera.toml\n" in (tmp_path / "a camera/Makefile").read_text()


def test_arrays_with_classes_of_their_own_get_them(tmp_path: Path, l3: L3) -> None:
    assert set(CLASSES) <= {path.stem for path in (CONFIGS / "cameras").glob("*.toml")}
    for camera in CLASSES:
        assert l3("init", camera, tmp_path / camera)[0] == 0
        made = (tmp_path / camera / "classes.toml").read_text()
        assert without_lights(made) == (CONFIGS / f"classes/{CLASSES[camera]}.toml").read_text()


def test_a_phase_comes_with_its_base(tmp_path: Path, l3: L3) -> None:
    code, _, err = l3("init", "bayer_bggr", tmp_path / "demo")
    assert code == 0
    assert "2×2, 3 channels   A Bayer array, BGGR" in err
    assert {path.name for path in (tmp_path / "demo").iterdir()} == {*COMMON, "camera.toml", "bayer.toml"}
    assert load_camera(tmp_path / "demo/camera.toml").name == "Bayer BGGR"


OWN = """name = "mine"
[sensor]
rows = 64
cols = 80
pixel_pitch_um = 3
bits = 12
black_level_dn = 95
[cfa]
channels = ["r", "g", "b"]
pattern = ["r g", "g b"]
[responsivity]
file = "../curves/mine.csv"
[noise]
well_capacity_e = 8000
[optics]
focal_length_mm = 8
f_number = 2
"""


@pytest.mark.parametrize("flag", [(), ("--from",)])
def test_a_recipe_of_ones_own_becomes_a_folder(flag: tuple[str, ...], tmp_path: Path, l3: L3) -> None:
    (tmp_path / "recipes").mkdir()
    (tmp_path / "curves").mkdir()
    rows = "\n".join(f"{nm},{nm / 4000},{nm / 3000},{nm / 5000}" for nm in range(380, 721, 10))
    (tmp_path / "curves/mine.csv").write_text(f"nm,r (e-/photon),g (e-/photon),b (e-/photon)\n{rows}\n")
    (tmp_path / "recipes/my_camera.toml").write_text(OWN)
    code, _, err = l3("init", *flag, tmp_path / "recipes/my_camera.toml", tmp_path / "demo")
    assert code == 0
    assert f"make -C {tmp_path}/demo" in err
    assert {path.name for path in (tmp_path / "demo").iterdir()} == {*COMMON, "camera.toml", "mine.csv"}
    assert "CAMERA ?= camera.toml\n" in (tmp_path / "demo/Makefile").read_text()
    made, own = (load_camera(tmp_path / each) for each in ("demo/camera.toml", "recipes/my_camera.toml"))
    np.testing.assert_array_equal(made.responsivity, own.responsivity)
    assert (made.gain, made.white_level) == ((4095 - 95) / 8000, 4095)


# ------------------------------------------------------------------------------------------------------- arrays


def test_the_bayer_recipes_are_the_phases_of_one_array() -> None:
    bayer = array("bayer")
    shifted = {
        "bayer_bggr": np.roll(bayer, 1, axis=0),
        "bayer_rggb": np.roll(bayer, 1, axis=1),
        "bayer_gbrg": np.roll(bayer, (1, 1), axis=(0, 1)),
    }
    for name, cfa in shifted.items():
        np.testing.assert_array_equal(array(name), cfa)
        np.testing.assert_array_equal(load_camera(CAMERAS[name]).responsivity, load_camera(CAMERAS["bayer"]).responsivity)
    np.testing.assert_array_equal(array("quad_bayer"), bayer.repeat(2, axis=0).repeat(2, axis=1))


# ----------------------------------------------------------------------------------------------- recipes at work


@pytest.mark.parametrize("name", [name if name in KINDS else pytest.param(name, marks=pytest.mark.soak) for name in NAMES])
def test_a_recipe_leads_to_a_better_picture_than_a_basic_pipeline(name: str, tmp_path: Path, l3: L3) -> None:
    folder = small_folder(name, tmp_path / "demo", l3)
    camera = ("--camera", folder / "camera.toml", "--quiet")
    assert l3("simulate", folder / "scenes.toml", *camera, "-o", folder / "training.h5")[0] == 0
    unseen = ("-o", folder / "unseen.h5", "--pictures", folder / "unseen")
    assert l3("simulate", folder / "unseen.toml", *camera, *unseen)[0] == 0
    classes = ("--classes", folder / "classes.toml", "--quiet")
    assert l3("train", folder / "training.h5", *classes, "-o", folder / "table.h5")[0] == 0
    raw = next((folder / "unseen").glob("*_raw.tif"))
    assert l3("render", folder / "table.h5", raw, "-o", folder / "picture.png", "--quiet")[0] == 0
    judged = ("evaluate", folder / "table.h5", folder / "unseen.h5", "--json", "--backend", "reference")
    figures = json.loads(l3(*judged)[1])["mean"]
    assert figures["ours"]["mean_delta_e"] < 0.95 * figures["basic"]["mean_delta_e"]
    assert figures["ours"]["psnr"] > figures["basic"]["psnr"] + 1.0
    picture, _ = read_image(folder / "picture.png")
    ideal, _ = read_image(next((folder / "unseen").glob("*_ideal.png")))
    assert psnr(picture / 255.0, ideal / 255.0) > 17.0


@pytest.mark.parametrize("name", [pytest.param("rgbir", marks=pytest.mark.soak), "snapshot16"])
def test_all_bands_come_out_better_than_interpolated(name: str, tmp_path: Path, l3: L3) -> None:
    folder = small_folder(name, tmp_path / "demo", l3)
    camera = ("--camera", folder / "camera.toml", "--quiet")
    assert 'outputs = "camera"' in (folder / "bands_scenes.toml").read_text()
    for scenes in ("scenes", "unseen"):
        (folder / f"{scenes}.toml").write_text(SMALL[scenes].replace("\n", BANDS, 1))
        assert l3("simulate", folder / f"{scenes}.toml", *camera, "-o", folder / f"{scenes}.h5")[0] == 0
    (folder / "classes.toml").write_text(
        SMALL["classes"].replace("levels = 6", "levels = 3").replace("chromas = 3", "chromas = 1")
    )
    classes = ("--classes", folder / "classes.toml", "--quiet")
    assert l3("train", folder / "scenes.h5", *classes, "-o", folder / "bands.h5")[0] == 0
    with open_training_set(folder / "unseen.h5") as reader:
        model, frame = reader.head.camera, reader.frame(0)
    np.save(folder / "raw.npy", frame.raw)
    assert l3("render", folder / "bands.h5", folder / "raw.npy", "-o", folder / "bands.exr", "--quiet")[0] == 0
    bands, _ = read_image(folder / "bands.exr")
    interpolated = interpolate(frame.raw - model.black_level, model.cfa)
    ours, basic = (fidelity(planes, frame.target) for planes in (np.moveaxis(bands, -1, 0), interpolated))
    assert ours.min() > basic.min()
    assert ours.mean() > basic.mean() + 1.0


def fidelity(planes: np.ndarray, target: np.ndarray) -> np.ndarray:
    """PSNR (band) of planes (band, row, col), each at the scale that brings it nearest to its target."""
    scaled = [plane * (plane * wanted).sum() / (plane**2).sum() for plane, wanted in zip(planes, target, strict=True)]
    peaks = np.percentile(target, 99, axis=(1, 2))
    return np.array([psnr(a / peak, b / peak) for a, b, peak in zip(scaled, target, peaks, strict=True)])
