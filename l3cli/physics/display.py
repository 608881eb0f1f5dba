"""Convert between XYZ and displayed pictures, and compute colour differences (docs/method.md#display).

XYZ is CIE 1931 XYZ. A picture is an array (row, col, 3) of linear sRGB values, where 1 is display white. The integer values
of a picture file are called *codes*.
"""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import RecipeError, shortened
from l3cli.physics.spaces import SRGB_CURVE, SRGB_FROM_XYZ, adaptation_matrix
from l3cli.physics.spectra import colour_science, white_point
from l3cli.system.text import Quantity

Array = NDArray[np.floating]
XYZ = ("X", "Y", "Z")  # names of outputs that are CIE 1931 tristimulus values
CHROMATICITY = Quantity(0.001, 0.999)  # permitted range of x and y of a white
WHITE_PERCENTILE = 99  # percentile of Y that is displayed as white, as in the pictures of the L3 paper
LUMA = np.array([0.2126, 0.7152, 0.0722])  # luminance weights of the sRGB primaries (Rec. 709)
FLOAT_BITS = 32  # bits per value of linear floating-point pictures
CODES = {8: np.uint8, 16: np.uint16}  # data type by number of bits per code
AT_ONCE = 1 << 13  # number of colours per block, small enough for the processor cache
TONE_LIMIT = 1e6  # upper limit of linear values before the tone curve, far above display white
PRECISION = 1e-3  # gradient at which the optimisation stops, because smaller gradients would not change the results


# ------------------------------------------------------------------------------------------- white and exposure


@functools.cache
def daylight() -> Array:
    """Return the XYZ (3,) of D65, the white point of displays, with Y = 1."""
    return white_point("D65")


def display_white() -> Array:
    """Return the tristimulus values (3,) of display white.

    They are computed from the rounded sRGB matrix, and equal D65 to four digits.
    """
    return np.linalg.solve(SRGB_FROM_XYZ, np.ones(3))


def white_luminance(luminance: Array) -> float:
    """Return the luminance to display as white: the 99th percentile of `luminance`, or 1 if it is not positive."""
    bright = white_percentile(luminance)
    return bright if bright > 0 else 1.0


def white_percentile(values: Array) -> float:
    """Return the 99th percentile of an array, or NaN if the array contains NaN.

    The result equals the result of np.percentile, except for float32 rounding, which differs between versions of numpy.
    np.percentile is not used, because it imports numpy's masked arrays, which takes 5 % of the time to render a picture.
    """
    flat = values.ravel()
    place = (flat.size - 1) * (WHITE_PERCENTILE / 100)
    below = min(int(place), flat.size - 1)
    above, share = min(below + 1, flat.size - 1), place - below
    sorted_there = np.partition(flat, (below, above, flat.size - 1))
    if np.isnan(sorted_there[-1]):
        return float("nan")
    low, high = sorted_there[below], sorted_there[above]
    return float(high - (high - low) * (1 - share) if share >= 0.5 else low + (high - low) * share)


def exposure_scale(luminance: Array) -> float:
    """Return the factor that maps the 99th percentile of `luminance` (row, col) to 1, or 1 if it is not positive."""
    return 1.0 / white_luminance(luminance)


def scene_white(text: str) -> NDArray[np.float64]:
    """Return the XYZ of a white that is given as a chromaticity "x,y" or as the name of an illuminant.

    Returns
    -------
    ndarray, (3,)
        XYZ with Y = 1.

    Raises
    ------
    RecipeError
        If the text is neither a valid chromaticity nor the name of an illuminant.
    """
    if "," not in text:
        return np.asarray(white_point(text), np.float64)
    parts = text.split(",")
    try:
        x, y = (CHROMATICITY.read(part) for part in parts)
    except ValueError as error:
        why = f": {error}" if len(parts) == 2 else ""
        raise RecipeError(f'white "{shortened(text)}" is not a chromaticity{why}; set x,y such as 0.3127,0.3290') from None
    if x + y > CHROMATICITY.most:
        raise RecipeError(f"white {text} is not a chromaticity; set x and y with a sum of at most {CHROMATICITY.most}")
    return np.array([x, y, 1 - x - y]) / y


# --------------------------------------------------------------------------------------------------------- sRGB


def xyz_from_srgb_matrix() -> Array:
    """Return the matrix (3, 3) that converts linear sRGB to XYZ, where white has Y = 1."""
    return np.linalg.inv(SRGB_FROM_XYZ)


def srgb_curve(linear: Array) -> Array:
    """Clip linear values to the range 0 to 1, and encode them as non-linear sRGB (IEC 61966-2-1)."""
    return SRGB_CURVE.encoded(linear)


