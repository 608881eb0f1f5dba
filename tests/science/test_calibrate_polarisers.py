"""Frames behind a rotating polariser yield the angle, the extinction ratio and the gain of each channel."""

import csv
import json
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel, Polarisers
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.store import load
from l3cli.calibration.captures import measure_polarisers
from l3cli.calibration.model import from_data_sheet
from l3cli.calibration.polarisers import fit_polarisers
from l3cli.cli import run
from l3cli.errors import InputFileError
from l3cli.frames.measurement import (
    LEAKAGE_NM,
    Body,
    FinishedCurves,
    Measurements,
    PolariserCapture,
    Rotator,
    SensorFigures,
)
from l3cli.io.measurements import read_measurements
from l3cli.physics.stokes import angle_difference, malus
from l3cli.recipes.builtin import find_recipe
from tests.helpers.calls import L3, Refused

LIGHT = np.arange(0.0, 180.0, 15.0)  # degrees
ANGLES = np.array([91.2, 44.5, 134.7, 179.8])
LEAKAGE = 1 / np.array([300.0, 250.0, 400.0, 350.0])
GAIN = np.array([1.0, 1.1, 0.95, 1.02])
LAB = """
[mono]
step_nm = 60
bandwidth_nm = 20
overexposed = 0
[chart]
illuminants = ["D65", "A"]
[white]
levels = [0.2, 0.6, 1.5]
trials = 2
[dark]
exposures_s = [0.01, 0.5]
trials = 2
"""


# -------------------------------------------------------------------------------------------------------- the fit


@pytest.mark.parametrize("light_polarisation", [1.0, 0.95])
def test_drifting_and_polarised_lamps_do_no_harm(light_polarisation: float) -> None:
    """The true values lie within the stated errors, though the lamp drifts by 2 % and is polarised by 5 % itself."""
    off = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        lamp = 1 + 0.02 * rng.standard_normal(LIGHT.size) + 0.05 * np.cos(2 * np.radians(LIGHT - 20))
        turned = LIGHT + 0.05 * rng.standard_normal(LIGHT.size)
        rate = 1e5 * lamp[:, None] * malus(turned, GAIN, ANGLES, LEAKAGE, light_polarisation)
        deviation = np.sqrt(rate / 5000)
        rate += deviation * rng.standard_normal(rate.shape)
        fit = fit_polarisers(LIGHT, rate, deviation, np.ones(4, bool), light_polarisation, light_angle_error=0.05)
        assert np.abs(angle_difference(fit.angle, ANGLES)).max() < 0.1
        assert np.abs(fit.leakage / LEAKAGE - 1).max() < 0.05
        assert np.corrcoef(fit.brightness, lamp)[0, 1] > 0.999
        off += [angle_difference(fit.angle, ANGLES) / fit.angle_error, (fit.leakage - LEAKAGE) / fit.leakage_error]
        off += [(fit.gain - GAIN / GAIN.mean()) / fit.gain_error]
    assert 0.6 < np.std(off) < 1.3
    assert np.abs(off).max() < 4.5


def test_channels_without_polarisers_and_saturated_captures() -> None:
    angles, leakage = np.array([0.0, 60.0, 0.0]), np.array([0.01, 0.02, 1.0])
    gain = np.array([1.0, 1.0, 0.5])
    rate = 1e5 * malus(LIGHT, gain, angles, leakage, 1.0)
    deviation = np.full(rate.shape, 1.0)
    clipped = rate > 0.9e5
    fit = fit_polarisers(LIGHT, np.where(clipped, 0.5e5, rate), np.where(clipped, np.inf, deviation), leakage < 1)
    np.testing.assert_allclose(fit.angle[:2], angles[:2], atol=1e-6)
    np.testing.assert_allclose(fit.leakage, leakage, atol=1e-8)
    np.testing.assert_allclose(fit.gain, gain / gain.mean(), atol=1e-8)
    assert (fit.angle_error[2], fit.leakage_error[2]) == (0.0, 0.0)


# ------------------------------------------------------------------------------------------------------- the captures


