"""Blur by the lens in every wavelength of a scene, at the cost of a few transforms (docs/method.md#optics)."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import Optics
from l3cli.physics.lens import diffraction_transfer, gaussian_transfer

Array = NDArray[np.floating]

LOW_RANK_ERROR = 5e-5  # largest error of the transfer function at any sampled frequency and wavelength
RADIAL_SAMPLES = 2048


@dataclass(frozen=True)
class LowRankTransfer:
    """A family of transfer functions, one a wavelength, as the product of a few radial and spectral terms."""

    frequency: Array  # (sample) cycles/m
    radial: Array  # (term, sample)
    spectral: Array  # (term, wavelength)


@functools.lru_cache(maxsize=4)
def low_rank_transfer(highest: float, wavelength: tuple[float, ...], f_number: float) -> LowRankTransfer:
    """Return the diffraction MTF up to `highest` cycles/m within LOW_RANK_ERROR in as few terms as that takes (singular
    values)."""
    frequency = np.linspace(0.0, highest, RADIAL_SAMPLES)
    exact = diffraction_transfer(frequency, np.array(wavelength), f_number)
    left, strength, right = np.linalg.svd(exact, full_matrices=False)
    terms = 1
    while abs((left[:, :terms] * strength[:terms]) @ right[:terms] - exact).max() > LOW_RANK_ERROR:
        terms += 1
    return LowRankTransfer(frequency, (left[:, :terms] * strength[:terms]).T, right[:terms])


def lens_transfer(
    optics: Optics, pixel_pitch: float, wavelength: Array, diffraction: bool, defocus: float
) -> LowRankTransfer | None:
    """Return the blur of each wavelength by the lens: diffraction and a Gaussian of standard deviation `defocus` in m on
    the sensor; None if it blurs nothing."""
    highest = float(np.sqrt(0.5) / pixel_pitch)
    if diffraction:
        transfer = low_rank_transfer(highest, tuple(wavelength), optics.f_number)
    elif defocus > 0:
        frequency = np.linspace(0.0, highest, RADIAL_SAMPLES)
        transfer = LowRankTransfer(frequency, np.ones((1, RADIAL_SAMPLES)), np.ones((1, wavelength.size)))
    else:
        return None
    gaussian = gaussian_transfer(transfer.frequency, defocus)
    return LowRankTransfer(transfer.frequency, transfer.radial * gaussian, transfer.spectral)


def blurred_channels(planes: NDArray[np.float32], transfer: LowRankTransfer, pixel_pitch: float) -> NDArray[np.float32]:
    """planes (channel, term, row, col), each term filtered by its radial part and summed: (channel, row, col).

    The planes hold Σ_band weight · spectral (term, band) · reflectance: the bands are projected on the channels before any
    transform. Beyond its border a frame is mirrored, which the discrete cosine transform does by itself. Overwrites
    `planes`.
    """
    from scipy import fft

    rows, cols = planes.shape[2:]
    frequency = np.hypot(np.arange(rows)[:, None] / (2 * rows), np.arange(cols) / (2 * cols)) / pixel_pitch
    maps = [np.interp(frequency, transfer.frequency, radial).astype(np.float32) for radial in transfer.radial]
    blurred = np.empty((len(planes), rows, cols), np.float32)
    for channel, terms in enumerate(planes):
        total = fft.dctn(terms[0], overwrite_x=True) * maps[0]
        for plane, factor in zip(terms[1:], maps[1:], strict=True):
            total += fft.dctn(plane, overwrite_x=True) * factor
        blurred[channel] = fft.idctn(total, overwrite_x=True)
    return blurred


def project(cube: NDArray[np.float32], weights: Array) -> NDArray[np.float32]:
    """cube (row, col, band) summed with weights (channel, band): (channel, row, col)."""
    rows, cols, bands = cube.shape
    return (weights.astype(np.float32) @ cube.reshape(-1, bands).T).reshape(-1, rows, cols)
