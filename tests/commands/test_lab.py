"""The virtual lab writes captures as a real lab would store them."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.cli import run
from l3cli.io.frames import read_frame
from l3cli.recipes.load import load_recipe
from l3cli.simulation.lab import LabRecipe, MonoRecipe, plan, take
from l3cli.simulation.sensor import DefectRecipe, defects_of, fixed_pattern
from l3cli.spectra.file import read_table
from tests.helpers import stages
from tests.helpers.calls import L3, Refused
from tests.helpers.paths import CONFIGS, contents

QUICK = f"lamp_drift = 0.0\nmonitor_error = 0.0\nwavelength_error_nm = 0.0\nfalloff = 0.0\n{stages.QUICK}"


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recipe") / "quick.toml"
    path.write_text(QUICK)
    return path


@pytest.fixture(scope="module")
def folder(bayer_recipe: Path, quick: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("lab") / "new/lab"
    assert run(["lab", str(bayer_recipe), "-o", str(path), "--recipe", str(quick), "--quiet"]) == 0
    return path


def test_every_named_file_is_there_and_no_other(folder: Path, bayer: CameraModel) -> None:
    text = tomllib.loads((folder / "MEASUREMENTS.toml").read_text())
    captures = [capture for kind in ("mono", "chart", "white", "dark") for capture in text[kind]]
    frames = {name for capture in captures for name in capture["frames"]}
    spectra = {capture["spectrum"] for capture in text["mono"]} | {capture["radiance"] for capture in text["chart"]}
    assert frames | spectra | {"MEASUREMENTS.toml"} == set(contents(folder))
    for name in frames:
        assert read_frame(folder / name, (bayer.rows, bayer.cols), bayer.bits).std() > 0
        assert not re.search(rb"\d{4}:\d\d:\d\d \d\d:\d\d", (folder / name).read_bytes())  # no clock
    assert text["cfa"] == {"channels": ["r", "g", "b"], "pattern": ["r g", "g b"]}
    assert text["sensor"] == {"rows": 192, "cols": 256, "pixel_pitch_um": 4.0, "bits": 12}
    assert text["optics"]["focal_length_mm"] == 25


def test_exposures_put_the_brightest_channel_at_half_scale(folder: Path, bayer: CameraModel) -> None:
    text = tomllib.loads((folder / "MEASUREMENTS.toml").read_text())
    half = bayer.black_level + 0.5 * (bayer.white_level - bayer.black_level)
    for capture in (text["chart"][0], text["mono"][0]):
        frame = read_frame(folder / capture["frames"][0], (bayer.rows, bayer.cols), bayer.bits)
        channels = [frame[0::2, 0::2], frame[0::2, 1::2], frame[1::2, 1::2]]
        brightest = max(float(np.percentile(channel, 99)) for channel in channels)
        assert half * 0.95 < brightest < half * 1.15
    saturated = read_frame(folder / text["white"][-1]["frames"][0], (bayer.rows, bayer.cols), bayer.bits)
    assert np.median(saturated[0::2, 1::2]) == bayer.white_level


def test_a_patch_has_the_value_that_its_measured_radiance_states(folder: Path, bayer: CameraModel) -> None:
    """The camera equation written out by hand for patch 22 (neutral 5) under A, in the channel g."""
    chart = tomllib.loads((folder / "MEASUREMENTS.toml").read_text())["chart"][0]
    spectra = read_table(folder / chart["radiance"]).counted(24)
    wavelength, radiance = spectra.wavelength, spectra.values
    (left, top), _, (right, bottom), _ = chart["corners"]
    col, row = round(left + (right - left) * 3.5 / 6), round(top + (bottom - top) * 3.5 / 4)
    frame = read_frame(folder / chart["frames"][0], (bayer.rows, bayer.cols), bayer.bits)
    core = frame[row - row % 2 - 8 : row + 8, col - col % 2 - 8 : col + 8].astype(float)
    sight = np.pi / (4 * 2.8**2 + 1) * (4e-6) ** 2 * chart["exposure_s"]
    efficiency = np.interp(wavelength, bayer.wavelength, bayer.responsivity[1], left=0, right=0)
    electrons = sight * np.sum(efficiency * radiance[21]) * (wavelength[1] - wavelength[0])
    measured = np.mean([core[0::2, 1::2].mean(), core[1::2, 0::2].mean()]) - bayer.black_level
    assert measured == pytest.approx(bayer.gain * electrons, rel=0.01)  # ~130 pixels of ~1000 e-: 0.3 %


@pytest.mark.usefixtures("same_workers")
def test_same_seed_same_bytes_whatever_the_jobs(
    folder: Path, bayer_recipe: Path, quick: Path, tmp_path: Path, l3: L3
) -> None:
    code, out, _ = l3("lab", bayer_recipe, "-o", tmp_path / "a", "--recipe", quick, "--jobs", 2)
    assert (code, out) == (0, "")
    assert contents(tmp_path / "a") == contents(folder)
    assert l3("lab", bayer_recipe, "-o", tmp_path / "b", "--recipe", quick, "--seed", 1)[0] == 0
    other = contents(tmp_path / "b")
    assert other["MEASUREMENTS.toml"] == contents(folder)["MEASUREMENTS.toml"]
    frames = [name for name in other if name.endswith(".tif")]
    assert all(other[name] != contents(folder)[name] for name in frames)


def test_drift_separates_light_from_its_spectrum(bayer: CameraModel) -> None:
    still, drifting = LabRecipe(lamp_drift=0.0), LabRecipe(lamp_drift=0.1)
    pairs = zip(plan(bayer, still, 0), plan(bayer, drifting, 0), strict=True)
    ratios = np.array([b.electrons.max() / a.electrons.max() for a, b in pairs if a.kind == "mono"])
    assert 0.05 < ratios.std() < 0.2
    same = [
        np.array_equal(a.radiance, b.radiance) for a, b in zip(plan(bayer, still, 0), plan(bayer, drifting, 0), strict=True)
    ]
    assert all(same)


def test_the_default_recipe_is_the_built_in_one() -> None:
    assert load_recipe(CONFIGS / "lab/default.toml", LabRecipe) == LabRecipe()


def test_a_sweep_of_too_few_steps_is_refused(bayer_recipe: Path, tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "lab.toml").write_text("[mono]\nfirst_nm = 690")
    assert "mono" in refused(2, "lab", bayer_recipe, "-o", tmp_path / "lab", "--recipe", tmp_path / "lab.toml")


def test_a_sensor_too_small_for_a_chart_is_refused(bayer_recipe: Path, tmp_path: Path, refused: Refused) -> None:
    tiny = tmp_path / "tiny.toml"
    tiny.write_text(bayer_recipe.read_text().replace("rows = 192", "rows = 32"))
    assert "32×256" in refused(2, "lab", tiny, "-o", tmp_path / "lab")


def test_hot_and_dead_pixels_and_dust_are_where_the_recipe_states(bayer: CameraModel) -> None:
    recipe = DefectRecipe(hot_pixels_per_million=200.0, dead_pixels_per_million=200.0, dust_specks_per_million=60.0)
    defects = defects_of(bayer, recipe)
    assert len(defects.hot) == len(defects.dead) == 10
    assert defects.shade.min() < 0.98
    captures = plan(bayer, LabRecipe(falloff=0.0), seed=0)
    cap = next(capture for capture in captures if capture.kind == "dark" and capture.exposure > 0.4)
    white = next(capture for capture in captures if capture.kind == "white")
    dark, lit = take(bayer, cap, 0, 0, recipe).astype(float), take(bayer, white, 0, 0, recipe).astype(float)
    assert (dark[tuple(defects.hot.T)] > np.percentile(dark, 99.9)).all()
    assert lit[tuple(defects.dead.T)].max() < bayer.black_level + 10


def test_frames_of_the_lab_have_the_fixed_offsets_of_the_camera(bayer: CameraModel) -> None:
    striped = replace(bayer, noise=replace(bayer.noise, column_noise=3.0, row_noise=2.0))
    cap = next(capture for capture in plan(striped, LabRecipe(), seed=0) if capture.kind == "dark")
    recipe = DefectRecipe(hot_pixels_per_million=0.0)
    mean = np.mean([take(striped, cap, trial, 0, recipe) for trial in range(6)], axis=0) / bayer.gain
    pattern = fixed_pattern(striped).dsnu
    for axis, deviation in ((0, 3.0), (1, 2.0)):
        offsets = mean.mean(axis=axis) - mean.mean()
        assert np.corrcoef(offsets, pattern.mean(axis=axis))[0, 1] > 0.97
        assert offsets.std() == pytest.approx(deviation, rel=0.15)


def test_the_monitor_follows_the_lamp_and_the_scale_is_off_by_one_error(bayer: CameraModel) -> None:
    still = plan(bayer, LabRecipe(lamp_drift=0.0, monitor_error=0.0, wavelength_error_nm=0.0), 3)
    session = plan(bayer, LabRecipe(lamp_drift=0.05, monitor_error=0.001, wavelength_error_nm=0.5), 3)
    light = np.array(
        [b.electrons.max() / a.electrons.max() for a, b in zip(still, session, strict=True) if a.kind != "dark"]
    )
    reading = np.array([capture.monitor for capture in session if capture.kind != "dark"])
    assert 0.02 < light.std() < 0.08
    assert 0.0005 < (reading / light).std() < 0.002
    shifts = {float(np.round(b.wavelength[0] - a.wavelength[0], 9)) for a, b in zip(still, session, strict=True)}
    assert len(shifts) == 1
    assert 0 < abs(shifts.pop()) < 1.5


def test_stray_light_is_in_the_measured_spectrum(bayer: CameraModel) -> None:
    captures = plan(bayer, LabRecipe(mono=MonoRecipe(stray_light=0.001)), 0)
    step = next(capture for capture in captures if capture.kind == "mono")
    spectrum = step.radiance[0] / step.radiance[0].max()
    assert spectrum.min() == pytest.approx(0.001, rel=1e-2)
    assert np.median(spectrum) == pytest.approx(0.001, rel=1e-2)
    assert 0.02 < np.sort(spectrum)[:-19].sum() / spectrum.sum() < 0.05  # one per mille everywhere is much of the power


def test_steps_taken_too_long_saturate(folder: Path, bayer: CameraModel) -> None:
    (name,) = (path for path in (folder / "mono").iterdir() if "too-long" in path.name)
    frame = read_frame(name, (bayer.rows, bayer.cols), bayer.bits)
    assert max(np.median(site) for site in (frame[0::2, 0::2], frame[0::2, 1::2], frame[1::2, 1::2])) == bayer.white_level
