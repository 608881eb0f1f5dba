"""Apply the metadata of stored values: no-data values, gains and offsets."""

import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-5  # relative tolerance for no-data values, which may be rounded in a text header, as in -3.40282e+38


def missing(values: NDArray, mark: float, good: NDArray[np.bool_] | None = None) -> NDArray[np.bool_] | None:
    """Return a mask of the pixels without data in at least one good band, or None if all pixels have data.

    Parameters
    ----------
    values : ndarray, (row, col, band)
        Values as stored.
    mark : float
        No-data value as stored, which may be NaN. Floating-point values are compared with a small relative tolerance.
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
    """Multiply values, (row, col, band), by a gain and add an offset, as float32.

    `gain` and `offset` are numbers, or arrays with one number per band. If all gains are 1 and all offsets are 0, `values`
    is returned unchanged.
    """
    if np.all(gain == 1) and np.all(offset == 0):
        return values
    made = np.empty(values.shape, np.float32)
    for row, line in enumerate(values):
        made[row] = line * np.asarray(gain, np.float64) + offset
    return made
