"""Estimate lamp drift from disagreements between charts (docs/method.md#drift-of-lamps).

If a lamp is brighter during a capture than when its spectrum was measured, all channel signals increase by the same factor.
During a monochromator sweep, this factor changes slowly with wavelength and distorts the responsivity curves. The curves
alone do not reveal the distortion. In a chart capture, the factor changes the scale of the signals. A comparison between
the measured values of each chart and channel, and the values predicted from the curves, reveals both effects.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.captures import Charts
from l3cli.calibration.responsivity import Sweep, chart_factors, fit_gain, smoothers

MEMORY = 0.8  # correlation of the drift between consecutive captures in the measurement file
# Relative error of a channel's mean over a chart. Errors of 0.5 % in single patches cause half of it.
CHART_ERROR = 0.002
TRIED = np.geomspace(2e-4, 0.2, 100)  # trial values for the relative standard deviation of the drift
EVIDENCE = 4.0  # the estimated drift replaces the declared drift if the log likelihood ratio is at least this value
Array = NDArray[np.float64]


@dataclass(frozen=True)
class DriftError:
    """Lamp drift, estimated from the charts, and the resulting uncertainty of the responsivities."""

    deviation: float  # relative standard deviation of the lamps' brightness since their spectra were measured
    curve_error: Array  # (channel, wavelength): standard deviation of the responsivities, excluding their common scale
    scale_error: float  # relative standard deviation of the common scale


def estimate_drift(
    sweep: Sweep, charts: Charts, curves: Array, delta: float, black_level: Array, declared: float
) -> DriftError | None:
    """Estimate the lamp drift from disagreements between the charts.

    Parameters
    ----------
    sweep : Sweep
        The monochromatic captures.
    charts : Charts
        The chart captures.
    curves : ndarray, (channel, wavelength)
        Responsivities from `sweep` with the smoothing `delta`.
    delta : float
        Smoothing weight in Eq. 1 of docs/method.md#responsivity.
    black_level : ndarray, (channel,)
        Black level of each channel in DN.
    declared : float
        Relative standard deviation of the drift, as declared in the measurement file.

    Returns
    -------
    DriftError or None
        None if the declared drift explains the disagreements.

    Notes
    -----
    For each chart and channel, ln(measured / predicted signal) is a linear function of the unknown drifts of all captures.
    The drifts are assumed to be normally distributed, with a correlation that decays exponentially between captures. Their
    standard deviation has a prior that is uniform in its logarithm. The returned deviation is the square root of the
    posterior mean variance, which exceeds the most probable deviation if there are few charts.
    """
    steps, count = len(sweep.values), len(charts.values)
    order = np.arange(steps + count)
    correlation = MEMORY ** np.abs(order[:, None] - order)
    factors = np.empty((count, len(curves)))
    # (chart, channel, capture): derivative of ln(measured / predicted signal) with respect to the drift in each capture
    response = np.zeros((count, len(curves), steps + count))
    deformations = []
    for channel, (curve, smoother) in enumerate(zip(curves, smoothers(sweep, delta), strict=True)):
        deformation = smoother * np.where(sweep.valid[:, channel], sweep.values[:, channel], 0.0)
        seen, values = charts.photons @ curve, charts.values[..., channel]
        level = float(black_level[channel])
        beta = fit_gain(seen.ravel(), values.ravel(), level)[1]
        factors[:, channel], weight = chart_factors(seen, values, level, beta)
        light = np.einsum("cp,cpn->cn", weight * seen, charts.photons)
        response[:, channel, :steps] = -(light @ deformation) / (light @ curve)[:, None]
        response[:, channel, steps:] = np.eye(count)
        scale = response[:, channel, :steps].mean(axis=0)
        deformations.append(deformation + curve[:, None] * scale)
    if not (factors > 0).all():
        return None  # the charts contradict the curves, so `fit_charts` will raise an error
    seen_factors, cause = np.log(factors).ravel(), response.reshape(factors.size, -1)
    seen_factors, cause = seen_factors - seen_factors.mean(), cause - cause.mean(axis=0)
    deviation = _deviation(seen_factors, cause @ correlation @ cause.T, declared)
    if deviation is None:
        return None
    among_steps, among_charts = correlation[:steps, :steps], correlation[steps:, steps:]
    variance = [np.einsum("nj,jk,nk->n", each, among_steps, each, optimize=True) for each in deformations]
    scale_error = deviation * float(np.sqrt(among_charts.mean()))
    return DriftError(deviation, deviation * np.sqrt(np.maximum(variance, 0.0)), scale_error)


def _deviation(factors: Array, covariance: Array, declared: float) -> float | None:
    """Estimate the standard deviation of the drift.

    Return None if the declared drift explains the differences between measured and predicted signals.

    `factors` contains ln(measured / predicted signal) for all charts and channels. `covariance` is the covariance of these
    logarithms for a drift with a standard deviation of 1.
    """
    variance, directions = np.linalg.eigh(covariance)
    seen = (directions.T @ factors) ** 2
    tried = np.append(TRIED, declared)
    expected = tried[:, None] ** 2 * np.maximum(variance, 0.0) + CHART_ERROR**2
    likelihood = -0.5 * (np.log(expected) + seen / expected).sum(axis=1)
    best = int(likelihood[:-1].argmax())
    if TRIED[best] <= declared or likelihood[best] - likelihood[-1] < EVIDENCE:
        return None
    probability = np.exp(likelihood[:-1] - likelihood[best])
    return float(np.sqrt(probability @ TRIED**2 / probability.sum()))
