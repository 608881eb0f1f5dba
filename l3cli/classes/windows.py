"""The windows around the sites of a CFA: the channel of each tap, and the number of taps of each channel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.errors import RecipeError

Integers = NDArray[np.int64]
VARIANCE_FRACTION = 9  # number of fractional bits of a channel variance


@dataclass(frozen=True)
class Neighbourhoods:
    """The p × p window of each site of a CFA, and the reciprocals that occur in the class formulas."""

    channel: Integers  # (site, tap) channel of each tap
    count: Integers  # (site, channel) number of taps of each channel
    mean_reciprocal: Integers  # (site, channel) round(65536 / count)
    variance_reciprocal: Integers  # (site, channel) round(512 / count)


def neighbourhoods(cfa: NDArray[np.uint8], patch: int, channels: int) -> Neighbourhoods:
    """Return the windows with side `patch` around every site.

    Raises RecipeError if a window does not contain all channels.
    """
    channel = window_channels(cfa, patch)
    count = np.array([np.bincount(window, minlength=channels) for window in channel])
    if (count == 0).any():
        rows, cols = cfa.shape
        raise RecipeError(f"a {patch}×{patch} patch does not reach every channel of the {rows}×{cols} CFA; enlarge patch")
    return Neighbourhoods(channel, count, _divided(65536, count), _divided(2**VARIANCE_FRACTION, count))


def window_channels(cfa: NDArray[np.uint8], patch: int) -> Integers:
    """Return the channel of each tap (site, tap), row by row, in the windows with side `patch` around every site."""
    rows, cols = cfa.shape
    reach = np.arange(patch) - patch // 2
    windows = [cfa[np.ix_((r + reach) % rows, (c + reach) % cols)].ravel() for r in range(rows) for c in range(cols)]
    return np.array(windows, dtype=np.int64)


def _divided(numerator: int, count: Integers) -> Integers:
    """Return round(numerator / count) in integer arithmetic, rounding halves up."""
    return (2 * numerator + count) // (2 * count)


@dataclass(frozen=True)
class TapOrder:
    """The taps of a site's window, sorted by channel. Within a channel, taps near the centre come first.

    Sums over the taps of a channel are then sums over adjacent rows of an array (tap, patch), which numpy computes fastest.
    """

    taps: Integers  # (tap) indices in the window
    channels: tuple[slice, ...]  # the taps of each channel
    inner: tuple[slice, ...]  # the taps of each channel that decide the saturation case
    windows: NDArray[np.float32]  # (sum, tap) how often each tap counts in the window sums of all features


def tap_order(rule: ClassRule, neighbours: Neighbourhoods, site: int) -> TapOrder:
    """Return the order of taps for one site."""
    channel, channels = neighbours.channel[site], neighbours.count.shape[1]
    reach = np.abs(np.arange(rule.patch) - rule.radius)
    outer = np.maximum(reach[:, None], reach[None]).ravel() > rule.saturation_radius
    start = np.append(0, np.cumsum(neighbours.count[site])).tolist()
    inner = np.bincount(channel[~outer], minlength=channels).tolist()
    taps = np.lexsort((outer, channel))
    return TapOrder(
        taps,
        tuple(slice(start[index], start[index + 1]) for index in range(channels)),
        tuple(slice(start[index], start[index] + inner[index]) for index in range(channels)),
        _tap_counts(rule)[:, taps],
    )


def _tap_counts(rule: ClassRule) -> NDArray[np.float32]:
    """Return the number of times (sum, tap) that each tap, row by row, is counted in the window sums of all features."""
    counts = np.zeros((rule.window_sums, rule.patch, rule.patch), np.float32)
    for window in rule.windows:
        down, across = slice(window.top, window.top + window.rows), slice(window.left, window.left + window.columns)
        counts[window.sum, down, across] += window.sign
    return counts.reshape(len(counts), rule.patch**2)


def sites(rows: int, cols: int, cfa_shape: tuple[int, ...], phase: tuple[int, int]) -> Integers:
    """Return the index of the CFA site (row, col) of every pixel of a frame whose first pixel has the site `phase`."""
    row = (np.arange(rows) + phase[0]) % cfa_shape[0]
    col = (np.arange(cols) + phase[1]) % cfa_shape[1]
    return row[:, None] * cfa_shape[1] + col
