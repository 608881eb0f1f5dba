"""Hot and dead pixels: detected by their values, listed, and left out of every figure."""

import numpy as np
from numpy.typing import NDArray

OUTLIER = 6.0  # robust standard deviations: no Gaussian pixel in a hundred million lies beyond
LEAST_LOSS = 0.1  # a response that differs less from its neighbours' is nonuniformity, not a defect
Array = NDArray[np.float64]
Defects = NDArray[np.int64]  # (defect, 2) row, col


def none() -> Defects:
    """No defects."""
    return np.zeros((0, 2), dtype=np.int64)


def outliers(picture: Array, cfa: NDArray[np.uint8], least: float = 0.0) -> Defects:
    """Pixels of a picture (row, col) that lie far from the median of their CFA site, and at least `least` from it."""
    rows, cols = cfa.shape
    defects = []
    for row in range(rows):
        for col in range(cols):
            site = picture[row::rows, col::cols]
            low, middle, high = np.percentile(site, (15.87, 50.0, 84.13))
            spread = (high - low) / 2 or site.std()
            far = np.abs(site - middle) > max(OUTLIER * spread, least)
            defects.append(np.argwhere(far) * (rows, cols) + (row, col))
    return join(*defects)


def join(*parts: Defects) -> Defects:
    """All pixels of several lists, each once, in the order of rows."""
    return np.unique(np.concatenate(parts), axis=0).astype(np.int64)


def patched(picture: Array, cfa: NDArray[np.uint8], defects: Defects) -> Array:
    """The picture (row, col) with every defect replaced by the median of its neighbours of the same CFA site."""
    rows, cols = cfa.shape
    result = picture.copy()
    for row, col in defects:
        first_row = row - 2 * rows if row >= 2 * rows else row % rows
        first_col = col - 2 * cols if col >= 2 * cols else col % cols
        result[row, col] = np.median(picture[first_row : row + 2 * rows + 1 : rows, first_col : col + 2 * cols + 1 : cols])
    return result
