"""Patches of a training frame, and the levels they are rescaled to (METHOD 4.1, 4.8)."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingFrame, TrainingSet
from l3cli.errors import InputFileError
from l3cli.spectra import at_luminance, illuminant
from l3cli.train.recipe import LearningRecipe

Floats = NDArray[np.float32]


def output_unit(camera: CameraModel) -> float:
    """cd s/m²: scene luminance × exposure time at which a perfect white under D65 just fills the brightest channel.

    It scales XYZ targets to about 0…1 in the same proportion for every illuminant and exposure.
    """
    white = at_luminance(illuminant("D65", camera.wavelength), camera.wavelength, 1.0)
    return camera.full_scale / float((camera.electron_weights @ white).max())


@dataclass(frozen=True)
class Patches:
    """Noise-free, unclipped patches of one canonical site with their targets."""

    signal: Floats  # (patch, tap) share of full scale
    target: Floats  # (patch, output) in the table's output unit


def sample_patches(
    frame: TrainingFrame,
    head: TrainingSet,
    unit: float,
    window: NDArray[np.int64],
    count: int,
    orientations: list[NDArray[np.int64]],
    rng: np.random.Generator,
) -> Patches:
    """`count` patches at random places and orientations of a frame, seen through the CFA `window` (tap).

    The mosaic is laid over the full-resolution electrons at any offset, after mirroring and turning the scene. Raises
    InputFileError if the frame is smaller than the patch.
    """
    side = int(np.sqrt(window.size))
    radius = side // 2
    _, rows, cols = frame.electrons.shape
    if min(rows, cols) < side:
        raise InputFileError(f"frame of scene {frame.scene} is {rows}×{cols}, smaller than the {side}×{side} patch")
    row = rng.integers(radius, rows - radius, count)
    col = rng.integers(radius, cols - radius, count)
    turn = np.arange(count) * len(orientations) // count
    reach = np.arange(side) - radius
    offset = (reach[:, None] * cols + reach[None]).ravel()
    channel_start = window * (rows * cols)
    electrons = frame.electrons.reshape(-1)
    signal = np.empty((count, window.size), dtype=np.float32)
    for index, permutation in enumerate(orientations):
        chosen = np.flatnonzero(turn == index)
        place = (row[chosen] * cols + col[chosen])[:, None] + (offset[permutation] + channel_start)[None]
        signal[chosen] = electrons[place]
    signal *= np.float32(1.0 / head.camera.full_scale)
    target = frame.target[:, row, col].T * np.float32(frame.exposure / unit)
    return Patches(signal, np.ascontiguousarray(target))


def draw_levels(recipe: LearningRecipe, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """`count` levels, share of full scale: log-uniform over the whole range, a share of them over the highlights."""
    low = np.where(rng.random(count) < recipe.highlight_share, recipe.highlight_from, recipe.darkest)
    return low * (recipe.brightest / low) ** rng.random(count)


@functools.cache
def _normal_quantiles() -> Floats:
    """The standard normal distribution in 65 536 equally likely values."""
    from scipy.special import ndtri

    return ndtri((np.arange(65536) + 0.5) / 65536).astype(np.float32)


def expose_patches(signal: Floats, camera: CameraModel, rng: np.random.Generator) -> NDArray[np.uint16]:
    """The noisy DN (patch, tap) that decide the class of signals (patch, tap) in shares of full scale."""
    mean = signal * np.float32(camera.white - camera.black)
    noisy = np.sqrt(camera.noise_variance(mean))
    # three times as fast as standard_normal; no class decision turns on what happens beyond 4.3 σ
    noisy *= _normal_quantiles().take(rng.integers(0, 65536, signal.shape, dtype=np.uint16))
    noisy += mean
    noisy += np.float32(camera.black + 0.5)  # cast rounds down
    return np.clip(noisy, 0.0, np.floor(camera.white), out=noisy).astype(np.uint16)


def noise_share(signal: Floats, camera: CameraModel) -> Floats:
    """Noise variance of signals (patch, tap) in units of full scale squared; 0 where clipped."""
    span = camera.white - camera.black
    variance = camera.noise_variance(signal * np.float32(span))
    variance *= np.float32(1 / span**2)
    variance *= signal < 1
    return variance
