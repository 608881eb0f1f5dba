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
    """Channels in the p × p window around each CFA site, and reciprocals for the features' integer formulas."""

    channel: Integers  # (site, tap): channel of each tap
    count: Integers  # (site, channel): number of taps of each channel
    mean_reciprocal: Integers  # (site, channel): round(65536 / count)
    variance_reciprocal: Integers  # (site, channel): round(512 / count)


def neighbourhoods(cfa: NDArray[np.uint8], patch: int, channels: int) -> Neighbourhoods:
    """Determine the channels in the windows around all sites of a CFA, and the reciprocals of their numbers of taps.

    Parameters
    ----------
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    patch : int
        Side of the windows in pixels.
    channels : int
        Number of channels.

    Raises
    ------
    RecipeError
        If a window does not contain every channel.
    """
    channel = window_channels(cfa, patch)
    count = np.array([np.bincount(window, minlength=channels) for window in channel])
    if (count == 0).any():
        rows, cols = cfa.shape
        raise RecipeError(
            f'a {patch}×{patch} patch does not contain every channel of the {rows}×{cols} CFA; increase "patch"'
        )
    return Neighbourhoods(channel, count, _divided(65536, count), _divided(2**VARIANCE_FRACTION, count))


def window_channels(cfa: NDArray[np.uint8], patch: int) -> Integers:
    """Return the channel of each tap in the windows around all sites of a CFA.

    Parameters
    ----------
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    patch : int
        Side of the windows in pixels.

    Returns
    -------
    ndarray, (site, tap)
        Channel of each tap. Taps are numbered row by row.
    """
    rows, cols = cfa.shape
    reach = np.arange(patch) - patch // 2
    windows = [cfa[np.ix_((r + reach) % rows, (c + reach) % cols)].ravel() for r in range(rows) for c in range(cols)]
    return np.array(windows, dtype=np.int64)


def _divided(numerator: int, count: Integers) -> Integers:
    """Return numerator / count, rounded half up."""
    return (2 * numerator + count) // (2 * count)


@dataclass(frozen=True)
class TapOrder:
    """Order of the taps in the window around a site.

    The taps are sorted by channel. Within a channel, the taps inside the saturation radius come first. The values of a
    channel are then adjacent rows of an array (tap, patch), which numpy sums fastest.
    """

    taps: Integers  # (tap,): position of each tap in the window
    channels: tuple[slice, ...]  # each channel's taps
    inner: tuple[slice, ...]  # each channel's taps within the saturation radius
    windows: NDArray[np.float32]  # (sum, tap): weight of each tap in the window sums of all features


def tap_order(rule: ClassRule, neighbours: Neighbourhoods, site: int) -> TapOrder:
    """Sort the taps in the window around a CFA site, as described in `TapOrder`."""
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
    """Return the weight of each tap in the window sums of all features: (sum, tap)."""
    counts = np.zeros((rule.window_sums, rule.patch, rule.patch), np.float32)
    for window in rule.windows:
        down, across = slice(window.top, window.top + window.rows), slice(window.left, window.left + window.columns)
        counts[window.sum, down, across] += window.sign
    return counts.reshape(len(counts), rule.patch**2)


def sites(rows: int, cols: int, cfa_shape: tuple[int, ...], phase: tuple[int, int]) -> Integers:
    """Return every pixel's CFA site: (row, col). `phase` is the CFA row and column of the first pixel."""
    row = (np.arange(rows) + phase[0]) % cfa_shape[0]
    col = (np.arange(cols) + phase[1]) % cfa_shape[1]
    return row[:, None] * cfa_shape[1] + col
