"""Model row and column noise in training patches (docs/method.md#row-and-column-noise).

A *line* is a row or a column. All pixels of a line receive the same random offset, so taps in the same line of a patch have
correlated noise. At each tap, the offsets are multiplied by a factor, the tap's *share*. The share is 0 if the tap clips,
because clipped taps have no noise. Otherwise, it is the gain of the tap's channel, relative to the camera's gain.
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
    """Random offsets of pixels, the sums of row and column offsets, and their variance.

    The offsets apply to channels with the camera's gain. Both arrays can be broadcast against the signals.
    """

    values: Floats  # fractions of full scale
    variance: Floats  # variance of `values`

    def transposed(self) -> "Offsets":
        return Offsets(self.values.T, self.variance.T)


@dataclass(frozen=True)
class LineNoise:
    """Variances of the row offsets and the column offsets, which are fractions of full scale."""

    rows: float
    columns: float  # temporal and fixed offsets together

    @classmethod
    def of(cls, camera: CameraModel, dark: float = 0.0) -> "LineNoise | None":
        """Return a camera's line noise, or None if it has none. `dark` is the subtracted dark signal in DN."""
        rows, columns = camera.line_variances(dark)
        span = camera.white_level - camera.black_level
        return cls(rows / span**2, columns / span**2) if camera.has_line_noise else None

    @property
    def total(self) -> float:
        """Variance of a pixel's offset, which is the sum of its row offset and its column offset."""
        return self.rows + self.columns

    def drawn(self, shape: tuple[int, ...], rng: np.random.Generator) -> Offsets:
        """Draw random offsets for all pixels of a frame of the given shape (rows, cols)."""
        down, across = (
            rng.standard_normal(length, dtype=np.float32) * np.float32(np.sqrt(variance))
            for length, variance in zip(shape, (self.rows, self.columns), strict=True)
        )
        return Offsets(down[:, None] + across, np.full((1, 1), self.total, np.float32))

    def drawn_for_taps(
        self, taps: NDArray[np.integer], side: int, lacking: NDArray[np.floating], rng: np.random.Generator
    ) -> Offsets:
        """Draw random offsets for the taps of patches.

        Parameters
        ----------
        taps : ndarray, (tap,)
            Index of each tap in the window.
        side : int
            Side of the window.
        lacking : ndarray, (patch,)
            Fraction of the noise variance to add to each patch.
        rng : numpy.random.Generator
            Random number generator.

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
    """Line noise in patches: the variances of row and column offsets, and each tap's *share* (see the module docstring)."""

    noise: LineNoise
    shares: Floats  # (patch, tap)

    def of(self, first: int, last: int) -> "SharedNoise":
        """Return the line noise in the patches `first` to `last` − 1."""
        return replace(self, shares=self.shares[first:last])

    def covariances(self) -> Floats:
        """Return the noise covariance of each tap pair in `line_pairs`, summed over the patches."""
        pairs = line_pairs(int(np.sqrt(self.shares.shape[1])))
        variance = np.where(pairs.is_row, np.float32(self.noise.rows), np.float32(self.noise.columns))
        return np.asarray((self.shares.T @ self.shares)[pairs.first, pairs.second] * variance)

    def propagated(self, weights: Floats, outputs: Sequence[tuple[int, int]]) -> Floats:
        """Compute by how much the correlation of line noise changes the noise covariance of the outputs.

        The change is the covariance due to line noise, minus the covariance due to independent noise with the same variance
        at each tap.

        Parameters
        ----------
        weights : ndarray, (tap, output)
            Transform of the patches' class.
        outputs : sequence of (int, int)
            Output pairs for which to compute the covariance.

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
    """Pairs of different taps in the same row or column of a window, each listed once."""

    first: Indices
    second: Indices
    is_row: NDArray[np.bool_]


@functools.cache
def line_pairs(side: int) -> LinePairs:
    """List the tap pairs in the same row, then in the same column, of a window of `side` × `side` pixels."""
    taps = np.arange(side**2).reshape(side, side)
    one, other = np.triu_indices(side, 1)
    rows, columns = [(each[:, one].ravel(), each[:, other].ravel()) for each in (taps, taps.T)]
    first, second = (np.concatenate(each) for each in zip(rows, columns, strict=True))
    return LinePairs(first, second, np.arange(first.size) < rows[0].size)


def split_noise(noise: NDArray[np.float64], taps: int) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    """Split stored noise sums (class, column) into variances (class, tap) and covariances (class, tap, tap).

    The covariances are zero on the diagonal. They are None if the camera has no line noise.
    """
    if noise.shape[1] == taps:
        return noise, None
    pairs, covariance = line_pairs(int(np.sqrt(taps))), np.zeros((len(noise), taps, taps))
    covariance[:, pairs.first, pairs.second] = covariance[:, pairs.second, pairs.first] = noise[:, taps:]
    return noise[:, :taps], covariance
