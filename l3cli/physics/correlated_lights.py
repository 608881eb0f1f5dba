"""Estimate the illuminant of a scene from its white point, or from the camera signals of a grey surface.

Illuminants are modelled as black bodies, or CIE daylight, with a green or magenta tint (docs/method.md#scene-white).
"""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.physics import spectra

Array = NDArray[np.floating]

WAVELENGTH = np.arange(380.0, 781.0, 5.0)  # wavelengths for XYZ, in nm
# Reciprocal colour temperatures of the model illuminants, in mired (10^-6/K), from 25 000 K to 1600 K.
MIREDS = np.concatenate([np.arange(40.0, 250.0, 10.0), np.arange(250.0, 631.0, 10.0)])
DAYLIGHT_MIRED = 250.0  # largest mired value (4000 K) of daylight; model illuminants with larger values are black bodies
GREENS = np.arange(-0.8, 1.01, 0.1)  # tints: natural logarithm of the factor at GREEN_NM; negative values are magenta
GREEN_NM, GREEN_WIDTH = 545.0, 45.0  # centre and width of the tint in nm, near the green line of fluorescent lamps
SAME_MIRED = 1.0  # difference in mired (42 K at 6500 K) below which two colour temperatures look the same
FINER = 10  # number of steps in the second search for each step of the first search


@dataclass(frozen=True)
class CorrelatedLight:
    """An illuminant, described by its colour temperature and its distance from the black-body locus."""

    xyz: NDArray[np.float64]  # (3,) XYZ of a perfect white, with Y = 1
    kelvin: float  # correlated colour temperature in K
    duv: float  # distance from the black-body locus in CIE 1960 uv; positive for greenish illuminants
    misfit: float  # RMS difference between the logarithms of the modelled and the measured signals
    radiance: Array | None  # (wavelength,) relative photon radiance at the camera's wavelengths; None if unknown


def radiance(mired: float, green: float, wavelength: Array) -> Array:
    """Return the relative photon radiance of a model illuminant.

    Parameters
    ----------
    mired : float
        Reciprocal correlated colour temperature in mired (10^-6/K).
    green : float
        Tint: natural logarithm of the factor by which light at 545 nm is increased. Negative values are magenta.
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.

    Returns
    -------
    ndarray, (wavelength,)
        Radiance, with a mean of 1 if there is no tint.
    """
    kelvin = 1e6 / mired
    plain = spectra.illuminant(f"{'D' if mired <= DAYLIGHT_MIRED else ''}{kelvin:.6f}K", wavelength)
    return np.asarray(plain * _greener(green, wavelength))


def _greener(green: float, wavelength: Array) -> Array:
    """Return the factor by which a tint changes the radiance at each wavelength."""
    return np.asarray(np.exp(green * np.exp(-(((wavelength - GREEN_NM) / GREEN_WIDTH) ** 2))))


def light_of_neutral(weights: Array, wavelength: Array, neutral: Array) -> CorrelatedLight:
    """Find the model illuminant that best explains the camera signals of a grey surface.

    The fit minimises the squared differences between the logarithms of the modelled and the measured signals.

    Parameters
    ----------
    weights : ndarray, (channel, wavelength)
        Responsivities of the camera.
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.
    neutral : ndarray, (channel,)
        Signals of a grey surface, in any unit. Channels without a positive signal are ignored.

    Returns
    -------
    CorrelatedLight
        The illuminant, with its radiance at `wavelength`.
    """
    mired, green, misfit = _nearest(weights, wavelength, neutral)
    xyz = spectra.xyz_weights(WAVELENGTH) @ radiance(mired, green, WAVELENGTH)
    return CorrelatedLight(xyz / xyz[1], *temperature(xyz), misfit, radiance(mired, green, wavelength))


