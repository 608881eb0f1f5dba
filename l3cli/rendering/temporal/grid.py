"""Cells and blocks that a frame is cut into."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEAST_CELL, LEAST_BLOCK = 4, 16  # pixels, at least, of the sides of a cell and of a block
LANES = 8  # pixels that kernels take side by side: columns of a block are a multiple


@dataclass(frozen=True)
class Grid:
    """A frame's sides in pixels: (rows, columns) each."""

    period: tuple[int, int]
    cell: tuple[int, int]  # whole periods: the blend is decided a cell
    block: tuple[int, int]  # whole cells: a vector each
    blocks: tuple[int, int]  # number of them
    planes: int  # number of planes of means, each half as fine as the one before

    @staticmethod
    def of(shape: tuple[int, ...], period: tuple[int, ...]) -> "Grid":
        """Return the grid of frames of a shape and an array."""
        down, across = (_sides(side, lanes) for side, lanes in zip(period, (1, LANES), strict=True))
        blocks = (-(-shape[0] // down[2]), -(-shape[1] // across[2]))
        planes = 1
        while max(period) << planes <= LEAST_BLOCK:
            planes += 1
        return Grid((down[0], across[0]), (down[1], across[1]), (down[2], across[2]), blocks, planes)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of whole blocks."""
        return self.blocks[0] * self.block[0], self.blocks[1] * self.block[1]

    @property
    def cells(self) -> tuple[int, int]:
        """Number of cells."""
        return self.shape[0] // self.cell[0], self.shape[1] // self.cell[1]

    @property
    def sites(self) -> int:
        """Pixels of a cell."""
        return self.cell[0] * self.cell[1]

    def window(self, level: int) -> tuple[int, int]:
        """Rows and columns of the window of a plane that a block is searched by: the block and, if it is small, two units on
        each side."""
        units = (side // (period << level) for side, period in zip(self.block, self.period, strict=True))
        rows, cols = (count + 4 if count <= 4 else count for count in units)
        return rows, cols

    def padded(self, values: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """values (row, col), repeated by whole periods up to whole blocks."""
        if values.shape == self.shape:
            return np.ascontiguousarray(values)
        (rows, cols), made = values.shape, np.empty(self.shape, np.uint16)
        made[:rows, :cols] = values
        made[:rows, cols:] = values[:, _repeated(cols, self.shape[1], self.period[1])[cols:]]
        made[rows:] = made[_repeated(rows, self.shape[0], self.period[0])[rows:]]
        return made


def _sides(period: int, lanes: int) -> tuple[int, int, int]:
    """Sides of a period, a cell and a block, whose length is a multiple of `lanes`."""
    cell = period * -(-LEAST_CELL // period)
    block = next(side for side in range(cell, 8 * LEAST_BLOCK, cell) if side >= LEAST_BLOCK and side % lanes == 0)
    return period, cell, block


def _repeated(there: int, wanted: int, period: int) -> NDArray[np.intp]:
    """Index of each of `wanted` samples: itself, or beyond the end that of equal phase in the last period."""
    index = np.arange(wanted)
    beyond = index - there
    last = index - (beyond // period + 1) * period if there >= period else np.full(wanted, there - 1)
    return np.where(beyond < 0, index, last)
