"""What files say of their stored values: which mark pixels without data, and by which gain and offset they are scaled."""

import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-5  # relative, of a mark that a text states, such as -3.40282e+38


def missing(values: NDArray, mark: float, good: NDArray[np.bool_] | None = None) -> NDArray[np.bool_] | None:
    """Return the pixels (row, col) that hold a mark of missing data in any good band; None if there are none.

    Parameters
    ----------
    values : (row, col, band)
        As stored.
    mark : float
        The stored value that marks missing data. NaN marks NaN.
    good : (band), optional
        The bands that count; default: all.
    """
    found = np.zeros(values.shape[:2], bool)
    for band in range(values.shape[2]):
        if good is not None and not good[band]:
            continue
        plane = values[..., band]
        if np.isnan(mark):
            found |= np.isnan(plane)
        elif values.dtype.kind == "f":
            found |= np.isclose(plane, mark, rtol=ROUNDING, atol=0.0)
        else:
            found |= plane == mark
    return found if found.any() else None


def scaled(values: NDArray, gain: NDArray[np.float64] | float, offset: NDArray[np.float64] | float) -> NDArray:
    """Return values · gain + offset (row, col, band), of each band; the values themselves where that changes nothing."""
    if np.all(gain == 1) and np.all(offset == 0):
        return values
    made = np.empty(values.shape, np.float32)
    for row, line in enumerate(values):
        made[row] = line * np.asarray(gain, np.float64) + offset
    return made
