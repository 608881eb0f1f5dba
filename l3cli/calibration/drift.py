"""Estimate unmonitored lamp drift from disagreements between the charts (docs/method.md#drift-of-lamps).

If a lamp is brighter during a capture than when its spectrum was measured, the responses of all channels increase by the
same factor. During a monochromator sweep, such factors deform the curves slowly over wavelength, and the curves alone do not
reveal the deformation. In chart captures, the factors change the scale. Both effects show when the curves' prediction for
each chart and channel is compared with the measurement.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.captures import Charts
from l3cli.calibration.responsivity import Sweep, chart_factors, fit_gain, smoothers

MEMORY = 0.8  # correlation of the drift between consecutive captures in the measurement file
CHART_ERROR = 0.002  # relative error of a chart's mean in a channel; errors of 24 patches, 0.5 % each, explain half of it
TRIED = np.geomspace(2e-4, 0.2, 100)  # relative standard deviations of the drift that are tried
EVIDENCE = 4.0  # smallest natural log of the likelihood ratio between a drift and the declared drift
Array = NDArray[np.float64]


@dataclass(frozen=True)
class DriftError:
    """Lamp drift that the charts reveal, and the uncertainty that it causes."""

    deviation: float  # relative standard deviation of the lamps from their measured spectra
    curve_error: Array  # (channel, wavelength) standard deviation of the responsivities, without the error of their scale
    scale_error: float  # relative standard deviation of the scale that the charts give


def estimate_drift(
    sweep: Sweep, charts: Charts, curves: Array, delta: float, black_level: Array, declared: float
) -> DriftError | None:
    """Estimate how much the lamps drifted from the disagreement of the charts.

    Parameters
    ----------
    sweep : Sweep
        The monochromatic captures.
    charts : Charts
        The chart captures.
    curves : ndarray, (channel, wavelength)
        Responsivities from `sweep` with the smoothing `delta`.
    delta : float
        Smoothing of Eq. 1.
    black_level : ndarray, (channel)
        DN.
    declared : float
        Relative standard deviation of the drift, as declared in the measurement file.

    Returns
    -------
    DriftError or None
        None if the declared drift explains the disagreements.

    Notes
    -----
    In each channel, a chart is brighter than the curves predict by some factor. The logarithms of these factors are linear
    in the unknown drifts of all captures. The drifts are assumed to be normally distributed, with an exponential
    correlation. The probability of each standard deviation follows from its likelihood, with a prior that is uniform in its
    logarithm. The returned deviation is the root of the mean variance. With few charts, it is larger than the most probable
    deviation.
    """
    steps, count = len(sweep.values), len(charts.values)
    order = np.arange(steps + count)
    correlation = MEMORY ** np.abs(order[:, None] - order)
    factors = np.empty((count, len(curves)))
    # (chart, channel, capture) change of the logarithm of each factor per drift of a capture
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
        return None  # charts that contradict the curves altogether are refused elsewhere
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
    """Return the drift that explains the logarithms of the factors (factor), or None if the declared drift explains them.

    `covariance` is their covariance if the standard deviation of the drift is 1.
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
