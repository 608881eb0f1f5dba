"""Contrast: how much the values in a patch vary, relative to the noise at the patch's level (docs/method.md#contrast).

For each channel, n is the number of its values in the patch, S is their sum, Q is the sum of their squares, and
M = S · round(65536 / n) >> 16 is their mean. Values have at most 12 bits, so S · round(65536 / n) fits into uint32.

    variance    V = min((Q − M (2 S − n M)) · round(512 / n), cap)   cap = (2³² − 1) // channels
    contrast    number of contrast edges of the pixel's level that are below the sum of V over all channels
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.keys import BasicKeys
from l3cli.classes.statistics import Statistics
from l3cli.classes.windows import VARIANCE_FRACTION, Integers, window_channels
from l3cli.errors import RecipeError

# Mean increase of V, in DN², because M is rounded down. It is relevant only if the noise is below 1 DN.
MEAN_TRUNCATED = 1 / 3
SNIPPET = "features/contrast.cl"


def check_edges(recipe: BasicKeys) -> None:
    """Raise RecipeError unless the contrast edges are positive and increase."""
    if tuple(sorted(set(recipe.contrasts))) != recipe.contrasts or any(edge <= 0 for edge in recipe.contrasts):
        raise RecipeError(f'"contrasts" is {list(recipe.contrasts)}; write positive numbers in increasing order')


def stored_edges(
    recipe: BasicKeys, levels: NDArray[np.float64], camera: CameraModel, shift: int, dark: float
) -> NDArray[np.uint32]:
    """Compute the contrast edges of a class rule from the camera's noise.

    Parameters
    ----------
    recipe : BasicKeys
        Class recipe with the edges in standard deviations of the noise.
    levels : ndarray, (level,)
        The most sensitive channel's signal at the centre of each level, as a fraction of full scale.
    camera : CameraModel
        The camera.
    shift : int
        Number of bits by which raw values are shifted right to leave at most 12 bits.
    dark : float
        Dark signal, in DN, that was subtracted from the frame.

    Returns
    -------
    ndarray, (contrast edge, level)
        Thresholds for the sum of V over all channels (see the module docstring).
    """
    channels = len(camera.channels)
    variance = noise_of_grey(levels, camera, dark) - noise_of_means(camera, recipe.patch, dark)
    variance = variance / 4**shift + (1 / 12 if shift else 0.0) + MEAN_TRUNCATED
    limit = 2.0**32 - 1 - channels
    squared = np.array(recipe.contrasts, dtype=np.float64).reshape(-1, 1) ** 2
    return np.minimum(np.rint(squared * variance * channels * 2**VARIANCE_FRACTION), limit).astype(np.uint32)


def noise_of_grey(levels: NDArray[np.float64], camera: CameraModel, dark: float) -> NDArray[np.floating]:
    """Compute the noise variance of grey patches, in DN², averaged over the channels.

    Clipped channels have no noise.

    Parameters
    ----------
    levels : ndarray, (level,)
        Signals of the most sensitive channel, as fractions of full scale.
    camera : CameraModel
        The camera.
    dark : float
        Dark signal, in DN, that was subtracted from the frame.
    """
    span = camera.white_level - camera.black_level
    if camera.readout is None:
        return camera.noise_variance(levels * span, dark)
    signal = levels[:, None] * camera.sensitivity
    variance = camera.noise_variance(signal * span, dark, np.arange(len(camera.channels)))
    return np.asarray((variance * (signal < 1)).mean(axis=1))


def noise_of_means(camera: CameraModel, patch: int, dark: float) -> float:
    """Compute the variance, due to row and column noise, of a patch's channel means, averaged over the channels, in DN².

    This variance does not contribute to the contrast, because deviations are measured from the channel means. Independent
    pixel noise hardly affects these means and is neglected.
    """
    rows, columns = camera.line_variances(dark)
    channel = window_channels(camera.cfa, patch).reshape(-1, patch, patch)
    member = channel == np.arange(len(camera.channels))[:, None, None, None]  # (channel, site, row, col)
    count = np.maximum(member.sum(axis=(2, 3)), 1)
    shares = [((member.sum(axis=axis) / count[..., None]) ** 2).sum(axis=2).mean(axis=1) for axis in (3, 2)]
    return float(((rows * shares[0] + columns * shares[1]) * camera.channel_gains**2).mean())


def contrasts(rule: ClassRule, statistics: Statistics, level: Integers) -> Integers:
    """Return the contrast of each pixel, given its level."""
    if statistics.squares is None:
        return np.zeros(level.shape, np.int64)
    neighbours, site, sums = statistics.neighbours, statistics.site, statistics.sums
    mean = statistics.scaled >> 16
    deviation = statistics.squares - mean * (2 * sums - neighbours.count[site] * mean)
    cap = (2**32 - 1) // sums.shape[-1]
    variance = np.minimum(deviation * neighbours.variance_reciprocal[site], cap).sum(axis=-1)
    return (variance[None] > rule.contrast_edges[:, level]).sum(axis=0)


def entry(table: TransformTable, contrast: int) -> dict[str, Any]:
    """Describe a contrast for reports and JSON: its number."""
    return {"contrast": contrast}


def heading(entry: dict[str, Any]) -> str:
    return str(entry["contrast"])


def name(table: TransformTable, contrast: int) -> str:
    return f"contrast {contrast}"


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the compiler macros for contrast.cl."""
    return {"CONTRASTS": rule.contrasts}


def kernel_array(rule: ClassRule) -> NDArray[np.uint32]:
    """Return the constants for contrast.cl: the contrast edges (contrast edge, level)."""
    return rule.contrast_edges
