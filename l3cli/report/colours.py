"""Colours and marks of channels, and chromaticities: from spectra and never from names."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.physics import spectra
from l3cli.physics.display import LUMA, SRGB_FROM_XYZ, srgb_codes, xyz_from_srgb_matrix
from l3cli.report.parts import Key

Array = NDArray[np.floating]


LINE_LUMINANCE = 0.18  # contrast over 4 to white and to the dark page alike
MARKS = {"line": "dot", "dashed": "plus", "dotted": "cross"}  # of a line → of a point
ALIKE = 170  # sum of sRGB differences below which two colours are easily taken for one another


def channel_light(camera: CameraModel) -> NDArray[np.float64]:
    """Return linear sRGB (channel, 3), largest value 1, of the daylight that each channel takes in; grey where a channel
    sees nothing visible."""
    seen = camera.responsivity * spectra.illuminant("D65", camera.wavelength)
    linear = np.maximum(seen @ spectra.xyz_weights(camera.wavelength).T @ SRGB_FROM_XYZ.T, 0.0)
    top = linear.max(axis=1, keepdims=True)
    return np.where(top > 0, linear / np.where(top > 0, top, 1.0), 0.5)


def channel_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Return the key of each channel's line: its light at one luminance, distinct from white and from black paper, and of
    channels of like colour the mark that fewest of those before have."""
    keys: list[Key] = []
    for name, linear in zip(camera.channels, channel_light(camera), strict=True):
        stroke = hex_colour(_at_luminance(linear))
        alike = [key.mark for key in keys if np.abs(_codes(key.colour) - _codes(stroke)).sum() < ALIKE]
        keys.append(Key(name, stroke, min(MARKS, key=alike.count)))
    return tuple(keys)


def point_keys(camera: CameraModel) -> tuple[Key, ...]:
    """Return the key of each channel's points."""
    return tuple(replace(key, mark=MARKS[key.mark]) for key in channel_keys(camera))


def _codes(colour: str) -> NDArray[np.int64]:
    return np.array([int(colour[start : start + 2], 16) for start in (1, 3, 5)])


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
