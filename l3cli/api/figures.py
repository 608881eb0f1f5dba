"""Figures of two pictures, as `l3 evaluate` takes them (docs/method.md#quality-figures).

A picture is sRGB (row, col, 3) or grey (row, col): codes of uint8 or uint16, or floats of 0…1, sRGB-encoded in each case.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from l3cli.errors import InputFileError
from l3cli.evaluation import quality
from l3cli.physics.display import LUMA, daylight, displayed_delta_e, displayed_xyz, srgb_decoded

Array = NDArray[np.floating]
DEPTHS = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}  # type of codes → code of display white


def delta_e_2000(one: ArrayLike, other: ArrayLike) -> Array:
    """Return CIEDE2000 (row, col) of two sRGB pictures (row, col, 3), seen on a display of white D65. InputFileError unless
    both are pictures of one shape."""
    ours, ideal = map(srgb_decoded, _colours(one, other))
    return displayed_delta_e(ours, ideal)


def scielab(one: ArrayLike, other: ArrayLike, viewing: float = quality.VIEWING) -> Array:
    """Return S-CIELAB (row, col), CIEDE2000 after the eye's blur (Zhang and Wandell 1996), of two sRGB pictures
    (row, col, 3) seen at `viewing` samples a degree. InputFileError unless both are pictures of one shape."""
    ours, ideal = (displayed_xyz(srgb_decoded(picture)) for picture in _colours(one, other))
    return quality.scielab(ours, ideal, daylight(), viewing)


def psnr(one: ArrayLike, other: ArrayLike) -> float:
    """Return the peak signal-to-noise ratio in dB of two pictures, as they are encoded; 120 dB where they are equal.
    InputFileError unless both are pictures of one shape."""
    return quality.psnr(*_pictures(one, other))


def ssim(one: ArrayLike, other: ArrayLike) -> float:
    """Return the mean structural similarity (Wang et al. 2004) of two grey pictures (row, col), or of the luma of two sRGB
    pictures (row, col, 3). InputFileError unless both are pictures of one shape."""
    return quality.ssim(*(picture @ LUMA if picture.ndim == 3 else picture for picture in _pictures(one, other)))


def _colours(one: ArrayLike, other: ArrayLike) -> tuple[Array, Array]:
    """Return both pictures in 0…1, of three colours."""
    pictures = _pictures(one, other)
    if pictures[0].ndim != 3:
        raise InputFileError(f"{_described(one)} is not a picture of colours; give sRGB (row, col, 3)")
    return pictures


def _pictures(one: ArrayLike, other: ArrayLike) -> tuple[Array, Array]:
    """Return both pictures in 0…1."""
    pictures = _picture(one), _picture(other)
    if pictures[0].shape != pictures[1].shape:
        raise InputFileError(f"{_described(one)} and {_described(other)} differ in shape; give two pictures of one size")
    return pictures


def _picture(given: ArrayLike) -> Array:
    array = np.asarray(given)
    if array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or not array.size:
        raise InputFileError(f"{_described(given)} is not a picture; give sRGB (row, col, 3) or grey (row, col)")
    if array.dtype in DEPTHS:
        return array / DEPTHS[array.dtype]
    if array.dtype.kind != "f":
        raise InputFileError(f"{_described(given)} is not a picture; give uint8, uint16 or floats of 0…1")
    if not (array.min() >= 0 and array.max() <= 1):
        raise InputFileError(f"{_described(given)} holds values outside of 0…1; clip it, or give codes as uint8 or uint16")
    return array.astype(np.float64)


def _described(given: ArrayLike) -> str:
    array = np.asarray(given)
    return f"an array of shape {array.shape} and dtype {array.dtype}"
