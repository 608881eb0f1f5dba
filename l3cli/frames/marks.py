"""Apply the metadata of stored values: the value that marks missing data, gains and offsets."""

import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-5  # relative tolerance for no-data values that are written as text, such as -3.40282e+38


def missing(values: NDArray, mark: float, good: NDArray[np.bool_] | None = None) -> NDArray[np.bool_] | None:
    """Return a mask (row, col) of the pixels with missing data in any good band, or None if no pixel has missing data.

    Parameters
    ----------
    values : ndarray, (row, col, band)
        Values as stored.
    mark : float
        Stored value that marks missing data. It may be NaN.
    good : ndarray of bool, (band,), optional
        Mask of the bands to examine. [default: all bands]
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
    """Multiply values (row, col, band) by a gain and add an offset, per band. Returns `values` if nothing changes."""
    if np.all(gain == 1) and np.all(offset == 0):
        return values
    made = np.empty(values.shape, np.float32)
    for row, line in enumerate(values):
        made[row] = line * np.asarray(gain, np.float64) + offset
    return made
