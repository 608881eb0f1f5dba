"""Matrices fitted over surfaces: the white is met, what is linear is found, colours get nearer than least squares."""

import numpy as np
import pytest

from l3cli.physics import spectra
from l3cli.physics.matrices import colour_errors, fit_through, refinement

WAVELENGTH = np.arange(400.0, 701.0, 10.0)
LIBRARY = spectra.reflectance_library(WAVELENGTH)[::4]
LIGHT = spectra.illuminant("D65", WAVELENGTH)
TO_XYZ = spectra.xyz_weights(WAVELENGTH) * LIGHT
WHITE = TO_XYZ.sum(axis=1) / TO_XYZ[1].sum()
XYZ = LIBRARY @ TO_XYZ.T / TO_XYZ[1].sum()


def channels(count: int) -> np.ndarray:
    """Of the surfaces (surface, channel) in Gaussian bands, a white's 1."""
    centres = np.linspace(440.0, 620.0, count)[:, None]
    weights = np.exp(-0.5 * ((WAVELENGTH - centres) / 35.0) ** 2) * LIGHT
    return np.asarray(LIBRARY @ weights.T / weights.sum(axis=1))


@pytest.mark.parametrize("count", [3, 4, 9])
def test_the_white_is_met_and_colours_get_nearer(count: int) -> None:
    seen = channels(count)
    start = fit_through(seen, XYZ, np.ones(count), WHITE, 1e-4)
    np.testing.assert_allclose(start.sum(axis=1), WHITE, rtol=1e-9)
    ours = refinement(seen @ start.T, XYZ, WHITE)
    np.testing.assert_allclose(ours @ WHITE, WHITE, rtol=1e-9)
    before, after = (colour_errors(seen @ m.T, XYZ, WHITE) for m in (start, ours @ start))
    assert np.square(after).mean() < np.square(before).mean() - 1e-4


def test_a_camera_that_sees_as_the_eye_is_found_exactly() -> None:
    truth = np.array([[0.9, 0.2, -0.1], [-0.3, 1.2, 0.1], [0.0, 0.1, 0.8]])
    found = fit_through(XYZ @ truth.T, XYZ, truth @ WHITE, WHITE)
    np.testing.assert_allclose(found, np.linalg.inv(truth), atol=1e-9)
    np.testing.assert_allclose(refinement(XYZ, XYZ, WHITE), np.eye(3), atol=1e-6)


def test_noise_is_not_amplified() -> None:
    """Nine smooth channels say little more than four: without a word of noise large weights of either sign cancel."""
    seen = channels(9)
    free, held = (fit_through(seen, XYZ, np.ones(9), WHITE, noise) for noise in (0.0, 1e-3))
    assert np.abs(held).sum() < 0.2 * np.abs(free).sum()
