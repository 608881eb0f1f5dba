"""Compute the statistics of patches from which all class features are derived.

The statistics are sums of values, sums of squares, saturation codes and window sums.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule
from l3cli.classes import saturation
from l3cli.classes.windows import Integers, Neighbourhoods, TapOrder, sites
from l3cli.frames.frame import pad_mosaic
from l3cli.physics.mosaic import shifted_cfa, tiled


@dataclass(frozen=True)
class Statistics:
    """Statistics of the patches around pixels. In the shapes below, … stands for the axes of the pixel array."""

    neighbours: Neighbourhoods
    site: Integers  # (…), or (1,) if all pixels have the same site: CFA site
    sums: Integers  # (…, channel): sums of v = DN >> shift
    squares: Integers | None  # (…, channel): sums of v²; None if the class rule does not distinguish contrasts
    code: Integers  # (…): saturation code; bit c is set if a pixel of channel c near the centre is saturated
    windows: Integers  # (…, sum): sums of v over the windows of all additional features

    @cached_property
    def scaled(self) -> Integers:
        """Channel means times 65536, computed as S · round(65536 / n) < 2³²: (…, channel)."""
        return self.sums * self.neighbours.mean_reciprocal[self.site]


class PatchSums(NamedTuple):
    """Sums over each training patch, for patches centred on the same CFA site."""

    sums: NDArray[np.uint32]  # (channel, patch): sums of v = DN >> shift
    squares: NDArray[np.uint32] | None  # (channel, patch): sums of v²; None if the class rule does not distinguish contrasts
    code: Integers  # (patch,): saturation codes
    windows: NDArray[np.float32]  # (sum, patch): sums of v over windows of additional features; integers below 2²⁴


def window_sums(rule: ClassRule, statistics: Statistics) -> tuple[Integers, ...]:
    """Return the window sums of each additional feature: (…, sum)."""
    ends = np.cumsum([feature.sums for feature in rule.feature_list], dtype=int)
    return tuple(
        statistics.windows[..., end - feature.sums : end]
        for feature, end in zip(rule.feature_list, ends.tolist(), strict=True)
    )


def truncation(shift: int) -> float:
    """Return the mean truncation error, in DN, if integers are shifted right by `shift` bits."""
    return (2**shift - 1) / 2


def patch_statistics(values: NDArray[np.uint32], rule: ClassRule, order: TapOrder) -> PatchSums:
    """Compute the statistics of training patches that are centred on the same CFA site.

    For each patch, the result contains the sums and the sums of squares of each channel, the saturation code, and the window
    sums of additional class features.

    Parameters
    ----------
    values : ndarray, (tap, patch)
        Raw values in DN, with the taps in the given order. The array is overwritten.
    rule : ClassRule
        Class rule of the first layer. It determines which statistics are needed.
    order : TapOrder
        Order of the taps.
    """
    code = saturation.codes(values, rule, order)
    if rule.shift:
        values >>= rule.shift
    sums = _channel_sums(values, order)
    windows = np.empty((0, values.shape[1]), np.float32)
    if len(order.windows):
        windows = order.windows @ values.astype(np.float32)
    squares = None
    if rule.contrasts > 1:
        values *= values
        squares = _channel_sums(values, order)
    return PatchSums(sums, squares, code, windows)


def _channel_sums(values: NDArray[np.uint32], order: TapOrder) -> NDArray[np.uint32]:
    return np.stack([np.add.reduce(values[taps], axis=0, dtype=np.uint32) for taps in order.channels])


def mosaic_statistics(
    values: NDArray[np.uint16], rule: ClassRule, neighbours: Neighbourhoods, cfa: NDArray[np.uint8], phase: tuple[int, int]
) -> Statistics:
    """Compute the statistics of every pixel of a mosaic.

    Parameters
    ----------
    values : ndarray, (row, col)
        Raw values in DN.
    rule : ClassRule
        Class rule of the first layer. It determines which statistics are needed.
    neighbours : Neighbourhoods
        Result of `neighbourhoods` for the CFA.
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    phase : tuple of int
        CFA site (row, col) of the first pixel.
    """
    rows, cols = values.shape
    padded = pad_mosaic(values, rule.radius, cfa.shape).astype(np.int64)
    channel = tiled(shifted_cfa(cfa, (phase[0] - rule.radius, phase[1] - rule.radius)), padded.shape)
    shifted = padded >> rule.shift
    saturated = padded >= rule.saturation
    sums, squares, code = [], [], np.zeros((rows, cols), dtype=np.int64)
    for index in range(neighbours.count.shape[1]):
        of_channel = channel == index
        sums.append(_box(shifted * of_channel, rule.patch))
        if rule.contrasts > 1:
            squares.append(_box(shifted**2 * of_channel, rule.patch))
        inner = _inner(saturated & of_channel, rule)
        if inner.any():
            code |= (_box(inner.astype(np.int64), 2 * rule.saturation_radius + 1) > 0).astype(np.int64) << index
    site = sites(rows, cols, cfa.shape, phase)
    windows = _mosaic_windows(shifted, rule, rows, cols)
    return Statistics(neighbours, site, np.stack(sums, -1), np.stack(squares, -1) if squares else None, code, windows)


def _mosaic_windows(padded: Integers, rule: ClassRule, rows: int, cols: int) -> Integers:
    """Compute the window sums of every pixel from an integral image: (row, col, sum)."""
    total = np.pad(padded.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    sums = np.zeros((rule.window_sums, rows, cols), np.int64)
    for window in rule.windows:
        top, low = (total[row : row + rows] for row in (window.top, window.top + window.rows))
        left, right = (slice(col, col + cols) for col in (window.left, window.left + window.columns))
        sums[window.sum] += window.sign * (low[:, right] - top[:, right] - low[:, left] + top[:, left])
    return np.moveaxis(sums, 0, -1)


def _inner(padded: NDArray, rule: ClassRule) -> NDArray:
    """Crop the margin of a padded array from the patch radius to the saturation radius."""
    cut = rule.radius - rule.saturation_radius
    return padded[cut : padded.shape[0] - cut, cut : padded.shape[1] - cut]


def _box(padded: Integers, size: int) -> Integers:
    """Return the sum over every size × size window of a padded array."""
    total = np.cumsum(np.pad(padded, ((1, 0), (0, 0))), axis=0)
    total = total[size:] - total[:-size]
    total = np.cumsum(np.pad(total, ((0, 0), (1, 0))), axis=1)
    return total[:, size:] - total[:, :-size]