def captured(body: Body, light: np.ndarray, stated: np.ndarray | None = None, polarisation: float = 1.0) -> Measurements:
    """Noise-free frames of a camera with ANGLES and LEAKAGE at a black level of 100 DN."""
    signal = 100 + 3000 * malus(light, GAIN, ANGLES, LEAKAGE, polarisation)
    sites = body.cfa[np.indices((body.rows, body.cols))[0] % 2, np.indices((body.rows, body.cols))[1] % 2]
    dither = np.random.default_rng(1).random((body.rows, body.cols))
    captures = tuple(
        PolariserCapture(f"{angle:g}deg.tif", 0.01, [(values[sites] + dither).astype(np.uint16)], angle=angle)
        for angle, values in zip((light if stated is None else stated).tolist(), signal, strict=True)
    )
    return Measurements(body=body, polariser=captures, rotator=Rotator(angle_error=0.1))


@pytest.fixture(scope="module")
def recipe_camera() -> CameraModel:
    return load_camera(find_recipe("polarised", "cameras"))


@pytest.fixture(scope="module")
def figures(recipe_camera: CameraModel) -> SensorFigures:
    return SensorFigures(0.38, 100.0, 4095.0, recipe_camera.noise)


@pytest.fixture(scope="module")
def body(recipe_camera: CameraModel) -> Body:
    """A small camera whose array is p90 p45 / p135 p0. Its angles are not stated."""
    geometry = (16, 24, 3.45e-6, 12)
    return Body("polarised", *geometry, recipe_camera.channels, recipe_camera.cfa, recipe_camera.optics)


def test_angles_are_found_without_stated_angles(body: Body, figures: SensorFigures) -> None:
    fit = measure_polarisers(captured(body, LIGHT), figures)
    assert fit is not None
    assert fit.polarised.all()
    assert np.abs(angle_difference(fit.angle, ANGLES)).max() < 0.05
    assert np.abs(fit.leakage - LEAKAGE).max() < 2e-4
    assert measure_polarisers(replace(captured(body, LIGHT), polariser=()), figures) is None


def test_a_reference_channel_sets_the_zero_of_the_scale(
    body: Body, figures: SensorFigures, recipe_camera: CameraModel
) -> None:
    known = replace(body, polarisers=recipe_camera.polarisers)
    measured = captured(known, LIGHT, LIGHT + 27.0)
    fit = measure_polarisers(replace(measured, rotator=Rotator(angle_error=0.1, reference="p90")), figures)
    assert fit is not None
    np.testing.assert_allclose(angle_difference(fit.angle, ANGLES - 1.2), 0.0, atol=0.05)
    assert fit.angle_error[0] == 0.0
    with pytest.raises(InputFileError, match="27°"):
        measure_polarisers(measured, figures)
    for unknown in (replace(measured, body=body), replace(measured, rotator=Rotator(reference="p1"))):
        reference = unknown.rotator.reference or "p90"
        with pytest.raises(InputFileError, match=f'"{reference}"'):
            measure_polarisers(replace(unknown, rotator=Rotator(angle_error=0.1, reference=reference)), figures)


def test_captures_that_contradict_are_refused(body: Body, figures: SensorFigures) -> None:
    wrong = LIGHT.copy()
    wrong[4] += 10.0
    with pytest.raises(InputFileError, match=r"^70deg\.tif"):
        measure_polarisers(captured(body, LIGHT, wrong), figures)
    with pytest.raises(InputFileError, match="p90 from captures with 2 usable angles"):
        measure_polarisers(captured(body, np.array([0.0, 90.0, 180.0])), figures)
    with pytest.raises(InputFileError, match="p90 from captures with 3 usable angles"):
        measure_polarisers(captured(body, np.array([0.0, 5.0, 10.0])), figures)
    with pytest.raises(InputFileError, match=r"p90 .* 9\.\d%"):
        measure_polarisers(captured(body, LIGHT, polarisation=0.1), figures)


@pytest.mark.parametrize(
    ("stated", "named", "cure"),
    [
        ([90.0, 45.0, 135.0, 0.0], [], ""),
        ([45.0, 90.0, 135.0, 0.0], ["p90", "p45"], ""),
        ([90.0, 0.0, 135.0, 45.0], ["p45", "p0"], ""),
        ([90.0, 135.0, 45.0, 0.0], ["p45", "p135"], "counter-clockwise"),
        ([135.0, 90.0, 0.0, 45.0], ["p90", "p45", "p135", "p0"], "135°"),
    ],
)
def test_swapped_polarisers_are_named(
    stated: list[float], named: list[str], cure: str, body: Body, figures: SensorFigures, recipe_camera: CameraModel
) -> None:
    assert recipe_camera.polarisers is not None
    polarisers = replace(recipe_camera.polarisers, polariser_deg=np.array(stated))
    measured = captured(replace(body, polarisers=polarisers), LIGHT)
    if not named:
        assert measure_polarisers(measured, figures) is not None
        return
    with pytest.raises(InputFileError) as refusal:
        measure_polarisers(measured, figures)
    line = str(refusal.value)
    assert [name for name in body.channels if f"{name} has" in line] == named
    assert cure in line
    assert ("angle_deg" in line) == bool(cure)


