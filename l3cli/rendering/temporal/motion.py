"""Estimates motion vectors: the position of each block of a frame in the previous frame (docs/method.md#temporal).

All computations are in integers. Both frames are averaged over CFA periods, which removes the mosaic. The resolution of
these planes is halved repeatedly, until a sample is about as large as a block. The search goes from the coarsest to the
finest plane, in whole periods, so that sites keep their channel. Most blocks do not move, or the vector of the coarser plane
fits. If the difference is not larger than noise, a block is not searched further.
"""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from l3cli.rendering.temporal.noise import DEEP, Grid, NoiseTerms

Plane = NDArray[np.int32]
Vectors = NDArray[np.int32]  # (block row, block col, 2) displacement in rows and columns

MAX_COARSE_DISPLACEMENT = 2  # samples of the coarsest plane; largest displacement in each direction
CLIPPED = (1 << 12) - 1  # u; differences are clamped to this value, so that column sums fit into 16 bits in kernels
SETTLED = 5  # eighths of the noise of a difference; blocks with a smaller mean difference are not searched
RELUCTANCE = 2  # standard deviations of noise by which a vector must fit better than the starting vector
NEIGHBOURS = ((-1, 0), (1, 0), (0, -1), (0, 1))  # offsets to the blocks whose coarser vectors are also tried


def planes_of(values: NDArray[np.uint16], grid: Grid) -> list[Plane]:
    """Return the means of a mosaic over CFA periods, the means of 2 × 2 of these, and so on.

    The mosaic must consist of whole blocks.
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
    """Return the vector of every block, in pixels.

    The content of a pixel in this frame was at pixel + vector in the previous frame.
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
    """Computes the differences between the windows of all blocks at one plane level."""

    def __init__(self, now: Plane, before: Plane, grid: Grid, noise: NoiseTerms, level: int) -> None:
        self._before, self._grid, self._level = before, grid, level
        tall, wide = grid.window(level)
        self._rows = self._first(0)[:, None] + np.arange(tall)
        self._cols = self._first(1)[:, None] + np.arange(wide)
        self._now = self._windows(now, np.zeros((*grid.blocks, 2), np.int32))
        mean = self._now.sum(axis=(2, 3)) // (tall * wide)
        spread = noise.spread[mean >> (DEEP - 8)]
        # The sum of n absolute differences has a standard deviation of 0.6 √n, or about 5/8 √n, times that of a difference.
        self._reluctance = (spread * (RELUCTANCE * 5 * root_of((tall, wide)))) >> (7 + level)
        # Its mean is 0.8 n standard deviations for two unfiltered frames, and 0.58 n if one of them is filtered.
        self._settled = (spread * (SETTLED * tall * wide)) >> (3 + level)

    def _first(self, axis: int) -> NDArray[np.intp]:
        """Return the first row or column of the window of every block."""
        grid, unit = self._grid, self._grid.period[axis] << self._level
        margin = (grid.window(self._level)[axis] - grid.block[axis] // unit) // 2
        return np.arange(grid.blocks[axis]) * grid.block[axis] // unit - margin

    def _windows(self, plane: Plane, vector: Vectors) -> Plane:
        """Return the windows (block row, block col, row, col) of a plane, displaced by vectors and extended at its edges."""
        rows = np.clip(self._rows[:, None, :] + vector[..., 0, None], 0, plane.shape[0] - 1)
        cols = np.clip(self._cols[None, :, :] + vector[..., 1, None], 0, plane.shape[1] - 1)
        return plane[rows[..., :, None], cols[..., None, :]]

    def _cost(self, vector: Vectors) -> NDArray[np.int64]:
        differences = np.abs(self._now - self._windows(self._before, vector))
        return np.minimum(differences, CLIPPED).sum(axis=(2, 3), dtype=np.int64)

    def settled(self, vector: Vectors) -> NDArray[np.bool_]:
        """Return whether the difference of each block is no larger than noise."""
        return self._cost(vector) <= self._settled

    def best_of(self, candidates: list[Vectors]) -> Vectors:
        """Return the best vector for each block. All candidates except the first must be better by the reluctance."""
        best = self._within(candidates[0])
        least = self._cost(best)
        for candidate in candidates[1:]:
            vector = self._within(candidate)
            cost = self._cost(vector) + self._reluctance
            better = cost < least
            best, least = np.where(better[..., None], vector, best), np.where(better, cost, least)
        return best

    def _within(self, vector: Vectors) -> Vectors:
        """Limit vectors so that the displaced blocks stay within the frame."""
        grid, limited = self._grid, vector.copy()
        for axis in (0, 1):
            unit = grid.period[axis] << self._level
            first = np.arange(grid.blocks[axis]) * grid.block[axis]
            shape = (-1, 1) if axis == 0 else (1, -1)
            least, most = -(first // unit), (grid.shape[axis] - grid.block[axis] - first) // unit
            limited[..., axis] = np.clip(vector[..., axis], least.reshape(shape), most.reshape(shape))
        return limited


def root_of(window: tuple[int, int]) -> int:
    """Return 16 times the square root of the number of samples in a window."""
    return int(np.sqrt(window[0] * window[1]) * 16 + 0.5)


def _neighbours(vectors: Vectors) -> Iterator[Vectors]:
    """Yield the vectors of the neighbours of each block. At the edge, these are the vectors of the block itself."""
    padded = np.pad(vectors, ((1, 1), (1, 1), (0, 0)), mode="edge")
    for down, across in NEIGHBOURS:
        yield padded[1 + down : padded.shape[0] - 1 + down, 1 + across : padded.shape[1] - 1 + across]
