"""Knowledge of responsivities before they are measured: a Gaussian over curves (docs/method.md#charts-in-photographs).

Curves are per photon, each channel scaled to a peak of 1. Of r, g and b measured cameras say what curves look like; of
other dyes only that they are smooth and lie in the visible.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.measurement import CurveStatistics, FinishedCurves
from l3cli.physics import spectra

WAVELENGTH = np.arange(400.0, 721.0, 10.0)  # nm: where published curves of cameras overlap
ROLES = ("r", "g", "b")  # channels that measured cameras have in common
MODES = 16  # of measured cameras; further ones change nothing
SMOOTH_SHARE, SMOOTH_NM = 0.1, 25.0  # of the variance that no measured camera shows; over which it is smooth
LEAST_SPREAD = 0.01  # of the peak: curves of another make differ at least so much
UNKNOWN_MEAN, UNKNOWN_SPREAD, UNKNOWN_NM = 0.3, 0.35, 45.0  # of a dye of which nothing is known
UNKNOWN_PEAK = 0.7  # natural logarithm, spread of the peak of such a channel
PEAK_FLOOR = 0.25  # the same added to the spread of known ones: converter gains differ between channels
JITTER = 1e-6
Array = NDArray[np.floating]


@dataclass(frozen=True)
class Prior:
    """A Gaussian over the curves of a camera, and over the heights of their peaks."""

    mean: Array  # (channel, wavelength)
    covariance: Array  # (channel · wavelength, channel · wavelength)
    log_peak: Array  # (channel)
    log_peak_covariance: Array  # (channel, channel)
    measured: bool  # whether measured cameras say it, or smoothness alone


def statistics(cameras: Sequence[FinishedCurves], modes: int = MODES) -> CurveStatistics:
    """Return those of measured cameras, all with the same channels, by at most `modes` modes."""
    curves = np.array([spectra.average(each.responsivity, each.wavelength, WAVELENGTH) for each in cameras])
    peaks = curves.max(axis=2)
    shapes = curves / peaks[..., None]
    mean = shapes.mean(axis=0)
    flat = (shapes - mean).reshape(len(curves), -1) / np.sqrt(max(len(curves) - 1, 1))
    _, size, directions = np.linalg.svd(flat, full_matrices=False)
    chosen = (size[:, None] * directions)[:modes]
    heights = np.log(peaks) - np.log(peaks).mean(axis=1, keepdims=True)
    spread = np.atleast_2d(np.cov(heights.T)) if len(curves) > 1 else np.zeros((mean.shape[0],) * 2)
    return CurveStatistics(WAVELENGTH, mean, chosen.reshape(-1, *mean.shape), heights.mean(axis=0), spread)


def camera_prior(known: CurveStatistics) -> Prior:
    """Return the prior of a camera whose channels are those of measured cameras."""
    count, size = known.mean.shape
    covariance = _covariance(known.modes).reshape(count * size, count * size) + JITTER * np.eye(count * size)
    return Prior(
        known.mean,
        np.asarray(covariance, np.float64),
        known.log_peak,
        known.log_peak_covariance + PEAK_FLOOR**2 * np.eye(count),
        True,
    )


def smooth(channels: int) -> Prior:
    """Return the prior of channels of which nothing is known: they are smooth, and see visible light."""
    size = WAVELENGTH.size
    one = _smooth(np.full(size, UNKNOWN_SPREAD), UNKNOWN_NM) + JITTER * np.eye(size)
    covariance = np.kron(np.eye(channels), one)
    mean = np.full((channels, size), UNKNOWN_MEAN)
    return Prior(mean, covariance, np.zeros(channels), np.eye(channels) * UNKNOWN_PEAK**2, False)


def turned(known: CurveStatistics, order: Sequence[int]) -> CurveStatistics:
    """Return the same with the channels in another order."""
    ours = np.array(order)
    spread = known.log_peak_covariance[np.ix_(ours, ours)]
    return CurveStatistics(known.wavelength, known.mean[ours], known.modes[:, ours], known.log_peak[ours], spread)


def _covariance(modes: Array) -> Array:
    """(channel, wavelength, channel, wavelength) of modes (mode, channel, wavelength), with a smooth share beside them."""
    _, count, size = modes.shape
    flat = modes.reshape(len(modes), -1)
    sampled = flat.T @ flat
    spread = np.hypot(np.sqrt(np.diag(sampled)).reshape(count, size), LEAST_SPREAD)
    smooth = np.zeros((count, size, count, size))
    for channel in range(count):
        smooth[channel, :, channel] = _smooth(spread[channel], SMOOTH_NM)
    return (1 - SMOOTH_SHARE) * sampled.reshape(count, size, count, size) + SMOOTH_SHARE * smooth


def _smooth(spread: Array, correlation_nm: float) -> Array:
    """Return the covariance (wavelength, wavelength) of what varies by `spread` (wavelength), smoothly over
    `correlation_nm`."""
    isolated = (WAVELENGTH[:, None] - WAVELENGTH) / correlation_nm
    return np.exp(-0.5 * isolated**2) * np.outer(spread, spread)
