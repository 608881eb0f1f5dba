"""A real photo of a ColorChecker, by a Canon 550D: its camera model, and the photo's own colours through a table of it."""

from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import PhotoFit
from l3cli.artifacts.store import load
from l3cli.io.images import read_image
from l3cli.physics import spectra
from l3cli.physics.display import delta_e_2000, lab
from tests.helpers.calls import L3

# Charts of paints, plastics and textiles under the photo's light, and what they are under daylight.
SCENES = """
illuminants = ["A"]
exposure_share = [0.9]
[target]
illuminant = "D65"
[[scene]]
source = "surfaces"
size = [160, 160]
patches = [10, 10]
count = 40
"""
HALF = 20  # pixels about a patch's centre


@pytest.fixture
def photo(l3_data: Path) -> Path:
    return l3_data / "raw/colorchart.dng"


def fit_of(camera: CameraModel) -> PhotoFit:
    assert camera.fit is not None
    assert camera.fit.photo is not None
    return camera.fit.photo


def test_the_chart_its_light_and_its_noise(photo: Path, tmp_path: Path, l3: L3) -> None:
    code, out, err = l3("calibrate", "--photo", photo, "-o", tmp_path / "camera.h5")
    assert code == 0, err
    camera = load(CameraModel, tmp_path / "camera.h5")
    fit = fit_of(camera)
    assert fit.lights[0] in ("A", "2400K", "3200K")  # indoors, by tungsten light
    assert fit.prior == "measured cameras"
    assert fit.misfit.max() < 0.01
    np.testing.assert_allclose(fit.corners[0], [[664, 578], [1304, 564], [1315, 973], [645, 985]], atol=6)
    assert "colours ± 95 %" in out
    assert 0.5 < camera.gain < 4
    assert (camera.black_level, camera.white_level) == (2056, 15000)
    code, _, err = l3("calibrate", "--photo", photo, "--light", "D65", "-o", tmp_path / "other.h5")
    assert code == 1
    assert "times more probable" in err


def centres(fit: PhotoFit) -> np.ndarray:
    """(24, 2) row, col of the patches' centres, of a chart that is nearly seen from the front."""
    first, second, third, fourth = fit.corners[0]
    y, x = (np.indices((4, 6)).reshape(2, 24) + 0.5) / [[4], [6]]
    x, y = x[:, None], y[:, None]
    place = first * (1 - x) * (1 - y) + second * x * (1 - y) + third * x * y + fourth * (1 - x) * y
    return np.rint(place[:, ::-1]).astype(int)


@pytest.mark.slow
def test_its_own_colours(photo: Path, tmp_path: Path, l3: L3) -> None:
    (tmp_path / "scenes.toml").write_text(SCENES)
    camera, training, table = (tmp_path / name for name in ("camera.h5", "training.h5", "table.h5"))
    exported = ("--export", tmp_path / "exported")
    assert l3("calibrate", "--photo", photo, "--light", "A", "-o", camera, *exported)[0] == 0
    assert l3("simulate", tmp_path / "scenes.toml", "--camera", camera, "-o", training, "--jobs", "2")[0] == 0
    assert l3("train", training, "--classes", "single", "-o", table, "--jobs", "2")[0] == 0
    fit = fit_of(load(CameraModel, camera))
    # Black level and glare of each channel, which calibration found in this photo, stand in for a dark frame.
    offsets = tmp_path / "exported/colorchart_offsets.tif"
    assert l3("render", table, photo, "--dark", offsets, "-o", tmp_path / "clean.exr")[0] == 0
    assert l3("render", table, photo, "-o", tmp_path / "plain.exr")[0] == 0
    wavelength = np.arange(400.0, 701.0, 5.0)
    weights = spectra.xyz_weights(wavelength) * spectra.illuminant("D65", wavelength)
    published = spectra.colorchecker(wavelength)[1] @ weights.T / weights[1].sum()
    white = spectra.white_point("D65")
    means = {}
    for name in ("clean", "plain"):
        picture = read_image(tmp_path / f"{name}.exr")[0]
        windows = [picture[row - HALF : row + HALF, col - HALF : col + HALF] for row, col in centres(fit)]
        measured = np.mean(windows, axis=(1, 2))
        balanced = measured / measured[18] * white * published[18, 1]  # exposure and white: the white patch is neutral
        means[name] = float(delta_e_2000(lab(balanced, white), lab(published, white)).mean())
    print(means)
    assert means["clean"] <= 2.5
    assert means["plain"] <= 3.5
