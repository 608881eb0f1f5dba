"""Choose the colours and the marks of channels in drawings, and compute chromaticities.

The colour of a channel depends on its responsivity, not on its name.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.physics import spectra
from l3cli.physics.display import LUMA, SRGB_FROM_XYZ, srgb_codes, xyz_from_srgb_matrix
from l3cli.report.parts import Key

Array = NDArray[np.floating]


# Luminance of all lines, as a fraction of white. The contrast ratio is above 4 on a white page and on a dark page.
LINE_LUMINANCE = 0.18
MARKS = {"line": "dot", "dashed": "plus", "dotted": "cross"}  # line style of a channel → mark of its points
# Two colours are too similar if the sum of the absolute differences of their 8-bit sRGB values is below this limit.
CONFUSABLE_DIFFERENCE = 170


def channel_light(camera: CameraModel) -> NDArray[np.float64]:
    """Compute a display colour for each channel, from the spectrum of daylight (D65) multiplied by the responsivity.

    Returns
    -------
    ndarray, (channel, 3)
        Linear sRGB, with a maximum of 1 in each row. A channel that does not respond to visible light is grey (0.5).
    """
    seen = camera.responsivity * spectra.illuminant("D65", camera.wavelength)
    linear = np.maximum(seen @ spectra.xyz_weights(camera.wavelength).T @ SRGB_FROM_XYZ.T, 0.0)
    top = linear.max(axis=1, keepdims=True)
    return np.where(top > 0, linear / np.where(top > 0, top, 1.0), 0.5)


def channel_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Return one legend entry per channel, with the colour and the style of its line.

    All colours have the same luminance, so that the lines are visible on a white page and on a dark page. Channels with
    similar colours have different line styles. If more than three channels are similar, the styles repeat.
    """
    keys: list[Key] = []
    for name, linear in zip(camera.channels, channel_light(camera), strict=True):
        stroke = hex_colour(_at_luminance(linear))
        alike = [key.mark for key in keys if np.abs(_codes(key.colour) - _codes(stroke)).sum() < CONFUSABLE_DIFFERENCE]
        keys.append(Key(name, stroke, min(MARKS, key=alike.count)))
    return tuple(keys)


def point_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Return one legend entry per channel, like `channel_keys`, but with the mark of its points instead of a line style."""
    return tuple(replace(key, mark=MARKS[key.mark]) for key in channel_keys(camera))


def _codes(colour: str) -> NDArray[np.int64]:
    """Parse #rrggbb into three 8-bit values."""
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)])


def _at_luminance(linear: Array) -> Array:
    """Darken a linear sRGB colour, or mix it with white, so that its luminance becomes LINE_LUMINANCE."""
    luminance = float(linear @ LUMA)
    if luminance >= LINE_LUMINANCE:
        return linear * (LINE_LUMINANCE / luminance)
    white = (LINE_LUMINANCE - luminance) / (1.0 - luminance)
    return linear + white * (1.0 - linear)


def hex_colour(linear: Array) -> str:
    """Format a linear sRGB colour (3,) as #rrggbb. Values are clipped to 0…1."""
    return "#" + "".join(f"{code:02x}" for code in srgb_codes(linear))


def ink_on(linear: Array) -> str:
    """Return black or white, as #rrggbb, for text on the background colour `linear` (linear sRGB)."""
    return "#000000" if float(linear @ LUMA) > LINE_LUMINANCE else "#ffffff"


def spectral_locus() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the CIE 1931 chromaticities of monochromatic light.

    Returns
    -------
    wavelength : ndarray, (wavelength,)
        Wavelengths from 400 to 700 nm in steps of 5 nm.
    chromaticity : ndarray, (wavelength, 2)
        Chromaticities x and y.
    """
    wavelength = np.arange(400.0, 701.0, 5.0)
    functions = spectra.colour_matching_functions(wavelength).T
    return wavelength, functions[:, :2] / functions.sum(axis=1, keepdims=True)


def srgb_primaries() -> NDArray[np.float64]:
    """Return the CIE 1931 chromaticities (primary, 2) of the sRGB primaries."""
    xyz = xyz_from_srgb_matrix().T
    return xyz[:, :2] / xyz.sum(axis=1, keepdims=True)
