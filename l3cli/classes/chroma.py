"""Chroma: the colour class of a patch without saturated pixels near its centre (docs/method.md#chroma).

    chroma = the first k that minimises Σ clamp((S · round(65536 / n) >> 12) − chroma_black_level, 0…65535) · weight[k]

S and n are the sum and the number of a channel's values in the patch. Σ is the sum over the channels.

Let m be the channel means above black, f = m / Σ m the channel fractions, and q_k the centre of chroma k. The centre nearest
to f has the smallest |f − q_k|², and therefore the smallest |q_k|² − 2 Σ f q_k. Multiplying this expression by Σ m does not
change which centre has the smallest value. Because Σ f = 1, the result is Σ m (|q_k|² − 2 q_k). The weights of chroma k are
therefore |q_k|² − 2 q_k, and the means need not be divided by their sum.

A class rule may dither between chromas (docs/method.md#dither). If a colour is midway between two chroma centres, half of
the CFA sites use the second nearest centre. The closer the colour is to the nearest centre, the fewer sites do so. Later
layers average over the sites, so that colours change smoothly.
"""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import CHROMA_SCALE, ClassRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.statistics import Statistics, truncation
from l3cli.classes.windows import Integers, Neighbourhoods

CHROMA_FRACTION = 4  # number of fractional bits of a channel mean in the chroma scores
MAX_CHROMA_INPUT = 2**16 - 1  # channel means are clamped to this value, so that the scores fit into 32 bits
# Number of k-means runs, of which the best is used. A single run would increase the S-CIELAB error by 10 % in one case of
# ten.
STARTS = 4
WIDTH_FRACTION = 8  # number of fractional bits of the dither widths
# Dither width, divided by the squared distance to the nearest other centre. A ratio of 1 would tint the palest paints.
DITHERED = 0.6
# The rule dithers between two centres only if their squared distance, multiplied by the squared number of channels, is at
# least this value.
MIN_DITHER_DISTANCE = 2e-3
TURN = 159  # 256 × 0.618 (golden ratio), so that the dither thresholds of consecutive sites are evenly distributed
SNIPPET = "features/chroma.cl"


def channel_shares(signal: NDArray[np.float32], neighbours: Neighbourhoods, site: int) -> NDArray[np.float64]:
    """Compute the channel fractions of patches: the channel means, divided by their sum.

    Parameters
    ----------
    signal : ndarray, (patch, tap)
        Signal above black.
    neighbours : Neighbourhoods
        Result of `neighbourhoods` for the CFA.
    site : int
        CFA site at the centre of the patches.

    Returns
    -------
    ndarray, (patch, channel)
        Channel fractions, which add up to 1.
    """
    member = (neighbours.channel[site][:, None] == np.arange(neighbours.count.shape[1])) / neighbours.count[site]
    means = signal.astype(np.float64) @ member
    return means / np.maximum(means.sum(axis=1, keepdims=True), 1e-9)


def choose_chromas(
    shares: NDArray[np.float64], count: int, seed: int, white: NDArray[np.float64] | None = None
) -> NDArray[np.float64] | None:
    """Choose chroma centres by k-means.

    Parameters
    ----------
    shares : ndarray, (patch, channel)
        Channel fractions of each patch.
    count : int
        Number of centres.
    seed : int
        Seed of the random starts.
    white : ndarray, (channel,), optional
        Signals of white. If all are positive, white becomes the last centre.

    Returns
    -------
    ndarray, (chroma, channel), or None
        The centres, at most one per distinct colour. None if `count` is 0 or 1.
    """
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
        warnings.simplefilter("ignore", UserWarning)  # scipy warns about empty clusters, which are removed below
        rng = np.random.default_rng([seed, 2])
        tried = [kmeans2(shares, count, iter=30, minit="++", rng=rng) for _ in range(STARTS)]
    centres, member = min(tried, key=lambda each: float(((shares - each[0][each[1]]) ** 2).sum()))
    return np.asarray(centres[np.unique(member)])  # without empty clusters


def chroma_weights(centres: NDArray[np.float64]) -> NDArray[np.int32]:
    """Convert chroma centres (chroma, channel) to integer weights, so that the nearest centre has the lowest score."""
    weights = (centres**2).sum(axis=1, keepdims=True) - 2 * centres
    return np.rint(weights * CHROMA_SCALE).astype(np.int32)


