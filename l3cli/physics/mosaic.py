"""Colour filter arrays: patterns of channels that repeat over a sensor."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def tiled(pattern: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return a pattern repeated to a shape (row, col), starting at the first pixel."""
    rows, cols = pattern.shape
    return pattern[np.arange(shape[0])[:, None] % rows, np.arange(shape[1]) % cols]


def shifted_cfa(cfa: NDArray[np.uint8], phase: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the super-pixel as seen from a frame whose first pixel has the site `phase`."""
    return np.roll(cfa, (-phase[0], -phase[1]), axis=(0, 1))


def least_period(pattern: NDArray[Any]) -> NDArray[Any]:
    """Return the smallest array whose repetition gives a pattern (row, col)."""
    lengths = []
    for axis, length in enumerate(pattern.shape):
        periods = (each for each in range(1, length + 1) if length % each == 0)
        lengths.append(next(each for each in periods if np.array_equal(np.roll(pattern, each, axis), pattern)))
    return pattern[: lengths[0], : lengths[1]]


def array_rows(channels: Sequence[str], cfa: NDArray[np.integer], between: str = " ") -> list[str]:
    """Return the rows of an array (row, col) of channels as text: names, separated by `between`."""
    return [between.join(channels[site] for site in row) for row in cfa]
