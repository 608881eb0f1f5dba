"""Convert pixel values of any number type to 16-bit DN.

Whole numbers from 0 to 65535 are DN, even if they are stored as floating-point numbers. The scale of all other values, such
as fractions from 0 to 1, is unknown, so the user must set the black and white level in the units of the file.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError

TOP = 65535  # largest DN
# Black and white level of scaled values in DN, with margins for noise below black and for values above white.
SCALED_BLACK, SCALED_WHITE = 8192.0, 57344.0
FULL_SCALE_ONE = 2.0  # if full scale is 1, all values are below this limit, even with noise
LEAST_DN_LEVEL = 16.0  # a white level of at least this value is probably in DN, not a fraction of full scale


def as_dn(values: NDArray) -> NDArray[np.uint16] | None:
    """Convert whole numbers from 0 to 65535, of any data type, to uint16. Return None if the values are not DN.

    Values are not DN if one of them is not a whole number or is out of range, or if the array is empty. If no floating-point
    value exceeds 1, they are not DN either, because they may be fractions of full scale.
    """
    if values.dtype in (np.uint8, np.uint16):
        return values.astype(np.uint16, copy=False)
    if not values.size or not (values.min() >= 0 and values.max() <= TOP):  # NaN fails the comparison
        return None
    if values.dtype.kind == "f" and (values.max() <= 1 or (values != np.rint(values)).any()):
        return None
    return values.astype(np.uint16)


def require_dn(name: str, values: NDArray) -> NDArray[np.uint16]:
    """Convert values to DN, or raise InputFileError if they are not DN. `name` is the file name for the message."""
    dn = as_dn(values)
    if dn is None:
        raise InputFileError(f"{name} contains {_range_of(name, values)}; save the values in DN (integers from 0 to {TOP})")
    return dn


def scaled_dn(name: str, values: NDArray, black: float | None, white: float | None) -> NDArray[np.uint16]:
    """Scale values in the units of a file to DN, with a black level of SCALED_BLACK and a white level of SCALED_WHITE.

    Parameters
    ----------
    name : str
        Name of the file, for messages.
    values : ndarray
        Stored values.
    black, white : float or None
        Black and white level in the units of the file, or None if the user has not set them.

    Returns
    -------
    ndarray of uint16
        Values in DN, clipped to 0…65535.

    Raises
    ------
    InputFileError
        If a level is None or does not match the values, or if a value is not finite.
    """
    found = _range_of(name, values)
    if black is None or white is None:
        raise InputFileError(
            f"{name} contains {found}, which are not DN; set ‹black_level› and ‹white_level› in the units of the file, such "
            f"as {'0.06 and 1' if float(values.max()) < FULL_SCALE_ONE else '0 and its full scale'}"
        )
    if not black < white or (float(values.max()) < FULL_SCALE_ONE and white >= LEAST_DN_LEVEL):
        raise InputFileError(
            f"{name} contains {found}, but ‹black_level› is {black:g} and ‹white_level› is {white:g}; set both levels "
            "in the units of the file"
        )
    dn = SCALED_BLACK + (values.astype(np.float64) - black) * ((SCALED_WHITE - SCALED_BLACK) / (white - black))
    return np.clip(np.rint(dn), 0, TOP).astype(np.uint16)


def _range_of(name: str, values: NDArray) -> str:
    """Describe the type and the range of values. Raises InputFileError if they are not finite numbers."""
    if values.dtype.kind not in "iuf":
        raise InputFileError(f"{name} contains values of type {values.dtype}; save integers or floating-point numbers")
    least, most = values.min(), values.max()
    if not np.isfinite([least, most]).all():
        raise InputFileError(f"{name} contains values that are infinite or not a number; save finite values")
    return f"{values.dtype} values from {least:.6g} to {most:.6g}"
