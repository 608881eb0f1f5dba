"""Colour spaces for pictures: primaries, white point and transfer curve (docs/method.md#display).

The definitions are from IEC 61966-2-1 (sRGB), SMPTE EG 432-1 with the curve of sRGB (Display P3), ITU-R BT.2020-2 (Rec.
2020) and Academy S-2014-004 (ACEScg).
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.floating]
XY: TypeAlias = tuple[float, float]  # chromaticity x, y

# These two matrices are also in colour-science, but importing it takes longer than rendering a frame.
SRGB_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])  # IEC 61966-2-1
# Bradford matrix, which converts XYZ to cone responses.
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
D65: XY = (0.3127, 0.3290)


@dataclass(frozen=True)
class Curve:
    """Transfer curve for linear values x in 0…1.

    The encoded value is slope · x if x ≤ knee, otherwise gain · x^exponent − offset.
    """

    knee: float
    slope: float
    gain: float
    offset: float
    exponent: float

    def encoded(self, linear: Array) -> Array:
        """Clip linear values to 0…1, and encode them."""
        clipped = np.clip(linear, 0.0, 1.0)
        power = self.gain * np.maximum(clipped, 1e-9) ** self.exponent - self.offset
        return np.where(clipped <= self.knee, self.slope * clipped, power)


SRGB_CURVE = Curve(0.0031308, 12.92, 1.055, 0.055, 1 / 2.4)
BT2020_CURVE = Curve(0.018053968510807, 4.5, 1.09929682680944, 0.09929682680944, 0.45)


@dataclass(frozen=True)
class Space:
    """A colour space with three components, such as RGB or XYZ."""

    name: str  # value of the option that selects the colour space
    title: str  # name in messages and reports
    primaries: tuple[XY, XY, XY]  # chromaticities of the components
    white: XY  # chromaticity of a colour with three equal components
    curve: Curve | None  # transfer curve; None if values are linear and not clipped
    neutral: XY | None = None  # chromaticity of a white surface; None if equal to `white`

    @property
    def neutral_xyz(self) -> Array:
        """XYZ of a white surface with Y = 1."""
        return xyz_of(self.neutral) if self.neutral else np.linalg.solve(self.from_xyz, np.ones(3))

    @property
    def to_xyz(self) -> Array:
        """Matrix (3, 3) that converts linear values to XYZ, computed from the primaries and the white point."""
        columns = np.array([(x, y, 1 - x - y) for x, y in self.primaries]).T
        return columns * np.linalg.solve(columns, xyz_of(self.white))

    @property
    def from_xyz(self) -> Array:
        """Matrix (3, 3) that converts XYZ to linear values. For sRGB, it is the rounded matrix of IEC 61966-2-1."""
        return SRGB_FROM_XYZ.copy() if self.name == SRGB.name else np.linalg.inv(self.to_xyz)


REC709 = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
SRGB = Space("srgb", "sRGB", REC709, D65, SRGB_CURVE)
REC2020 = Space("rec2020", "Rec. 2020", ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)), D65, BT2020_CURVE)
XYZ = Space("xyz", "CIE XYZ, white D65", ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0)), (1 / 3, 1 / 3), None, D65)
SPACES = {
    space.name: space
    for space in (
        SRGB,
        Space("display-p3", "Display P3", ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)), D65, SRGB_CURVE),
        REC2020,
        Space("acescg", "ACEScg", ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044)), (0.32168, 0.33767), None),
        XYZ,
    )
}


def xyz_of(chromaticity: XY) -> Array:
    """Return the XYZ (3,) of a chromaticity x, y, with Y = 1."""
    x, y = chromaticity
    return np.array([x, y, 1 - x - y]) / y


def chromaticity_of(xyz: Array) -> XY:
    """Return the chromaticity x, y of the colour `xyz`."""
    x, y, _ = np.asarray(xyz, np.float64) / np.sum(xyz)
    return float(x), float(y)


def adaptation_matrix(white: Array, to: Array) -> Array:
    """Return the matrix that adapts XYZ from one white to another, by the Bradford method.

    Parameters
    ----------
    white, to : ndarray, (3,)
        XYZ of the original and the new white, at any luminance.

    Returns
    -------
    ndarray, (3, 3)
    """
    gain = (BRADFORD @ to / to[1]) / (BRADFORD @ white / white[1])
    return np.linalg.solve(BRADFORD, gain[:, None] * BRADFORD)
