"""Linear polarisation: Stokes parameters, degree and angle of polarisation, and Malus's law (docs/polarisation.md).

S0 is the intensity. S1 is the intensity behind an ideal polariser at 0° minus the intensity at 90°. S2 is the intensity at
45° minus the intensity at 135°. Angles are measured counter-clockwise from the frame's horizontal axis.
"""

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

# Outputs of a table for a monochrome polarisation camera. The luminance is the second output, as in X, Y, Z, so that
# refinement layers treat S1 and S2 like chroma. Both are 0 for unpolarised light, just as chroma is 0 for greys.
STOKES = ("S1", "S0", "S2")
COLOUR_STOKES = ("X", "Y", "Z", "S1", "S2")  # outputs of a table for a colour polarisation camera
IN_ORDER = ("S0", "S1", "S2")  # order in files and pictures
FEATURES = ("DoLP", "AoLP")
DARKEST = 1e-6  # smallest S0 that is used as a divisor
MAX_CORRELATION = 0.95  # upper limit for the estimated correlation between the noise of S0 and the noise of polarised light
MAX_DOLP_SIGMA = 0.5  # maximum possible standard deviation of values from 0 to 1
CLEAR_SIGNAL = 12.0  # ratio of polarised light to its noise above which DoLP and AoLP have Gaussian noise


def has_stokes(outputs: Sequence[str]) -> bool:
    """Whether the outputs of a table contain S1 and S2."""
    return {"S1", "S2"} <= set(outputs)


def luminance_name(outputs: Sequence[str]) -> str:
    """Return the name of the luminance output: S0 for tables of monochrome polarisation cameras, otherwise Y."""
    return "S0" if "S0" in outputs else "Y"


def stokes_of(planes: Array, outputs: Sequence[str]) -> Array:
    """Select S0 (or Y, for tables with colours), S1 and S2 from the outputs of a table.

    Parameters
    ----------
    planes : ndarray, (output, …)
        Values of all outputs.
    outputs : sequence of str
        Names of the outputs, which must include S1 and S2.

    Returns
    -------
    ndarray, (3, …)
    """
    names = (luminance_name(outputs), "S1", "S2")
    return np.stack([planes[outputs.index(name)] for name in names])


def dolp(stokes: Array) -> Array:
    """Return the degree of linear polarisation, clipped to 0…1, from the Stokes parameters (3, …)."""
    return np.clip(np.hypot(stokes[1], stokes[2]) / np.maximum(stokes[0], DARKEST), 0, 1)


def aolp(stokes: Array) -> Array:
    """Return the angle of linear polarisation in degrees, 0 ≤ angle < 180, from the Stokes parameters (3, …)."""
    return np.degrees(0.5 * np.arctan2(stokes[2], stokes[1])) % 180


@functools.cache
def _weak_signal() -> tuple[Array, Array, Array]:
    """Tabulate the standard deviations of the length and direction of short vectors with Gaussian noise.

    Returns
    -------
    ratio : ndarray
        Noise-free length of the vector, relative to the standard deviation of its components.
    length : ndarray
        Standard deviation of the length (Rice distribution), relative to the standard deviation of the components.
    angle : ndarray
        Standard deviation of half the direction angle, in radians. It is π/√12 for a vector of length 0.
    """
    from scipy.special import i0e, i1e, ndtr  # imported here to save start-up time, because few runs need it

    ratio = np.linspace(0, CLEAR_SIGNAL, 481)
    half = np.square(ratio) / 4
    mean = np.sqrt(np.pi / 2) * ((1 + 2 * half) * i0e(half) + 2 * half * i1e(half))
    length = np.sqrt(2 + np.square(ratio) - np.square(mean))
    phase = (np.arange(3600) + 0.5) * (np.pi / 3600)
    along = ratio[:, None] * np.cos(phase)
    density = np.exp(-np.square(ratio[:, None]) / 2) + np.sqrt(2 * np.pi) * along * ndtr(along) * np.exp(
        -np.square(ratio[:, None] * np.sin(phase)) / 2
    )
    angle = 0.5 * np.sqrt((density * np.square(phase)).sum(axis=1) / density.sum(axis=1))
    return ratio, length, angle


