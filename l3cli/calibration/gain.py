"""Eq. 2: gain and offset of each channel from charts under known lights (docs/method.md#gain-and-offset)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.statistics import Defects
from l3cli.errors import InputFileError
from l3cli.frames import chart
from l3cli.frames.measurement import CHART_COLS, CHART_ROWS, PATCHES, Body, ChartCapture

CORE = 0.25  # half the side of a patch's sampled core, in chart cells
RELATIVE_ERROR, ABSOLUTE_ERROR = 0.005, 0.3  # of the signal, DN: how well a patch is known (docs/method.md#gain-and-offset)
Array = NDArray[np.float64]


def patch_map(corners: Array, rows: int, cols: int) -> NDArray[np.int64]:
    """Return the index (row, col) of the ColorChecker patch whose core a pixel lies in, 24 elsewhere.

    corners (4, 2) are col, row of the outer corners of patches 1, 6, 24, 19; the chart may be turned and in perspective.
    """
    cells = chart.corner_cells(CHART_ROWS, CHART_COLS)
    return chart.patch_map(chart.homography(cells, corners), (CHART_ROWS, CHART_COLS), (rows, cols), CORE)


def patch_values(capture: ChartCapture, body: Body, limit: float, defects: Defects) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean DN (patch, channel) of the cores of a chart's patches over its frames, and whether they are saturated.

    Saturated is a patch with more than one pixel in a thousand at `limit` DN or above in any frame. InputFileError if the
    corners do not lie in the frame, or if a core holds no pixel of a channel.
    """
    channels = len(body.channels)
    pixels, label, count = _cores(capture, body, defects)
    total, frames = np.zeros((PATCHES, channels)), 0
    saturated = np.zeros((PATCHES, channels), dtype=bool)
    for frame in capture.frames:
        values = frame.ravel()[pixels].astype(np.float64)
        saturated |= _per_label(label, values >= limit, channels) > count / 1000
        total += _per_label(label, values, channels)
        frames += 1
    return total / count / frames, saturated


def unsaturated_values(capture: ChartCapture, body: Body, limit: float, defects: Defects) -> Array:
    """Return the mean DN (patch, channel) of a chart; InputFileError names a patch that is saturated."""
    values, saturated = patch_values(capture, body, limit, defects)
    if saturated.any():
        patch, channel = np.argwhere(saturated)[0]
        raise InputFileError(
            f"{capture.name}: patch {patch + 1} is saturated in channel {body.channels[channel]}; shorten the exposure"
        )
    return values


def patch_illumination(capture: ChartCapture, body: Body, defects: Defects) -> Array:
    """Return the light (patch, 1) that reaches the cores of a chart's patches over what they would get on the axis."""
    pixels, label, count = _cores(capture, body, defects)
    channels = len(body.channels)
    light = _per_label(label, body.relative_illumination.ravel()[pixels], channels)
    return light.sum(axis=1, keepdims=True) / count.sum(axis=1, keepdims=True)


def _cores(capture: ChartCapture, body: Body, defects: Defects) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Return the pixels in patch cores but defects, the label patch · channels + channel of each, and their count (patch,
    channel)."""
    rows, cols, channels = body.rows, body.cols, len(body.channels)
    if (capture.corners < 0).any() or (capture.corners > (cols, rows)).any():
        raise InputFileError(
            f"{capture.name}: a chart corner lies outside the frame of {cols}×{rows}; give col, row of the four corners"
        )
    try:
        patches = patch_map(capture.corners, rows, cols)
    except np.linalg.LinAlgError:
        raise InputFileError(f"{capture.name}: the chart corners lie on a line; give them clockwise from patch 1") from None
    patches[defects[:, 0], defects[:, 1]] = PATCHES
    patch = patches.ravel()
    pixels = np.flatnonzero(patch < PATCHES)
    channel = body.cfa[(pixels // cols) % body.cfa.shape[0], (pixels % cols) % body.cfa.shape[1]]
    label = patch[pixels] * channels + channel
    count = _per_label(label, np.ones(label.size), channels)
    if not count.all():
        raise InputFileError(f"{capture.name}: patches hold too few pixels; check the corners, clockwise from patch 1")
    return pixels, label, count


def _per_label(label: NDArray[np.int64], weights: NDArray, channels: int) -> Array:
    """Return the sums (patch, channel) of weights (pixel)."""
    sums = np.bincount(label, weights=weights, minlength=PATCHES * channels)
    return sums.astype(np.float64).reshape(PATCHES, channels)


def fit_gain(photons: Array, values: Array, black_level: float) -> tuple[float, float]:
    """Fit Eq. 2 of one channel: (alpha, beta) of values ≈ alpha · photons + beta, alpha ≥ 0.

    photons and values (sample) are what the responsivity predicts and the mean DN; weights: docs/method.md#gain-and-offset.
    """
    from scipy.optimize import lsq_linear

    weight = 1.0 / np.hypot(RELATIVE_ERROR * (values - black_level), ABSOLUTE_ERROR)
    scale = photons.max()
    system = np.stack([photons / scale, np.ones_like(photons)], axis=1) * weight[:, None]
    alpha, beta = lsq_linear(system, values * weight, bounds=([0.0, -np.inf], [np.inf, np.inf])).x
    return float(alpha / scale), float(beta)


def gain_error(photons: Array, values: Array, black_level: float, alpha: float, beta: float, drift: float) -> float:
    """Return the standard deviation of alpha: its spread over charts (chart, patch) fitted one by one, or the declared
    drift's."""
    weight = 1.0 / np.hypot(RELATIVE_ERROR * (values - black_level), ABSOLUTE_ERROR) ** 2
    single = (weight * photons * (values - beta)).sum(axis=1) / (weight * photons**2).sum(axis=1)
    charts = len(single)
    return float(max(single.std(ddof=1), drift * alpha) / np.sqrt(charts))


def relative_rmse(measured: Array, predicted: Array, black_level: Array | float) -> Array:
    """Return the RMSE over the mean signal above black, over the axes (chart, patch) of both; further axes stay."""
    return np.sqrt(np.mean((measured - predicted) ** 2, axis=(0, 1))) / np.mean(measured - black_level, axis=(0, 1))


def r_squared(measured: Array, predicted: Array) -> Array:
    """Return the share of the variance of `measured` that `predicted` explains, over the axes (chart, patch)."""
    residual = np.sum((measured - predicted) ** 2, axis=(0, 1))
    return 1.0 - residual / np.sum((measured - measured.mean(axis=(0, 1))) ** 2, axis=(0, 1))


def cross_validate(photons: Array, values: Array, black_level: float) -> float:
    """Return the relative RMSE of charts (chart, patch) predicted with alpha and beta from the charts under the other
    lights."""
    predicted = np.empty_like(values)
    for left_out in range(len(values)):
        others = np.arange(len(values)) != left_out
        alpha, beta = fit_gain(photons[others].ravel(), values[others].ravel(), black_level)
        predicted[left_out] = alpha * photons[left_out] + beta
    return float(relative_rmse(values, predicted, black_level))
