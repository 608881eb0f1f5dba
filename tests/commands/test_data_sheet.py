"""`l3 calibrate --sheet`: one page of a camera's figures as `l3 calibrate` gives them, with the standard's plots."""

import json
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.report.camera import data_sheet, deviation_figure
from l3cli.report.parts import Figures, Table
from tests.helpers.calls import L3, Refused
from tests.helpers.pages import Tags

PLOTS = ["Photon transfer", "Linearity", "Deviation from linearity", "Signal over noise", "Responsivities"]
SAME = {  # name in the sheet: that of the figures of calibration
    "overall system gain K (DN/e⁻)": "K (DN/e-)",
    "temporal dark noise (e⁻)": "dark noise (e-)",
    "SNR max (dB)": "SNR max (dB)",
    "dynamic range DR (dB)": "DR (dB)",
    "DSNU1288 (e⁻)": "DSNU (e-)",
    "PRNU1288 (%)": "PRNU (%)",
    "linearity error LE (%)": "LE (%)",
}


def test_the_sheet_holds_figures_and_plots(lab_folder: Path, tmp_path: Path, l3: L3) -> None:
    sheet = tmp_path / "sheet.html"
    measured = lab_folder / "MEASUREMENTS.toml"
    code, out, err = l3("calibrate", measured, "-o", tmp_path / "c.h5", "--sheet", sheet, "--json", "--quiet")
    assert (code, err) == (0, "")
    channels, camera = json.loads(out)["channels"], load(CameraModel, tmp_path / "c.h5")
    text = sheet.read_text()
    Tags(sheet)
    assert sheet.stat().st_size < 300_000
    section = data_sheet(camera)
    blocks = [block for part in section.parts for block in part.blocks]
    titles = [figure.title for block in blocks if isinstance(block, Figures) for figure in block.figures]
    assert titles[: len(PLOTS)] == PLOTS
    assert all(f"<h4>{title}</h4>" in text for title in titles)
    table = next(block for block in blocks if isinstance(block, Table) and block.caption == "Figures of each channel")
    rows = {row[0]: [float(cell) for cell in row[1:]] for row in table.rows}
    for name, other in SAME.items():
        assert rows[name] == pytest.approx([channels[each][other] for each in camera.channels], rel=2e-3)
    efficiency = np.array(rows["quantum efficiency η (%)"]) / 100
    assert np.array(rows["threshold (photons)"]) * efficiency == pytest.approx(rows["threshold (e⁻)"], rel=2e-3)
    assert camera.fit is not None
    assert camera.fit.noise is not None
    figure = deviation_figure(camera, camera.fit.noise)
    assert figure.data is not None
    deviations = [abs(float(row[2])) for row in figure.data.rows if row[0] == camera.channels[0]]
    assert 0 < np.mean(deviations) < 0.5  # per cent: the lamp drifts by so much


def test_a_sheet_that_cannot_be_is_refused(lab_folder: Path, tmp_path: Path, refused: Refused) -> None:
    command = ("calibrate", lab_folder / "MEASUREMENTS.toml", "-o", tmp_path / "c.h5", "--sheet")
    assert "ends in .html" in refused(2, *command, tmp_path / "sheet.pdf")
    assert "--sheet" in refused(
        2, "calibrate", "--draft", lab_folder, "-o", tmp_path / "m.toml", "--sheet", tmp_path / "s.html"
    )
