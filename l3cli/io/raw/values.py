"""Convert pixel values of any number type to 16-bit DN.

Integers from 0 to 65535 are DN, whatever type stores them. For other values, such as floating-point values from 0 to 1 or
negative values, only the caller knows the scale: the black and the white level in the units of the file.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError

TOP = 65535  # largest DN
# Levels of scaled values in DN, with room for noise below black and for values above white.
SCALED_BLACK, SCALED_WHITE = 8192.0, 57344.0
FULL_SCALE_ONE = 2.0  # values with a full scale of 1 stay below this, noise included
LEAST_DN_LEVEL = 16.0  # white levels from here on are in DN


def as_dn(values: NDArray) -> NDArray[np.uint16] | None:
    """Return integer values from 0 to 65535 as uint16, or None for other values.

    Floating-point values that are all 0 or 1 do not count as DN, because they may be fractions of full scale.
    """
    if values.dtype in (np.uint8, np.uint16):
        return values.astype(np.uint16, copy=False)
    if not values.size or not (values.min() >= 0 and values.max() <= TOP):  # also true for NaN
        return None
    if values.dtype.kind == "f" and (values.max() <= 1 or (values != np.rint(values)).any()):
        return None
    return values.astype(np.uint16)


def require_dn(name: str, values: NDArray) -> NDArray[np.uint16]:
    """Return values as DN. Raises InputFileError that names `name` if they are not DN."""
    dn = as_dn(values)
    if dn is None:
        raise InputFileError(f"{name} holds {_held(name, values)}; give DN, whole numbers of 0 to {TOP}")
    return dn


def scaled_dn(name: str, values: NDArray, black: float | None, white: float | None) -> NDArray[np.uint16]:
    """Convert values with another scale to DN with SCALED_BLACK and SCALED_WHITE as levels.

    Parameters
    ----------
    name : str
        The file, for messages.
    values : ndarray
        Stored values.
    black, white : float or None
        Levels in the units of the file.

    Raises
    ------
    InputFileError
        If the levels are missing or not in the units of the values, or if a value is not a number.
    """
    held = _held(name, values)
    if black is None or white is None:
        raise InputFileError(
            f"{name} holds {held}, no DN; give ‹black_level› and ‹white_level› in the units of the file, such as "
            f"{'0.06 and 1' if float(values.max()) < FULL_SCALE_ONE else '0 and its full scale'}"
        )
    if not black < white or (float(values.max()) < FULL_SCALE_ONE and white >= LEAST_DN_LEVEL):
        raise InputFileError(
            f"{name} holds {held}, its ‹black_level› is {black:g} and its ‹white_level› {white:g}; give both in the units "
            "of the file"
        )
    dn = SCALED_BLACK + (values.astype(np.float64) - black) * ((SCALED_WHITE - SCALED_BLACK) / (white - black))
    return np.clip(np.rint(dn), 0, TOP).astype(np.uint16)


def _held(name: str, values: NDArray) -> str:
    if values.dtype.kind not in "iuf":
        raise InputFileError(f"{name} holds {values.dtype}; give numbers")
    least, most = values.min(), values.max()
    if not np.isfinite([least, most]).all():
        raise InputFileError(f"{name} holds values that are no finite numbers; give DN")
    return f"{values.dtype} from {least:.6g} to {most:.6g}"
