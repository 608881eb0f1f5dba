"""Chroma: the colour of a neighbourhood in which nothing is saturated (docs/method.md#chroma).

chroma = the first k of least Σ clamp((S · round(65536 / n) >> 12) − chroma_black_level, 0…65535) · weight[k] over channels

With f the channel means above black over their sum and q a chroma centre, |f − q|² is least where |q|² Σ f − 2 Σ f q is:
hence the weights |q|² − 2 q, and no division.

A rule may dither (docs/method.md#dither): from the middle between two chromas to the centre of either a falling share of the
CFA sites takes the other, so that colours do not step; layers that follow take the mean.
"""

import warnings
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import CHROMA_SCALE, MAX_CHROMAS, ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.statistics import Statistics, truncation
from l3cli.classes.windows import Integers, Neighbourhoods
from l3cli.recipes.toml import Recipe

CHROMA_FRACTION = 4  # fractional bits of a channel mean above black in the chroma scores
TOP = 2**16 - 1  # of what enters the scores, which only values at the top of the range pass
STARTS = 4  # of k-means: one in ten ends at centres that cost a tenth of S-CIELAB
WIDTH_FRACTION = 8  # fractional bits of widths
DITHERED = 0.6  # of the squared distance to the next centre: with all of it the palest paint takes on a cast
TWINS = 2e-3  # squared distance of two centres, in shares of the mean channel, below which no site changes between them
TURN = 159  # 256 times the golden section: sites one after the other, and any few of them, differ
SNIPPET = "features/chroma.cl"


class Options(Recipe):
    """Chroma keys of the [classes] of a recipe."""

    # colours distinguished where nothing is saturated, white one of them; 0 or 1: none (docs/method.md#chroma)
    chromas: Annotated[int, msgspec.Meta(ge=0, le=MAX_CHROMAS)] = 9
    # between two chromas some CFA sites take one and some the other: no seams, for tables of several layers
    chroma_dither: bool = False


def channel_shares(signal: NDArray[np.float32], neighbours: Neighbourhoods, site: int) -> NDArray[np.float64]:
    """Return the means of the channels over each patch (patch, tap), as shares of their sum: (patch, channel)."""
    member = (neighbours.channel[site][:, None] == np.arange(neighbours.count.shape[1])) / neighbours.count[site]
    means = signal.astype(np.float64) @ member
    return means / np.maximum(means.sum(axis=1, keepdims=True), 1e-9)


def choose_chromas(
    shares: NDArray[np.float64], count: int, seed: int, white: NDArray[np.float64] | None = None
) -> NDArray[np.float64] | None:
    """Return `count` centres (chroma, channel) of the channel shares (patch, channel) by k-means, the last of them, if they
    are known, the shares of white's signals (channel); None if none or one is asked for."""
    if count <= 1:
        return None
    if white is not None and white.min() > 0:
        others = _means(shares, count - 1, seed)
        return np.concatenate([others, white[None] / white.sum()])
    return _means(shares, count, seed)


def _means(shares: NDArray[np.float64], count: int, seed: int) -> NDArray[np.float64]:
    from scipy.cluster.vq import kmeans2

    distinct = np.unique(shares, axis=0)
    if len(distinct) <= count:
        return distinct
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of empty clusters
        rng = np.random.default_rng([seed, 2])
        tried = [kmeans2(shares, count, iter=30, minit="++", rng=rng) for _ in range(STARTS)]
    centres, member = min(tried, key=lambda each: float(((shares - each[0][each[1]]) ** 2).sum()))
    return np.asarray(centres[np.unique(member)])  # a centre that nobody is nearest to is left out


