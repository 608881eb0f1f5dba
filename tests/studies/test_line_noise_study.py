"""How well dark frames give the noise of rows and columns, temporal and fixed, alone and together, in 21 virtual sensors.

python -m pytest -m slow -s tests/studies/test_line_noise_study.py      63 sets of dark frames of 960×1280 pixels
"""

import dataclasses

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera
from l3cli.calibration.noise import DarkNoise, dark_noise
from l3cli.frames.measurement import Body, Capture
from l3cli.simulation import sensor
from tests.helpers.paths import CONFIGS

SEEDS = range(21)
TERMS = ("row_temporal_noise", "column_temporal_noise", "row_noise", "column_noise")
EXPOSURES, FRAMES = (0.01, 0.5, 1.0, 2.0), 8
WITHIN = 3.0  # %, of what the rows and columns of this sensor have


def measured(camera: CameraModel, seed: int) -> DarkNoise:
    """Measure the noise of a camera from dark frames."""
    dark = np.zeros((camera.rows, camera.cols), np.float32)
    captures = [
        Capture(
            f"{time} s",
            time,
            [sensor.expose(camera, dark, time, np.random.default_rng([seed, at, n])) for n in range(FRAMES)],
        )
        for at, time in enumerate(EXPOSURES)
    ]
    c = camera
    return dark_noise(captures, Body(c.name, c.rows, c.cols, c.pixel_pitch, c.bits, c.channels, c.cfa, c.optics))


def deviations(camera: CameraModel, terms: tuple[str, ...]) -> dict[str, float]:
    """Return the standard deviation of each term in e-. For fixed offsets, this is the deviation of the drawn offsets."""
    noise, pattern = camera.noise, sensor.fixed_pattern(camera).dsnu
    alone = sensor.fixed_pattern(
        dataclasses.replace(camera, noise=dataclasses.replace(noise, row_noise=0.0, column_noise=0.0))
    )
    fixed = pattern - alone.dsnu
    found = {"row_noise": fixed.mean(axis=1).std(ddof=1), "column_noise": fixed.mean(axis=0).std(ddof=1)}
    return {term: float(found.get(term, getattr(noise, term))) for term in terms}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "alone", "together"])
def test_rows_and_columns_of_twenty_one_sensors(kind: str) -> None:
    base = dataclasses.replace(load_camera(CONFIGS / "cameras/bayer.toml"), rows=960, cols=1280)
    lines, worst, alarms, dsnu = [], 0.0, 0, 0.0
    for seed in SEEDS:
        terms = {"none": (), "alone": (TERMS[seed % 4],), "together": TERMS}[kind]
        strength = float(4.0 * 2.0 ** np.random.default_rng(seed).uniform(-2, 1))  # 1 to 8 e-, read noise 4 e-
        noise = dataclasses.replace(base.noise, **dict.fromkeys(terms, strength))
        camera = dataclasses.replace(base, noise=noise, fixed_pattern_seed=seed)
        dark = measured(camera, seed)
        parts = (dark.rows, dark.columns, dark.fixed_rows, dark.fixed_columns)
        found = dict(zip(TERMS, parts, strict=True))
        alarms += sum(found[term].deviation > 0 for term in TERMS if term not in terms)
        for term, true in deviations(camera, terms).items():
            error = 100 * (found[term].deviation / camera.gain / true - 1)
            stated = (found[term].deviation / camera.gain - getattr(noise, term)) / (found[term].error / camera.gain)
            lines.append((term, error, stated))
            worst = max(worst, abs(error))
        dsnu = max(dsnu, float(np.abs(dark.dsnu / camera.gain / base.noise.dsnu - 1).max()))
    for term in TERMS:
        errors, stated = np.array([each[1:] for each in lines if each[0] == term] or [(0, 0)]).T
        print(
            f"\n{kind:9} {term:22} worst {np.abs(errors).max():5.2f} %, mean {errors.mean():+5.2f} %, "
            f"in standard errors: RMS {np.sqrt((stated**2).mean()):.2f}, worst {np.abs(stated).max():.2f}",
            end="",
        )
    print(f"\n{kind:9} false alarms {alarms}, DSNU of pixels worst {100 * dsnu:.2f} %")
    assert worst < WITHIN
    assert alarms <= 4
