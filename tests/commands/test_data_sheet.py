"""The data sheet in the report on a measured camera: the values of `l3 calibrate`, and the plots of EMVA 1288."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.calibration.captures import measure_sensor
from l3cli.calibration.model import describe_noise
from l3cli.frames.measurement import Body, Capture, Measurements
from l3cli.report.camera import data_sheet, deviation_figure, figures_table
from l3cli.report.parts import Figures, Table
from l3cli.simulation import lab
from l3cli.simulation.lab import LabRecipe
from tests.helpers.calls import L3
from tests.helpers.pages import Tags

PLOTS = ["Photon transfer", "Linearity", "Deviation from linearity", "Signal-to-noise ratio"]
PATTERNS = ["spectrograms", "horizontal profile", "vertical profile", "logarithmic histogram"]
PATTERNS += ["accumulated logarithmic histogram"]
SAME = {  # name in the sheet: that of the figures of calibration
    "overall system gain K (DN/e⁻)": "K (DN/e-)",
    "temporal dark noise (e⁻)": "dark noise (e-)",
    "SNR max (dB)": "SNR max (dB)",
    "dynamic range DR (dB)": "DR (dB)",
    "DSNU1288.pix (e⁻)": "DSNU (e-)",
    "PRNU1288.pix (%)": "PRNU (%)",
    "linearity error LE (%)": "LE (%)",
}


def test_the_data_sheet_holds_figures_and_plots(lab_folder: Path, tmp_path: Path, l3: L3) -> None:
    page, measured = tmp_path / "report.html", lab_folder / "MEASUREMENTS.toml"
    code, out, err = l3("calibrate", measured, "-o", tmp_path / "c.h5", "--json", "--quiet")
    assert (code, err) == (0, "")
    assert l3("report", tmp_path / "c.h5", "-o", page, "--quiet")[0] == 0
    channels, camera = json.loads(out)["channels"], load(CameraModel, tmp_path / "c.h5")
    assert camera.fit is not None
    assert camera.fit.noise is not None
    text = page.read_text()
    Tags(page)
    assert page.stat().st_size < 400_000
    blocks = data_sheet(camera, camera.fit.noise).blocks
    titles = [figure.title for block in blocks if isinstance(block, Figures) for figure in block.figures]
    assert titles == PLOTS + [f"{name} {pattern}" for name in ("DSNU", "PRNU") for pattern in PATTERNS]
    assert all(text.count(f"<h4>{title}</h4>") == 1 for title in titles)
    table = next(block for block in blocks if isinstance(block, Table) and len(block.headings) > 2)
    rows = {row[0]: [float(cell) for cell in row[1:]] for row in table.rows}
    for name, other in SAME.items():
        assert rows[name] == pytest.approx([channels[each][other] for each in camera.channels], rel=2e-3)
    efficiency = np.array(rows["quantum efficiency η (%)"]) / 100
    assert np.array(rows["threshold (photons)"]) * efficiency == pytest.approx(rows["threshold (e⁻)"], rel=2e-3)
    figure = deviation_figure(camera, camera.fit.noise)
    assert figure.data is not None
    deviations = [abs(float(row[2])) for row in figure.data.rows if row[0] == camera.channels[0]]
    assert 0 < np.mean(deviations) < 0.5  # per cent: the lamp drifts by so much


def test_all_values_of_a_virtual_lab_are_right_within_their_uncertainty(bayer: CameraModel) -> None:
    """A sensor with temporal and fixed noise of rows and columns, and with rows and columns that differ in response."""
    lines = {"row_temporal_noise": 3.0, "column_temporal_noise": 2.0, "row_noise": 3.0, "column_noise": 4.0}
    true = replace(bayer, noise=replace(bayer.noise, **lines, row_prnu=0.004, column_prnu=0.003))
    recipe = LabRecipe(wavelength_error_nm=0.0, lamp_drift=0.0)
    captures: dict[str, list[Capture]] = {"white": [], "dark": []}
    for plan in lab.plan(true, recipe, 1):
        if plan.kind in captures:
            frames = [lab.take(true, plan, trial, 1, recipe.defects) for trial in range(plan.trials)]
            captures[plan.kind].append(Capture(plan.name, plan.exposure, frames, monitor=plan.monitor))
    c = true
    body = Body(c.name, c.rows, c.cols, c.pixel_pitch, c.bits, c.channels, c.cfa, c.optics)
    measured = Measurements(body, darks=tuple(captures["dark"]), whites=tuple(captures["white"]))
    fit = describe_noise(measure_sensor(measured), body)
    table = figures_table(true, fit)
    rows = {row[0]: np.array([float(cell) for cell in row[1:]]) for row in table.rows}
    noise = true.noise
    expected = {
        "DSNU1288 (e⁻)": np.sqrt(noise.fixed),
        "DSNU1288.row (e⁻)": noise.row_noise,
        "DSNU1288.col (e⁻)": noise.column_noise,
        "DSNU1288.pix (e⁻)": noise.dsnu,
        "PRNU1288 (%)": 100 * np.sqrt(noise.uneven),
        "PRNU1288.row (%)": 100 * noise.row_prnu,
        "PRNU1288.col (%)": 100 * noise.column_prnu,
        "PRNU1288.pix (%)": 100 * noise.prnu,
    }
    for name, value in expected.items():
        assert (np.abs(rows[name] - value) < 4 * rows[f"standard error of {name}"]).all(), name
        assert (rows[f"standard error of {name}"] < 0.12 * value).all(), name
    for line in ("row", "column"):
        name = f"{line} temporal noise"
        error = rows[f"{name}, standard error (e⁻)"]
        assert (np.abs(rows[f"{name} (e⁻)"] - lines[f"{line}_temporal_noise"]) < 4 * error).all(), name
    assert np.abs(rows["overall system gain K (DN/e⁻)"] - true.gain).max() < 4 * rows["standard error of K (DN/e⁻)"].max()
    assert rows["temporal dark noise (e⁻)"] == pytest.approx(noise.dark_noise, rel=0.03)
    assert rows["dark current from the mean (e⁻/s)"] == pytest.approx(noise.dark_current, rel=0.1)
    current = rows["dark current from the variance (e⁻/s)"]
    error = rows["standard error of the dark current from the variance (e⁻/s)"]
    assert (np.abs(current - noise.dark_current) < 4 * error).all()
    assert fit.dark_pattern is not None
    assert fit.response_pattern is not None
    fine = fit.dark_pattern.frequency > 0.1  # the response contains the shading of the lens at low frequencies
    for spectrum, pixels, line_noise in (
        (fit.dark_pattern.horizontal_spectrum, noise.dsnu, noise.column_noise),
        (fit.dark_pattern.vertical_spectrum, noise.dsnu, noise.row_noise),
        (fit.response_pattern.horizontal_spectrum, noise.prnu, noise.column_prnu),
        (fit.response_pattern.vertical_spectrum, noise.prnu, noise.row_prnu),
    ):
        # The mean power of a spectrum of white noise has the relative error of the variance of the lines.
        assert (spectrum[fine] ** 2).mean() == pytest.approx(pixels**2 + line_noise**2, rel=0.2)
    assert rows["saturation capacity (e⁻)"] == pytest.approx(min(noise.well_capacity, true.full_scale), rel=0.03)