def chroma_weights(centres: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return integer weights (chroma, channel) whose lowest score is that of the nearest of `centres` (chroma, channel)."""
    weights = (centres**2).sum(axis=1, keepdims=True) - 2 * centres
    return np.rint(weights * CHROMA_SCALE).astype(np.int32)


def chroma_centres(rule: ClassRule) -> NDArray[np.float64]:
    """Return the chroma centres q (chroma, channel), rows of sum 1, of the integer weights |q|² − 2 q; equal shares if there
    is one."""
    weights = rule.chroma_weights / CHROMA_SCALE
    if rule.chromas == 1:
        return np.full((1, rule.channels), 1.0 / rule.channels)
    square = (weights.sum(axis=1, keepdims=True) + 2.0) / rule.channels
    return np.clip((square - weights) / 2.0, 0.0, 1.0)


def chroma_widths(rule: ClassRule) -> NDArray[np.int32]:
    """Return for each chroma (chroma) how much nearer than the second a colour is to it where no site takes that: DITHERED
    of the squared distance from its centre to the nearest other, in 256ths of what scores are to sums of the channels; 0
    without dither, and of twins, between which greys would flicker."""
    centres = chroma_centres(rule)
    distance = ((centres[:, None] - centres[None]) ** 2).sum(axis=2)
    nearest = np.where(distance > 0, distance, np.inf).min(axis=1)
    if not rule.chroma_dither or not np.isfinite(nearest).all():
        return np.zeros(rule.chromas, np.int32)
    nearest[nearest * rule.channels**2 < TWINS] = 0.0
    return np.rint(DITHERED * nearest * (CHROMA_SCALE << WIDTH_FRACTION)).astype(np.int32)


def stored_black_level(camera: CameraModel, shift: int) -> int:
    """Return the rule's black level."""
    return int(np.rint((camera.black_level - truncation(shift)) / 2**shift * 2**CHROMA_FRACTION))


def chromas(rule: ClassRule, statistics: Statistics) -> Integers:
    """Return the chroma (…), whatever is saturated."""
    above_black = np.clip((statistics.scaled >> (16 - CHROMA_FRACTION)) - rule.chroma_black_level, 0, TOP)
    # below 2⁵³: exact in float64, whose products BLAS does
    scores = above_black.astype(np.float64) @ rule.chroma_weights.T.astype(np.float64)
    nearest = np.argmin(scores, axis=-1)
    if not (widths := chroma_widths(rule)).any():
        return nearest
    least = np.take_along_axis(scores, nearest[..., None], -1)[..., 0]
    np.put_along_axis(scores, nearest[..., None], np.inf, -1)
    second = np.argmin(scores, axis=-1)
    farther = (np.take_along_axis(scores, second[..., None], -1)[..., 0] - least).astype(np.int64)
    turn = 2 * (statistics.site * TURN + TURN // 2 & 255) - 255
    reach = ((above_black.sum(axis=-1) >> WIDTH_FRACTION) * widths[nearest] >> 8) * np.where(nearest < second, turn, -turn)
    return np.where(farther < reach, second, nearest)


def entry(table: TransformTable, chroma: int) -> dict[str, Any]:
    """Return the number of a chroma and its centre as the channels' shares, read back from the rule's weights |q|² − 2 q."""
    shares = chroma_centres(table.first.rule)[chroma].tolist()
    return {"chroma": chroma, "shares": dict(zip(table.channels, shares, strict=True))}


def heading(entry: dict[str, Any]) -> str:
    """Return an entry as a row of a table begins, such as "1: r 0.30 g 0.45 b 0.25"."""
    return f"{entry['chroma']}: " + " ".join(f"{name} {share:.2f}" for name, share in entry["shares"].items())


def name(table: TransformTable, chroma: int) -> str:
    """Return a name such as "chroma 5"."""
    return f"chroma {chroma}"


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the macros that chroma.cl is compiled with."""
    black_level = rule.chroma_black_level
    return {
        "CHROMAS": rule.chromas,
        "CHROMA_FRACTION": CHROMA_FRACTION,
        "CHROMA_TOP": TOP,
        "CHROMA_BLACK_LEVEL": black_level,
        **({"CHROMA_TURN": TURN, "WIDTH_FRACTION": WIDTH_FRACTION} if chroma_widths(rule).any() else {}),
    }


def kernel_array(rule: ClassRule) -> NDArray[np.int32]:
    """Return (chroma and one of equal weights, 2 + pair of channels), as chroma.cl has them."""
    weights = np.concatenate([rule.chroma_weights, np.ones((1, rule.channels), np.int32)])
    pairs = np.zeros((len(weights), (rule.channels + 1) // 2, 2), np.int16)  # which the weights fit
    pairs.reshape(len(weights), -1)[:, : rule.channels] = weights
    start = 2**15 * weights.sum(axis=1, keepdims=True, dtype=np.int32)
    widths = np.append(chroma_widths(rule), 0)[:, None].astype(np.int32)
    return np.concatenate([start, widths, pairs.view(np.int32)[..., 0]], axis=1)
