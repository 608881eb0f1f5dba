"""Metrics that compare two pictures. `l3 evaluate` uses the same metrics (docs/method.md#quality-metrics).

Colour pictures are arrays of shape (row, col, 3), and grey pictures are arrays of shape (row, col). Their values are
sRGB-encoded, as uint8, uint16, or floats from 0 to 1.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from l3cli.errors import InputFileError
from l3cli.evaluation import quality
from l3cli.physics.display import LUMA, daylight, displayed_delta_e, displayed_xyz, srgb_decoded

Array = NDArray[np.floating]
WHITE_CODES = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}  # display white


def delta_e_2000(one: ArrayLike, other: ArrayLike) -> Array:
    """Compute the CIEDE2000 colour difference between two sRGB pictures at each pixel, for a display with a D65 white.

    Parameters
    ----------
    one, other : array_like, (row, col, 3)
        sRGB pictures of the same shape: uint8, uint16, or floats from 0 to 1.

    Returns
    -------
    ndarray, (row, col)
        ΔE00 at each pixel.

    Raises
    ------
    InputFileError
        If an array is not an sRGB picture, or if the shapes differ.

    Examples
    --------
    >>> import numpy as np
    >>> import l3cli as l3
    >>> grey, lighter = np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 0.52)
    >>> f"{l3.delta_e_2000(grey, lighter).mean():.2f}"
    '1.91'
    """
    ours, ideal = map(srgb_decoded, _colours(one, other))
    return displayed_delta_e(ours, ideal)


def scielab(one: ArrayLike, other: ArrayLike, viewing: float = quality.VIEWING) -> Array:
    """Compute the S-CIELAB difference between two sRGB pictures at each pixel.

    S-CIELAB blurs both pictures as the eye does at the viewing distance, and then computes CIEDE2000.

    Parameters
    ----------
    one, other : array_like, (row, col, 3)
        sRGB pictures of the same shape: uint8, uint16, or floats from 0 to 1.
    viewing : float, default 50
        Pixels per degree of visual angle, from 2 to 1000. A 110 dpi monitor viewed from 66 cm has 50 pixels per degree.

    Returns
    -------
    ndarray, (row, col)
        ΔE00 between the blurred pictures at each pixel.

    Raises
    ------
    InputFileError
        If an array is not an sRGB picture, or if the shapes differ.
    RecipeError
        If `viewing` is out of range.

    References
    ----------
    X. Zhang and B. A. Wandell, "A spatial extension of CIELAB for digital color image reproduction", SID Digest (1996).

    Examples
    --------
    A pattern too fine for the eye to resolve hardly differs from its mean:

    >>> import numpy as np
    >>> import l3cli as l3
    >>> columns = np.indices((64, 64))[1] % 2
    >>> stripes, uniform = (np.repeat(each[..., None], 3, axis=2) for each in (columns * 1.0, np.full((64, 64), 0.7354)))
    >>> f"{l3.delta_e_2000(stripes, uniform).mean():.1f}", f"{l3.scielab(stripes, uniform, viewing=100).mean():.1f}"
    ('40.2', '0.5')
    """
    ours, ideal = (displayed_xyz(srgb_decoded(picture)) for picture in _colours(one, other))
    return quality.scielab(ours, ideal, daylight(), viewing)


def psnr(one: ArrayLike, other: ArrayLike) -> float:
    """Compute the peak signal-to-noise ratio (PSNR) between the encoded values of two pictures.

    Parameters
    ----------
    one, other : array_like, (row, col) or (row, col, 3)
        Grey or sRGB pictures of the same shape: uint8, uint16, or floats from 0 to 1.

    Returns
    -------
    float
        PSNR in dB, or 120 if the pictures are equal.

    Raises
    ------
    InputFileError
        If an array is not a picture, or if the shapes differ.

    Examples
    --------
    >>> import numpy as np
    >>> import l3cli as l3
    >>> f"{l3.psnr(np.full((4, 4), 0.5), np.full((4, 4), 0.51)):.1f} dB"
    '40.0 dB'
    """
    return quality.psnr(*_pictures(one, other))


def ssim(one: ArrayLike, other: ArrayLike) -> float:
    """Compute the mean structural similarity (SSIM) of two pictures, with an 11 × 11 Gaussian window (σ = 1.5 pixels).

    Parameters
    ----------
    one, other : array_like, (row, col) or (row, col, 3)
        Grey or sRGB pictures of the same shape: uint8, uint16, or floats from 0 to 1. Of sRGB pictures, only the luma
        is compared.

    Returns
    -------
    float
        SSIM. It is 1 if the pictures are equal.

    Raises
    ------
    InputFileError
        If an array is not a picture, or if the shapes differ.

    References
    ----------
    Z. Wang, A. C. Bovik, H. R. Sheikh and E. P. Simoncelli, "Image quality assessment: from error visibility to
    structural similarity", IEEE Transactions on Image Processing 13 (2004).

    Examples
    --------
    >>> import numpy as np
    >>> import l3cli as l3
    >>> ramp = np.linspace(0, 1, 64) * np.ones((64, 1))
    >>> l3.ssim(ramp, ramp)
    1.0
    >>> l3.ssim(ramp, ramp[:, ::-1]) < 0.5
    True
    """
    return quality.ssim(*(picture @ LUMA if picture.ndim == 3 else picture for picture in _pictures(one, other)))


def _colours(one: ArrayLike, other: ArrayLike) -> tuple[Array, Array]:
    pictures = _pictures(one, other)
    if pictures[0].ndim != 3:
        raise InputFileError(f"{_described(one)} is not a colour picture; pass an sRGB picture (row, col, 3)")
    return pictures


def _pictures(one: ArrayLike, other: ArrayLike) -> tuple[Array, Array]:
    pictures = _picture(one), _picture(other)
    if pictures[0].shape != pictures[1].shape:
        raise InputFileError(
            f"{_described(one)} and {_described(other)} have different shapes; pass pictures of the same size"
        )
    return pictures


def _picture(given: ArrayLike) -> Array:
    """Check a picture, and scale its values to the range from 0 to 1."""
    array = np.asarray(given)
    if array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or not array.size:
        raise InputFileError(f"{_described(given)} is not a picture; pass an sRGB (row, col, 3) or grey (row, col) picture")
    if array.dtype in WHITE_CODES:
        return array / WHITE_CODES[array.dtype]
    if array.dtype.kind != "f":
        raise InputFileError(f"{_described(given)} is not a picture; pass uint8, uint16 or floats from 0 to 1")
    if not (array.min() >= 0 and array.max() <= 1):
        raise InputFileError(
            f"{_described(given)} contains values outside 0…1; clip the values, or pass the picture as uint8 or uint16"
        )
    return array.astype(np.float64)


def _described(given: ArrayLike) -> str:
    array = np.asarray(given)
    return f"an array with shape {array.shape} and dtype {array.dtype}"
