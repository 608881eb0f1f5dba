"""Colours that a space cannot show, brought into its gamut along lines of constant hue (docs/method.md#gamut).

A colour is linear values c of a space. Its OkLab cone responses are s = (A c)^(1/3), with rows of A that give 1 for
white, and its lightness is L = λ · s. Greys have s = (L, L, L), so the colours of one lightness and hue lie on the line
s(t) = L + t (s − L), and linear values along it are cubic polynomials in t.

1. Negative values: the colour moves towards grey until none is below 0. t is the least root of the cubics, by one step of
   Halley's method from where the straight line through both ends of the cubic that ends lowest is 0.
2. Values above 1: the colour is darkened until none is above 1, which leaves its OkLab hue as it is. Towards a luminance Y
   of 1 this gives way to clipping each value, by Y⁴, so that highlights are as bright as they can be and end in white.

References
----------
B. Ottosson, "A perceptual color space for image processing", 2020: the matrix and λ.
B. Ottosson, "sRGB gamut clipping", 2021: lines of constant hue and lightness, cubics, Halley's method.
CSS Color Module Level 4, W3C, section 13: chroma is reduced at constant OkLCh lightness and hue.
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
LIGHTNESS = np.array([0.2104542553, 0.7936177850, -0.0040720468])  # of the cubic roots of cone responses
LEAST_CONE = 1e-12
CONE_SHARE = 0.02  # of the largest cone response, below which another is raised: real colours have no less than 0.07
LEAST_LIGHTNESS = 1e-4
TINY = 1e-30


@dataclass(frozen=True)
class Gamut:
    """The colours that a space shows: linear values in 0…1."""

    cones: NDArray[np.float64]  # (3, 3) cone responses from linear values; (1, 1, 1) of white
    linear: NDArray[np.float64]  # (3, 3) its inverse
    luminance: NDArray[np.float64]  # (3) Y of linear values; 1 of white


@functools.cache
def gamut_of(space: Space) -> Gamut:
    """Return the gamut of a space whose white is D65."""
    to_xyz = np.linalg.inv(space.from_xyz)
    cones = CONES_FROM_XYZ @ to_xyz
    cones /= cones.sum(axis=1, keepdims=True)
    return Gamut(cones, np.linalg.inv(cones), to_xyz[1] / to_xyz[1].sum())


def into_gamut(linear: NDArray[np.float64], gamut: Gamut, bounded: bool = True) -> NDArray[np.float64]:
    """Return colours with those outside of a gamut brought into it; the others are unchanged.

    Parameters
    ----------
    linear : ndarray, (…, 3)
        Linear values of the space.
    gamut : Gamut
        The gamut of the space.
    bounded : bool
        False if values above 1 can be shown, because a tone curve follows. They are then left as they are.

    Returns
    -------
    ndarray, (…, 3)
        Linear values. A few may still lie outside of 0…1, deep blues by up to 2 % of their largest value, and are to be
        clipped.
    """
    shown = linear.copy()
    negative = linear.min(axis=-1) < 0
    shown[negative] = _less_chromatic(linear[negative], gamut)
    if bounded:
        bright = shown.max(axis=-1) > 1
        shown[bright] = _darker(shown[bright], gamut)
    return shown


def _less_chromatic(linear: NDArray[np.float64], gamut: Gamut) -> NDArray[np.float64]:
    """Return colours (colour, 3) moved towards the grey of their lightness until no value is negative."""
    responses = linear @ gamut.cones.T
    least_responses = np.maximum(CONE_SHARE * responses.max(axis=1, keepdims=True), LEAST_CONE)
    roots = np.cbrt(np.maximum(responses, least_responses))
    lightness = np.maximum(roots @ LIGHTNESS, LEAST_LIGHTNESS)[:, None]
    chroma = roots / lightness - 1
    first, second, third = (scale * chroma**power @ gamut.linear.T for scale, power in ((3, 1), (3, 2), (1, 3)))
    ends = np.minimum(linear / lightness**3, 0)  # of the cubics, at t = 1; they begin at 1
    t = 1 / (1 - ends.min(axis=1, keepdims=True))
    value = 1 + t * (first + t * (second + t * third))
    slope = first + t * (2 * second + t * (3 * third))
    bend = 2 * second + t * (6 * third)
    square = slope * slope + TINY
    roots_of = t - 2 * value * slope / np.maximum(2 * square - value * bend, square)
    t = np.clip(np.where(ends < 0, roots_of, 1).min(axis=1, keepdims=True), 0, 1)
    return lightness**3 * ((1 + t * chroma) ** 3 @ gamut.linear.T)


def _darker(linear: NDArray[np.float64], gamut: Gamut) -> NDArray[np.float64]:
    """Return colours (colour, 3) with values above 1 darkened, or clipped the nearer to white they are."""
    square = np.square(np.clip(linear @ gamut.luminance, 0, 1))[:, None]
    clipped, scaled = np.minimum(linear, 1), linear / linear.max(axis=1, keepdims=True)
    return scaled + square * square * (clipped - scaled)
