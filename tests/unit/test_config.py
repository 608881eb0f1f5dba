"""Recipes: every key typed, every mistake one line that names file, key and table."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import CameraRecipe, camera_files, load_camera, recipe_text
from l3cli.errors import InputFileError, RecipeError
from l3cli.io.curves import write_curves
from l3cli.recipes.toml import load_recipe, toml_key, toml_value
from l3cli.spectra.file import read_table
from tests.helpers.cameras import bayer_camera
from tests.helpers.paths import CONFIGS


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bits = 12\n", "", "missing key `bits` in [sensor]"),
        ("bits = 12", "bits = 12\nbitz = 3", "unknown key `bitz` in [sensor]"),
        ("bits = 12", 'bits = "twelve"', "Expected `int`, got `str` in [sensor.bits]"),
        ("bits = 12", "bits = ", "is not valid TOML"),
        ('name = "small Bayer"', "", "missing key `name` at the top level"),
        ('"g b"', '"g b b"', "rows of cfa.pattern must name equally many channels"),
        ('"g b"', '"g x"', "do not name the same channels"),
        ("wavelength_nm = [400, 700, 10]", "wavelength_nm = [700, 400, 10]", "first < last"),
        ("black_level_dn = 64", "black_level_dn = 5000", "black level 5000"),
        ("black_level_dn = 64", "black_dn = 64", 'unknown key `black_dn` in [sensor]; did you mean "black_level_dn"?'),
    ],
)
def test_a_wrong_recipe_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = bayer_camera()
    assert old in text
    path = tmp_path / "camera.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(RecipeError) as caught:
        load_camera(path)
    assert message in str(caught.value)
    assert str(path) in str(caught.value)


PHASE = 'name = "shifted"\nbase = "whole.toml"\nphase = [1, 0]\n'


def test_a_camera_recipe_is_another_one_from_another_pixel_on(tmp_path: Path) -> None:
    whole, path = tmp_path / "whole.toml", tmp_path / "camera.toml"
    whole.write_text(bayer_camera())
    path.write_text(PHASE)
    camera, base = load_camera(path), load_camera(whole)
    assert camera.name == "shifted"
    np.testing.assert_array_equal(camera.cfa, np.roll(base.cfa, -1, axis=0))
    np.testing.assert_array_equal(camera.responsivity, base.responsivity)
    assert camera_files(path) == [path, whole]
    assert recipe_text(path) == PHASE + "\n" + bayer_camera()
    path.write_text(PHASE.replace("[1, 0]", "[1, 1]"))
    np.testing.assert_array_equal(load_camera(path).cfa, np.roll(base.cfa, (-1, -1), axis=(0, 1)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[1, 0]", "[0, 2]", "phase is [0, 2], beyond the 2×2 array of"),
        ("[1, 0]", "[-1, 0]", "the least is 0"),
        ("phase = [1, 0]", "", "missing key `phase` at the top level"),
        ("phase", "bits = 3\nphase", "unknown key `bits` at the top level"),
        ("whole.toml", "camera.toml", "unknown key `base` at the top level"),
        ("whole.toml", "none.toml", "none.toml does not exist"),
    ],
)
def test_a_wrong_base_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    (tmp_path / "whole.toml").write_text(bayer_camera())
    (tmp_path / "camera.toml").write_text(PHASE.replace(old, new))
    with pytest.raises((RecipeError, InputFileError)) as caught:
        load_camera(tmp_path / "camera.toml")
    assert message in str(caught.value)


def test_a_recipe_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "camera.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputFileError, match="not a text file"):
        load_recipe(path, CameraRecipe)


def test_the_fiveband_recipe_is_the_camera_of_method_1_1() -> None:
    camera = load_camera(CONFIGS / "cameras/fiveband.toml")
    assert (camera.rows, camera.cols, camera.bits) == (1164, 2048, 12)
    names = np.array(camera.channels)[camera.cfa]
    assert [" ".join(row) for row in names] == ["b g c g", "g o g r", "c g b g", "g r g o"]
    assert np.bincount(camera.cfa.ravel()).tolist() == [2, 8, 2, 2, 2]
    assert camera.black_level / 4095 == pytest.approx(0.0266, abs=1e-4)
    peaks = camera.wavelength[camera.responsivity.argmax(axis=1)]
    assert np.abs(peaks - [615, 535, 440, 565, 515]).max() <= 10


def test_the_parametric_responsivities_meet_the_measured_ones(fiveband: CameraModel, l3_data: Path) -> None:
    import json

    published = json.loads((l3_data / "sensitivities/fiveband_camera.json").read_text())
    measured = np.array(published["filterSpectra_photon_relative"]).T
    measured = measured / measured.max()
    grid = np.array(published["wavelength_nm"], dtype=float)
    ours = np.array([np.interp(grid, fiveband.wavelength, curve) for curve in fiveband.responsivity])
    ours = ours / ours.max()
    assert np.sqrt(np.mean((ours - measured) ** 2, axis=1)).max() < 0.03
    assert np.sqrt(np.mean((ours - measured) ** 2)) < 0.017  # docs/method.md#five-band-prototype says about 1.4 %
    assert published["cfa_pattern_1based"] == (fiveband.cfa + 1).tolist()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wavelength,a\n400,1\n410,x\n", "not a row of numbers"),
        ("400,1\n400,2\n", "wavelengths must increase"),
        ("400,1\n410,nan\n", "wavelengths must increase and every value be a number"),
        ("400,1\n410\n", "equally many values"),
        ("400,1,2\n410,1,2\n", "holds 2 curves, 1 are wanted"),
        ("", "rows must be"),
    ],
)
def test_wrong_curves_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with pytest.raises(InputFileError, match=message):
        read_table(path).counted(1)


@pytest.mark.parametrize("name", ['a"\nb = 1', "\x7f\x1b[31m", "\\", "'", "a.b", "#", "ü漢\U0001f600", ""])
def test_any_name_is_written_so_that_it_is_read_again(name: str) -> None:
    text = f"{toml_key(name)} = {toml_value([name, {name: 1.5}])}\n"
    assert tomllib.loads(text) == {name: [name, {name: 1.5}]}


def test_bytes_that_are_no_text_are_replaced() -> None:
    assert toml_value("a\udcff").encode() == b'"a?"'


def test_names_of_curves_come_back_whatever_they_hold(tmp_path: Path) -> None:
    names = ("a,b", 'say "g"', "b")
    write_curves(tmp_path / "curves.csv", np.array([400.0, 500.0, 600.0]), np.eye(3), names)
    assert read_table(tmp_path / "curves.csv").names == names
