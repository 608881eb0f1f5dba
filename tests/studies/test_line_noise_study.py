"""How well a calibration gives the noise of rows and columns, temporal and fixed, alone and together.

python -m pytest -m slow -s tests/studies/test_line_noise_study.py      63 sets of dark frames, 63 whole labs
"""

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import load_camera, noise_keys
from l3cli.artifacts.store import load
from l3cli.calibration.noise import DarkNoise, dark_noise
from l3cli.frames.measurement import Body, Capture
from l3cli.simulation import sensor
from tests.helpers.calls import L3
from tests.helpers.paths import CONFIGS

SEEDS = range(21)
TERMS = ("row_temporal_noise", "column_temporal_noise", "row_noise", "column_noise")
RESPONSES = ("row_prnu", "column_prnu")
EXPOSURES, FRAMES = (0.01, 0.5, 1.0, 2.0), 8
WITHIN = 3.0  # %, of what the rows and columns of this sensor have
# Fewer captures of responsivities and white frames than in the default recipe, and more dark frames.
LAB = """
[mono]
step_nm = 50.0
overexposed = 0
[chart]
illuminants = ["D65", "A"]
[white]
levels = [0.05, 0.3, 0.6, 0.9, 1.6]
[dark]
trials = 8
"""


def terms_of(seed: int, kind: str, names: tuple[str, ...] = TERMS) -> dict[str, float]:
    """Return the deviation of each kind of noise in a sensor.

    Offsets have a standard deviation of 1 to 8 e-, beside a read noise of 4 e-. The PRNU is a tenth as many per cent.
    """
    strength = float(4.0 * 2.0 ** np.random.default_rng(seed).uniform(-2, 1))
    chosen = {"none": (), "alone": (names[seed % len(names)],), "together": names}[kind]
    return {name: strength / 1000 if name in RESPONSES else strength for name in chosen}


def measured(camera: CameraModel, seed: int) -> DarkNoise:
    """Measure the noise of a camera from dark frames."""
    dark, fixed = np.zeros((camera.rows, camera.cols), np.float32), sensor.fixed_pattern(camera)
    captures = [
        Capture(
            f"{time} s",
            time,
            [sensor.read_out(camera, fixed, dark, time, np.random.default_rng([seed, at, n])) for n in range(FRAMES)],
        )
        for at, time in enumerate(EXPOSURES)
    ]
    c = camera
    return dark_noise(captures, Body(c.name, c.rows, c.cols, c.pixel_pitch, c.bits, c.channels, c.cfa, c.optics))


def deviations(camera: CameraModel, terms: tuple[str, ...]) -> dict[str, float]:
    """Return the standard deviation of each term, in e- or as a fraction. For fixed terms, it is that of the drawn lines."""
    noise, pattern = camera.noise, sensor.fixed_pattern(camera)
    without = dict.fromkeys(("row_noise", "column_noise", *RESPONSES), 0.0)
    alone = sensor.fixed_pattern(dataclasses.replace(camera, noise=dataclasses.replace(noise, **without)))
    found = {}
    for lines, axis in (("row", 1), ("column", 0)):
        found[f"{lines}_noise"] = (pattern.dsnu - alone.dsnu).mean(axis=axis).std(ddof=1)
        found[f"{lines}_prnu"] = (pattern.prnu - alone.prnu).mean(axis=axis).std(ddof=1)
    return {term: float(found.get(term, getattr(noise, term))) for term in terms}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "alone", "together"])
def test_rows_and_columns_of_twenty_one_sensors(kind: str) -> None:
    base = dataclasses.replace(load_camera(CONFIGS / "cameras/bayer.toml"), rows=960, cols=1280)
    lines, worst, alarms, dsnu = [], 0.0, 0, 0.0
    for seed in SEEDS:
        terms = terms_of(seed, kind)
        noise = dataclasses.replace(base.noise, **terms)
        camera = dataclasses.replace(base, noise=noise, fixed_pattern_seed=seed)
        dark = measured(camera, seed)
        parts = (dark.rows, dark.columns, dark.fixed_rows, dark.fixed_columns)
        found = dict(zip(TERMS, parts, strict=True))
        alarms += sum(found[term].deviation > 0 for term in TERMS if term not in terms)
        for term, true in deviations(camera, tuple(terms)).items():
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


