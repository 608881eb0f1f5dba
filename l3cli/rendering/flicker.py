"""Estimates by how much the flicker of mains light brightens or darkens each frame of a sequence (docs/method.md#flicker).

Lamps on mains of 50 or 60 Hz flicker at 100 or 120 Hz. In a sequence with r frames per second, this frequency and its second
harmonic are aliased to the distance from the nearest multiple of r. For example, 100 Hz appears as 10 Hz at 30 frames per
second.

The log brightness of a sequence is modelled as the sum of a slow trend, of jumps where light or content change, and of sines
at these known frequencies. The model is fitted to the differences between consecutive frames. A jump is then a single
outlier, which the robust fit ignores.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.exposure import SpreadSamples

LOOKAHEAD = 16  # number of frames before and after a frame from which its flicker is estimated
MIN_STEPS = 8  # smallest number of frame differences for a fit
MIN_CYCLES = 2.0  # smallest number of cycles of a sine within the window; slower changes are changes of light
MAINS_HZ = (50, 60)
HARMONICS = (2, 4)  # multiples of the mains frequency; power has twice the frequency of the voltage
MIN_SIGNAL = 0.005  # fraction of full scale; darker patches are not used
MIN_PATCHES = 50
L1_ROUNDS, BIWEIGHT_ROUNDS = 10, 5  # rounds of reweighting, for least absolute deviations and then with Tukey's biweight
EXACT = 5e-4  # log ratio; smaller residuals are never treated as outliers
OUTLIER = 4.685  # cut-off of Tukey's biweight, in standard deviations
Array = NDArray[np.float64]


class BrightnessRatio:
    """Computes the log ratio of each frame's brightness to the previous frame's, from about 1500 patches of raw values.

    It is the median over the patches, so that motion has no influence if it covers less than half of the picture.
    """

    def __init__(self, table: TransformTable) -> None:
        self._samples = SpreadSamples(table)
        self._before: Array | None = None

    def of(self, frame: RawFrame) -> float:
        """Return the log ratio to the previous frame.

        It is 0 for the first frame, and if all patches are dark or clipped.
        """
        patches = self._samples.patches(frame)
        signal = self._samples.signal(patches)
        now = np.where((signal < 1).all(axis=1), signal.mean(axis=1, dtype=np.float64), np.nan) / frame.gain
        before, self._before = self._before, now
        if before is None or before.shape != now.shape:
            return 0.0
        usable = np.minimum(now, before) * frame.gain > MIN_SIGNAL  # false where one of them is NaN
        if usable.sum() < MIN_PATCHES:
            return 0.0
        return float(np.median(np.log(now[usable] / before[usable])))


def seen_frequencies(mains: int, rate: Fraction, frames: int) -> list[float]:
    """Return the frequencies, in cycles per frame, at which a sequence shows the flicker of a mains frequency.

    Parameters
    ----------
    mains : int
        Frequency of the mains in Hz.
    rate : Fraction
        Frames per second.
    frames : int
        Number of frames within which a sine must have at least MIN_CYCLES cycles, and differ from other sines by at least
        one cycle.

    Returns
    -------
    list of float
        The frequencies. Frequencies at which the light looks steady or changes slowly are left out.
    """
    found: list[float] = []
    for harmonic in HARMONICS:
        cycles = Fraction(mains * harmonic) / rate
        seen = float(abs(cycles - round(cycles)))
        if seen * frames >= MIN_CYCLES and all(abs(seen - other) * frames >= 1 for other in found):
            found.append(seen)
    return found


@dataclass(frozen=True)
class Flicker:
    """The flicker of a frame."""

    log: float  # logarithm of the factor by which flicker brightens the frame
    mains: int | None  # Hz; None if no flicker is seen


def flicker_at(time: float, times: Sequence[float], ratios: Sequence[float], rate: Fraction) -> Flicker:
    """Fit the flicker of mains light to the brightness of the frames around one frame.

    Parameters
    ----------
    time : float
        Time of the frame, in frames.
    times : sequence of float
        Times of the surrounding frames, in frames, in increasing order.
    ratios : sequence of float
        Log ratio of the brightness of each of these frames to that of the previous one. The first value is not used.
    rate : Fraction
        Frames per second.

    Returns
    -------
    Flicker
        Flicker at the best-fitting mains frequency, multiplied by the fraction of the variance that the fit explains.
    """
    at, steps = np.asarray(times, np.float64), np.asarray(ratios, np.float64)[1:]
    best, least = Flicker(0.0, None), np.inf
    if steps.size < MIN_STEPS:
        return best
    total = _spread(steps - np.median(steps))
    for mains in MAINS_HZ:
        angles = 2 * np.pi * np.array(seen_frequencies(mains, rate, at.size))
        if not angles.size or total == 0:
            continue
        phase = np.outer(at - time, angles)
        sines = np.hstack([np.cos(phase), np.sin(phase)])
        # The frequencies of the mains and of the camera's clock are not exact, so the first sine may change in the window.
        changing = sines[:, [0, angles.size]] * ((at - time) / LOOKAHEAD)[:, None]
        basis = np.hstack([np.diff(sines, axis=0), np.diff(changing, axis=0), np.diff(at)[:, None]])  # last: the trend
        solution, residual = _robust(basis, steps)
        if residual < least:
            explained = max(0.0, 1.0 - (residual / total) ** 2)
            least = residual
            best = Flicker(float(solution[: angles.size].sum() * explained), mains)  # all cosines are 1 at this frame
    return best


def _robust(basis: Array, values: Array) -> tuple[Array, float]:
    """Return a robust solution of basis · x = values, and the standard deviation of the residuals."""
    weights = np.ones(values.size)
    for number in range(L1_ROUNDS + BIWEIGHT_ROUNDS):
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(basis * root[:, None], values * root, rcond=1e-9)[0]
        left = values - basis @ solution
        scale = max(_spread(left), EXACT)
        if number < L1_ROUNDS:
            weights = EXACT / np.maximum(np.abs(left), EXACT)
        else:
            weights = np.square(np.clip(1 - np.square(left / (OUTLIER * scale)), 0, None))
    return np.asarray(solution, np.float64), _spread(left)


def _spread(values: Array) -> float:
    """Return the standard deviation of a normal distribution with the same median absolute value."""
    return float(np.median(np.abs(values)) * 1.4826)
