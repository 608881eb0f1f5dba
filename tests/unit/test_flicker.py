"""Flicker of mains lamps is found in the brightness of a sequence, and other changes are not mistaken for flicker."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from l3cli.frames.frame import RawFrame
from l3cli.rendering.flicker import LOOKAHEAD, BrightnessRatio, flicker_at, seen_frequencies
from tests.helpers.cameras import BAYER
from tests.helpers.tables import random_table

RATES = [(30, 100.0), (25, 120.0), (24, 100.0), (Fraction(30000, 1001), 100.0), (50, 120.0), (240, 100.0), (30, 99.9)]
LIMIT = 0.005  # RMS that is left, of 5.7 %


def mains(rate: Fraction | float, hertz: float, frames: int) -> np.ndarray:
    """Log brightness of frames under a lamp of 5.7 % RMS."""
    return np.log1p(0.0806 * np.sin(2 * np.pi * hertz * np.arange(frames) / float(rate) + 1))


def removed(brightness: np.ndarray, rate: Fraction | float) -> np.ndarray:
    """Flicker of each frame, by the frames around it."""
    ratios = np.diff(brightness, prepend=brightness[0])
    found = []
    for time in range(brightness.size):
        window = slice(max(0, time - LOOKAHEAD), time + LOOKAHEAD + 1)
        times = np.arange(brightness.size, dtype=float)[window]
        found.append(flicker_at(float(time), list(times), list(ratios[window]), Fraction(rate)).log)
    return np.array(found)


TRENDS = {
    "still": lambda frame: 0.0 * frame,
    "switched on": lambda frame: 0.7 * (frame > frame.size // 2),
    "dimmed": lambda frame: -0.01 * frame,
    "noisy": lambda frame: np.random.default_rng(1).normal(0, 0.003, frame.size),
}


@pytest.mark.parametrize("trend", TRENDS)
@pytest.mark.parametrize(("rate", "hertz"), RATES)
def test_flicker_is_found_beside_changes_of_light(rate: Fraction | float, hertz: float, trend: str) -> None:
    change = TRENDS[trend](np.arange(60.0))
    left = mains(rate, hertz, 60) + change - removed(mains(rate, hertz, 60) + change, rate) - change
    assert (left - left.mean()).std() < LIMIT


@pytest.mark.parametrize("trend", ["still", "switched on", "dimmed"])
def test_changes_of_light_alone_are_no_flicker(trend: str) -> None:
    np.testing.assert_allclose(removed(TRENDS[trend](np.arange(60.0)), 30), 0, atol=1e-6)


@pytest.mark.parametrize(
    ("hertz", "rate", "cycles"),
    [(50, 30, [1 / 3]), (50, 25, []), (60, 30, []), (60, 25, [0.2, 0.4]), (50, 240, [5 / 12, 1 / 6])],
)
def test_the_frequencies_that_a_camera_sees(hertz: int, rate: int, cycles: list[float]) -> None:
    np.testing.assert_allclose(seen_frequencies(hertz, Fraction(rate), 33), cycles)


def test_the_ratio_is_that_of_what_stays() -> None:
    """Whatever crosses a fifth of the picture, clips, or is amplified in the camera."""
    meter = BrightnessRatio(random_table(BAYER, 12, 64.0))
    scene = np.random.default_rng(0).uniform(300, 1500, (80, 96))
    first = RawFrame("a", np.rint(64 + scene).astype(np.uint16), 64.0, 4095.0)
    assert meter.of(first) == 0
    later = np.rint(64 + scene * 1.1 * 2).astype(np.uint16)
    later[20:36] = 1000
    later[:5] = 4095
    ratio = meter.of(replace(first, values=later, gain=2.0))
    assert ratio == pytest.approx(np.log(1.1), abs=1e-3)
