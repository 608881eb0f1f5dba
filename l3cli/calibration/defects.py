"""Hot and dead pixels and lines: detected by their values, listed, and left out of every figure."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import DefectMap

OUTLIER = 6.0  # robust standard deviations: no Gaussian pixel in a hundred million lies beyond
LEAST_LOSS = 0.1  # a response that differs less from its neighbours' is nonuniformity, not a defect
WHOLE_LINE = 0.9  # share of a line's pixels from which on all of it is defective
Array = NDArray[np.float64]
Defects = NDArray[np.int64]  # (defect, 2) row, col


def none() -> Defects:
    """Return an empty list of defects."""
    return np.zeros((0, 2), dtype=np.int64)


def outliers(picture: Array, cfa: NDArray[np.uint8], least: float = 0.0) -> Defects:
    """Return the pixels of a picture (row, col) that lie far from the median of their CFA site, and at least `least` from
    it; and all of a row or column whose median does so by the spread of such medians, and by more than pixels differ as a
    rule."""
    rows, cols = cfa.shape
    defects = []
    for row in range(rows):
        for col in range(cols):
            site = picture[row::rows, col::cols]
            middle, spread = _middle_and_spread(site)
            far = np.abs(site - middle) > max(OUTLIER * spread, least)
            for axis in (0, 1):
                lines = np.median(site, axis=axis)
                centre, between = _middle_and_spread(lines)
                odd = np.abs(lines - centre) > max(OUTLIER * between, spread, least)
                far |= odd if axis == 0 else odd[:, None]
            defects.append(np.argwhere(far) * (rows, cols) + (row, col))
    return join(*defects)


def _middle_and_spread(values: Array) -> tuple[float, float]:
    """Return the median, and the standard deviation that those have who lie near it."""
    low, middle, high = np.percentile(values, (15.87, 50.0, 84.13))
    return float(middle), float((high - low) / 2 or values.std())


def join(*parts: Defects) -> Defects:
    """Return all pixels of several lists, each once, in the order of rows."""
    return np.unique(np.concatenate(parts), axis=0).astype(np.int64)


def patched(picture: Array, cfa: NDArray[np.uint8], defects: Defects) -> Array:
    """Return the picture (row, col) with every defect replaced by the median of its neighbours of the same CFA site."""
    rows, cols = cfa.shape
    result = picture.copy()
    for row, col in defects:
        first_row = row - 2 * rows if row >= 2 * rows else row % rows
        first_col = col - 2 * cols if col >= 2 * cols else col % cols
        result[row, col] = np.median(picture[first_row : row + 2 * rows + 1 : rows, first_col : col + 2 * cols + 1 : cols])
    return result


def as_map(defects: Defects, hot: Defects, shape: tuple[int, int]) -> DefectMap:
    """Return the map of `defects` of a sensor of `shape` (rows, cols), `hot` those of them that are so without light; of a
    line that is defective nearly everywhere the other pixels are taken for defective, too."""
    bad, warm = np.zeros(shape, bool), np.zeros(shape, bool)
    bad[tuple(defects.T)] = True
    warm[tuple(hot.T)] = True
    whole_cols, whole_rows = bad.mean(axis=0) >= WHOLE_LINE, bad.mean(axis=1) >= WHOLE_LINE
    lined = whole_cols | whole_rows[:, None]
    position = np.argwhere(bad | lined)
    row, col = position.T
    kinds = np.where(whole_cols[col], "column", np.where(whole_rows[row], "row", np.where(warm[row, col], "hot", "dead")))
    return DefectMap(position.astype(np.int64), tuple(map(str, kinds)))


def counts(defects: DefectMap, shape: tuple[int, int]) -> dict[str, int]:
    """Return the numbers of hot and dead pixels, rows and columns of a map, and of clusters: pixels off such lines that
    touch."""
    from scipy.ndimage import label

    kind, (row, col) = np.array(defects.pixel_kind, dtype=str), defects.position.T
    single = np.isin(kind, ("hot", "dead"))
    alone = np.zeros(shape, bool)
    alone[row[single], col[single]] = True
    groups, _ = label(alone, np.ones((3, 3)))
    sizes = np.bincount(groups.ravel())[1:]
    return {
        "hot": int((kind == "hot").sum()),
        "dead": int((kind == "dead").sum()),
        "rows": len(np.unique(row[kind == "row"])),
        "columns": len(np.unique(col[kind == "column"])),
        "clusters": int((sizes > 1).sum()),
    }
