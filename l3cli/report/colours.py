"""Colours and marks of channels in drawings, and chromaticities.

All colours are computed from spectra, never from channel names.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.physics import spectra
from l3cli.physics.display import LUMA, SRGB_FROM_XYZ, srgb_codes, xyz_from_srgb_matrix
from l3cli.report.parts import Key

Array = NDArray[np.floating]


LINE_LUMINANCE = 0.18  # luminance of lines relative to white; the contrast to a white and to a dark page is above 4
MARKS = {"line": "dot", "dashed": "plus", "dotted": "cross"}  # line style of a channel → mark of its points
CONFUSABLE_DIFFERENCE = 170  # sRGB codes, summed over r, g and b; two colours that differ by less are easily confused


def channel_light(camera: CameraModel) -> NDArray[np.float64]:
    """Compute the display colour of each channel: daylight (D65) seen through its responsivity.

    Parameters
    ----------
    camera : CameraModel
        Supplies the responsivities.

    Returns
    -------
    ndarray, (channel, 3)
        Linear sRGB, scaled so that the largest of the three values is 1. A channel without response to visible light is grey
        (0.5).
    """
    seen = camera.responsivity * spectra.illuminant("D65", camera.wavelength)
    linear = np.maximum(seen @ spectra.xyz_weights(camera.wavelength).T @ SRGB_FROM_XYZ.T, 0.0)
    top = linear.max(axis=1, keepdims=True)
    return np.where(top > 0, linear / np.where(top > 0, top, 1.0), 0.5)


def channel_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Choose the colour and the mark of each channel's line.

    All colours get the same luminance, so that they are visible on a white and on a dark page. If the colours of several
    channels are easily confused, the channels get different marks.

    Parameters
    ----------
    camera : CameraModel
        Supplies channel names and responsivities.

    Returns
    -------
    tuple of Key
        One legend entry per channel.
    """
    keys: list[Key] = []
    for name, linear in zip(camera.channels, channel_light(camera), strict=True):
        stroke = hex_colour(_at_luminance(linear))
        alike = [key.mark for key in keys if np.abs(_codes(key.colour) - _codes(stroke)).sum() < CONFUSABLE_DIFFERENCE]
        keys.append(Key(name, stroke, min(MARKS, key=alike.count)))
    return tuple(keys)


def point_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Return one legend entry per channel, for points instead of lines."""
    return tuple(replace(key, mark=MARKS[key.mark]) for key in channel_keys(camera))


def _codes(colour: str) -> NDArray[np.int64]:
    """Parse #rrggbb into its three sRGB codes."""
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)])


def _at_luminance(linear: Array) -> Array:
    """Bring a linear sRGB colour to LINE_LUMINANCE: scale it down, or mix white into it."""
    luminance = float(linear @ LUMA)
    if luminance >= LINE_LUMINANCE:
        return linear * (LINE_LUMINANCE / luminance)
    white = (LINE_LUMINANCE - luminance) / (1.0 - luminance)
    return linear + white * (1.0 - linear)


def hex_colour(linear: Array) -> str:
    """Format a linear sRGB colour (3) as #rrggbb."""
    return "#" + "".join(f"{code:02x}" for code in srgb_codes(linear))


def ink_on(linear: Array) -> str:
    """Return black or white as text colour, whichever is easier to read on a linear sRGB background (3)."""
    return "#000000" if float(linear @ LUMA) > LINE_LUMINANCE else "#ffffff"


def spectral_locus() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the chromaticities of monochromatic light (CIE 1931).

    Returns
    -------
    wavelength : ndarray, (wavelength,)
        400 to 700 nm in steps of 5 nm.
    chromaticity : ndarray, (wavelength, 2)
        x and y.
    """
    wavelength = np.arange(400.0, 701.0, 5.0)
    functions = spectra.colour_matching_functions(wavelength).T
    return wavelength, functions[:, :2] / functions.sum(axis=1, keepdims=True)


def srgb_primaries() -> NDArray[np.float64]:
    """Return the CIE 1931 chromaticities (primary, 2) of the sRGB primaries."""
    xyz = xyz_from_srgb_matrix().T
    return xyz[:, :2] / xyz.sum(axis=1, keepdims=True)
