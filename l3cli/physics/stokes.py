"""Linear polarisation: Stokes parameters, degree and angle, and Malus's law (docs/polarisation.md).

S0 is the intensity. S1 and S2 are the differences of the intensities behind ideal polarisers at 0° and 90°, and at 45° and
135°. Angles are counter-clockwise from the horizontal axis of the frame.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

# Outputs of a table for a monochrome polarisation camera. Luminance is the second of three outputs, as in X, Y, Z, so that
# refinement layers treat S1 and S2 like chroma, which is 0 for unpolarised light.
STOKES = ("S1", "S0", "S2")
IN_ORDER = ("S0", "S1", "S2")  # order in files and pictures
FEATURES = ("DoLP", "AoLP")
DARKEST = 1e-6  # smallest S0 that ratios are divided by


def has_stokes(outputs: Sequence[str]) -> bool:
    """Return whether the outputs of a table contain S1 and S2."""
    return {"S1", "S2"} <= set(outputs)


def luminance_name(outputs: Sequence[str]) -> str:
    """Return the name of the output that contains the luminance: S0, or Y of tables with colours."""
    return "S0" if "S0" in outputs else "Y"


def stokes_of(planes: Array, outputs: Sequence[str]) -> Array:
    """Return S0, S1 and S2, (3, …), of the outputs (output, …) of a table."""
    names = (luminance_name(outputs), "S1", "S2")
    return np.stack([planes[outputs.index(name)] for name in names])


def dolp(stokes: Array) -> Array:
    """Return the degree of linear polarisation, between 0 and 1, of S0, S1 and S2, (3, …)."""
    return np.clip(np.hypot(stokes[1], stokes[2]) / np.maximum(stokes[0], DARKEST), 0, 1)


def aolp(stokes: Array) -> Array:
    """Return the angle of linear polarisation of S0, S1 and S2, (3, …), in degrees from 0 to below 180."""
    return np.degrees(0.5 * np.arctan2(stokes[2], stokes[1])) % 180


def behind(stokes: Array, angle: float) -> Array:
    """Return the intensity of S0, S1 and S2, (3, …), behind an ideal polariser at `angle` degrees."""
    double = 2 * np.radians(angle)
    return 0.5 * (stokes[0] + np.cos(double) * stokes[1] + np.sin(double) * stokes[2])


def malus_matrix(angles: Sequence[float]) -> Array:
    """Return the matrix (picture, 3) that maps S0, S1 and S2 to intensities behind ideal polarisers at `angles` degrees."""
    double = 2 * np.radians(np.asarray(angles, np.float64))
    return 0.5 * np.stack([np.ones_like(double), np.cos(double), np.sin(double)], axis=1)


def fit_stokes(intensities: Array, angles: Sequence[float]) -> tuple[Array, Array]:
    """Fit Stokes parameters to intensities behind an ideal polariser at several angles, by least squares.

    Parameters
    ----------
    intensities : ndarray, (picture, …)
        Intensity behind the polariser at each angle.
    angles : sequence of float
        Angles of the transmission axis in degrees, at least three different ones.

    Returns
    -------
    stokes : ndarray, (3, …)
        S0, S1 and S2.
    residual : ndarray, (picture, …)
        Intensities minus the intensities that the fitted parameters have. With three angles, they are zero.
    """
    matrix = malus_matrix(angles)
    inverse = np.linalg.pinv(matrix).astype(intensities.dtype)
    stokes = np.tensordot(inverse, intensities, 1)
    return stokes, intensities - np.tensordot(matrix.astype(intensities.dtype), stokes, 1)


def angle_difference(degrees: Array, others: Array | float) -> Array:
    """Return the difference between directions of polarisation, from −90° to 90°. Directions repeat after 180°."""
    return np.asarray((degrees - others + 90.0) % 180.0 - 90.0)


def malus(light_angle: Array, gain: Array, angle: Array, leakage: Array, light_polarisation: float) -> Array:
    """Return the signal of each channel for light that has passed through a polariser (Malus's law).

    Parameters
    ----------
    light_angle : ndarray, (capture,)
        Angle of the transmission axis of the polariser in front of the light, in degrees.
    gain : ndarray, (channel,)
        Signal for light that is fully polarised along the transmission axis of the channel.
    angle : ndarray, (channel,)
        Angle of the transmission axis of each channel in degrees.
    leakage : ndarray, (channel,)
        Inverse of the extinction ratio of each channel. It is 1 for a channel without a polariser.
    light_polarisation : float
        Degree of linear polarisation of the light.

    Returns
    -------
    ndarray, (capture, channel)
        Signals.
    """
    cosine = np.cos(2.0 * np.radians(angle - light_angle[:, None]))
    return np.asarray(0.5 * gain * (1.0 + leakage + light_polarisation * (1.0 - leakage) * cosine))
