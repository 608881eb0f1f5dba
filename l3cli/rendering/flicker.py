"""Estimate by how much mains flicker brightens or darkens each frame of a sequence (docs/method.md#flicker).

Lamps on 50 or 60 Hz mains flicker at 100 or 120 Hz. At r frames per second, this frequency and its second harmonic alias to
their distances from the nearest multiple of r. For example, 100 Hz appears as 10 Hz at 30 frames per second.

The log brightness is modelled as the sum of a slow trend, jumps at scene changes, and sines at the aliased frequencies. The
model is fitted to differences between consecutive frames, where a jump is a single outlier that the robust fit ignores.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.exposure import SpreadSamples

LOOKAHEAD = 16  # the flicker of a frame is estimated from this number of frames before and after it
MIN_STEPS = 8  # a fit needs at least this number of frame differences
MIN_CYCLES = 2.0  # flicker with fewer cycles among the frames of a fit counts as a change in the scene
MAINS_HZ = (50, 60)
HARMONICS = (2, 4)  # flicker frequencies as multiples of the mains frequency: fundamental and second harmonic
MIN_SIGNAL = 0.005  # smallest signal of a usable patch, as a fraction of full scale
MIN_PATCHES = 50  # a brightness ratio needs at least this number of usable patches
L1_ROUNDS = 10  # iterations that minimise absolute deviations
BIWEIGHT_ROUNDS = 5  # further iterations with Tukey's biweight
EXACT = 5e-4  # lower limit for the standard deviation of the residuals, which are log brightness ratios
OUTLIER = 4.685  # cut-off of Tukey's biweight, in standard deviations
Array = NDArray[np.float64]


class BrightnessRatio:
    """Compares the brightness of each frame with the previous frame.

    The ratio is a median over about 1500 raw patches. Motion hardly affects it, as long as moving objects cover less than
    half of the frame.
    """

    def __init__(self, table: TransformTable) -> None:
        self._samples = SpreadSamples(table)
        self._before: Array | None = None

    def of(self, frame: RawFrame) -> float:
        """Return the natural logarithm of the frame's brightness, relative to the previous frame.

        Patches that are dark or clipped in either frame are not used. For the first frame, or if fewer than MIN_PATCHES
        patches are usable, the result is 0.
        """
        patches = self._samples.patches(frame)
        signal = self._samples.signal(patches)
        now = np.where((signal < 1).all(axis=1), signal.mean(axis=1, dtype=np.float64), np.nan) / frame.gain
        before, self._before = self._before, now
        if before is None or before.shape != now.shape:
            return 0.0
        usable = np.minimum(now, before) * frame.gain > MIN_SIGNAL  # false for clipped patches (NaN)
        if usable.sum() < MIN_PATCHES:
            return 0.0
        return float(np.median(np.log(now[usable] / before[usable])))


def seen_frequencies(mains: int, rate: Fraction, frames: int) -> list[float]:
    """Return the aliased flicker frequencies in a sequence, in cycles per frame.

    A frequency is omitted if it has fewer than `MIN_CYCLES` cycles in the sequence. The second harmonic is also omitted if
    its number of cycles differs by less than one from the number of cycles of the fundamental.

    Parameters
    ----------
    mains : int
        Mains frequency in Hz.
    rate : Fraction
        Frames per second.
    frames : int
        Number of frames in the sequence.

    Returns
    -------
    list of float
        The aliased frequency of the fundamental, then of the second harmonic, unless they are omitted.
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
    """Flicker of one frame."""

    log: float  # natural logarithm of the factor by which flicker brightens the frame
    mains: int | None  # mains frequency in Hz, or None if no flicker was found


def flicker_at(time: float, times: Sequence[float], ratios: Sequence[float], rate: Fraction) -> Flicker:
    """Estimate the flicker of one frame from the brightness of the surrounding frames.

    Parameters
    ----------
    time : float
        Time of the frame, in frame intervals.
    times : sequence of float
        Times of the surrounding frames in frame intervals, in increasing order.
    ratios : sequence of float
        Log brightness of each surrounding frame, relative to its predecessor (`BrightnessRatio.of`). The first value is not
        used.
    rate : Fraction
        Frames per second.

    Returns
    -------
    Flicker
        Flicker at the mains frequency that fits better. Its logarithm is multiplied by the fraction of variance that the fit
        explains, so that a poor fit changes little.
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
        # The amplitude and phase of the first sine may drift, because neither mains frequency nor frame rate is exact.
        changing = sines[:, [0, angles.size]] * ((at - time) / LOOKAHEAD)[:, None]
        trend = np.diff(at)[:, None]
        basis = np.hstack([np.diff(sines, axis=0), np.diff(changing, axis=0), trend])
        solution, residual = _robust(basis, steps)
        if residual < least:
            explained = max(0.0, 1.0 - (residual / total) ** 2)
            least = residual
            best = Flicker(float(solution[: angles.size].sum() * explained), mains)  # at `time`, all cosines are 1
    return best


def _robust(basis: Array, values: Array) -> tuple[Array, float]:
    """Solve basis · x = values robustly, and return x and the standard deviation of the residuals.

    The method is iteratively reweighted least squares. It first minimises absolute deviations, then excludes outliers.
    """
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
    """Estimate the standard deviation of zero-mean values robustly, from their median absolute value."""
    return float(np.median(np.abs(values)) * 1.4826)
