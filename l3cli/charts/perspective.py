"""Perspective of a flat chart: which pixel shows which place of its grid of patches."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


def homography(cells: Array, pixels: Array) -> Array:
    """(3, 3) from chart cells (point, 2) x, y to pixels (point, 2) col, row, four points or more, by least squares; applied
    to (x, y, 1) it gives col, row times a scale. LinAlgError if four points lie on a line."""
    scale, shift = float(np.ptp(pixels, axis=0).max()) or 1.0, pixels.mean(axis=0)
    equations, right_side = [], []
    for (x, y), (u, v) in zip(cells, (pixels - shift) / scale, strict=True):
        equations += [[x, y, 1, 0, 0, 0, -u * x, -u * y], [0, 0, 0, x, y, 1, -v * x, -v * y]]
        right_side += [u, v]
    system, right = np.array(equations, dtype=np.float64), np.array(right_side)
    solved = np.linalg.solve(system, right) if len(cells) == 4 else np.linalg.lstsq(system, right, rcond=None)[0]
    normalised = np.append(solved, 1.0).reshape(3, 3)
    back = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]], [0.0, 0.0, 1.0]])
    return back @ normalised


def corner_cells(rows: int, cols: int) -> Array:
    """(4, 2) x, y of the outer corners of a grid of patches, clockwise from the first patch."""
    return np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], dtype=np.float64)


def through(matrix: Array, points: Array) -> Array:
    """Return the points (…, 2) through a homography; infinite where it has none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = points @ matrix[:, :2].T + matrix[:, 2]
        return np.asarray(moved[..., :2] / moved[..., 2:])


def patch_map(to_pixels: Array, grid: tuple[int, int], shape: tuple[int, int], core: float) -> NDArray[np.int64]:
    """Return the index (row, col) of the patch whose core a pixel lies in, rows · cols of the grid elsewhere.

    `to_pixels`: homography of a grid (rows, cols) of cells; `core`: half the side of a core in cells."""
    rows, cols = grid
    col, row = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    cells = through(np.linalg.inv(to_pixels), np.stack([col, row], axis=-1))
    x, y = cells[..., 0], cells[..., 1]
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (x < cols) & (y >= 0) & (y < rows) & (np.abs(x % 1 - 0.5) < core) & (np.abs(y % 1 - 0.5) < core)
    index = np.full(shape, rows * cols)
    index[inside] = y[inside].astype(np.int64) * cols + x[inside].astype(np.int64)
    return index
