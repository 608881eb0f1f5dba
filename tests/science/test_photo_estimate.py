"""Responsivities from the patches of a chart: truth known (docs/method.md#charts-in-photographs). The study over measured
cameras is tests/studies/test_photo_study.py."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.calibration.photo import lights
from l3cli.calibration.photo.estimate import Posterior, estimate
from l3cli.calibration.photo.prior import WAVELENGTH, Prior, camera_prior, smooth
from l3cli.io.curves import shipped_statistics
from l3cli.physics import spectra
from tests.helpers import photos, priors
from tests.helpers.paths import ROOT

SEEDS = range(12)
SURFACES = spectra.reflectance_library(WAVELENGTH)[::5]


@pytest.fixture(autouse=True, scope="module")
def one_thread() -> Iterator[None]:
    """As in the command: small matrices are faster so."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="module")
def prior() -> Prior:
    return camera_prior(shipped_statistics())


def figures(prior: Prior, glare: float = 0.0, uneven: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of responses under A from a chart under D65, and shares of these and of the curves within the band."""
    errors, shares, curves = [], [], []
    for seed in SEEDS:
        camera = photos.drawn(seed)
        posterior = estimate([photos.shot(camera, "D65", np.random.default_rng(seed), glare=glare, uneven=uneven)], prior)
        error, share = photos.response_figures(camera, posterior, "A", SURFACES)
        errors.append(error)
        shares.append(share)
        curves.append(photos.curve_figures(camera, posterior)[1])
    return np.concatenate(errors), np.concatenate(shares), np.concatenate(curves)


def test_responses_under_another_light_and_the_band(prior: Prior) -> None:
    errors, shares, curves = figures(prior)
    assert np.median(errors) < 0.0035
    assert np.percentile(errors, 95) < 0.01
    assert 0.9 <= shares.mean() <= 0.995
    assert 0.9 <= curves.mean() <= 0.995


def test_glare_and_uneven_light_cost_little(prior: Prior) -> None:
    plain, hard = figures(prior)[0], figures(prior, glare=0.02, uneven=0.2)
    assert np.median(hard[0]) < 1.5 * max(np.median(plain), 0.0025)
    assert hard[1].mean() >= 0.9


def test_curves_are_nowhere_negative_and_noise_free_patches_fit(prior: Prior) -> None:
    camera = photos.drawn(3)
    shot = photos.shot(camera, "D65", np.random.default_rng(0), noise=1e-4)
    posterior = estimate([shot], prior)
    assert posterior.responsivity.min() >= 0
    assert np.abs(posterior.predicted[0] - shot.values).max() < 0.005 * photos.BRIGHTEST


def test_glare_and_illumination_are_recovered(prior: Prior) -> None:
    camera = photos.drawn(5)
    even = photos.shot(camera, "D65", np.random.default_rng(0), noise=0.001, glare=0.05)
    glare = 0.05 * (even.values.mean(axis=0) / 1.05)
    np.testing.assert_allclose(estimate([even], prior).glare[0], glare, atol=0.01 * photos.BRIGHTEST)


def test_a_second_light_helps(prior: Prior) -> None:
    one, two = [], []
    for seed in SEEDS:
        camera, rng = photos.drawn(seed), np.random.default_rng(seed)
        shots = [photos.shot(camera, light, rng, uneven=0.2) for light in ("D65", "A")]
        one.append(photos.response_figures(camera, estimate(shots[:1], prior), "4000K", SURFACES)[0])
        two.append(photos.response_figures(camera, estimate(shots, prior), "4000K", SURFACES)[0])
    assert np.median(two) < 0.9 * np.median(one)


def test_the_light_that_is_advised_helps_more_than_more_of_the_same(prior: Prior) -> None:
    camera = photos.drawn(1)
    shot = photos.shot(camera, "D65", np.random.default_rng(1))
    posterior = estimate([shot], prior)
    candidates = {name: spectra.illuminant(name, WAVELENGTH) for name in ("D65", "A", "F11", "D50")}
    best, remaining = lights.next_light(shot, posterior, candidates, list(candidates.values()), SURFACES)
    assert best in ("A", "F11")
    assert 0.2 < remaining < 0.95


def test_a_clipped_patch_is_left_out(prior: Prior) -> None:
    camera = photos.drawn(2)
    shot = photos.shot(camera, "D65", np.random.default_rng(2))
    shot.values[18, 1] = 700.0
    shot.used[18, 1] = False
    assert photos.response_figures(camera, estimate([shot], prior), "A", SURFACES)[0].max() < 0.015


@pytest.mark.parametrize(("true", "named"), [("A", "D65"), ("D65", "A"), ("F11", "D65"), ("D65", "F2"), ("LED-B3", "D50")])
def test_a_wrong_light_is_noticed_and_the_right_one_not(prior: Prior, true: str, named: str) -> None:
    names = ("A", "D50", "D65", "F2", "F11", "LED-B3", "4000K")
    candidates = {name: spectra.illuminant(name, WAVELENGTH) for name in names}
    for seed in range(3):
        camera, rng = photos.drawn(seed), np.random.default_rng(seed)
        wrong = photos.shot(camera, true, rng, uneven=0.2, named=named)
        assert lights.compare([wrong], 0, prior, candidates).wrong
        right = photos.shot(camera, true, rng, uneven=0.2)
        assert not lights.compare([right], 0, prior, candidates).wrong


def test_a_light_that_is_only_guessed_widens_the_band(prior: Prior) -> None:
    candidates = {name: spectra.illuminant(name, WAVELENGTH) for name in ("A", "D50", "D55", "D65", "D75", "F11")}
    camera = photos.drawn(6)
    shot = photos.shot(camera, "D55", np.random.default_rng(6))
    likely = lights.probabilities([shot], 0, prior, candidates)
    assert sum(likely.values()) == pytest.approx(1.0)
    assert likely["A"] + likely["F11"] < 0.01
    guessed = replace(shot, light=candidates[max(likely, key=lambda name: likely[name])])
    known = estimate([guessed], prior)
    unsure = lights.unsure_of_light(known, [guessed], 0, prior, candidates)
    assert (np.diag(unsure.covariance) >= np.diag(known.covariance)).all()
    assert np.diag(unsure.covariance).mean() > 1.1 * np.diag(known.covariance).mean()


def test_dyes_that_no_camera_has_take_the_smooth_prior() -> None:
    camera = load_camera(ROOT / "configs/cameras/fiveband.toml")
    curves = spectra.average(camera.responsivity, camera.wavelength, WAVELENGTH)
    shot = photos.shot(curves, "D65", np.random.default_rng(0))
    posterior = estimate([shot], smooth(len(curves)))
    errors, shares = photos.response_figures(curves, posterior, "A", SURFACES)
    assert errors.max() < 0.02
    assert shares.mean() > 0.9


def test_curves_unlike_all_measured_ones_are_more_probable_when_merely_smooth(prior: Prior) -> None:
    """By the evidence a camera with an infrared channel is told from one that sees red, green and blue."""

    def evidences(curves: np.ndarray) -> list[float]:
        shot = photos.shot(curves, "D65", np.random.default_rng(0))
        found: list[Posterior] = [estimate([shot], each) for each in (prior, smooth(3))]
        return [each.evidence for each in found]

    usual, odd = photos.drawn(4), np.roll(photos.drawn(4), 8, axis=1)
    measured, plain = evidences(usual)
    assert measured > plain
    measured, plain = evidences(odd)
    assert measured < plain


def test_the_table_is_that_of_the_measured_cameras() -> None:
    if not os.environ.get("L3_DATA"):
        pytest.skip("L3_DATA does not name the folder of real data")
    assert priors.TABLE.read_text() == priors.as_toml(priors.measured(Path(os.environ["L3_DATA"])))
