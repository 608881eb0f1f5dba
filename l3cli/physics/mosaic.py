"""Functions for colour filter arrays (CFAs). A CFA is an array (row, col) of channel indices, one per site of a period."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def tiled(pattern: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Repeat a pattern (row, col) over an area of the given shape, starting with pattern[0, 0]."""
    rows, cols = pattern.shape
    return pattern[np.arange(shape[0])[:, None] % rows, np.arange(shape[1]) % cols]


def shifted_cfa(cfa: NDArray[np.uint8], phase: tuple[int, int]) -> NDArray[np.uint8]:
    """Shift a CFA cyclically, so that the site at `phase` becomes its first site.

    If `phase` is the CFA row and column of a frame's first pixel, the result is the CFA of this frame.
    """
    return np.roll(cfa, (-phase[0], -phase[1]), axis=(0, 1))


MOST_DISTINCT = 3  # largest number of channels whose responsivities need not overlap


def channel_reach(cfa: NDArray[np.uint8]) -> int:
    """Return the radius, in pixels, of the smallest square window that contains all channels at every position.

    If the CFA has more than three channels, one channel may be missing in each window. The responsivities of so many
    channels overlap, so no surface is dark in one channel only.
    """
    channels, reach = np.unique(cfa), 0
    least = channels.size - (channels.size > MOST_DISTINCT)
    while np.sum([_near(cfa == channel, reach) for channel in channels], axis=0).min() < least:
        reach += 1
    return reach


def _near(pattern: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Dilate a periodic pattern with a square window of radius `reach`."""
    for axis in (0, 1):
        pattern = np.logical_or.reduce([np.roll(pattern, step, axis) for step in range(-reach, reach + 1)])
    return pattern


def least_period(pattern: NDArray[Any]) -> NDArray[Any]:
    """Return the smallest rectangle, starting at pattern[0, 0], that reproduces the pattern (row, col) if it is repeated."""
    lengths = []
    for axis, length in enumerate(pattern.shape):
        periods = (each for each in range(1, length + 1) if length % each == 0)
        lengths.append(next(each for each in periods if np.array_equal(np.roll(pattern, each, axis), pattern)))
    return pattern[: lengths[0], : lengths[1]]


def array_rows(channels: Sequence[str], cfa: NDArray[np.integer], between: str = " ") -> list[str]:
    """Return each row of a CFA as text, with channel names separated by `between`."""
    return [between.join(channels[site] for site in row) for row in cfa]
