"""Chroma from far around, where pixels are alike, for which windows are too small (docs/method.md#coarse-chroma).

Means of 4 × 4 pixels of the planes pass four edge-avoiding steps, the means 1, 2, 4 and 8 apart. A pixel reads the last from
its four nearest means, those that are like it after the first step.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import PLANE_STEP, CoarseChroma
from l3cli.classes.planes import LUMINANCE
from l3cli.classes.refinement import mirrored, window_means

BIN = 4  # pixels, side of what a mean is taken of
SPACINGS = (1, 2, 4, 8)  # means, by step
REACH = BIN * (sum(SPACINGS) + 2)  # pixels beyond which nothing counts
ALIKE = 3.0  # standard deviations of noise that likeness falls off by
POWER = 8  # of 1 − u / POWER, which is nearly exp(−u), but an end has
OWN = 0.05  # weight of the pixel's own window
SPREAD = np.array([1.0, 2.0, 1.0]) / 4
Array = NDArray[np.float64]


def scales_of(chroma: CoarseChroma, share: float = 1.0) -> Array:
    """Return the squares of differences, in squared steps of a plane, from which on nothing is alike, (compared, plane,
    power of luminance in steps); `share`: of the camera's noise variance."""
    steps = chroma.variance * (share / PLANE_STEP**2) * PLANE_STEP ** np.arange(chroma.variance.shape[-1])
    return steps * (POWER * ALIKE**2 * np.array([4.0] * len(SPACINGS) + [2.0])[:, None, None])


def coarse_change(planes: NDArray[np.int32], side: int, scales: Array) -> Array:
    """Return what coarse chroma adds to every pixel of windows of `side`: (chroma, row, col) of planes (plane, row, col), in
    their steps; `scales`: of `scales_of`."""
    pixel, means = pixel_evidence(planes, side), binned(planes)
    first = means = edge_avoiding(means, SPACINGS[0], scales[0])
    for spacing, scale in zip(SPACINGS[1:], scales[1:], strict=False):
        means = edge_avoiding(means, spacing, scale)
    least = _at(scales[-1], pixel[LUMINANCE])
    total, weights = np.zeros_like(pixel), np.full(pixel.shape[1:], OWN)
    for rows, down in nearest_means(planes.shape[1], means.shape[1]):
        for cols, across in nearest_means(planes.shape[2], means.shape[2]):
            there = (slice(None), rows[:, None], cols)
            weight = down[:, None] * across * likeness(first[there] - pixel, least)
            total += weight * (means[there] - pixel)
            weights += weight
    return np.delete(total / weights, LUMINANCE, axis=0)


def pixel_evidence(planes: NDArray[np.int32], side: int) -> Array:
    """Return what a pixel is compared by (plane, row, col): chroma over its window, luminance over 1 2 1."""
    means = np.asarray(window_means(mirrored(planes.astype(np.float64), side // 2), side))
    smoothed = mirrored(planes[LUMINANCE].astype(np.float64), 1)
    smoothed = SPREAD[0] * smoothed[:-2] + SPREAD[1] * smoothed[1:-1] + SPREAD[2] * smoothed[2:]
    means[LUMINANCE] = SPREAD[0] * smoothed[:, :-2] + SPREAD[1] * smoothed[:, 1:-1] + SPREAD[2] * smoothed[:, 2:]
    return means


def binned(planes: NDArray[np.int32]) -> Array:
    """Return the means (plane, row, col) of BIN × BIN pixels of planes, at the end of those that are there."""
    starts = [np.arange(0, length, BIN) for length in planes.shape[1:]]
    sums = np.add.reduceat(np.add.reduceat(planes.astype(np.float64), starts[0], axis=1), starts[1], axis=2)
    rows, cols = (np.diff(np.append(start, length)) for start, length in zip(starts, planes.shape[1:], strict=True))
    return np.asarray(sums / (rows[:, None] * cols))


def edge_avoiding(means: Array, spacing: int, scale: Array) -> Array:
    """Return the mean (plane, row, col) over 3 × 3 means `spacing` from each other, of those alike."""
    _, rows, cols = means.shape
    least = _at(scale, means[LUMINANCE])
    padded = np.pad(means, ((0, 0), (spacing, spacing), (spacing, spacing)))
    inside = np.pad(np.ones((rows, cols)), spacing)
    change, weights = np.zeros_like(means), np.zeros((rows, cols))
    for i, j in np.ndindex(3, 3):
        there = slice(i * spacing, i * spacing + rows), slice(j * spacing, j * spacing + cols)
        difference = padded[:, *there] - means
        weight = SPREAD[i] * SPREAD[j] * inside[there] * likeness(difference, least)
        change += weight * difference
        weights += weight
    return np.asarray(means + change / weights)


def likeness(difference: Array, least: Array) -> Array:
    """Return the weight (row, col) of what differs so (plane, row, col); 0 from the square `least` on."""
    return np.asarray(np.maximum(1 - (difference**2 / least).sum(axis=0), 0) ** POWER)


def nearest_means(pixels: int, means: int) -> list[tuple[NDArray[np.intp], Array]]:
    """Return, twice, the place of a mean near each pixel and the weight of linear interpolation, 0 where none is."""
    place = (np.arange(pixels) + 0.5) / BIN - 0.5
    low = np.floor(place).astype(np.intp)
    pairs = ((low, 1 - (place - low)), (low + 1, place - low))
    return [(np.clip(at, 0, means - 1), np.where((at >= 0) & (at < means), share, 0.0)) for at, share in pairs]


def _at(scale: Array, luminance: Array) -> Array:
    """Return the scale (plane, power) at a luminance (row, col), no less than in darkness."""
    above = np.maximum(luminance, 0)
    return np.asarray(np.einsum("pn,nrc->prc", scale, np.stack([np.ones_like(above), above, above**2])))