def light_of_white(white: Array, wavelength: Array) -> CorrelatedLight:
    """Find the model illuminant that best matches a white point.

    Parameters
    ----------
    white : ndarray, (3,)
        XYZ of the white point, at any luminance.
    wavelength : ndarray, (wavelength,)
        Wavelengths of the camera in nm.

    Returns
    -------
    CorrelatedLight
        The illuminant, with its radiance at `wavelength`. Its `misfit` refers to X, Y and Z instead of camera signals.
    """
    mired, green, misfit = _nearest(spectra.xyz_weights(WAVELENGTH), WAVELENGTH, white)
    return CorrelatedLight(white / white[1], *temperature(white), misfit, radiance(mired, green, wavelength))


def _nearest(weights: Array, wavelength: Array, neutral: Array) -> tuple[float, float, float]:
    """Return the mired value, tint and misfit of the illuminant that best explains the grey signals `neutral`."""
    used = neutral > 0
    wanted = _centred(np.log(neutral[used]))
    mireds, greens = MIREDS, GREENS
    for _ in range(2):
        lights = np.array([radiance(each, 0.0, wavelength) for each in mireds])
        signals = np.einsum("cw,mw,gw->mgc", weights[used], lights, [_greener(each, wavelength) for each in greens])
        error = np.sqrt(((_centred(np.log(np.maximum(signals, 1e-30))) - wanted) ** 2).mean(axis=-1))
        row, col = np.unravel_index(int(error.argmin()), error.shape)
        mired, green, misfit = float(mireds[row]), float(greens[col]), float(error[row, col])
        mireds = np.clip(mired + np.linspace(-10, 10, 2 * FINER + 1), MIREDS[0], MIREDS[-1])
        greens = np.clip(green + np.linspace(-0.1, 0.1, 2 * FINER + 1), GREENS[0], GREENS[-1])
    return mired, green, misfit


def light_of(white: Array) -> CorrelatedLight:
    """Describe an illuminant with an unknown spectrum by its white point, XYZ (3,) at any luminance."""
    return CorrelatedLight(np.asarray(white / white[1], np.float64), *temperature(white), 0.0, None)


def temperature(xyz: Array) -> tuple[float, float]:
    """Compute the correlated colour temperature of a white and its distance from the black-body locus.

    Parameters
    ----------
    xyz : ndarray, (3,)
        XYZ of the white, at any luminance.

    Returns
    -------
    kelvin : float
        Correlated colour temperature in K, limited to 1600…25 000 K.
    duv : float
        Distance in CIE 1960 uv, positive if the white is greener than a black body.
    """
    mireds, locus = _black_bodies()
    point = uv(xyz)
    step = np.diff(locus, axis=0)
    along = np.clip(((point - locus[:-1]) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0)
    distance = point - locus[:-1] - along[:, None] * step
    nearest = int((distance**2).sum(axis=1).argmin())
    mired = mireds[nearest] + along[nearest] * (mireds[nearest + 1] - mireds[nearest])
    side = step[nearest][0] * distance[nearest][1] - step[nearest][1] * distance[nearest][0]
    return float(1e6 / mired), float(np.copysign(np.linalg.norm(distance[nearest]), side))


def mired_of(xyz: Array) -> float:
    """Return the reciprocal colour temperature of a white, limited to 40…625 mired (see `temperature`)."""
    return 1e6 / temperature(xyz)[0]


def uv(xyz: Array) -> NDArray[np.float64]:
    """Convert XYZ (…, 3) to CIE 1960 uv (…, 2)."""
    x, y, z = np.moveaxis(np.asarray(xyz, np.float64), -1, 0)
    return np.stack([4 * x, 6 * y], axis=-1) / (x + 15 * y + 3 * z)[..., None]


@functools.cache
def _black_bodies() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the black-body locus: reciprocal colour temperatures in mired, and CIE 1960 uv (point, 2)."""
    mireds = np.arange(MIREDS[0], MIREDS[-1] + 1, 5.0)
    lights = np.array([spectra.illuminant(f"{1e6 / each:.6f}K", WAVELENGTH) for each in mireds])
    return mireds, uv(lights @ spectra.xyz_weights(WAVELENGTH).T)


def _centred(logarithms: Array) -> Array:
    return np.asarray(logarithms - logarithms.mean(axis=-1, keepdims=True))
