"""Lights that scenes have: black bodies and daylight, more or less green; which of them a colour, or a camera's grey, is of
(docs/method.md#scene-white)."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.physics import spectra

Array = NDArray[np.floating]

WAVELENGTH = np.arange(380.0, 781.0, 5.0)  # nm: where an eye sees
MIREDS = np.concatenate([np.arange(40.0, 250.0, 10.0), np.arange(250.0, 631.0, 10.0)])  # 10^6 / K: 25 000 K to 1600 K
DAYLIGHT_MIRED = 250.0  # 4000 K: from here down light is daylight, above it a black body's
GREENS = np.arange(-0.8, 1.01, 0.1)  # natural logarithm of what a light has more, in the green, than black body or daylight
GREEN_NM, GREEN_WIDTH = 545.0, 45.0  # where the lines of fluorescent lamps lie that make them green
SAME_MIRED = 1.0  # between colour temperatures that are the same: 42 K at 6500 K, which nobody sees
FINER = 10  # steps of the second search in one of the first


@dataclass(frozen=True)
class CorrelatedLight:
    """A light by its distance from black bodies and daylight."""

    xyz: NDArray[np.float64]  # (3) of a perfect white, Y = 1
    kelvin: float  # correlated colour temperature
    duv: float  # distance from the black bodies in CIE 1960 uv, above zero if greener
    misfit: float  # RMS difference of the logarithms of a camera's channels from those that were asked for
    radiance: Array | None  # relative photon radiance on the camera's grid; None: not known


def radiance(mired: float, green: float, wavelength: Array) -> Array:
    """Return relative photon radiance (wavelength) of this correlated colour temperature, `green` as in GREENS."""
    kelvin = 1e6 / mired
    plain = spectra.illuminant(f"{'D' if mired <= DAYLIGHT_MIRED else ''}{kelvin:.6f}K", wavelength)
    return np.asarray(plain * _greener(green, wavelength))


def _greener(green: float, wavelength: Array) -> Array:
    """Return the factor of each wavelength by which a light is greener."""
    return np.asarray(np.exp(green * np.exp(-(((wavelength - GREEN_NM) / GREEN_WIDTH) ** 2))))


def light_of_neutral(weights: Array, wavelength: Array, neutral: Array) -> CorrelatedLight:
    """Return the light under which a grey gives a camera of `weights` (channel, wavelength) the signals `neutral` (channel),
    of any scale: by least squares in their logarithms. Channels whose signal is not above zero are left out."""
    mired, green, misfit = _nearest(weights, wavelength, neutral)
    xyz = spectra.xyz_weights(WAVELENGTH) @ radiance(mired, green, WAVELENGTH)
    return CorrelatedLight(xyz / xyz[1], *temperature(xyz), misfit, radiance(mired, green, wavelength))


def light_of_white(white: Array, wavelength: Array) -> CorrelatedLight:
    """Return the light that has a white (3), its radiance on a camera's grid `wavelength`; `misfit` is of X, Y and Z."""
    mired, green, misfit = _nearest(spectra.xyz_weights(WAVELENGTH), WAVELENGTH, white)
    return CorrelatedLight(white / white[1], *temperature(white), misfit, radiance(mired, green, wavelength))


def _nearest(weights: Array, wavelength: Array, neutral: Array) -> tuple[float, float, float]:
    """Return reciprocal temperature (mired), green and misfit of the light whose grey is `neutral` (channel)."""
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
    """Return a light of which no more is known than its white (3)."""
    return CorrelatedLight(np.asarray(white / white[1], np.float64), *temperature(white), 0.0, None)


def temperature(xyz: Array) -> tuple[float, float]:
    """Return correlated colour temperature (K) of a white (3) within 1600…25 000 K, and its distance from the black bodies
    in CIE 1960 uv, above zero if it is greener than they."""
    mireds, locus = _black_bodies()
    point = uv(xyz)
    step = np.diff(locus, axis=0)
    along = np.clip(((point - locus[:-1]) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0)
    isolated = point - locus[:-1] - along[:, None] * step
    nearest = int((isolated**2).sum(axis=1).argmin())
    mired = mireds[nearest] + along[nearest] * (mireds[nearest + 1] - mireds[nearest])
    side = step[nearest][0] * isolated[nearest][1] - step[nearest][1] * isolated[nearest][0]
    return float(1e6 / mired), float(np.copysign(np.linalg.norm(isolated[nearest]), side))


def mired_of(xyz: Array) -> float:
    """Return reciprocal colour temperature (10^6 / K) of a white (3), as `temperature`."""
    return 1e6 / temperature(xyz)[0]


def uv(xyz: Array) -> NDArray[np.float64]:
    """Return CIE 1960 uv (…, 2) of XYZ (…, 3)."""
    x, y, z = np.moveaxis(np.asarray(xyz, np.float64), -1, 0)
    return np.stack([4 * x, 6 * y], axis=-1) / (x + 15 * y + 3 * z)[..., None]


@functools.cache
def _black_bodies() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return reciprocal temperatures (mired) and CIE 1960 uv (…, 2) of black bodies."""
    mireds = np.arange(MIREDS[0], MIREDS[-1] + 1, 5.0)
    lights = np.array([spectra.illuminant(f"{1e6 / each:.6f}K", WAVELENGTH) for each in mireds])
    return mireds, uv(lights @ spectra.xyz_weights(WAVELENGTH).T)


def _centred(logarithms: Array) -> Array:
    return np.asarray(logarithms - logarithms.mean(axis=-1, keepdims=True))