def polarisation_sigma(stokes: Array, covariance: Array) -> Array:
    """Compute the standard deviations of the degree and angle of polarisation by noise propagation.

    Parameters
    ----------
    stokes : ndarray, (3, …)
        Noisy S0, S1 and S2.
    covariance : ndarray, (3, 3, …)
        Covariance matrix of S0, S1 and S2.

    Returns
    -------
    ndarray, (2, …)
        Standard deviations of DoLP and AoLP. For AoLP it is in degrees, up to 180°/√12 = 52° for unpolarised light.

    Notes
    -----
    S1 and S2 form a vector with Gaussian noise. If the vector is long, its length and direction also have Gaussian noise. If
    it is not longer than its noise, its length has a Rice distribution, and its direction is almost uniform. The square of
    the noise-free length is estimated as the square of the noisy length minus the variances of S1 and S2.
    """
    strength = np.hypot(stokes[1], stokes[2])
    bright = np.maximum(stokes[0], DARKEST)
    direction = np.arctan2(stokes[2], stokes[1])
    unit = np.stack([np.cos(direction), np.sin(direction)])
    radial = np.einsum("i...,ij...,j...->...", unit, covariance[1:, 1:], unit)
    both = covariance[1, 1] + covariance[2, 2]
    noise = np.sqrt(np.maximum(both / 2, np.finfo(np.float32).tiny))
    clean = np.sqrt(np.maximum(np.square(strength) - both, 0))
    ratio, of_length, of_angle = _weak_signal()
    degree = np.minimum(clean / bright, 1)
    most = MAX_CORRELATION * np.sqrt(np.maximum(radial * covariance[0, 0], 0))
    with_s0 = np.clip(np.einsum("i...,i...->...", unit, covariance[0, 1:]), -most, most)
    variance = np.square(np.interp(clean / noise, ratio, of_length)) * radial
    variance += np.square(degree) * covariance[0, 0] - 2 * degree * with_s0
    across = np.sqrt(np.maximum(both - radial, 0))
    weak = np.interp(clean / np.maximum(across, np.finfo(np.float32).tiny), ratio, of_angle)
    angle = np.where(clean < CLEAR_SIGNAL * across, weak, 0.5 * across / np.maximum(clean, np.finfo(np.float32).tiny))
    dolp_sigma = np.minimum(np.sqrt(np.maximum(variance, 0)) / bright, MAX_DOLP_SIGMA)
    return np.stack([dolp_sigma, np.degrees(angle)])


def behind(stokes: Array, angle: float) -> Array:
    """Return the intensity behind an ideal polariser at `angle` degrees, from the Stokes parameters (3, …)."""
    double = 2 * np.radians(angle)
    return 0.5 * (stokes[0] + np.cos(double) * stokes[1] + np.sin(double) * stokes[2])


def malus_matrix(angles: Sequence[float]) -> Array:
    """Return the matrix (picture, 3) that converts S0, S1, S2 to intensities behind ideal polarisers at `angles` degrees."""
    double = 2 * np.radians(np.asarray(angles, np.float64))
    return 0.5 * np.stack([np.ones_like(double), np.cos(double), np.sin(double)], axis=1)


def fit_stokes(intensities: Array, angles: Sequence[float]) -> tuple[Array, Array]:
    """Fit Stokes parameters to the intensities behind an ideal polariser at several angles, by least squares.

    Parameters
    ----------
    intensities : ndarray, (picture, …)
        Intensity behind the polariser at each angle.
    angles : sequence of float
        Angles of the transmission axis in degrees, with at least three different values.

    Returns
    -------
    stokes : ndarray, (3, …)
        S0, S1 and S2.
    residual : ndarray, (picture, …)
        Intensities minus fitted intensities. With three angles, all residuals are zero.
    """
    matrix = malus_matrix(angles)
    inverse = np.linalg.pinv(matrix).astype(intensities.dtype)
    stokes = np.tensordot(inverse, intensities, 1)
    return stokes, intensities - np.tensordot(matrix.astype(intensities.dtype), stokes, 1)


def angle_difference(degrees: Array, others: Array | float) -> Array:
    """Return the differences `degrees` − `others` between angles of polarisation, reduced to −90…90°."""
    return np.asarray((degrees - others + 90.0) % 180.0 - 90.0)


def malus(light_angle: Array, gain: Array, angle: Array, leakage: Array, light_polarisation: float) -> Array:
    """Predict the signal of each channel for light from a rotating polariser (Malus's law).

    Parameters
    ----------
    light_angle : ndarray, (capture,)
        Angle of the rotating polariser's transmission axis in degrees, for each capture.
    gain : ndarray, (channel,)
        Signal for light that is fully polarised along the channel's transmission axis.
    angle : ndarray, (channel,)
        Angle of each channel's transmission axis in degrees.
    leakage : ndarray, (channel,)
        Inverse of each channel's extinction ratio, which is 1 for a channel without a polariser.
    light_polarisation : float
        Degree of linear polarisation of the light.

    Returns
    -------
    ndarray, (capture, channel)
        Signals.
    """
    cosine = np.cos(2.0 * np.radians(angle - light_angle[:, None]))
    return np.asarray(0.5 * gain * (1.0 + leakage + light_polarisation * (1.0 - leakage) * cosine))
