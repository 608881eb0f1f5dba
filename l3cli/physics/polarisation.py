"""Linear polarisation: differences between angles, and Malus's law."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def difference(degrees: Array, others: Array | float) -> Array:
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
