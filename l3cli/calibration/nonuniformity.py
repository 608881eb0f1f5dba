"""Compute spectra, profiles and histograms of DSNU and PRNU, as in EMVA 1288, release 4.0.

All results apply to the whole sensor. The mean of each CFA site is subtracted first, so that differences between channels
have no effect. See docs/method.md#dark-and-white-frames.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.fit import Nonuniformity
from l3cli.calibration.statistics import by_site
from l3cli.frames.measurement import Body

MAX_FREQUENCIES = 128  # largest number of points in a spectrum
MAX_POSITIONS = 200  # largest number of points in a profile
BINS = 200  # number of bins in a histogram
BINS_PER_SIGMA = 8  # bins per standard deviation; bins are wider if BINS of them would not cover all deviations
THRESHOLDS = 64  # number of thresholds in an accumulated histogram
LOWEST_THRESHOLD = 0.1  # lowest threshold of an accumulated histogram, in standard deviations
Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseLeft:
    """Variances of the temporal noise that remains in a mean of frames."""

    pixels: float
    rows: float  # noise that all pixels of a row share
    columns: float


def centred(picture: Array, repaired: Array, body: Body, relative: bool) -> Array:
    """Subtract the mean of each CFA site.

    Parameters
    ----------
    picture : ndarray, (row, col)
        Offset or response of each pixel.
    repaired : ndarray, (row, col)
        The same picture with defective pixels interpolated. The means are computed from it.
    body : Body
        Filter array and channel gains of the camera.
    relative : bool
        Whether to divide the result by the site's mean, instead of the channel's relative gain.
    """
    result = np.empty(picture.shape)
    sites = zip(by_site(result, body.cfa), by_site(picture, body.cfa), by_site(repaired, body.cfa), strict=True)
    for (channel, target), (_, site), (_, sound) in sites:
        mean = sound.mean()
        target[...] = (site - mean) / (mean if relative else body.channel_gains[channel])
    return result


def describe(picture: Array, repaired: Array, deviation: Array, left: NoiseLeft) -> Nonuniformity:
    """Compute spectra, profiles and histograms of a fixed pattern.

    Parameters
    ----------
    picture, repaired : ndarray, (row, col)
        Results of `centred`, with and without defective pixels. The spectra are computed from `repaired`.
    deviation : ndarray, (row, col)
        Each pixel's deviation for the histograms: `picture`, or a version of it without shading.
    left : NoiseLeft
        Temporal noise in `picture`, which is subtracted from the spectra.
    """
    count = min(MAX_FREQUENCIES, *(length // 2 for length in picture.shape))
    spectra = (
        power_spectrum(repaired, axis, count) - left.pixels - lines for axis, lines in ((1, left.columns), (0, left.rows))
    )
    horizontal, vertical = (np.sqrt(np.maximum(power, 0.0)) for power in spectra)
    (column, columns), (row, rows) = (profile(picture, axis) for axis in (1, 0))
    spread = float((deviation if deviation is not picture else repaired).std()) or np.finfo(float).tiny
    edges, counts = histogram(deviation, spread)
    threshold, exceeding = accumulated(deviation, spread)
    return Nonuniformity(
        frequency=(np.arange(count) + 0.5) / (2 * count),
        horizontal_spectrum=horizontal,
        vertical_spectrum=vertical,
        column=column,
        horizontal_profile=columns,
        row=row,
        vertical_profile=rows,
        histogram_edge=edges,
        histogram_count=counts,
        threshold=threshold,
        exceeding=exceeding,
        spread=spread,
    )


def power_spectrum(picture: Array, axis: int, count: int) -> Array:
    """Compute the power spectrum along an axis, averaged over all lines.

    The result is the mean power in `count` equal frequency ranges from 0 to 0.5 cycles per pixel, without the constant
    component. For white noise, it equals the variance at every frequency.
    """
    length = picture.shape[axis]
    lines = picture if axis == 1 else picture.T
    total = np.zeros(length // 2 + 1)
    for start in range(0, len(lines), 256):  # in parts, to limit memory use for large sensors
        total += (np.abs(np.fft.rfft(lines[start : start + 256], axis=1)) ** 2).sum(axis=0)
    index = np.arange(1, length // 2 + 1)
    place = (index * 2 * count - 1) // length
    return np.asarray(np.bincount(place, total[1:], count) / np.bincount(place, minlength=count) / (length * len(lines)))


def profile(picture: Array, axis: int) -> tuple[Array, Array]:
    """Return positions along an axis, and the profile (4, position): mean, minimum, maximum and middle line.

    The mean, minimum and maximum are computed over all lines in a short range around each position. The middle line is
    sampled at the position itself.
    """
    lines = picture if axis == 1 else picture.T
    length = lines.shape[1]
    starts = np.linspace(0, length, min(length, MAX_POSITIONS) + 1).astype(int)
    widths = np.diff(starts)
    position = starts[:-1] + widths // 2
    return position.astype(np.float64), np.stack(
        [
            np.add.reduceat(lines.mean(axis=0), starts[:-1]) / widths,
            np.minimum.reduceat(lines.min(axis=0), starts[:-1]),
            np.maximum.reduceat(lines.max(axis=0), starts[:-1]),
            lines[len(lines) // 2, position],
        ]
    )


def histogram(deviation: Array, spread: float) -> tuple[Array, NDArray[np.int64]]:
    """Return the edges and counts of a histogram with equal bins. `spread` is the standard deviation of the deviations."""
    low, high = float(deviation.min()), float(deviation.max())
    reach = max(0.5 * BINS / BINS_PER_SIGMA * spread, 0.51 * (high - low))
    edges = (low + high) / 2 + np.linspace(-reach, reach, BINS + 1)
    return edges, np.histogram(deviation, edges)[0].astype(np.int64)


def accumulated(deviation: Array, spread: float) -> tuple[Array, NDArray[np.int64]]:
    """Return thresholds, and the number of pixels with an absolute deviation of at least each threshold."""
    absolute = np.sort(np.abs(deviation), axis=None)
    lowest = LOWEST_THRESHOLD * spread
    threshold = np.geomspace(lowest, max(float(absolute[-1]), 2 * lowest), THRESHOLDS)
    threshold[-1] = max(float(absolute[-1]), 2 * lowest)
    return threshold, (absolute.size - np.searchsorted(absolute, threshold)).astype(np.int64)