def chroma_centres(rule: ClassRule) -> NDArray[np.float64]:
    """Recover the chroma centres q of a class rule from its integer weights |q|² − 2 q.

    Returns
    -------
    ndarray, (chroma, channel)
        Channel fractions. If the rule has only one chroma, all channels have the same value.
    """
    weights = rule.chroma_weights / CHROMA_SCALE
    if rule.chromas == 1:
        return np.full((1, rule.channels), 1.0 / rule.channels)
    square = (weights.sum(axis=1, keepdims=True) + 2.0) / rule.channels
    return np.clip((square - weights) / 2.0, 0.0, 1.0)


def chroma_widths(rule: ClassRule) -> NDArray[np.int32]:
    """Return the dither width of each chroma. The unit is 1/256 of the scores for channel means that add up to 1.

    A pixel can use the second nearest chroma centre only if the scores of the two nearest centres differ by less than the
    dither width. A chroma's width is DITHERED times the squared distance from its centre to the closest other centre. If the
    rule does not dither, or if the two centres are so close that greys would flicker between them, the width is 0.
    """
    centres = chroma_centres(rule)
    distance = ((centres[:, None] - centres[None]) ** 2).sum(axis=2)
    nearest = np.where(distance > 0, distance, np.inf).min(axis=1)
    if not rule.chroma_dither or not np.isfinite(nearest).all():
        return np.zeros(rule.chromas, np.int32)
    nearest[nearest * rule.channels**2 < MIN_DITHER_DISTANCE] = 0.0
    return np.rint(DITHERED * nearest * (CHROMA_SCALE << WIDTH_FRACTION)).astype(np.int32)


def stored_black_level(camera: CameraModel, shift: int) -> int:
    """Return the black level to subtract from channel means, in units of (DN >> shift) / 2^CHROMA_FRACTION."""
    return int(np.rint((camera.black_level - truncation(shift)) / 2**shift * 2**CHROMA_FRACTION))


def chromas(rule: ClassRule, statistics: Statistics) -> Integers:
    """Return the chroma of each pixel. Saturated pixels also get a chroma, but it does not affect their class."""
    above_black = np.clip((statistics.scaled >> (16 - CHROMA_FRACTION)) - rule.chroma_black_level, 0, MAX_CHROMA_INPUT)
    # The scores are below 2⁵³ and therefore exact in float64. For floats, numpy uses the faster matrix products of BLAS.
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
    """Describe a chroma for reports and JSON: its number, and the channel fractions of its centre."""
    shares = chroma_centres(table.first.rule)[chroma].tolist()
    return {"chroma": chroma, "shares": dict(zip(table.channels, shares, strict=True))}


def heading(entry: dict[str, Any]) -> str:
    """Return a row label for a chroma, such as "1: r 0.30 g 0.45 b 0.25"."""
    return f"{entry['chroma']}: " + " ".join(f"{name} {share:.2f}" for name, share in entry["shares"].items())


def name(table: TransformTable, chroma: int) -> str:
    return f"chroma {chroma}"


def macros(rule: ClassRule) -> dict[str, int]:
    """Return the compiler macros for chroma.cl."""
    black_level = rule.chroma_black_level
    return {
        "CHROMAS": rule.chromas,
        "CHROMA_FRACTION": CHROMA_FRACTION,
        "CHROMA_TOP": MAX_CHROMA_INPUT,
        "CHROMA_BLACK_LEVEL": black_level,
        **({"CHROMA_TURN": TURN, "WIDTH_FRACTION": WIDTH_FRACTION} if chroma_widths(rule).any() else {}),
    }


def kernel_array(rule: ClassRule) -> NDArray[np.int32]:
    """Return the constants for chroma.cl: one row for each chroma class, and a last row in which all weights are 1.

    chroma.cl computes a score for each class, and the class with the best score wins. Each row contains the initial value of
    the score, the dither width, and the weights of all channels. Pairs of 16-bit weights are packed into 32-bit integers.
    """
    weights = np.concatenate([rule.chroma_weights, np.ones((1, rule.channels), np.int32)])
    pairs = np.zeros((len(weights), (rule.channels + 1) // 2, 2), np.int16)  # weights fit into 16 bits
    pairs.reshape(len(weights), -1)[:, : rule.channels] = weights
    start = 2**15 * weights.sum(axis=1, keepdims=True, dtype=np.int32)
    widths = np.append(chroma_widths(rule), 0)[:, None].astype(np.int32)
    return np.concatenate([start, widths, pairs.view(np.int32)[..., 0]], axis=1)
