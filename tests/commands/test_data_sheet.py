"""The data sheet in the report on a measured camera: the values of `l3 calibrate`, and the plots of EMVA 1288."""

import json
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.report.camera import data_sheet, deviation_figure
from l3cli.report.parts import Figures, Table
from tests.helpers.calls import L3
from tests.helpers.pages import Tags

PLOTS = ["Photon transfer", "Linearity", "Deviation from linearity", "Signal-to-noise ratio"]
SAME = {  # name in the sheet: that of the figures of calibration
    "overall system gain K (DN/e⁻)": "K (DN/e-)",
    "temporal dark noise (e⁻)": "dark noise (e-)",
    "SNR max (dB)": "SNR max (dB)",
    "dynamic range DR (dB)": "DR (dB)",
    "DSNU1288 (e⁻)": "DSNU (e-)",
    "PRNU1288 (%)": "PRNU (%)",
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
    assert page.stat().st_size < 300_000
    blocks = data_sheet(camera, camera.fit.noise).blocks
    titles = [figure.title for block in blocks if isinstance(block, Figures) for figure in block.figures]
    assert titles == PLOTS
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
