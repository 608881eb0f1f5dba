"""What the lens does beyond the camera equation: fall-off towards the corners and diffraction (METHOD 1.3)."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import Optics

Array = NDArray[np.floating]

LOW_RANK_ERROR = 5e-5  # largest error of the transfer function at any sampled frequency and wavelength
RADIAL_SAMPLES = 2048
MARGIN = 32  # pixels mirrored around a frame before it is blurred


def image_distance(optics: Optics) -> float:
    """Distance in m from lens to sensor when the object is in focus; the focal length for an object at infinity."""
    focal, distance = optics.focal_length, optics.object_distance
    return focal * distance / (distance - focal) if distance > 0 else focal


def relative_illumination(optics: Optics, pixel_pitch: float, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Fall-off (row, col) of a frame centred on the axis: (D² / (D² + r²))², the "cos⁴ law"."""
    down, across = ((np.arange(length) - (length - 1) / 2) * pixel_pitch for length in shape)
    squared = image_distance(optics) ** 2
    return ((squared / (squared + down[:, None] ** 2 + across**2)) ** 2).astype(np.float32)


def diffraction_transfer(frequency: Array, wavelength: Array, f_number: float) -> Array:
    """MTF (frequency, wavelength) of an aberration-free lens: 2/π (acos u − u √(1 − u²)), u = f λ N.

    `frequency` in cycles/m on the sensor, `wavelength` in nm.
    """
    u = np.minimum(frequency[:, None] * (wavelength * 1e-9) * f_number, 1.0)
    return 2.0 / np.pi * (np.arccos(u) - u * np.sqrt(1.0 - u**2))


@dataclass(frozen=True)
class LowRankTransfer:
    """A family of transfer functions, one a wavelength, as the product of a few radial and spectral terms."""

    frequency: Array  # (sample) cycles/m
    radial: Array  # (term, sample)
    spectral: Array  # (term, wavelength)


@functools.lru_cache(maxsize=4)
def low_rank_transfer(highest: float, wavelength: tuple[float, ...], f_number: float) -> LowRankTransfer:
    """The diffraction MTF up to `highest` cycles/m within LOW_RANK_ERROR in as few terms as that takes (singular values)."""
    frequency = np.linspace(0.0, highest, RADIAL_SAMPLES)
    exact = diffraction_transfer(frequency, np.array(wavelength), f_number)
    left, strength, right = np.linalg.svd(exact, full_matrices=False)
    terms = 1
    while abs((left[:, :terms] * strength[:terms]) @ right[:terms] - exact).max() > LOW_RANK_ERROR:
        terms += 1
    return LowRankTransfer(frequency, (left[:, :terms] * strength[:terms]).T, right[:terms])


def blurred_channels(
    cube: NDArray[np.float32], weights: Array, wavelength: Array, f_number: float, pixel_pitch: float
) -> NDArray[np.float32]:
    """Σ_band weights (channel, band) · diffraction of cube (row, col, band): (channel, row, col).

    The bands are projected on the channels once a term of the low-rank transfer function, before any Fourier transform.
    Beyond its border a frame is mirrored.
    """
    from scipy import fft

    rows, cols, _ = cube.shape
    margin = min(MARGIN, rows, cols)
    shape = tuple(fft.next_fast_len(length + 2 * margin, real=True) for length in (rows, cols))
    frequency = np.hypot(fft.fftfreq(shape[0])[:, None], fft.rfftfreq(shape[1])) / pixel_pitch
    transfer = low_rank_transfer(np.sqrt(0.5) / pixel_pitch, tuple(wavelength), f_number)
    pad = [(0, 0), *((margin, full - length - margin) for full, length in zip(shape, (rows, cols), strict=True))]
    total = np.zeros((len(weights), *frequency.shape), np.complex64)
    for radial, spectral in zip(transfer.radial, transfer.spectral, strict=True):
        projected = np.pad(project(cube, weights * spectral), pad, mode="symmetric")
        total += fft.rfft2(projected) * np.interp(frequency, transfer.frequency, radial).astype(np.float32)
    return fft.irfft2(total, s=shape)[:, margin : margin + rows, margin : margin + cols]


def project(cube: NDArray[np.float32], weights: Array) -> NDArray[np.float32]:
    """cube (row, col, band) summed with weights (channel, band): (channel, row, col)."""
    rows, cols, bands = cube.shape
    return (weights.astype(np.float32) @ cube.reshape(-1, bands).T).reshape(-1, rows, cols)
