"""Row weights of the second pass where the outputs are the camera's channels."""

import numpy as np
import pytest

from l3cli.evaluation.quality import spectral_angle
from l3cli.training.row_weighting import DARKEST, ERROR_FLOOR, SpectralWeighting

TAPS, OUTPUTS, COUNT = 9, 6, 40
POWER = 0.25


def error(weight: np.ndarray) -> np.ndarray:
    """Squared error in degrees that a weight stands for."""
    return weight ** (-1 / POWER) - ERROR_FLOOR


def patches() -> tuple[SpectralWeighting, dict]:
    rng = np.random.default_rng(3)
    weights = rng.normal(0, 0.02, (2, TAPS, OUTPUTS)).astype(np.float32)
    intercept = np.full((2, OUTPUTS), 0.3, np.float32)
    clean = rng.uniform(0, 1, (COUNT, TAPS)).astype(np.float32)
    target = rng.normal(0.3, 0.03, (COUNT, OUTPUTS)).astype(np.float32)
    runs = [(0, 0, 25), (1, 25, COUNT)]
    about = {"clean": clean, "target": target, "level": target.mean(axis=1), "runs": runs}
    return SpectralWeighting(weights, (weights**2).sum(axis=2), intercept, POWER), about


def outputs(weighting: SpectralWeighting, clean: np.ndarray) -> np.ndarray:
    of = np.repeat([0, 1], [25, COUNT - 25])
    return np.einsum("pt,pto->po", clean, weighting.weights[of]) + weighting.intercept[of]


def test_rows_weigh_by_the_spectral_angle_of_the_first_pass() -> None:
    weighting, about = patches()
    weight = weighting.weight(variance=np.zeros((COUNT, TAPS), np.float32), **about)
    made = outputs(weighting, about["clean"])
    size = np.linalg.norm(about["target"], axis=1)
    across = np.sin(np.radians(spectral_angle(made.T[..., None], about["target"].T[..., None])[:, 0]))
    angle = np.degrees(across * np.linalg.norm(made, axis=1) / size)  # of an output as long as the target
    np.testing.assert_allclose(error(weight), angle**2, rtol=1e-3)


def test_brighter_or_darker_outputs_of_the_right_spectrum_weigh_as_none() -> None:
    weighting, about = patches()
    about["target"] = outputs(weighting, about["clean"]) / 1.3
    weight = weighting.weight(variance=np.zeros((COUNT, TAPS), np.float32), **about)
    np.testing.assert_allclose(weight, ERROR_FLOOR**-POWER, rtol=1e-4)


def test_noise_counts_as_the_angle_that_it_makes_on_average() -> None:
    weighting, about = patches()
    about["target"] = outputs(weighting, about["clean"])
    variance = np.full((COUNT, TAPS), 0.01**2, np.float32)
    rng = np.random.default_rng(4)
    noisy = [outputs(weighting, about["clean"] + rng.normal(0, 0.01, (COUNT, TAPS))) for _ in range(400)]
    angles = [spectral_angle(each.T[..., None], about["target"].T[..., None]) for each in noisy]
    # Noise of the outputs is no more along the spectrum than across it: what is left out is a matter of single patches.
    expected = np.mean(error(weighting.weight(variance=variance, **about)))
    assert expected == pytest.approx(np.mean(np.square(angles)), rel=0.1)


def test_targets_darker_than_a_fiftieth_of_their_level_are_judged_no_more_strictly() -> None:
    weighting, about = patches()
    about["target"] = np.zeros((COUNT, OUTPUTS), np.float32)
    about["level"] = np.ones(COUNT, np.float32)
    weight = weighting.weight(variance=np.zeros((COUNT, TAPS), np.float32), **about)
    made = np.linalg.norm(outputs(weighting, about["clean"]), axis=1)
    np.testing.assert_allclose(error(weight), (np.degrees(made / DARKEST) ** 2) / OUTPUTS, rtol=1e-3)
