"""Colours of channels and chromaticities, from spectra and never from names."""

import numpy as np
from numpy.typing import NDArray

from l3cli.physics import spectra
from l3cli.physics.display import LUMA, srgb_codes, srgb_from_xyz_matrix, xyz_from_srgb_matrix

Array = NDArray[np.floating]
LINE_LUMINANCE = 0.18  # contrast over 4 to white and to the dark page alike
SERIES = ("var(--one)", "var(--two)", "var(--three)", "var(--four)")  # the page's colours for what has no colour itself


def channel_light(responsivity: Array, wavelength: Array) -> NDArray[np.float64]:
    """Return linear sRGB (channel, 3), largest value 1, of the daylight that each channel (channel, wavelength) takes in.

    Light of channels that see nothing visible is grey.
    """
    seen = responsivity * spectra.illuminant("D65", wavelength)
    linear = np.maximum(seen @ spectra.xyz_weights(wavelength).T @ srgb_from_xyz_matrix().T, 0.0)
    top = linear.max(axis=1, keepdims=True)
    return np.where(top > 0, linear / np.where(top > 0, top, 1.0), 0.5)


def strokes(light: Array) -> tuple[str, ...]:
    """Return the same hues at one luminance, to be distinct from white and from black paper."""
    return tuple(hex_colour(_at_luminance(linear)) for linear in light)


def _at_luminance(linear: Array) -> Array:
    luminance = float(linear @ LUMA)
    if luminance >= LINE_LUMINANCE:
        return linear * (LINE_LUMINANCE / luminance)
    white = (LINE_LUMINANCE - luminance) / (1.0 - luminance)
    return linear + white * (1.0 - linear)


def hex_colour(linear: Array) -> str:
    """Return linear sRGB (3) as #rrggbb."""
    return "#" + "".join(f"{code:02x}" for code in srgb_codes(linear))


def ink_on(linear: Array) -> str:
    """Return black or white, whichever reads better on linear sRGB (3)."""
    return "#000000" if float(linear @ LUMA) > LINE_LUMINANCE else "#ffffff"


def spectral_locus() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the wavelengths in nm and chromaticities (wavelength, 2) of monochromatic light, CIE 1931."""
    wavelength = np.arange(400.0, 701.0, 5.0)
    functions = spectra.colour_matching_functions(wavelength).T
    return wavelength, functions[:, :2] / functions.sum(axis=1, keepdims=True)


def srgb_primaries() -> NDArray[np.float64]:
    """Return the chromaticities (3, 2) of the primaries of sRGB."""
    xyz = xyz_from_srgb_matrix().T
    return xyz[:, :2] / xyz.sum(axis=1, keepdims=True)
