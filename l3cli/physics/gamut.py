"""Map out-of-gamut colours into a colour space along lines of constant hue (docs/method.md#gamut).

Let c be the vector of a colour's linear values. Its OkLab cone responses are s = (A c)^(1/3), where the rows of A are scaled
so that white has s = (1, 1, 1). Its lightness is L = λ · s. Greys have s = (L, L, L), so colours with the same lightness and
hue are on the line s(t) = L + t (s − L). Along this line, each linear value is a cubic polynomial in t.

1. **Negative values.** The colour moves towards grey until no linear value is negative. Its position t is the smallest root
   of the three cubics. Each root is approximated by one step of Halley's method. All three steps start at the same t. It is
   computed from the cubic that is lowest at t = 1: a straight line through this cubic's values at t = 0 and t = 1 is zero
   at the starting t.
2. **Values above 1.** The colour is darkened until no linear value is above 1, which preserves the OkLab hue. In addition,
   the colour is clipped to 1. The result is the mean of the darkened and the clipped colour with the weights 1 − Y⁴ and Y⁴.
   Bright highlights therefore become as bright as possible and end in white.

References
----------
B. Ottosson, "A perceptual color space for image processing", 2020 (the matrix and λ).
B. Ottosson, "sRGB gamut clipping", 2021 (lines of constant hue and lightness, cubics, Halley's method).
CSS Color Module Level 4, W3C, section 13 (reduction of chroma at constant OkLCh lightness and hue).
"""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.spaces import Space

CONES_FROM_XYZ = np.array(
    [
        [0.8189330101, 0.3618667424, -0.1288597137],
        [0.0329845436, 0.9293118715, 0.0361456387],
        [0.0482003018, 0.2643662691, 0.6338517070],
    ]
)
LIGHTNESS = np.array([0.2104542553, 0.7936177850, -0.0040720468])  # weights λ of the cube roots of the cone responses
LEAST_CONE = 1e-12  # minimum cone response, so that black does not have zero responses
CONE_SHARE = 0.02  # minimum cone response, as a fraction of the largest response; real colours have at least 0.07
LEAST_LIGHTNESS = 1e-4  # minimum lightness as a divisor
MIN_DIVISOR = 1e-30  # added to a divisor that may be zero


@dataclass(frozen=True)
class Gamut:
    """Conversion between a colour space's linear values and cone responses."""

    cones: NDArray[np.float64]  # (3, 3) converts linear values to cone responses, which are (1, 1, 1) for white
    linear: NDArray[np.float64]  # (3, 3) inverse of `cones`
    luminance: NDArray[np.float64]  # (3,) weights of the linear values in Y, where white has Y = 1


@functools.cache
def gamut_of(space: Space) -> Gamut:
    """Return the gamut of a colour space with the white point D65."""
    to_xyz = np.linalg.inv(space.from_xyz)
    cones = CONES_FROM_XYZ @ to_xyz
    cones /= cones.sum(axis=1, keepdims=True)
    return Gamut(cones, np.linalg.inv(cones), to_xyz[1] / to_xyz[1].sum())


def into_gamut(linear: NDArray[np.float64], gamut: Gamut, bounded: bool = True) -> NDArray[np.float64]:
    """Map out-of-gamut colours into a gamut. Colours inside the gamut do not change.

    Parameters
    ----------
    linear : ndarray, (…, 3)
        Linear values.
    gamut : Gamut
        Gamut of the colour space.
    bounded : bool
        Whether to map colours with values above 1. Use False if a tone curve follows, which maps these colours itself.

    Returns
    -------
    ndarray, (…, 3)
        Linear values. The caller must clip them to 0…1, because deep blues can exceed this range by up to 2 % of their
        largest value.
    """
    shown = linear.copy()
    negative = linear.min(axis=-1) < 0
    shown[negative] = _less_chromatic(linear[negative], gamut)
    if bounded:
        bright = shown.max(axis=-1) > 1
        shown[bright] = _darker(shown[bright], gamut)
    return shown


def _less_chromatic(linear: NDArray[np.float64], gamut: Gamut) -> NDArray[np.float64]:
    """Move colours (colour, 3) towards the grey with the same lightness until no value is negative."""
    responses = linear @ gamut.cones.T
    least_responses = np.maximum(CONE_SHARE * responses.max(axis=1, keepdims=True), LEAST_CONE)
    roots = np.cbrt(np.maximum(responses, least_responses))
    lightness = np.maximum(roots @ LIGHTNESS, LEAST_LIGHTNESS)[:, None]
    chroma = roots / lightness - 1
    first, second, third = (scale * chroma**power @ gamut.linear.T for scale, power in ((3, 1), (3, 2), (1, 3)))
    ends = np.minimum(linear / lightness**3, 0)  # values of the cubics at t = 1, if negative; all cubics are 1 at t = 0
    t = 1 / (1 - ends.min(axis=1, keepdims=True))
    value = 1 + t * (first + t * (second + t * third))
    slope = first + t * (2 * second + t * (3 * third))
    bend = 2 * second + t * (6 * third)
    square = slope * slope + MIN_DIVISOR
    roots_of = t - 2 * value * slope / np.maximum(2 * square - value * bend, square)
    t = np.clip(np.where(ends < 0, roots_of, 1).min(axis=1, keepdims=True), 0, 1)
    return lightness**3 * ((1 + t * chroma) ** 3 @ gamut.linear.T)


def _darker(linear: NDArray[np.float64], gamut: Gamut) -> NDArray[np.float64]:
    """Limit colours (colour, 3) to 1, by averaging clipped and darkened colours with the weights Y⁴ and 1 − Y⁴."""
    square = np.square(np.clip(linear @ gamut.luminance, 0, 1))[:, None]
    clipped, scaled = np.minimum(linear, 1), linear / linear.max(axis=1, keepdims=True)
    return scaled + square * square * (clipped - scaled)