@pytest.mark.parametrize("captures", [0, LIGHT.size])
def test_responsivities_are_those_along_the_axis(
    captures: int, body: Body, figures: SensorFigures, recipe_camera: CameraModel
) -> None:
    """Curves describe unpolarised light. Without captures, the polarisers are as stated."""
    stated = Polarisers(np.array([90.0, 45.0, 135.0, 0.0]), np.full((4, LEAKAGE_NM.size), 0.25))
    curves = FinishedCurves(np.arange(400.0, 701.0, 10.0), np.outer([1.0, 0.9, 1.0, 0.8], np.linspace(0.5, 1.0, 31)))
    measured = captured(replace(body, polarisers=stated), LIGHT)
    camera = from_data_sheet(replace(measured, polariser=measured.polariser[:captures], curve=curves), figures)
    assert camera.polarisers is not None
    angles, leakage = (ANGLES, LEAKAGE) if captures else (stated.polariser_deg, np.full(4, 0.25))
    np.testing.assert_allclose(angle_difference(camera.polarisers.polariser_deg, angles), 0.0, atol=0.1)
    np.testing.assert_allclose(camera.polarisers.leakage, np.repeat(leakage[:, None], 31, axis=1), atol=2e-4)
    passed = camera.responsivity * camera.stokes_response[:, 0]
    np.testing.assert_allclose(passed / passed.max(), curves.responsivity, rtol=1e-12)
    assert camera.responsivity.max() == 1.0
    assert (camera.fit is not None and camera.fit.polarisers is not None) == bool(captures)


# ------------------------------------------------------------------------------------------------------- the commands


def with_angles(recipe: str, angles: list[float]) -> str:
    """The recipe with other angles of p90, p45, p135 and p0, in this order."""
    each = iter(angles)
    return re.sub(r"(?<=polariser_deg = )[\d.]+", lambda _: f"{next(each)}", recipe)


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recipe of a small camera whose polarisers differ from their nominal angles, as a sensor's do."""
    folder, source = tmp_path_factory.mktemp("unit"), find_recipe("polarised", "cameras")
    text = source.read_text().replace("rows = 2048", "rows = 64").replace("cols = 2448", "cols = 96")
    (folder / "nominal.toml").write_text(text)
    (folder / "camera.toml").write_text(with_angles(text, ANGLES.tolist()))
    shutil.copy(source.parent / "polarised_extinction.csv", folder)
    (folder / "lab.toml").write_text(LAB)
    return folder


@pytest.fixture(scope="module")
def lab(unit: Path) -> Path:
    command = ["lab", str(unit / "camera.toml"), "--recipe", str(unit / "lab.toml"), "-o", str(unit / "lab"), "--quiet"]
    assert run(command) == 0
    return unit / "lab"


def test_a_camera_measured_in_the_lab(unit: Path, lab: Path, tmp_path: Path, l3: L3) -> None:
    """Angles within 0.1°, extinction ratios within 5 %, and the responsivity along the axis of the polariser."""
    camera = tmp_path / "camera.h5"
    command = ("calibrate", lab / "MEASUREMENTS.toml", "-o", camera, "--truth", unit / "camera.toml", "--json")
    code, out, _ = l3(*command, "--accept")
    assert code == 0
    for row in json.loads(out)["truth"]["channels"].values():
        assert abs(row["polariser error (°)"]) < 0.1
        assert abs(row["extinction error (%)"]) < 5.0
        assert abs(row["gain alpha·r error (%)"]) < 1.0
    made = load(CameraModel, camera)
    assert made.polarisers is not None
    assert made.fit is not None
    assert made.fit.polarisers is not None
    assert l3("report", camera, "-o", tmp_path / "report.html")[0] == 0
    assert "Signals behind a rotating polariser" in (tmp_path / "report.html").read_text()
    assert l3("export", camera, "-o", tmp_path / "profiles")[0] == 0
    with (tmp_path / "profiles/datasheet.csv").open() as stream:
        rows = {(row["quantity"], row["channel"]): row for row in csv.DictReader(stream)}
    assert abs(float(rows["polariser angle", "p45"]["value"]) - 44.5) < 0.1
    assert float(rows["extinction ratio", "p45"]["value"]) == pytest.approx(1 / made.fit.polarisers.leakage[1])
    assert rows["95 % band of the angle", "p45"]["source"] == "measured"
    np.testing.assert_allclose(made.polarisers.leakage, made.fit.polarisers.leakage[:, None].repeat(made.wavelength.size, 1))


