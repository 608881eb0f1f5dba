"""docs/green-webcam.md for a simulated camera with colour shading: from raw photos to tuning files."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.calibration.photo.estimate import WAVELENGTH
from l3cli.io.pictures.dng import write_dng
from l3cli.physics import spectra
from l3cli.physics.display import SRGB_FROM_XYZ, delta_e_2000, lab, white_point
from tests.helpers import lenses, photos
from tests.helpers.calls import L3
from tests.helpers.readme import PAGES, blocks, commands

BLOCKS = blocks(PAGES["green-webcam.md"])
BLACK, SECONDS = 256.0, 0.02


@pytest.fixture
def desk(bayer: CameraModel, tmp_path: Path) -> tuple[Path, CameraModel]:
    """A folder with the raw files that the page names, and the camera that took them, as far as its size and levels go."""
    camera = replace(bayer, rows=600, cols=800, bits=12, black_level=BLACK, white_level=4095.0)
    rng = np.random.default_rng(1)
    sites = np.tile(photos.BAYER, (300, 400))
    loss = 1 / np.take_along_axis(lenses.gain(camera, np.arange(600), np.arange(800), 1.5), sites[None], axis=0)[0]
    light = spectra.illuminant("D65", WAVELENGTH) @ photos.drawn(1).T
    white = (1800 * light / light.max())[sites] * loss
    for name, signal in (("white", white), ("dark", np.zeros(white.shape))):
        for number in (1, 2):
            values = BLACK + signal + np.sqrt(photos.GAIN * signal + photos.READ**2) * rng.standard_normal(white.shape)
            write_raw(tmp_path / f"{name}{number}.dng", values, camera)
    write_raw(tmp_path / "chart.dng", BLACK + photos.photograph(photos.UPRIGHT, rng) * loss, camera)
    return tmp_path, camera


def write_raw(path: Path, values: np.ndarray, camera: CameraModel) -> None:
    stored = np.clip(np.rint(values), 0, 4095).astype(np.uint16)
    write_dng(path, stored, camera, {"A": np.eye(3), "D65": np.eye(3)}, None, SECONDS)


def algorithms(path: Path) -> dict[str, dict[str, Any]]:
    return {name: parameters for each in json.loads(path.read_text())["algorithms"] for name, parameters in each.items()}


def test_the_page_makes_tuning_files(desk: tuple[Path, CameraModel], monkeypatch: pytest.MonkeyPatch, l3: L3) -> None:
    folder, camera = desk
    monkeypatch.chdir(folder)
    (recipe,) = [block for block in BLOCKS if block.startswith('base = "chart.h5"')]
    (folder / "shading.toml").write_text(recipe)
    (lines,) = [block for block in BLOCKS if block.startswith("l3 calibrate --photo")]
    for line in lines.splitlines():
        for words in commands(line):
            code, _, err = l3(*words, "--quiet")
            assert code == 0, err
    tuning = algorithms(folder / "tuning/libcamera_pisp.json")
    assert tuning["rpi.black_level"] == {"black_level": 256 * 16}
    assert tuning["rpi.awb"]["bayes"] == 1
    deviation = tuning["rpi.noise"]["reference_constant"] + tuning["rpi.noise"]["reference_slope"] * np.sqrt(16 * 1000.0)
    assert deviation / 16 == pytest.approx(np.sqrt(photos.GAIN * 1000 + photos.READ**2), rel=0.25)
    alsc = tuning["rpi.alsc"]
    luminance = np.reshape(alsc["luminance_lut"], (32, 32))
    middle = [np.arange(1, 31), (np.arange(1, 31) + 0.5) / 32]
    truth = lenses.gain(camera, middle[1] * 600 - 0.5, middle[1] * 800 - 0.5, 1.5)
    for channel, ratio in enumerate(
        (alsc["calibrations_Cr"][0]["table"], np.ones((32, 32)), alsc["calibrations_Cb"][0]["table"])
    ):
        left = (luminance * np.reshape(ratio, (32, 32)))[1:-1, 1:-1] / truth[channel]
        assert np.abs(left / np.median(left) - 1).max() < 0.015, channel  # of tables; edges: tests/commands/test_export.py
    daylight = next(each for each in tuning["rpi.ccm"]["ccms"] if each["ct"] == 6504)
    light = spectra.illuminant("D65", WAVELENGTH)
    seen = photos.REFLECTANCE @ (light * photos.drawn(1)).T / (light @ photos.drawn(1).T)
    xyz = seen @ np.reshape(daylight["ccm"], (3, 3)).T @ np.linalg.inv(SRGB_FROM_XYZ).T
    weights = spectra.xyz_weights(WAVELENGTH) * light
    wanted, white = photos.REFLECTANCE @ weights.T / weights[1].sum(), white_point("D65")
    assert delta_e_2000(lab(xyz, white), lab(wanted, white)).mean() < 3.0
    assert "blackLevel: 4096" in (folder / "tuning/libcamera_simple.yaml").read_text()


def test_what_a_board_wants_beside_comes_from_another_file(tmp_path: Path, l3: L3) -> None:
    if shutil.which("jq") is None:
        pytest.skip("jq is not installed")
    assert l3("export", "bayer", "-o", tmp_path / "tuning", "--quiet")[0] == 0
    other = {
        "version": 2.0,
        "algorithms": [{"rpi.lux": {}}, {"rpi.agc": {"speed": 1}}, {"rpi.contrast": {}}, {"rpi.sharpen": {}}],
    }
    (tmp_path / "other.json").write_text(json.dumps(other))
    (line,) = [block for block in BLOCKS if block.startswith("jq ")]
    line = re.sub(r"/usr/share/\S+", "other.json", line)
    subprocess.run(["sh", "-c", line], cwd=tmp_path, check=True)
    made, ours = algorithms(tmp_path / "SENSOR.json"), algorithms(tmp_path / "tuning/libcamera_pisp.json")
    assert made == ours | {"rpi.agc": {"speed": 1}, "rpi.contrast": {}, "rpi.sharpen": {}}
