"""A picture as a viewer sees it: adapted to D65, one exposure scale, clipped to sRGB (docs/method.md#quality-figures)."""

import functools

import numpy as np
from numpy.typing import NDArray

from l3cli import spectra

Array = NDArray[np.floating]
DISPLAY_PERCENTILE = 99.0  # of the target's luminance becomes display white, as the authors show their pictures


def display_scale(target: Array) -> float:
    """Luminance shown white, from the target's XYZ (3, row, col): its 99th percentile; 1 where all is dark."""
    bright = float(np.percentile(target[1], DISPLAY_PERCENTILE))
    return bright if bright > 0 else 1.0


def displayed(xyz: Array, white: Array, scale: float) -> Array:
    """Linear sRGB (row, col, 3) in 0…1 of XYZ planes (3, row, col): `white` (3) adapted to D65, Y = `scale` shown as 1."""
    matrix = spectra.srgb_from_xyz_matrix() @ spectra.adaptation_matrix(white, display_white()) / scale
    return np.clip(np.einsum("oc,crk->rko", matrix, xyz), 0.0, 1.0)


def displayed_xyz(linear: Array) -> Array:
    """XYZ (row, col, 3) of a display that shows linear sRGB (row, col, 3), white at Y = 1."""
    return linear @ np.linalg.inv(spectra.srgb_from_xyz_matrix()).T


@functools.cache
def display_white() -> Array:
    """XYZ (3), Y = 1, of the display's white, D65."""
    return spectra.white_point("D65")


def delta_e(one: Array, other: Array) -> Array:
    """CIEDE2000 (row, col) of two pictures of linear sRGB (row, col, 3)."""
    labs = [spectra.lab(displayed_xyz(picture), display_white()) for picture in (one, other)]
    return spectra.delta_e_2000(*labs)


def encoded(linear: Array) -> NDArray[np.uint8]:
    """Linear sRGB as the 8-bit values of a picture file."""
    return np.floor(spectra.srgb_curve(linear) * 255.0 + 0.5).astype(np.uint8)
