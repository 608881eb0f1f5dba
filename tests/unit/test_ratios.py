"""Chroma as light and shade would make it, of planes whose truth is known."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from l3cli.classes.ratios import DARKEST, shaded_chroma

SHAPE = (9, 12)


def planes_of(luminance: NDArray[np.floating], first: float, second: float) -> NDArray[np.float64]:
    """Planes (plane, row, col) of one colour, whose chroma is `first` and `second` times its luminance."""
    return np.stack([first * luminance, luminance, second * luminance])


def means(plane: NDArray[np.floating], side: int) -> NDArray[np.float64]:
    """Over side × side about the pixels that have all of it."""
    return np.lib.stride_tricks.sliding_window_view(plane, (side, side)).mean(axis=(-2, -1), dtype=np.float64)


@given(
    st.integers(0, 2**32 - 1), st.sampled_from([3, 5, 7]), st.floats(-2, 2), st.floats(-2, 2), st.floats(DARKEST, 2.0**20)
)
def test_of_one_colour_it_is_all_that_chroma_differs_by(
    seed: int, side: int, first: float, second: float, level: float
) -> None:
    """Whatever light falls on it, up to twice its mean."""
    luminance = level * (1.2 + np.random.default_rng(seed).random(SHAPE))
    planes = planes_of(luminance, first, second)
    reach = side // 2
    inside = np.s_[reach:-reach, reach:-reach]
    for made, plane in zip(shaded_chroma(planes, side), planes[[0, 2]], strict=True):
        np.testing.assert_allclose(made[inside], plane[inside] - means(plane, side), atol=1e-9 * level)


@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.booleans())
def test_it_turns_with_the_planes(seed: int, turns: int, mirrored: bool) -> None:
    planes = np.random.default_rng(seed).normal(0, 2000, (3, *SHAPE))

    def turned(values: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.rot90(values[..., ::-1] if mirrored else values, turns, (1, 2))

    np.testing.assert_allclose(shaded_chroma(turned(planes), 5), turned(shaded_chroma(planes, 5)), atol=1e-8)


def test_flat_areas_and_greys_have_none() -> None:
    flat = planes_of(np.full(SHAPE, 5000.0), 0.3, -0.2)
    assert np.abs(shaded_chroma(flat, 5)).max() < 1e-9
    grey = planes_of(np.random.default_rng(0).random(SHAPE) * 5000, 0.0, 0.0)
    assert (shaded_chroma(grey, 5) == 0).all()


def test_it_is_never_more_than_the_mean_and_dark_planes_have_little() -> None:
    """A spark, and noise about nothing: what is divided by stays above DARKEST, what is multiplied within one."""
    rng = np.random.default_rng(1)
    spark = np.full(SHAPE, 1000.0)
    spark[4, 5] = 1e6
    planes = planes_of(spark, 0.5, 0.5)
    assert shaded_chroma(planes, 5)[0, 4, 5] == means(planes[0], 5)[2, 3]
    dark = rng.normal(0, DARKEST / 100, (3, *SHAPE))
    assert np.abs(shaded_chroma(dark, 5)).max() < np.abs(dark).max() / 10