def run_lab(seed: int, kind: str, folder: Path, l3: L3) -> tuple[CameraModel, CameraModel, dict[str, float]]:
    """Measure a camera in a whole virtual lab, from its recipe to its camera model.

    Returns
    -------
    true : CameraModel
        The camera of the recipe.
    measured : CameraModel
        The camera model that `l3 calibrate` wrote.
    terms : dict
        Deviation of each term of the noise that the recipe states for rows and columns.
    """
    terms = terms_of(seed, kind, TERMS + RESPONSES)
    text = (CONFIGS / "cameras/bayer.toml").read_text()
    sizes = {"rows = 1080": "rows = 720", "cols = 1920": "cols = 960", "pattern_seed = 1": f"pattern_seed = {seed}"}
    for old, new in sizes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    keys = "".join(f"{key} = {terms[name]}\n" for name, key in noise_keys().items() if name in terms)
    recipe, lab = folder / "camera.toml", folder / "lab"
    recipe.write_text(text.replace("[noise]\n", f"[noise]\n{keys}"))
    (folder / "lab.toml").write_text(LAB)
    assert l3("lab", recipe, "-o", lab, "--recipe", folder / "lab.toml", "--seed", seed, "--quiet")[0] == 0
    code, _, err = l3("calibrate", lab / "MEASUREMENTS.toml", "-o", folder / "camera.h5", "--force", "--quiet")
    assert (code, err) == (0, "")
    shutil.rmtree(lab)
    return load_camera(recipe), load(CameraModel, folder / "camera.h5"), terms


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["none", "alone", "together"])
def test_rows_and_columns_in_twenty_one_labs(kind: str, tmp_path: Path, l3: L3) -> None:
    runs = [run_lab(seed, kind, tmp_path, l3) for seed in SEEDS]
    worst, furthest, alarms = 0.0, 0.0, 0
    others: dict[str, list[float]] = {"read_noise": [], "dsnu": [], "prnu": [], "gain": []}
    for term in TERMS + RESPONSES:
        errors, stated = [], []
        for true, measured, terms in runs:
            assert measured.fit is not None
            fit = measured.fit.noise
            found = getattr(fit, term)
            if term not in terms:
                alarms += found > 0
                continue
            deviation = deviations(true, (term,))[term]
            errors.append(100 * (getattr(measured.noise, term) / deviation - 1))
            stated.append((found - terms[term]) / getattr(fit, f"{term}_error"))
        if errors:
            worst = max(worst, *map(abs, errors)) if term in TERMS else worst
            furthest = max(furthest, *map(abs, stated))
            print(
                f"\n{kind:9} {term:22} worst {np.abs(errors).max():5.2f} %, mean {np.mean(errors):+5.2f} %, in standard "
                f"errors: RMS {np.sqrt(np.mean(np.square(stated))):.2f}, worst {np.abs(stated).max():.2f}",
                end="",
            )
    for true, measured, _ in runs:
        for name in ("read_noise", "dsnu", "prnu"):
            others[name].append(100 * (getattr(measured.noise, name) / getattr(true.noise, name) - 1))
        others["gain"].append(100 * (measured.gain / true.gain - 1))
    print(f"\n{kind:9} false alarms {alarms}")
    print("\n".join(f"{kind:9} {name:22} worst {np.abs(each).max():5.2f} %" for name, each in others.items()))
    assert worst < WITHIN
    assert furthest < 4.0
    assert alarms <= 0.05 * sum(term not in terms for _, _, terms in runs for term in TERMS + RESPONSES)