def test_a_check_finds_swapped_polarisers(unit: Path, lab: Path, tmp_path: Path, l3: L3, refused: Refused) -> None:
    text = (lab / "MEASUREMENTS.toml").read_text()
    (lab / "swapped.toml").write_text(text.replace('["p90 p45", "p135 p0"]', '["p0 p45", "p135 p90"]'))
    assert l3("check", lab / "swapped.toml")[0] == 3
    assert "p90 has 179.8° instead of 91°" in l3("check", lab / "swapped.toml")[1]
    assert "p0 has 91.2°" in refused(3, "calibrate", lab / "swapped.toml", "-o", tmp_path / "new.h5")

    # Without angles in the measurement file, the recipe in the same folder states them.
    silent = "\n".join(line for line in text.splitlines() if not line.startswith("polariser_deg"))
    (lab / "silent.toml").write_text(silent)
    assert l3("check", lab / "silent.toml")[0] == 0
    shutil.copy(unit / "polarised_extinction.csv", lab)
    (lab / "camera.toml").write_text(with_angles((unit / "nominal.toml").read_text(), [90.0, 135.0, 45.0, 0.0]))
    code, out, _ = l3("check", lab / "silent.toml", lab / "camera.toml")
    assert code == 3
    assert "p45 has 44.5° instead of 135°" in out


def test_a_draft_lists_the_captures(unit: Path, lab: Path, tmp_path: Path, l3: L3) -> None:
    for kind in ("mono", "chart", "white", "dark", "polariser", "spectra"):
        shutil.copytree(lab / kind, tmp_path / kind)
    draft = tmp_path / "MEASUREMENTS.toml"
    assert l3("calibrate", "--draft", tmp_path, "--camera", unit / "camera.toml", "-o", draft)[0] == 0
    made, own = (tomllib.loads(path.read_text()) for path in (draft, lab / "MEASUREMENTS.toml"))
    assert [(each["frames"], each["angle_deg"]) for each in made["polariser"]] == [
        (each["frames"], each["angle_deg"]) for each in own["polariser"]
    ]
    assert [made["channel"][name]["polariser_deg"] for name in own["channel"]] == ANGLES.tolist()
    assert len(made["mono"]) == len(own["mono"])


def test_polarisers_of_a_known_camera(unit: Path, lab: Path, tmp_path: Path, l3: L3) -> None:
    """A recipe as base: only its polarisers are measured."""
    sections = (lab / "MEASUREMENTS.toml").read_text().split("\n[[")
    chosen = [section for section in sections if section.startswith(("dark]]", "polariser]]"))]
    last, rest = chosen[-1].split("\n[rotator]")
    rotator = rest.partition("\n[")[0]
    chosen[-1] = last
    base = f'base = "{unit / "nominal.toml"}"\n'
    (lab / "base.toml").write_text(base + "".join(f"\n[[{each}\n" for each in chosen) + f"\n[rotator]{rotator}\n")
    assert l3("check", lab / "base.toml")[0] == 0
    assert l3("calibrate", lab / "base.toml", "-o", tmp_path / "camera.h5")[0] == 0
    made, true = load(CameraModel, tmp_path / "camera.h5"), load_camera(unit / "camera.toml")
    assert made.polarisers is not None
    assert true.polarisers is not None
    assert np.abs(angle_difference(made.polarisers.polariser_deg, true.polarisers.polariser_deg)).max() < 0.1
    np.testing.assert_array_equal(made.responsivity, true.responsivity)
    assert read_measurements(lab / "base.toml").measurements.whites == ()
