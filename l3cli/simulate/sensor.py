"""The sensor of METHOD 1.2: mean photo-electrons → digital numbers."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel

MOST_ELECTRONS = 1e15  # beyond any well, within what a Poisson generator takes


@dataclass(frozen=True)
class FixedPattern:
    """What a camera's pixels differ by, the same in every frame."""

    prnu: NDArray[np.float32]  # (row, col) relative deviation of the response
    dsnu: NDArray[np.float32]  # (row, col) e-, offset


def fixed_pattern(camera: CameraModel) -> FixedPattern:
    """The PRNU and DSNU maps of the whole sensor, drawn from the camera's own seed."""
    noise = camera.noise
    return _fixed_pattern(camera.fixed_pattern_seed, camera.rows, camera.cols, noise.prnu, noise.dsnu)


@functools.lru_cache(maxsize=1)
def _fixed_pattern(seed: int, rows: int, cols: int, prnu: float, dsnu: float) -> FixedPattern:
    rng = np.random.default_rng(seed)
    response = rng.standard_normal((rows, cols), dtype=np.float32) * np.float32(prnu)
    offset = rng.standard_normal((rows, cols), dtype=np.float32) * np.float32(dsnu)
    return FixedPattern(response, offset)


def mosaic(electrons: NDArray[np.float32], cfa: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The (row, col) mosaic of full-resolution electrons (channel, row, col), CFA phase (0, 0)."""
    rows, cols = electrons.shape[1:]
    channel = cfa[np.ix_(np.arange(rows) % cfa.shape[0], np.arange(cols) % cfa.shape[1])]
    return np.take_along_axis(electrons, channel[None].astype(np.intp), axis=0)[0]


def expose(
    camera: CameraModel, electrons: NDArray[np.floating], exposure: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """One noisy raw frame (row, col) in DN of mean photo-electrons (row, col) after `exposure` seconds (METHOD 1.2).

    The frame is the upper left part of the sensor, whose fixed pattern it carries; ValueError if it is larger.
    """
    rows, cols = electrons.shape
    if rows > camera.rows or cols > camera.cols:
        raise ValueError(f"a frame of {rows}×{cols} does not fit the sensor of {camera.rows}×{camera.cols} pixels")
    pattern = fixed_pattern(camera)
    return read_out(camera, FixedPattern(pattern.prnu[:rows, :cols], pattern.dsnu[:rows, :cols]), electrons, exposure, rng)


def read_out(
    camera: CameraModel,
    pattern: FixedPattern,
    electrons: NDArray[np.floating],
    exposure: float,
    rng: np.random.Generator,
) -> NDArray[np.uint16]:
    """The raw frame (row, col) in DN of mean photo-electrons on pixels with a pattern of the same shape (METHOD 1.2)."""
    noise = camera.noise
    mean = np.clip(electrons, 0.0, MOST_ELECTRONS) + min(noise.dark_current * exposure, MOST_ELECTRONS)
    collected = rng.poisson(mean).astype(np.float64)
    collected += rng.normal(0.0, noise.read_noise, collected.shape) if noise.read_noise else 0.0
    signal = collected * (1.0 + pattern.prnu) + pattern.dsnu
    values = np.rint(camera.gain * np.minimum(signal, noise.well_capacity) + camera.black)
    return np.clip(values, 0, 2**camera.bits - 1).astype(np.uint16)
