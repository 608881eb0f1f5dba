"""Contrast: how much more a neighbourhood varies than noise of its level does (docs/method.md#contrast).

With count n, sum S, sum of squares Q and mean M = S · round(65536 / n) >> 16 of a channel (M is exact in uint32, as v has
12 bits):

    variance    V = min((Q − M (2 S − n M)) · round(512 / n), cap)   cap = (2³² − 1) // channels
    contrast    number of contrast edges (of the pixel's level) < Σ V over the channels
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.statistics import Statistics
from l3cli.classes.windows import VARIANCE_FRACTION, Integers
from l3cli.errors import RecipeError
from l3cli.recipes.toml import Recipe

MEAN_TRUNCATED = 1 / 3  # what M, rounded down, adds to V on average: matters where noise is below a DN
SNIPPET = "features/contrast.cl"


class Options(Recipe):
    """Contrast keys of the [classes] of a recipe."""

    contrasts: tuple[float, ...] = (1.4,)  # edges of √(signal variance / noise variance)


def check_edges(recipe: Options) -> None:
    """Raise RecipeError if contrast edges cannot be."""
    if tuple(sorted(set(recipe.contrasts))) != recipe.contrasts or any(edge <= 0 for edge in recipe.contrasts):
        raise RecipeError("contrasts must be positive and increase")


def stored_edges(
    recipe: Options, levels: NDArray[np.float64], camera: CameraModel, shift: int, dark: float
) -> NDArray[np.uint32]:
    """Return the rule's contrast edges (edge, level) from the camera's noise at `levels`, as `noise_of_grey` has them."""
    channels = len(camera.channels)
    variance = noise_of_grey(levels, camera, dark) / 4**shift + (1 / 12 if shift else 0.0) + MEAN_TRUNCATED
    limit = 2.0**32 - 1 - channels
    squared = np.array(recipe.contrasts, dtype=np.float64).reshape(-1, 1) ** 2
    return np.minimum(np.rint(squared * variance * channels * 2**VARIANCE_FRACTION), limit).astype(np.uint32)


def noise_of_grey(levels: NDArray[np.float64], camera: CameraModel, dark: float) -> NDArray[np.floating]:
    """Return the mean over the channels of the noise variance (level) in DN² of greys at `levels`, shares of full scale in
    the most sensitive channel, of frames of which `dark` DN of dark current have been taken off; clipped channels have
    none."""
    span = camera.white_level - camera.black_level
    if camera.readout is None:
        return camera.noise_variance(levels * span, dark)
    signal = levels[:, None] * camera.sensitivity
    variance = camera.noise_variance(signal * span, dark, np.arange(len(camera.channels)))
    return np.asarray((variance * (signal < 1)).mean(axis=1))


def contrasts(rule: ClassRule, statistics: Statistics, level: Integers) -> Integers:
    """Return contrast (…) at `level` (…)."""
    if statistics.squares is None:
        return np.zeros(level.shape, np.int64)
    neighbours, site, sums = statistics.neighbours, statistics.site, statistics.sums
    mean = statistics.scaled >> 16
    deviation = statistics.squares - mean * (2 * sums - neighbours.count[site] * mean)
    cap = (2**32 - 1) // sums.shape[-1]
    variance = np.minimum(deviation * neighbours.variance_reciprocal[site], cap).sum(axis=-1)
    return (variance[None] > rule.contrast_edges[:, level]).sum(axis=0)


def entry(table: TransformTable, contrast: int) -> dict[str, Any]:
    """Return the number of a contrast."""
    return {"contrast": contrast}


def heading(entry: dict[str, Any]) -> str:
    """Return an entry as a row of a table begins: its number."""
    return str(entry["contrast"])


def name(table: TransformTable, contrast: int) -> str:
    """Return a name such as "contrast 0"."""
    return f"contrast {contrast}"


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the macros that contrast.cl is compiled with."""
    return {"CONTRASTS": rule.contrasts}


def kernel_array(rule: ClassRule) -> NDArray[np.uint32]:
    """Return (contrast edge, level)"""
    return rule.contrast_edges
