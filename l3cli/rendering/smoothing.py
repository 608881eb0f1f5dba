"""Spectra that take the mean of their neighbourhood and keep their brightness (docs/method.md#smoothed-spectra)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import SpectralSmoothing
from l3cli.classes.later import mirrored

DARKEST = 2.0**-20  # of the output unit: pixels of less brightness stay as they are, far below the noise of any sensor


def smoothed_spectra(planes: NDArray[np.float64], smoothing: SpectralSmoothing) -> NDArray[np.float64]:
    """Outputs (output, row, col) whose spectra are smoothed; at the borders planes are mirrored about the outermost pixels.

        w_q = max(0, 1 − ((Y_q − Y_p) / (reach · Y_p))²)²        Y: mean of the outputs, q: pixels of the window, p too
        o_p ← ō_p · Y_p / Ȳ_p                                    ō, Ȳ: means weighed by w

    Means are taken of differences from the pixel itself, so that a plain area stays as it is to the last bit.
    """
    _, rows, cols = planes.shape
    brightness = planes.mean(axis=0)
    padded, around = mirrored(planes, smoothing.radius), mirrored(brightness, smoothing.radius)
    scale = smoothing.reach * np.maximum(brightness, DARKEST)
    total, brighter, change = np.ones_like(brightness), np.zeros_like(brightness), np.zeros_like(planes)
    for down, right in np.ndindex(smoothing.window, smoothing.window):
        if down == right == smoothing.radius:
            continue  # of the pixel itself: no difference, and a weight of 1
        there = slice(down, down + rows), slice(right, right + cols)
        difference = around[there] - brightness
        weight = np.maximum(1 - np.square(difference / scale), 0) ** 2
        total += weight
        brighter += weight * difference
        change += weight * (padded[:, *there] - planes)
    kept = np.where(brightness > DARKEST, brightness, 1.0)
    share = kept / np.where(brightness > DARKEST, brightness + brighter / total, 1.0)
    return np.where(brightness > DARKEST, (planes + change / total) * share, planes)
