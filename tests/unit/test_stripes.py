"""Stripes with the period of the array (docs/method.md#stripes)."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.physics import spectra
from l3cli.training.plain_surfaces import (
    MAX_STRIPE_CHROMAS,
    MIN_STRIPE_CHROMA,
    UNLIKE,
    false_colours,
    optimal_reflectances,
    shares,
    uniform_stripes,
)
from tests.helpers.paths import CONFIGS

BAYER = np.array([[0, 1], [1, 2]])
QUAD_BAYER = np.kron(BAYER, np.ones((2, 2), int))


def test_the_finest_checkerboard_is_green_or_magenta_to_bayer() -> None:
    np.testing.assert_array_equal(uniform_stripes(BAYER, 3), [[-1, 1, -1], [1, -1, 1]])


def test_pairs_of_equal_sites_see_every_stripe() -> None:
    assert uniform_stripes(QUAD_BAYER, 3).shape == (0, 3)


@settings(max_examples=30, deadline=None)
@given(hnp.arrays(int, st.sampled_from([(2, 2), (2, 4), (4, 4)]), elements=st.integers(0, 3)))
def test_stripes_are_gratings_that_each_channel_sees_as_uniform(cfa: np.ndarray) -> None:
    _, cfa = np.unique(cfa, return_inverse=True)  # channels without a gap
    cfa = cfa.reshape(cfa.shape)
    for stripe in uniform_stripes(cfa, int(cfa.max()) + 1):
        mosaic = stripe[cfa]
        waves = np.abs(np.fft.fft2(mosaic)).round(4)
        assert waves[0, 0] == 0
        assert np.count_nonzero(waves) <= 2  # a frequency and its mirror image
        assert np.ptp(stripe) > 0.5


# No camera whose channels are few and far apart: its colours may be anybody's.
@pytest.mark.parametrize(
    ("camera", "count", "one"),
    [
        ("bayer", 0, None),
        ("xtrans", 0, None),
        ("fiveband", 6, [1, 0, -1, -1, 1]),  # r and c bright, b and o dark
        ("rccb", 1, [1, -1, 1]),  # red and blue without what lies between
        ("snapshot16", MAX_STRIPE_CHROMAS, None),
    ],
)
def test_colours_are_false_that_no_surface_has(camera: str, count: int, one: Sequence[int] | None) -> None:
    model = load_camera(CONFIGS / f"cameras/{camera}.toml")
    wavelength = spectra.light_grid(model.wavelength).astype(float)
    light = np.asarray(spectra.illuminant("D65", wavelength), float)
    false = false_colours(model, wavelength, light)
    assert len(false) == count
    assert one is None or one in false.tolist()
    electrons = model.signal_weights @ spectra.sampling_matrix(wavelength, model.wavelength) * light
    optimal = shares(optimal_reflectances(wavelength) @ electrons.T)
    white = shares(electrons.sum(axis=1))
    for stripe in false:
        colour = shares(white * (1 + 0.65 * stripe))
        distance = np.linalg.norm(colour - white)
        assert distance >= MIN_STRIPE_CHROMA
        assert np.linalg.norm(optimal - colour, axis=1).min() >= UNLIKE * distance


def test_a_light_that_leaves_a_channel_dark_has_no_false_colours() -> None:
    model = load_camera(CONFIGS / "cameras/fiveband.toml")
    wavelength = spectra.light_grid(model.wavelength).astype(float)
    assert len(false_colours(model, wavelength, np.zeros(wavelength.size))) == 0
