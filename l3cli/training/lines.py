"""Temporal noise of rows and columns: all pixels of a line get the same random offset (docs/method.md#row-and-column-noise).

The noise of two taps in one row or column of a patch is therefore correlated. Clipped taps have no noise, so an offset does
not change them. The *share* of a tap is the factor with which it gets the offsets of its lines: 0 if it clips, and otherwise
the gain of its channel relative to the camera.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel

Floats = NDArray[np.float32]
Indices = NDArray[np.intp]


class Offsets(NamedTuple):
    """Offsets of lines that were drawn for some pixels, and their variance. Both can be broadcast to the signals.

    They apply to channels with the gain of the camera.
    """

    values: Floats  # fractions of full scale
    variance: Floats  # full scale²

    def transposed(self) -> "Offsets":
        return Offsets(self.values.T, self.variance.T)


@dataclass(frozen=True)
class LineNoise:
    """Variances of the offsets that the pixels of a line share, as fractions of full scale²."""

    rows: float
    columns: float  # including the fixed offsets of columns

    @classmethod
    def of(cls, camera: CameraModel, dark: float = 0.0) -> "LineNoise | None":
        """Return the line noise of a camera, or None if it has none. `dark` is the dark signal in DN that was subtracted."""
        rows, columns = camera.line_variances(dark)
        span = camera.white_level - camera.black_level
        return cls(rows / span**2, columns / span**2) if camera.has_line_noise else None

    @property
    def total(self) -> float:
        """Variance of the offsets of a pixel."""
        return self.rows + self.columns

    def drawn(self, shape: tuple[int, ...], rng: np.random.Generator) -> Offsets:
        """Draw the offsets of the lines of an image (row, col)."""
        down, across = (
            rng.standard_normal(length, dtype=np.float32) * np.float32(np.sqrt(variance))
            for length, variance in zip(shape, (self.rows, self.columns), strict=True)
        )
        return Offsets(down[:, None] + across, np.full((1, 1), self.total, np.float32))

    def drawn_for_taps(
        self, taps: NDArray[np.integer], side: int, lacking: NDArray[np.floating], rng: np.random.Generator
    ) -> Offsets:
        """Draw the offsets of the lines of patches.

        Parameters
        ----------
        taps : ndarray, (tap,)
            Index of each tap in the window.
        side : int
            Side of the window.
        lacking : ndarray, (patch,)
            Fraction of the noise variance to add to each patch.
        rng : numpy.random.Generator
            Source of the random numbers.

        Returns
        -------
        Offsets
            Values (tap, patch), and variances (1, patch).
        """
        scale = np.sqrt(lacking).astype(np.float32)
        down, across = (
            rng.standard_normal((side, scale.size), dtype=np.float32) * (np.float32(np.sqrt(variance)) * scale)
            for variance in (self.rows, self.columns)
        )
        return Offsets(down[taps // side] + across[taps % side], (self.total * lacking[None]).astype(np.float32))


@dataclass(frozen=True)
class SharedNoise:
    """Line noise of patches that differ in how much of it their taps get."""

    noise: LineNoise
    shares: Floats  # (patch, tap) share of each tap

    def of(self, first: int, last: int) -> "SharedNoise":
        """Return the noise of the patches from `first` to `last` − 1."""
        return replace(self, shares=self.shares[first:last])

    def covariances(self) -> Floats:
        """Return the covariance of each pair of taps in `line_pairs`, summed over the patches."""
        pairs = line_pairs(int(np.sqrt(self.shares.shape[1])))
        variance = np.where(pairs.is_row, np.float32(self.noise.rows), np.float32(self.noise.columns))
        return np.asarray((self.shares.T @ self.shares)[pairs.first, pairs.second] * variance)

    def propagated(self, weights: Floats, outputs: Sequence[tuple[int, int]]) -> Floats:
        """Return by how much the covariances of outputs exceed those that independent noise of the taps would cause.

        Parameters
        ----------
        weights : ndarray, (tap, output)
            Transform of the class of the patches.
        outputs : sequence of (int, int)
            Pairs of outputs whose covariance is returned.

        Returns
        -------
        ndarray, (patch, pair)
        """
        side, (first, second) = int(np.sqrt(len(weights))), np.array(outputs).T
        lines, transform = self.shares.reshape(-1, side, side), weights.reshape(side, side, -1)
        by_row = np.matmul(lines.transpose(1, 0, 2), transform)  # (row, patch, output) sums over the columns
        by_column = np.matmul(lines.transpose(2, 0, 1), transform.transpose(1, 0, 2))
        total = -np.float32(self.noise.total) * (self.shares**2 @ (weights[:, first] * weights[:, second]))
        for variance, sums in ((self.noise.rows, by_row), (self.noise.columns, by_column)):
            total += np.float32(variance) * (sums[..., first] * sums[..., second]).sum(axis=0)
        return np.asarray(total)


class LinePairs(NamedTuple):
    """Pairs of different taps of a window that lie in the same row or in the same column. Each pair occurs once."""

    first: Indices
    second: Indices
    is_row: NDArray[np.bool_]


@functools.cache
def line_pairs(side: int) -> LinePairs:
    """Return the pairs of taps in the same line of a window of `side` × `side` pixels: first the rows, then the columns."""
    taps = np.arange(side**2).reshape(side, side)
    one, other = np.triu_indices(side, 1)
    rows, columns = [(each[:, one].ravel(), each[:, other].ravel()) for each in (taps, taps.T)]
    first, second = (np.concatenate(each) for each in zip(rows, columns, strict=True))
    return LinePairs(first, second, np.arange(first.size) < rows[0].size)


def split_noise(noise: NDArray[np.float64], taps: int) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Split stored noise (class, column) into variances (class, tap) and covariances (class, tap, tap).

    The covariances have zeros on the diagonal. They are None if the camera has no line noise.
    """
    if noise.shape[1] == taps:
        return noise, None
    pairs, covariance = line_pairs(int(np.sqrt(taps))), np.zeros((len(noise), taps, taps))
    covariance[:, pairs.first, pairs.second] = covariance[:, pairs.second, pairs.first] = noise[:, taps:]
    return noise[:, :taps], covariance
