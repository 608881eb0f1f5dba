"""Choose colours and marks for channels in drawings, and compute chromaticities.

A channel's colour depends on its responsivity, not on its name.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.physics import spectra
from l3cli.physics.display import LUMA, SRGB_FROM_XYZ, srgb_codes, xyz_from_srgb_matrix
from l3cli.report.parts import Key

Array = NDArray[np.floating]


# Luminance of all lines, as a fraction of white. Their contrast ratio is above 4 both on a white and on a dark page.
LINE_LUMINANCE = 0.18
MARKS = {"line": "dot", "dashed": "plus", "dotted": "cross"}  # mark of a channel's points, by line style
# Sum of absolute 8-bit sRGB differences below which two colours are too similar.
CONFUSABLE_DIFFERENCE = 170


def channel_light(camera: CameraModel) -> NDArray[np.float64]:
    """Compute each channel's display colour from its responsivity under daylight (D65).

    Returns
    -------
    ndarray, (channel, 3)
        Linear sRGB with a maximum of 1 per channel. A channel that does not respond to visible light is grey (0.5).
    """
    seen = camera.responsivity * spectra.illuminant("D65", camera.wavelength)
    linear = np.maximum(seen @ spectra.xyz_weights(camera.wavelength).T @ SRGB_FROM_XYZ.T, 0.0)
    top = linear.max(axis=1, keepdims=True)
    return np.where(top > 0, linear / np.where(top > 0, top, 1.0), 0.5)


def channel_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Return one legend entry per channel, with its colour and line style.

    All colours have the same luminance, so that lines are visible on a white and on a dark page. Channels with similar
    colours have different line styles, which repeat if more than three channels are similar.
    """
    keys: list[Key] = []
    for name, linear in zip(camera.channels, channel_light(camera), strict=True):
        stroke = hex_colour(_at_luminance(linear))
        alike = [key.mark for key in keys if np.abs(_codes(key.colour) - _codes(stroke)).sum() < CONFUSABLE_DIFFERENCE]
        keys.append(Key(name, stroke, min(MARKS, key=alike.count)))
    return tuple(keys)


def point_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Return one legend entry per channel, with its colour and the mark of its points."""
    return tuple(replace(key, mark=MARKS[key.mark]) for key in channel_keys(camera))


def _codes(colour: str) -> NDArray[np.int64]:
    """Parse #rrggbb into three 8-bit values."""
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)])


def _at_luminance(linear: Array) -> Array:
    """Change the luminance of a linear sRGB colour to LINE_LUMINANCE by darkening it or mixing it with white."""
    luminance = float(linear @ LUMA)
    if luminance >= LINE_LUMINANCE:
        return linear * (LINE_LUMINANCE / luminance)
    white = (LINE_LUMINANCE - luminance) / (1.0 - luminance)
    return linear + white * (1.0 - linear)


def hex_colour(linear: Array) -> str:
    """Format a linear sRGB colour (3,) as #rrggbb. Values are clipped to 0…1."""
    return "#" + "".join(f"{code:02x}" for code in srgb_codes(linear))


def ink_on(linear: Array) -> str:
    """Return black or white, as #rrggbb, for text on a linear sRGB background."""
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
