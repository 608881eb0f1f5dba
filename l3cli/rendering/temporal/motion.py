"""Estimate one motion vector per block between two frames (docs/method.md#temporal).

Both frames are averaged over CFA periods, which removes the mosaic. An image pyramid halves the resolution repeatedly until
a sample is about as large as a block. The search runs in integers, from the coarsest to the finest plane of the pyramid. All
vectors are whole CFA periods, so that pixels of the same channel are compared. At each resolution, the search skips a block
if noise explains the remaining differences, either without motion or with the present vector.
"""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from l3cli.rendering.temporal.noise import DEEP, Grid, NoiseTerms

Plane = NDArray[np.int32]
Vectors = NDArray[np.int32]  # (block row, block col, 2) displacement in rows and columns

MAX_COARSE_DISPLACEMENT = 2  # largest displacement in the coarsest plane, in samples of this plane
# Limit of absolute differences, in units of u (see the module `noise`), so that kernels can sum columns in 16 bits.
CLIPPED = (1 << 12) - 1
SETTLED = 5  # a block is not searched if its mean absolute difference is at most 5/8 of the noise standard deviation
RELUCTANCE = 2  # a new vector replaces the old one only if its cost is lower by this number of noise standard deviations
NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))  # offsets of the neighbouring blocks that provide candidate vectors


