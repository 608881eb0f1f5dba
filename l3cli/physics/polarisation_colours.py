"""Colour scales for the degree and angle of polarisation in pictures (docs/polarisation.md#pictures)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.stokes import aolp, dolp

Floats = NDArray[np.floating]

FULL_BRIGHTNESS = 0.5  # pictures of the angle have full brightness at and above this degree of polarisation
# sRGB values of the colour map viridis (CC0, Smith and van der Walt, 2015) at equidistant positions
VIRIDIS = np.array(
    [(68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141), (39, 173, 129), (92, 200, 99),
     (170, 220, 50), (253, 231, 37)]
) / 255.0  # fmt: skip
# sRGB values of a colour map for signed values: blue (negative), white (0), red (positive)
DIVERGING = np.array([(33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43)]) / 255.0


def degree_colours(stokes: Floats, most: float = 1.0) -> Floats:
    """Map the degree of polarisation of Stokes parameters (3, …) to colours (…, 3). The colour map ends at `most`."""
    return coloured(dolp(stokes) / most, VIRIDIS)


def angle_colours(stokes: Floats, full: float = FULL_BRIGHTNESS) -> Floats:
    """Map the angle of polarisation of Stokes parameters (3, …) to colours (…, 3).

    The brightness is proportional to the degree of polarisation, up to the degree `full`.
    """
    return hues(aolp(stokes) / 180) * np.minimum(dolp(stokes) / full, 1)[..., None]


def coloured(values: Floats, colours: Floats) -> Floats:
    """Map values (…) from 0 to 1 to colours (…, 3), interpolated linearly between equidistant `colours` (colour, 3)."""
    at = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(values, at, channel) for channel in colours.T], axis=-1)


def hues(share: Floats) -> Floats:
    """Return the fully saturated R, G and B for hues from 0 (red) to 1 (red again)."""
    sector = (share[..., None] * 6 + np.array([0.0, 4.0, 2.0])) % 6
    return np.clip(np.abs(sector - 3) - 1, 0, 1)
