"""Figures of pictures as arrays, whatever they show: PSNR, structural similarity, spectral angle."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
LEAST_ERROR = 1e-12  # mean square, of equal pictures: 120 dB
WINDOW_SIGMA, WINDOW_REACH = 1.5, 5  # pixels, of the 11 × 11 Gaussian window of SSIM
FAINTEST = float(np.finfo(np.float32).eps)  # spectra as much shorter than the picture's longest are rounding errors
STABILISERS = (0.01**2, 0.03**2)  # C1 and C2 of SSIM for values in 0…1


def psnr(one: Array, other: Array) -> float:
    """Return the peak signal-to-noise ratio in dB of two arrays of one shape whose peak is 1; 120 dB where they are
    equal."""
    return float(-10.0 * np.log10(max(float(np.mean((one - other) ** 2)), LEAST_ERROR)))


def ssim(one: Array, other: Array) -> float:
    """Return the mean structural similarity of two pictures (row, col) in 0…1 (Wang et al. 2004: 11 × 11 Gaussian window of
    σ 1.5).

    Only whole windows count, unless the picture is smaller than one.
    """
    from scipy.ndimage import gaussian_filter

    def mean(values: Array) -> Array:
        return gaussian_filter(values, WINDOW_SIGMA, radius=WINDOW_REACH)

    mean_one, mean_other = mean(one), mean(other)
    variances = mean(one**2) - mean_one**2 + mean(other**2) - mean_other**2
    covariance = mean(one * other) - mean_one * mean_other
    luminance_term = (2 * mean_one * mean_other + STABILISERS[0]) / (mean_one**2 + mean_other**2 + STABILISERS[0])
    similarity = luminance_term * (2 * covariance + STABILISERS[1]) / (variances + STABILISERS[1])
    if min(similarity.shape) > 2 * WINDOW_REACH:
        similarity = similarity[WINDOW_REACH:-WINDOW_REACH, WINDOW_REACH:-WINDOW_REACH]
    return float(similarity.mean())


def spectral_angle(rendered: Array, target: Array) -> Array:
    """Return the angle in degrees (row, col) between the spectra of two cubes (band, row, col).

    NaN where the target has no direction, since its spectrum is zero, or shorter than float32 resolves beside the longest of
    the picture; 90 where only the rendered spectrum is zero (docs/method.md#quality-figures).
    """
    cubes = [cube.astype(np.float64) for cube in (rendered, target)]
    lengths = [np.sqrt((cube**2).sum(axis=0)) for cube in cubes]
    units = [cube / np.where(length > 0, length, 1.0) for cube, length in zip(cubes, lengths, strict=True)]
    chord = np.sqrt(((units[0] - units[1]) ** 2).sum(axis=0))  # 2 sin(angle / 2): exact for small angles, unlike arccos
    angle = np.where(lengths[0] > 0, np.degrees(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))), 90.0)
    return np.where(lengths[1] > FAINTEST * lengths[1].max(), angle, np.nan)
