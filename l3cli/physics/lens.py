"""Lens optics: camera equation, cos⁴ falloff, and blur from diffraction and defocus (docs/method.md#optics).

The formulas are from ISETCam, and tests compare the results with ISETCam. Lengths are in m unless stated otherwise.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


def image_distance(focal_length: float, object_distance: float) -> float:
    """Return the distance from the lens to the sensor for an object in focus at the distance d: f d / (d − f).

    If `object_distance` (d) is 0, the object is at infinity, and the result is the focal length f.
    """
    if object_distance > 0:
        return focal_length * object_distance / (object_distance - focal_length)
    return focal_length


def magnification(focal_length: float, object_distance: float) -> float:
    """Return the magnification |m| of an object in focus at the distance d: f / (d − f).

    If `object_distance` (d) is 0, the object is at infinity, and the result is 0.
    """
    return focal_length / (object_distance - focal_length) if object_distance > 0 else 0.0


def irradiance_per_radiance(f_number: float, magnification: float) -> float:
    """Return the ratio of sensor irradiance to scene radiance on the optical axis, in sr: π / (1 + 4 N² (1 + |m|)²).

    N is the f-number, and m is the magnification.
    """
    return float(np.pi / (1.0 + 4.0 * f_number**2 * (1.0 + magnification) ** 2))


def relative_illumination(image_distance: float, pixel_pitch: float, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return each pixel's illuminance for a uniform scene, relative to the frame centre (cos⁴ law).

    The relative illuminance is (D² / (D² + r²))², where D is the image distance and r is the pixel's distance from the
    centre.

    Parameters
    ----------
    image_distance : float
        Distance D from the lens to the sensor, in m.
    pixel_pitch : float
        Pixel pitch in m.
    shape : tuple of int
        Rows and columns of the frame.

    Returns
    -------
    ndarray, (row, col)
    """
    down, across = ((np.arange(length) - (length - 1) / 2) * pixel_pitch for length in shape)
    squared = image_distance**2
    return np.asarray((squared / (squared + down[:, None] ** 2 + across**2)) ** 2, dtype=np.float64)


def diffraction_transfer(frequency: Array, wavelength: Array, f_number: float) -> Array:
    """Return the MTF of a diffraction-limited lens: 2/π (acos u − u √(1 − u²)) with u = f λ N.

    Parameters
    ----------
    frequency : ndarray, (frequency,)
        Spatial frequency f in cycles/m on the sensor.
    wavelength : ndarray, (wavelength,)
        Wavelength λ in nm.
    f_number : float
        F-number N.

    Returns
    -------
    ndarray, (frequency, wavelength)
        MTF, which is 0 beyond the cut-off frequency 1 / (λ N).
    """
    u = np.minimum(frequency[:, None] * (wavelength * 1e-9) * f_number, 1.0)
    return 2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u**2))


def gaussian_transfer(frequency: Array, deviation: float) -> Array:
    """Return the MTF of a Gaussian blur: exp(−2 (π σ f)²).

    Parameters
    ----------
    frequency : ndarray, (frequency,)
        Spatial frequency f in cycles/m on the sensor.
    deviation : float
        Standard deviation σ in m on the sensor.

    Returns
    -------
    ndarray, (frequency,)
    """
    return np.asarray(np.exp(-2.0 * (np.pi * deviation * frequency) ** 2))
