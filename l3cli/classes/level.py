"""Level: the brightness of a patch (docs/method.md#level).

    level = number of level edges ≤ Σ (S · round(65536 / n) >> 8)

S and n are the sum and the number of a channel's values in the patch. Σ is the sum over the channels.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.keys import BasicKeys
from l3cli.classes.statistics import Statistics, truncation
from l3cli.classes.windows import Integers
from l3cli.errors import RecipeError

LEVEL_FRACTION = 8  # number of fractional bits of a channel mean in the level sum
SNIPPET = "features/level.cl"


def edge_shares(recipe: BasicKeys, reach: float = 1.0) -> NDArray[np.float64]:
    """Compute the level edges from a class recipe.

    Parameters
    ----------
    recipe : BasicKeys
        The class recipe.
    reach : float
        Exposure at which all channels of a grey clip, relative to the exposure at which its most sensitive channel clips.

    Returns
    -------
    ndarray, (level edge,)
        Signals of greys before clipping, in increasing order, as fractions of the most sensitive channel's full scale.

    Raises
    ------
    RecipeError
        If the edges do not increase, or if an edge is not between 0 and 1.
    """
    if recipe.level_edges is not None:
        edges = np.array(recipe.level_edges)
        if not (edges.size and edges[0] > 0 and edges[-1] < 1 and (np.diff(edges) > 0).all()):
            raise RecipeError(f"classes.level_edges is {edges.tolist()}; write increasing numbers between 0 and 1")
        return edges
    if not (recipe.levels >= 2 and 0 < recipe.lowest_level < recipe.highest_level < 1):
        raise RecipeError(
            f"classes.levels is {recipe.levels}, lowest_level {recipe.lowest_level:g} and highest_level "
            f"{recipe.highest_level:g}; write levels ≥ 2 and 0 < lowest_level < highest_level < 1"
        )
    spaced = np.geomspace if recipe.spacing == "logarithmic" else np.linspace
    return spaced(recipe.lowest_level, recipe.highest_level * reach, recipe.levels - 1)


def centres(shares: NDArray[np.float64], reach: float = 1.0) -> NDArray[np.float64]:
    """Return the signal at the centre of each level, as a fraction of the most sensitive channel's full scale.

    `shares` is the result of `edge_shares` for the same `reach`.
    """
    return np.concatenate([[shares[0] / 2], np.sqrt(shares[1:] * shares[:-1]), [(reach + shares[-1]) / 2]])


def clipped_mean(share: NDArray[np.floating], sensitivity: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return a grey's mean signal over all channels, each clipped at 1 (docs/method.md#exposures).

    Parameters
    ----------
    share : ndarray, (…)
        Signal of the most sensitive channel before clipping, as a fraction of full scale.
    sensitivity : ndarray, (channel,)
        Sensitivities relative to the most sensitive channel.
    """
    if (sensitivity == 1).all():
        return share
    return np.asarray(np.minimum(share[..., None] * sensitivity, 1.0).mean(axis=-1))


def unclipped_level(mean: NDArray[np.floating], sensitivity: NDArray[np.float64]) -> NDArray[np.floating]:
    """Estimate a grey's mean signal over all channels before clipping, from the mean after clipping.

    This is the inverse of `clipped_mean`, times the mean sensitivity. If all channels are equally sensitive, the result
    equals `mean`.

    Parameters
    ----------
    mean : ndarray, (…)
        Mean signal over the channels, each clipped at 1.
    sensitivity : ndarray, (channel,)
        Sensitivities relative to the most sensitive channel.
    """
    if (sensitivity == 1).all():
        return mean
    # Signals at which channels start to clip. Between these signals, the mean is linear.
    knots = np.append(0.0, np.unique(1 / sensitivity))
    shares = np.interp(mean, clipped_mean(knots, sensitivity), knots)
    return np.where(mean < 0, mean, shares * sensitivity.mean())


def stored_edges(shares: NDArray[np.float64], camera: CameraModel, shift: int) -> NDArray[np.uint32]:
    """Convert level edges from `edge_shares` to the integers that a class rule stores."""
    span = camera.white_level - camera.black_level
    means = clipped_mean(shares, camera.sensitivity)
    in_values = (camera.black_level + means * span - truncation(shift)) / 2**shift
    return np.rint(in_values * 2**LEVEL_FRACTION * len(camera.channels)).astype(np.uint32)


def levels(rule: ClassRule, statistics: Statistics) -> Integers:
    """Return the level of each pixel."""
    total = (statistics.scaled >> (16 - LEVEL_FRACTION)).sum(axis=-1)
    return np.searchsorted(rule.level_edges, total, side="right")


def level_of_mean(rule: ClassRule, total: float) -> int:
    """Return the level of a uniform area, given the sum of its channel means in DN."""
    return int(np.searchsorted(rule.level_edges, total * 2**LEVEL_FRACTION / 2**rule.shift))


def inner_bounds(rule: ClassRule, black_level: float, white_level: float) -> NDArray[np.float64]:
    """Return the lower bound of each level except the darkest, as a fraction of full scale.

    `black_level` and `white_level` are in DN.
    """
    in_dn = rule.level_edges * 2.0**rule.shift / (2**LEVEL_FRACTION * rule.channels)
    return (in_dn - black_level) / (white_level - black_level)


def bounds(table: TransformTable) -> NDArray[np.float64]:
    """Return the bounds of all levels, from 0 to 1, as fractions of full scale: (level + 1,)."""
    inner = inner_bounds(table.first.rule, table.black_level, table.white_level)
    return np.concatenate([[0.0], np.clip(inner, 0.0, 1.0), [1.0]])


def entry(table: TransformTable, level: int) -> dict[str, Any]:
    """Describe a level for reports and JSON: its number, and its bounds as fractions of full scale."""
    lower, upper = bounds(table)[level : level + 2].tolist()
    return {"level": level, "from": lower, "to": upper}


def heading(entry: dict[str, Any]) -> str:
    """Return a row label for a level, such as "3: 0.0020–0.0031"."""
    return f"{entry['level']}: {entry['from']:.4f}–{entry['to']:.4f}"


def name(table: TransformTable, level: int) -> str:
    """Return the name of a level, such as "level 3 (0.002–0.003 of full scale)"."""
    inner = inner_bounds(table.first.rule, table.black_level, table.white_level)
    lower = "0" if level == 0 else f"{inner[level - 1]:.3g}"
    upper = f"{inner[level]:.3g}" if level < len(inner) else "1"
    return f"level {level} ({lower}–{upper} of full scale)"


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the compiler macros for level.cl."""
    return {"LEVELS": rule.levels, "LEVEL_FRACTION": LEVEL_FRACTION}


def kernel_array(rule: ClassRule) -> NDArray[np.int32]:
    """Return the constants for level.cl: the largest integer below each level edge.

    They are limited to 2³¹ − 1, because no sum reaches 2³¹.
    """
    return np.minimum(rule.level_edges.astype(np.int64) - 1, 2**31 - 1).astype(np.int32)
