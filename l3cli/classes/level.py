"""Level: how bright a neighbourhood is (docs/method.md#level).

level = number of level edges ≤ Σ (S · round(65536 / n) >> 8) over the channels, n and S being count and sum of a channel.
"""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.statistics import Statistics, truncation
from l3cli.classes.windows import Integers
from l3cli.errors import RecipeError
from l3cli.recipes.toml import Count, Recipe

LEVEL_FRACTION = 8  # fractional bits of a channel mean in the level sum
SNIPPET = "features/level.cl"


class Options(Recipe):
    """Level keys of the [classes] of a recipe."""

    levels: Count = 20
    spacing: Literal["logarithmic", "linear"] = "logarithmic"  # of the level edges
    lowest_level: float = 0.001  # upper edge of the darkest level, share of full scale
    highest_level: float = 0.95  # lower edge of the brightest level, share of full scale
    level_edges: tuple[float, ...] | None = None  # shares of full scale, in place of the four keys above


def edge_shares(recipe: Options, reach: float = 1.0) -> NDArray[np.float64]:
    """Return the level edges, increasing, as shares of full scale of the most sensitive channel, all channels of which clip
    at `reach` of it; RecipeError if they cannot be."""
    if recipe.level_edges is not None:
        edges = np.array(recipe.level_edges)
        if not (edges.size and edges[0] > 0 and edges[-1] < 1 and (np.diff(edges) > 0).all()):
            raise RecipeError("classes.level_edges must increase and lie between 0 and 1")
        return edges
    if not (recipe.levels >= 2 and 0 < recipe.lowest_level < recipe.highest_level < 1):
        raise RecipeError("classes need levels ≥ 2 and 0 < lowest_level < highest_level < 1")
    spaced = np.geomspace if recipe.spacing == "logarithmic" else np.linspace
    return spaced(recipe.lowest_level, recipe.highest_level * reach, recipe.levels - 1)


def centres(shares: NDArray[np.float64], reach: float = 1.0) -> NDArray[np.float64]:
    """Return a share of full scale in the middle of each of the levels that edges at `shares` make, as `edge_shares`."""
    return np.concatenate([[shares[0] / 2], np.sqrt(shares[1:] * shares[:-1]), [(reach + shares[-1]) / 2]])


def clipped_mean(share: NDArray[np.floating], sensitivity: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the mean over channels of such `sensitivity` (channel) of what a grey gives, each clipped at 1, that gives a
    `share` (…) of full scale in the most sensitive one (docs/method.md#exposures)."""
    if (sensitivity == 1).all():
        return share
    return np.asarray(np.minimum(share[..., None] * sensitivity, 1.0).mean(axis=-1))


def unclipped_level(mean: NDArray[np.floating], sensitivity: NDArray[np.float64]) -> NDArray[np.floating]:
    """Return the mean over the channels that a grey would have if none clipped, from the mean (…) of its channels, each
    clipped at 1: where the sensitive channels clip, the others determine it. Return the mean itself where all are alike."""
    if (sensitivity == 1).all():
        return mean
    knots = np.append(0.0, np.unique(1 / sensitivity))  # shares at which a channel clips, between which the mean is linear
    shares = np.interp(mean, clipped_mean(knots, sensitivity), knots)
    return np.where(mean < 0, mean, shares * sensitivity.mean())


def stored_edges(shares: NDArray[np.float64], camera: CameraModel, shift: int) -> NDArray[np.uint32]:
    """Return the rule's level edges at `shares` of full scale of a grey in the most sensitive channel."""
    span = camera.white_level - camera.black_level
    means = clipped_mean(shares, camera.sensitivity)
    in_values = (camera.black_level + means * span - truncation(shift)) / 2**shift
    return np.rint(in_values * 2**LEVEL_FRACTION * len(camera.channels)).astype(np.uint32)


def levels(rule: ClassRule, statistics: Statistics) -> Integers:
    """Return the level (…)."""
    total = (statistics.scaled >> (16 - LEVEL_FRACTION)).sum(axis=-1)
    return np.searchsorted(rule.level_edges, total, side="right")


def level_of_mean(rule: ClassRule, total: float) -> int:
    """Return the level of a flat area by the sum over the channels of their means, in DN, which is on no grid."""
    return int(np.searchsorted(rule.level_edges, total * 2**LEVEL_FRACTION / 2**rule.shift))


def inner_bounds(rule: ClassRule, black_level: float, white_level: float) -> NDArray[np.float64]:
    """Return shares of full scale at which each level but the darkest begins; `black_level` and `white_level` in DN."""
    in_dn = rule.level_edges * 2.0**rule.shift / (2**LEVEL_FRACTION * rule.channels)
    return (in_dn - black_level) / (white_level - black_level)


def bounds(table: TransformTable) -> NDArray[np.float64]:
    """Return the bounds (level + 1) of the levels as shares of full scale, from 0 to 1."""
    inner = inner_bounds(table.first.rule, table.black_level, table.white_level)
    return np.concatenate([[0.0], np.clip(inner, 0.0, 1.0), [1.0]])


def entry(table: TransformTable, level: int) -> dict[str, Any]:
    """Return the number and bounds of a level, as shares of full scale; the first begins at 0, the last ends at 1."""
    lower, upper = bounds(table)[level : level + 2].tolist()
    return {"level": level, "from": lower, "to": upper}


def heading(entry: dict[str, Any]) -> str:
    """Return an entry as a row of a table begins, such as "3: 0.0020–0.0031"."""
    return f"{entry['level']}: {entry['from']:.4f}–{entry['to']:.4f}"


def name(table: TransformTable, level: int) -> str:
    """Return a name such as "level 3 (0.002–0.003 of full scale)"."""
    inner = inner_bounds(table.first.rule, table.black_level, table.white_level)
    lower = "0" if level == 0 else f"{inner[level - 1]:.3g}"
    upper = f"{inner[level]:.3g}" if level < len(inner) else "1"
    return f"level {level} ({lower}–{upper} of full scale)"


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the macros that level.cl is compiled with."""
    return {"LEVELS": rule.levels, "LEVEL_FRACTION": LEVEL_FRACTION}


def kernel_array(rule: ClassRule) -> NDArray[np.int32]:
    """Return (level edge) the highest level sum below each, as kernels compare; no sum reaches 2³¹."""
    return np.minimum(rule.level_edges.astype(np.int64) - 1, 2**31 - 1).astype(np.int32)
