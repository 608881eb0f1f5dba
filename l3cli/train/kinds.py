"""Which saturation patterns and colours get classes (docs/method.md#saturation-cases, docs/method.md#chroma)."""

import warnings

import numpy as np
from numpy.typing import NDArray

from l3cli.classify import Neighbourhoods

SMALLEST_SHARE = 2e-4  # of the training patches: rarer patterns join the nearest kept one


def choose_cases(occurrences: NDArray[np.int64], most: int) -> NDArray[np.uint16]:
    """Case of every saturation code (code) from how often each occurred (code).

    Code 0 is case 0. The most frequent others are kept, `most` cases in all. Every other code goes to the kept one that
    differs in the fewest channels, one that also clips its clipped channels before others; to case 0 only if none is kept.
    """
    codes = np.arange(len(occurrences))
    frequent = np.argsort(-occurrences[1:], kind="stable")[: most - 1] + 1
    kept = np.sort(frequent[occurrences[frequent] > SMALLEST_SHARE * occurrences.sum()])
    case_of_code = np.zeros(len(occurrences), dtype=np.uint16)
    if not kept.size:
        return case_of_code
    differing = np.bitwise_count(codes[:, None] ^ kept[None]).astype(np.float64)
    misses = (codes[:, None] & ~kept[None]) != 0
    case_of_code[:] = np.argmin(differing + 0.5 * misses, axis=1) + 1
    case_of_code[0] = 0
    return case_of_code


def channel_shares(signal: NDArray[np.float32], near: Neighbourhoods, site: int) -> NDArray[np.float64]:
    """Means of the channels over each patch (patch, tap), as shares of their sum: (patch, channel)."""
    member = (near.channel[site][:, None] == np.arange(near.count.shape[1])) / near.count[site]
    means = signal.astype(np.float64) @ member
    return means / np.maximum(means.sum(axis=1, keepdims=True), 1e-9)


def choose_chromas(shares: NDArray[np.float64], count: int, seed: int) -> NDArray[np.float64] | None:
    """`count` centres (chroma, channel) of the channel shares (patch, channel) by k-means; None if none or one is asked
    for."""
    if count <= 1:
        return None
    from scipy.cluster.vq import kmeans2

    distinct = np.unique(shares, axis=0)
    if len(distinct) <= count:
        return distinct
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of empty clusters
        centres, member = kmeans2(shares, count, iter=30, minit="++", rng=np.random.default_rng([seed, 2]))
    return centres[np.unique(member)]  # a centre that nobody is nearest to is left out
