"""Detect blinking pixels in dark frames (docs/method.md#blinking-pixels).

A blinking pixel switches between two levels at random, for example because its transistor traps and releases single
electrons (random telegraph noise). Its values have a distribution with two peaks. A hot pixel also has an increased
variance, but only one peak.

1. Each frame's row and column offsets are subtracted. The variance of each pixel over the frames is computed.
2. Pixels with less than twice the median variance are not blinking. The values of each remaining pixel are divided into a
   lower and an upper group with at least `MIN_STATE` values each, such that the variance between the groups is as large as
   possible (Otsu, 1979).
3. The pixel is blinking if two conditions are met. The variance between the groups, as a fraction of the total variance,
   must exceed `highest_share`. Normally distributed values exceed this limit with a probability of `FALSE_ALARMS`, whatever
   their variance. The levels must differ by at least `MIN_SIGMAS` standard deviations of a normal pixel, and by more than
   rounding can explain.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.statistics import Defects, by_site
from l3cli.frames.measurement import Body, Capture

MIN_FRAMES = 32  # minimum number of dark frames with the same exposure time
FALSE_ALARMS = 1e-6  # probability that a pixel with normally distributed noise is classified as blinking
# For each number of frames, the result of `two_levels` (`share`) that normally distributed values exceed with the
# probability FALSE_ALARMS. The values were simulated, with the tail below 0.1 % extrapolated exponentially (checked by
# tests/science/test_blinking.py).
SHARE_OF_COUNT = {32: 0.896, 64: 0.832, 128: 0.778, 256: 0.740, 512: 0.710}
MIN_STATE = 3  # minimum number of values at each level, so that one or two particle hits have no effect
MIN_SIGMAS = 4.0  # minimum difference between the levels, in standard deviations of a normal pixel
MIN_STEP_DN = 2.0  # minimum difference between the levels in DN, because rounding alone produces two levels 1 DN apart
MIN_EXCESS = 2.0  # minimum variance, relative to the median variance
Array = NDArray[np.float64]


@dataclass(frozen=True)
class BlinkingPixels:
    """The blinking pixels of a sensor."""

    frames: int  # number of dark frames in which they were found
    position: Defects  # (pixel, 2): row and column
    step: Array  # (pixel,) DN; difference between the levels


def find_blinking(captures: Sequence[Capture], trials: Sequence[int], body: Body) -> BlinkingPixels | None:
    """Find blinking pixels in the dark capture with the most frames.

    `trials` contains the number of frames in each capture. If no capture has MIN_FRAMES frames, return None.
    """
    most = int(np.argmax(trials))
    if trials[most] < MIN_FRAMES:
        return None
    count, variance = trials[most], np.zeros((body.rows, body.cols))
    total = np.zeros_like(variance)
    for difference in _levelled(captures[most], body):
        total += difference
        variance += difference**2
    variance = (variance - total**2 / count) / (count - 1)
    usual = np.empty_like(variance)
    for (_, site), (_, target) in zip(by_site(variance, body.cfa), by_site(usual, body.cfa), strict=True):
        target[...] = np.median(site)
    row, col = np.nonzero(variance > MIN_EXCESS * usual)
    values = np.array([difference[row, col] for difference in _levelled(captures[most], body)])
    share, step = two_levels(values)
    blinking = (share > highest_share(count)) & (step > np.maximum(MIN_SIGMAS * np.sqrt(usual[row, col]), MIN_STEP_DN))
    position = np.stack([row, col], axis=1)[blinking].astype(np.int64)
    return BlinkingPixels(count, position, step[blinking])


def _levelled(capture: Capture, body: Body) -> Iterator[Array]:
    """Yield the difference between each frame and the first frame, without row and column offsets."""
    frames = iter(capture.frames)
    first = next(frames)
    for frame in itertools.chain([first], frames):
        difference = frame.astype(np.float64) - first
        for _, site in by_site(difference, body.cfa):
            site -= site.mean(axis=1, keepdims=True)
            site -= site.mean(axis=0)
        yield difference


def two_levels(values: Array) -> tuple[Array, Array]:
    """Divide each pixel's values into two groups, with the largest possible variance between the groups (Otsu's method).

    Parameters
    ----------
    values : ndarray, (frame, pixel)
        Values of the pixels.

    Returns
    -------
    share : ndarray, (pixel,)
        Variance between the groups as a fraction of the total variance.
    step : ndarray, (pixel,)
        Difference between the means of the groups.
    """
    count, centred = len(values), np.sort(values - values.mean(axis=0), axis=0)
    below = np.arange(MIN_STATE, count - MIN_STATE + 1)[:, None]
    sums = centred.cumsum(axis=0)[MIN_STATE - 1 : count - MIN_STATE]  # sum of the lower group; the sum of all values is 0
    between = sums**2 * count / (below * (count - below))
    best = between.argmax(axis=0)
    pixels = np.arange(values.shape[1])
    squares = (centred**2).sum(axis=0)
    share = between[best, pixels] / np.where(squares > 0, squares, 1.0)
    lower = below[best, 0]
    step = -sums[best, pixels] * count / (lower * (count - lower))
    return share, step


def highest_share(count: int) -> float:
    """Return the detection limit for `share` from `two_levels`, for `count` frames.

    Normally distributed values exceed it with the probability FALSE_ALARMS.
    """
    counts, shares = zip(*SHARE_OF_COUNT.items(), strict=True)
    return float(np.interp(np.log(count), np.log(counts), shares))