def srgb_decoded(encoded: Array) -> Array:
    """Convert non-linear sRGB values between 0 and 1 to linear values (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def codes(encoded: Array, bits: int = 8) -> NDArray[Any]:
    """Convert encoded values between 0 and 1 to 8-bit or 16-bit integers: round((2^bits − 1) · value).

    Values outside this range must be clipped before the call.
    """
    return np.floor(encoded * (2**bits - 1) + 0.5).astype(CODES[bits])


def srgb_codes(linear: Array, bits: int = 8) -> NDArray[Any]:
    """Clip linear sRGB values to the range 0 to 1, and encode them as 8-bit or 16-bit non-linear sRGB integers."""
    return codes(srgb_curve(linear), bits)


@dataclass(frozen=True)
class Tone:
    """Tone curve x (a x + b) / (x (c x + d) + e) for linear values x. The result is limited to 0…1."""

    a: float
    b: float
    c: float
    d: float
    e: float

    def toned(self, linear: Array) -> Array:
        """Apply the tone curve to linear values. The result is linear, and must still be encoded for display."""
        x = np.clip(linear, 0.0, TONE_LIMIT)
        return np.minimum(x * (self.a * x + self.b) / (x * (self.c * x + self.d) + self.e), 1.0)


# This approximation of the ACES output transform is from K. Narkowicz, "ACES Filmic Tone Mapping Curve", 2016.
TONES = {"aces": Tone(2.51, 0.03, 2.43, 0.59, 0.14)}


# ------------------------------------------------------------------------------------------ pictures on a display


def displayed(xyz: Array, white: Array, scale: float) -> Array:
    """Convert scene XYZ to a picture, with chromatic adaptation to D65.

    Parameters
    ----------
    xyz : ndarray, (3, row, col)
        CIE 1931 XYZ.
    white : ndarray, (3,)
        XYZ of the scene white, at any luminance, which is displayed as neutral.
    scale : float
        Luminance Y to display as white, in the unit of `xyz`.

    Returns
    -------
    ndarray, (row, col, 3)
        Linear sRGB, clipped to 0…1.
    """
    matrix = SRGB_FROM_XYZ @ adaptation_matrix(white, daylight()) / scale
    return np.clip(np.einsum("oc,crk->rko", matrix, xyz), 0.0, 1.0)


def scene_xyz(linear: Array, white: Array, scale: float) -> Array:
    """Convert a picture to scene XYZ (3, row, col), the inverse of `displayed` except for clipped values."""
    matrix = adaptation_matrix(daylight(), white) @ xyz_from_srgb_matrix() * scale
    return np.einsum("co,rko->crk", matrix, linear)


def displayed_xyz(linear: Array) -> Array:
    """Convert a picture to the XYZ (row, col, 3) that a display emits, with Y = 1 for display white."""
    return linear @ xyz_from_srgb_matrix().T


def lab(xyz: Array, white: Array) -> Array:
    """Convert XYZ (…, 3) to CIE L*a*b* in float64. `white` is the XYZ (3,) of the reference white, in the same unit."""
    share = np.asarray(xyz, np.float64) / white
    root = np.where(share > (6 / 29) ** 3, np.cbrt(share), share * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def lightness(linear: Array) -> Array:
    """Return the CIE L* (row, col) of a picture, from 0 for black to 100 for display white."""
    return np.asarray(colour_science().lightness(100.0 * (linear @ LUMA), method="CIE 1976"))


def srgb_from_lab(lab_values: Array) -> Array:
    """Convert CIE L*a*b* (…, 3) with the white D65 to linear sRGB (…, 3), without clipping."""
    colour = colour_science()
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    return np.asarray(colour.Lab_to_XYZ(lab_values, white) @ SRGB_FROM_XYZ.T)


def delta_e_2000(lab_a: Array, lab_b: Array) -> Array:
    """Compute the CIEDE2000 differences between two arrays of L*a*b* values.

    Parameters
    ----------
    lab_a, lab_b : ndarray, (…, 3)
        The colours, broadcast against each other.

    Returns
    -------
    ndarray, (…)
        Differences, in float64.
    """
    one, other = np.broadcast_arrays(lab_a, lab_b)
    flat = one.reshape(-1, 3), other.reshape(-1, 3)
    difference = np.empty(len(flat[0]))
    for first in range(0, len(difference), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        difference[part] = _delta_e_2000(*(values[part].astype(np.float64).T for values in flat))
    return difference.reshape(one.shape[:-1])


def _delta_e_2000(one: Array, other: Array) -> Array:
    """Compute CIEDE2000 differences between L*, a*, b* values (3, colour), as in Sharma, Wu and Dalal (2005).

    To avoid trigonometric functions, hues are unit vectors, and the mean of two hues is their bisector. Only the mean hue is
    computed as an angle.
    """
    (light_1, a_1, b_1), (light_2, a_2, b_2) = one, other
    stretch = 1.5 - 0.5 * _vivid((_length(a_1, b_1) + _length(a_2, b_2)) / 2)
    a_1, a_2 = a_1 * stretch, a_2 * stretch
    chroma_1, chroma_2 = _length(a_1, b_1), _length(a_2, b_2)
    both, dot, cross = chroma_1 * chroma_2, a_1 * a_2 + b_1 * b_2, a_1 * b_2 - b_1 * a_2
    opposed = both + dot <= 1e-9 * both  # True where the hues are opposite, or one of the colours is grey
    far = np.copysign(np.sqrt(np.maximum(2 * (both - dot), 0)), cross)
    hue = np.where(opposed, far, cross * np.sqrt(2 / np.where(opposed, 1, both + dot)))  # 2 √(C₁C₂) sin(Δh/2)
    x, y = (np.where(both > 0, p * chroma_2 + q * chroma_1, p + q) for p, q in ((a_1, a_2), (b_1, b_2)))
    sign = np.where((b_1 > 0) | (b_1 == 0) & (a_1 > 0), 1, -1)  # choice between the two bisectors of opposite hues
    x, y = (np.where((x == 0) & (y == 0), each, of) for of, each in ((x, -sign * b_1), (y, sign * a_1)))
    length = _length(x, y)
    mean = (x + 1j * y) / np.where(length > 0, length, 1) + (length == 0)
    twice = mean * mean
    terms = ((-0.17, mean, -30), (0.24, twice, 0), (0.32, twice * mean, 6), (-0.20, twice * twice, -63))
    weight = 1 + sum(factor * (np.exp(1j * np.radians(angle)) * hues).real for factor, hues, angle in terms)
    blue = np.exp(-(((np.degrees(np.angle(mean)) % 360 - 275) / 25) ** 2))
    light, chroma = ((light_1 + light_2) / 2 - 50) ** 2, (chroma_1 + chroma_2) / 2
    light_part = (light_2 - light_1) / (1 + 0.015 * light / np.sqrt(20 + light))
    chroma_part, hue_part = (chroma_2 - chroma_1) / (1 + 0.045 * chroma), hue / (1 + 0.015 * chroma * weight)
    rotation = -2 * _vivid(chroma) * np.sin(np.radians(60) * blue)
    squares = light_part**2 + chroma_part**2 + hue_part**2 + rotation * chroma_part * hue_part
    return np.asarray(np.sqrt(np.maximum(squares, 0)))


def _length(x: Array, y: Array) -> Array:
    """Return √(x² + y²). np.hypot is five times slower, because it guards against overflow."""
    return np.sqrt(x * x + y * y)


def _vivid(chroma: Array) -> Array:
    """Return √(C⁷ / (C⁷ + 25⁷))."""
    seventh = (chroma * chroma * chroma) ** 2 * chroma
    return np.sqrt(seventh / (seventh + 25.0**7))


def displayed_delta_e(one: Array, other: Array) -> Array:
    """Return the CIEDE2000 differences (row, col) between two pictures of the same size."""
    labs = [lab(displayed_xyz(picture), daylight()) for picture in (one, other)]
    return delta_e_2000(*labs)


def fit_through(inputs: Array, outputs: Array, known: Array, answer: Array, noise: Array | float = 0.0) -> Array:
    """Fit a matrix M that converts inputs to outputs, by least squares with the constraint M @ known = answer.

    Parameters
    ----------
    inputs : ndarray, (surface, input)
        Inputs, such as camera signals.
    outputs : ndarray, (surface, output)
        Desired outputs, such as XYZ.
    known : ndarray, (input,)
        Input for which M must be exact, such as the signals of white.
    answer : ndarray, (output,)
        Output for the input `known`.
    noise : ndarray, (input,), or float
        Noise variance of each input. The larger the variance, the less M amplifies noise.

    Returns
    -------
    ndarray, (output, input)
        The matrix M.

    Notes
    -----
    The constraint is imposed with a Lagrange multiplier.
    """
    gram = inputs.T @ inputs + len(inputs) * np.diag(np.broadcast_to(noise, inputs.shape[1:]))
    free = np.linalg.solve(gram, inputs.T @ outputs).T
    towards = np.linalg.solve(gram, known)
    return free + np.outer(answer - free @ known, towards / (known @ towards))


DERIVATIVE_STEP = 2.0**-26  # step of numerical derivatives: square root of the float64 precision


def refinement(xyz: Array, wanted: Array, white: Array) -> Array:
    """Find the matrix R that minimises the mean squared CIEDE2000 error of R @ xyz and preserves white.

    Parameters
    ----------
    xyz : ndarray, (surface, 3)
        XYZ of the colours to correct.
    wanted : ndarray, (surface, 3)
        Correct XYZ of the same colours.
    white : ndarray, (3,)
        XYZ of white, in the same unit.

    Returns
    -------
    ndarray, (3, 3)
        The matrix R: a local minimum, found by starting from the identity.
    """
    from scipy.optimize import minimize

    goal, free = lab(wanted, white), np.linalg.svd(white[None])[2][1:]  # `free`: two vectors orthogonal to white

    def turned(changes: Array) -> Array:
        return np.eye(3) + changes.reshape(-1, 3, 2) @ free

    def errors(changes: Array) -> Array:  # squared errors are smooth even at an error of 0
        return np.square(delta_e_2000(lab(xyz @ turned(changes).swapaxes(1, 2), white), goal)).mean(axis=1)

    def sloped(change: Array) -> tuple[float, Array]:  # five times faster than one derivative at a time
        first, *others = errors(change + np.vstack([np.zeros(6), DERIVATIVE_STEP * np.eye(6)]))
        return float(first), (np.array(others) - first) / DERIVATIVE_STEP

    return turned(minimize(sloped, np.zeros(6), jac=True, method="BFGS", options={"gtol": PRECISION}).x)[0]
