"""Flicker of mains light in a sequence: how much brighter each frame is because of it (docs/method.md#flicker).

Lamps on mains of 50 or 60 Hz flicker at 100 or 120 Hz. A camera of r frames a second sees this, and its second harmonic, at
the nearest distance to a multiple of r: 100 Hz at 30 frames a second is 10 Hz. The log brightness of a sequence is a slow
trend, jumps where the light or the picture changes, and sines of these few known frequencies. They are fitted to the
differences from frame to frame, where a jump is one outlier, which the fit leaves out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.exposure import SpreadSamples

LOOKAHEAD = 16  # frames on either side of a frame that its flicker is fitted to
LEAST_STEPS = 8  # differences between frames, for a fit
LEAST_CYCLES = 2.0  # of a sine within that window: slower ones are changes of light
MAINS_HZ = (50, 60)
HARMONICS = (2, 4)  # of the mains: light has no sign, so it flickers at twice its frequency
LEAST_SIGNAL = 0.005  # of full scale, of a patch whose ratio counts
LEAST_PATCHES = 50
LEAST_SUM, BIWEIGHT = 10, 5  # rounds of reweighting: for the least sum of magnitudes, then by Tukey's biweight
EXACT = 5e-4  # log ratio up to which a step agrees with a fit, however small the others' errors are
OUTLIER = 4.685  # standard deviations, of Tukey's biweight
Array = NDArray[np.float64]


class BrightnessRatio:
    """The log ratio of the brightness of each frame to that of the frame before, from about 1500 patches of the raw values.

    It is the median over the patches, so that what moves does not count as long as it is less than half of the picture.
    """

    def __init__(self, table: TransformTable) -> None:
        self._samples = SpreadSamples(table)
        self._before: Array | None = None

    def of(self, frame: RawFrame) -> float:
        """Return the log ratio to the frame before; 0 of the first frame, and where patches are dark or clipped."""
        patches = self._samples.patches(frame)
        signal = self._samples.signal(patches)
        now = np.where((signal < 1).all(axis=1), signal.mean(axis=1, dtype=np.float64), np.nan) / frame.gain
        before, self._before = self._before, now
        if before is None or before.shape != now.shape:
            return 0.0
        usable = np.minimum(now, before) * frame.gain > LEAST_SIGNAL  # false where one is not known
        if usable.sum() < LEAST_PATCHES:
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
        Frames in which a sine must have LEAST_CYCLES, and differ from another by one cycle.

    Returns
    -------
    list of float
        None at which the light seems steady or changes slowly.
    """
    found: list[float] = []
    for harmonic in HARMONICS:
        cycles = Fraction(mains * harmonic) / rate
        seen = float(abs(cycles - round(cycles)))
        if seen * frames >= LEAST_CYCLES and all(abs(seen - other) * frames >= 1 for other in found):
            found.append(seen)
    return found


@dataclass(frozen=True)
class Flicker:
    """The flicker of a frame."""

    log: float  # of the factor by which it makes the frame brighter
    mains: int | None  # Hz, of the mains that explain it; None: no flicker is seen


def flicker_at(time: float, times: Sequence[float], ratios: Sequence[float], rate: Fraction) -> Flicker:
    """Fit the flicker of mains light to the brightness of the frames around one frame.

    Parameters
    ----------
    time : float
        Time of the frame whose flicker is wanted, in frames.
    times : sequence of float
        Times of the frames around it, in frames, rising.
    ratios : sequence of float
        Log ratio of the brightness of each of these frames to the one before it; that of the first does not count.
    rate : Fraction
        Frames per second.

    Returns
    -------
    Flicker
        Of the mains frequency that fits best, shrunk by the share of the variance that the fit leaves unexplained.
    """
    at, steps = np.asarray(times, np.float64), np.asarray(ratios, np.float64)[1:]
    best, least = Flicker(0.0, None), np.inf
    if steps.size < LEAST_STEPS:
        return best
    total = _spread(steps - np.median(steps))
    for mains in MAINS_HZ:
        angles = 2 * np.pi * np.array(seen_frequencies(mains, rate, at.size))
        if not angles.size or total == 0:
            continue
        phase = np.outer(at - time, angles)
        sines = np.hstack([np.cos(phase), np.sin(phase)])
        # The mains and the camera's clock are off by a little, so the first sine may change within the window.
        changing = sines[:, [0, angles.size]] * ((at - time) / LOOKAHEAD)[:, None]
        basis = np.hstack([np.diff(sines, axis=0), np.diff(changing, axis=0), np.diff(at)[:, None]])  # and a slow trend
        solution, residual = _robust(basis, steps)
        if residual < least:
            explained = max(0.0, 1.0 - (residual / total) ** 2)
            least = residual
            best = Flicker(float(solution[: angles.size].sum() * explained), mains)  # every cosine is 1 at the frame
    return best


def _robust(basis: Array, values: Array) -> tuple[Array, float]:
    """Return the solution of basis · x = values without outliers, and the spread of what is left."""
    weights = np.ones(values.size)
    for number in range(LEAST_SUM + BIWEIGHT):
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(basis * root[:, None], values * root, rcond=1e-9)[0]
        left = values - basis @ solution
        scale = max(_spread(left), EXACT)
        if number < LEAST_SUM:
            weights = EXACT / np.maximum(np.abs(left), EXACT)
        else:
            weights = np.square(np.clip(1 - np.square(left / (OUTLIER * scale)), 0, None))
    return np.asarray(solution, np.float64), _spread(left)


def _spread(values: Array) -> float:
    """Return the standard deviation of a normal distribution with the same median of magnitudes."""
    return float(np.median(np.abs(values)) * 1.4826)
