"""Menon's demosaicing followed by CBM3D (Mäkinen, Azzari and Foi, Collaborative Filtering of Correlated Noise, 2020).

CBM3D comes from the package bm3d, whose licence allows only nonprofit, noncommercial use. The generalised Anscombe transform
is applied before demosaicing and makes the variance of the noise 1. The unbiased inverse is applied at the end (Mäkitalo and
Foi, Optimal Inversion of the Generalized Anscombe Transformation for Poisson-Gaussian Noise, 2013). CBM3D uses the power
spectrum that the noise has after demosaicing.

On a face and a temple at mean signals of 0.02 and 0.01, these variants were worse. The numbers are increases of ΔE00:

* no Anscombe transform: 0.2 with the spectrum, 0.8 to 1.5 with the variance;
* Anscombe transform after demosaicing: 0.1;
* no white balance: 0.4;
* variance instead of the spectrum: 0.9 to 1.5;
* 1.5² times the variance of the mosaic, as in Jin, Facciolo and Morel (2020): 0.03 to 0.13 (−0.1 to 0.1 dB);
* 1.4 or 0.8 times the noise: 0.1.
"""

import functools
import warnings
from typing import Any

import numpy as np
from rivals import CFA, PLAIN, Array, Denoiser, Noise, NotInstalled, Rival, installed

from l3cli.evaluation.demosaic import menon
from l3cli.physics.mosaic import tiled

OPPONENT = np.array([[1 / 3, 1 / 3, 1 / 3], [1 / 2, 0.0, -1 / 2], [1 / 4, -1 / 2, 1 / 4]])  # CBM3D's luminance and chromas
FLATS = 24  # number of pure noise frames from which the spectrum is computed
SMOOTH = 1.5  # standard deviation, in frequencies, of the Gaussian that smooths the spectrum
LEVEL = 50.0  # value of a uniform frame; far from 0, so that noise is not clipped


def bayer() -> list[Rival]:
    """Return the method, which has one setting. Raise NotInstalled if bm3d or colour-demosaicing is missing."""
    program = f"{installed('bm3d')}, {installed('colour-demosaicing')}"
    return [Rival("Menon + CBM3D", program, {PLAIN: Denoiser(functools.partial(_channels, _program()))})]


def _program() -> Any:
    vars(np).setdefault("trapz", np.trapezoid)  # bm4d 4.2.5 calls numpy.trapz, which numpy 2.4 has removed
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import bm3d
    except ImportError as error:
        raise NotInstalled(f"bm3d ({error.name} is missing)") from error
    return bm3d


def _channels(program: Any, mosaic: Array, cfa: CFA, noise: Noise) -> Array:
    """Demosaic and denoise a mosaic (see `rivals.Denoiser`)."""
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
    """Transform electrons with shot noise and read noise of variance `dark` so that the variance of the noise is 1."""
    return 2.0 * np.sqrt(np.maximum(electrons + dark + 3 / 8, 0.0))


def inverse_anscombe(mean: Array, dark: float) -> Array:
    """Return the number of electrons for which `anscombe` has this mean."""
    above = np.maximum(mean, 1.0)  # the series is valid only from 1 on
    root = np.sqrt(3 / 2)
    return above**2 / 4 + root / 4 / above - 11 / 8 / above**2 + 5 / 8 * root / above**3 - 1 / 8 - dark


def spectrum(shape: tuple[int, int], cfa: CFA, deviation: Array) -> Array:
    """Return the power spectrum (opponent plane, row, col) of noise with σ `deviation` (channel) after demosaicing."""
    from scipy.ndimage import gaussian_filter

    rng, deviations = np.random.default_rng(0), deviation[tiled(cfa, shape)]
    power = np.zeros((3, *shape))
    for _ in range(FLATS):
        planes = menon(LEVEL + rng.normal(size=shape) * deviations, cfa) - LEVEL
        power += np.abs(np.fft.fft2(np.einsum("oc,crk->ork", OPPONENT, planes))) ** 2
    smoothed: Array = gaussian_filter(power / FLATS, (0.0, SMOOTH, SMOOTH), mode="wrap")
    return smoothed
