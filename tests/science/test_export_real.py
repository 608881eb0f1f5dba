"""Matrices that are exported of a Canon 550D, calibrated from one photo, on the patches of that photo."""

import json
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.store import load
from l3cli.calibration.photo.estimate import terms
from l3cli.physics import charts, spectra
from l3cli.physics.display import delta_e_2000, displayed_xyz, lab, white_point
from tests.helpers.calls import L3
from tests.helpers.photos import PLACE

GRID = np.arange(380.0, 781.0, 5.0)
MOST = {"ColorMatrix1": 1.5, "ForwardMatrix1": 2.1, "CCM": 2.4}  # mean CIEDE2000


def errors(xyz: np.ndarray, light: str) -> np.ndarray:
    """Of the chart's patches (24, 3) of free exposure beside those under a light."""
    weights = spectra.xyz_weights(GRID) * spectra.illuminant(light, GRID)
    wanted, white = charts.chart("classic", GRID)[1] @ weights.T / weights[1].sum(), white_point(light)
    exposed = xyz * (xyz[:, 1] @ wanted[:, 1]) / (xyz[:, 1] @ xyz[:, 1])
    return np.asarray(delta_e_2000(lab(exposed, white), lab(wanted, white)))


@pytest.mark.slow
def test_a_real_chart_is_developed_by_what_is_exported(l3_data: Path, tmp_path: Path, l3: L3) -> None:
    photo, to = l3_data / "raw/colorchart.dng", ("-o", tmp_path / "camera.h5", "--export", tmp_path)
    assert l3("calibrate", "--photo", photo, "--light", "A", *to)[0] == 0
    camera = load(CameraModel, tmp_path / "camera.h5")
    assert camera.fit is not None
    assert camera.fit.photo is not None
    fit = camera.fit.photo
    values = (fit.measured[0] - fit.glare[0]) / (terms(PLACE) @ fit.illumination[0])[:, None]
    dcp = json.loads((tmp_path / "dcp.json").read_text())
    tuning = json.loads((tmp_path / "libcamera_rpi.json").read_text())
    (ccms,) = (each["rpi.ccm"]["ccms"] for each in tuning["algorithms"] if "rpi.ccm" in each)
    balanced = values / np.array(dcp["AsShotNeutral"]["StdA"])
    picture = balanced @ np.reshape(ccms[0]["ccm"], (3, 3)).T
    found = {
        "ColorMatrix1": errors(values @ np.linalg.inv(dcp["ColorMatrix1"]).T, "A"),
        "ForwardMatrix1": errors(balanced @ np.transpose(dcp["ForwardMatrix1"]), "D50"),
        "CCM": errors(displayed_xyz(picture), "D65"),
    }
    for name, each in found.items():
        print(f"{name}: mean ΔE00 {each.mean():.2f}, worst {each.max():.2f} (patch {each.argmax() + 1})")
        assert each.mean() < MOST[name]
