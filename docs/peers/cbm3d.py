"""Menon's demosaicking and then CBM3D (Mäkinen, Azzari and Foi, Collaborative Filtering of Correlated Noise, 2020), by bm3d,
whose licence allows nonprofit, noncommercial use alone.

The generalised Anscombe transform first makes the noise one of variance 1, its unbiased inverse comes last (Mäkitalo and
Foi, Optimal Inversion of the Generalized Anscombe Transformation for Poisson-Gaussian Noise, 2013). The noise is given as
the spectrum that it has after demosaicking. On a face and a temple at 0.02 and 0.01 these were worse, by so much ΔE00: light
as it is (0.2 with the spectrum, 0.8 to 1.5 with the variance), the transform after demosaicking (0.1), no white balance
(0.4), the variance in place of the spectrum (0.9 to 1.5), 1.5² times that of the mosaic, as Jin, Facciolo and Morel (2020)
have it (0.03 to 0.13; −0.1 to 0.1 dB), 1.4 or 0.8 times the noise (0.1).
"""

import functools
import warnings
from typing import Any

import numpy as np
from rivals import CFA, PLAIN, Array, Denoiser, Noise, NotInstalled, Rival, installed

from l3cli.evaluation.demosaic import menon
from l3cli.physics.mosaic import tiled

OPPONENT = np.array([[1 / 3, 1 / 3, 1 / 3], [1 / 2, 0.0, -1 / 2], [1 / 4, -1 / 2, 1 / 4]])  # CBM3D's luminance and chromas
FLATS = 24  # of noise alone, whose mean power is the spectrum
SMOOTH = 1.5  # frequencies, of the Gaussian that smooths it
LEVEL = 50.0  # far from 0: of a flat


def bayer() -> list[Rival]:
    """The method, of one setting. NotInstalled without bm3d or colour-demosaicing."""
    program = f"{installed('bm3d')}, {installed('colour-demosaicing')}"
    return [Rival("Menon + CBM3D", program, {PLAIN: Denoiser(functools.partial(_channels, _program()))})]


def _program() -> Any:
    vars(np).setdefault("trapz", np.trapezoid)  # which numpy 2.4 has no longer, and bm4d 4.2.5 calls
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import bm3d
    except ImportError as error:
        raise NotInstalled(f"bm3d ({error.name} is missing)") from error
    return bm3d


def _channels(program: Any, mosaic: Array, cfa: CFA, noise: Noise) -> Array:
    """Channels of a mosaic (`rivals.Denoiser`)."""
    balance = np.sqrt(noise.electron)
    balance /= balance.max()
    channel = tiled(cfa, mosaic.shape)
    stable = menon(anscombe(mosaic / noise.electron[channel], noise.dark) * balance[channel], cfa)
    planes = np.einsum("oc,crk->rko", OPPONENT, stable)
    least, span = planes.min((0, 1)), np.ptp(planes, axis=(0, 1))
    profile = program.BM3DProfile()
    profile.num_threads = 1
    power = np.moveaxis(spectrum(mosaic.shape, cfa, balance), 0, -1)
    clean = program.bm3d((planes - least) / span, power / span**2, profile) * span + least
    stable = np.einsum("co,rko->crk", np.linalg.inv(OPPONENT), clean) / balance[:, None, None]
    return inverse_anscombe(stable, noise.dark) * noise.electron[:, None, None]


def anscombe(electrons: Array, dark: float) -> Array:
    """Electrons with shot noise and a variance of `dark`, so that their noise is 1."""
    return 2.0 * np.sqrt(np.maximum(electrons + dark + 3 / 8, 0.0))


def inverse_anscombe(mean: Array, dark: float) -> Array:
    """The electrons of which `anscombe` has this mean."""
    above = np.maximum(mean, 1.0)  # the series ends there
    root = np.sqrt(3 / 2)
    return above**2 / 4 + root / 4 / above - 11 / 8 / above**2 + 5 / 8 * root / above**3 - 1 / 8 - dark


def spectrum(shape: tuple[int, int], cfa: CFA, deviation: Array) -> Array:
    """Power (opponent plane, row, col) that noise of a `deviation` (channel) in the mosaic has after demosaicking."""
    from scipy.ndimage import gaussian_filter

    rng, deviations = np.random.default_rng(0), deviation[tiled(cfa, shape)]
    power = np.zeros((3, *shape))
    for _ in range(FLATS):
        planes = menon(LEVEL + rng.normal(size=shape) * deviations, cfa) - LEVEL
        power += np.abs(np.fft.fft2(np.einsum("oc,crk->ork", OPPONENT, planes))) ** 2
    smoothed: Array = gaussian_filter(power / FLATS, (0.0, SMOOTH, SMOOTH), mode="wrap")
    return smoothed