def planes_of(values: NDArray[np.uint16], grid: Grid) -> list[Plane]:
    """Build the image pyramid: average a mosaic over CFA periods, then repeatedly over 2 × 2 samples.

    Parameters
    ----------
    values : ndarray, (row, col)
        Mosaic in units of u (see the module `noise`), padded to a whole number of blocks.
    grid : Grid
        Cells and blocks of the frame.

    Returns
    -------
    list of ndarray
        Planes from the finest to the coarsest.
    """
    down, across = grid.period
    sums = values.reshape(grid.shape[0] // down, down, grid.shape[1] // across, across).sum(axis=(1, 3), dtype=np.int64)
    planes = [((sums + down * across // 2) // (down * across)).astype(np.int32)]
    for _ in range(1, grid.planes):
        fine = planes[-1]
        fine = fine[: fine.shape[0] // 2 * 2, : fine.shape[1] // 2 * 2]
        planes.append((fine[::2, ::2] + fine[1::2, ::2] + fine[::2, 1::2] + fine[1::2, 1::2] + 2) >> 2)
    return planes


def vectors_of(now: list[Plane], before: list[Plane], grid: Grid, noise: NoiseTerms) -> Vectors:
    """Estimate the motion vector of each block, which points to its position in the previous frame.

    Parameters
    ----------
    now, before : list of ndarray
        Image pyramids of this frame and the previous frame, from `planes_of`.
    grid : Grid
        Cells and blocks of the frame.
    noise : NoiseTerms
        Noise of the frames.

    Returns
    -------
    ndarray, (block row, block col, 2)
        Displacements in rows and columns, in pixels.
    """
    found = np.zeros((*grid.blocks, 2), np.int32)
    for level in reversed(range(grid.planes)):
        coarsest = level == grid.planes - 1
        search, parents = _Search(now[level], before[level], grid, noise, level), found * 2
        still = np.zeros_like(parents)
        start = still if coarsest else search.best_of([still, parents, *_neighbours(parents)])
        start = np.where(search.settled(still)[..., None], still, start)
        reach = MAX_COARSE_DISPLACEMENT if coarsest else 1
        steps = itertools.product(range(-reach, reach + 1), repeat=2)
        best = search.best_of([start, *(start + np.array(step, np.int32) for step in steps if any(step))])
        found = np.where(search.settled(start)[..., None], start, best)
    return found * np.array(grid.period, np.int32)


class _Search:
    """Compares blocks of two frames at one level of the image pyramids."""

    def __init__(self, now: Plane, before: Plane, grid: Grid, noise: NoiseTerms, level: int) -> None:
        self._before, self._grid, self._level = before, grid, level
        tall, wide = grid.window(level)
        self._rows = self._first(0)[:, None] + np.arange(tall)
        self._cols = self._first(1)[:, None] + np.arange(wide)
        self._now = self._windows(now, np.zeros((*grid.blocks, 2), np.int32))
        mean = self._now.sum(axis=(2, 3)) // (tall * wide)
        spread = noise.spread[mean >> (DEEP - 8)]
        # If differences have the standard deviation σ, the sum of n absolute differences has the standard deviation 0.6 √n
        # σ, approximated here by 5/8 √n σ.
        self._reluctance = (spread * (RELUCTANCE * 5 * root_of((tall, wide)))) >> (7 + level)
        # The mean of this sum is 0.8 n σ for two unfiltered frames, and 0.58 n σ if the previous frame is filtered.
        self._settled = (spread * (SETTLED * tall * wide)) >> (3 + level)

    def _first(self, axis: int) -> NDArray[np.intp]:
        """Return the first row (axis 0) or column (axis 1) of every block's window."""
        grid, unit = self._grid, self._grid.period[axis] << self._level
        margin = (grid.window(self._level)[axis] - grid.block[axis] // unit) // 2
        return np.arange(grid.blocks[axis]) * grid.block[axis] // unit - margin

    def _windows(self, plane: Plane, vector: Vectors) -> Plane:
        """Return every block's window in a plane, displaced by `vector`. At the edges, samples are repeated."""
        rows = np.clip(self._rows[:, None, :] + vector[..., 0, None], 0, plane.shape[0] - 1)
        cols = np.clip(self._cols[None, :, :] + vector[..., 1, None], 0, plane.shape[1] - 1)
        return plane[rows[..., :, None], cols[..., None, :]]

    def _cost(self, vector: Vectors) -> NDArray[np.int64]:
        differences = np.abs(self._now - self._windows(self._before, vector))
        return np.minimum(differences, CLIPPED).sum(axis=(2, 3), dtype=np.int64)

    def settled(self, vector: Vectors) -> NDArray[np.bool_]:
        """Return which blocks fit after displacement by `vector`: noise alone explains the differences that are left."""
        return self._cost(vector) <= self._settled

    def best_of(self, candidates: list[Vectors]) -> Vectors:
        """Return the best vector for each block: the first candidate, unless another candidate fits clearly better."""
        best = self._within(candidates[0])
        least = self._cost(best)
        for candidate in candidates[1:]:
            vector = self._within(candidate)
            cost = self._cost(vector) + self._reluctance
            better = cost < least
            best, least = np.where(better[..., None], vector, best), np.where(better, cost, least)
        return best

    def _within(self, vector: Vectors) -> Vectors:
        """Limit vectors so that the displaced blocks remain inside the frame."""
        grid, limited = self._grid, vector.copy()
        for axis in (0, 1):
            unit = grid.period[axis] << self._level
            first = np.arange(grid.blocks[axis]) * grid.block[axis]
            shape = (-1, 1) if axis == 0 else (1, -1)
            least, most = -(first // unit), (grid.shape[axis] - grid.block[axis] - first) // unit
            limited[..., axis] = np.clip(vector[..., axis], least.reshape(shape), most.reshape(shape))
        return limited


def root_of(window: tuple[int, int]) -> int:
    """Return 16 times the square root of a window's number of samples, rounded."""
    return int(np.sqrt(window[0] * window[1]) * 16 + 0.5)


def _neighbours(vectors: Vectors) -> Iterator[Vectors]:
    """Yield the vectors of each block's upper, lower, left and right neighbours.

    At the edge of the frame, a missing neighbour has the block's own vector.
    """
    padded = np.pad(vectors, ((1, 1), (1, 1), (0, 0)), mode="edge")
    for down, across in NEIGHBOURS:
        yield padded[1 + down : padded.shape[0] - 1 + down, 1 + across : padded.shape[1] - 1 + across]
