"""Frames with uniform and textured areas at any analog gain."""

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from l3cli.artifacts.camera import CameraModel
from l3cli.simulation import sensor
from l3cli.simulation.sensor import with_analog_gain

SHAPE, CELLS = (240, 320), 36


def cells(camera: CameraModel, rng: np.random.Generator, textured: float) -> np.ndarray:
    """Return a scene (row, col) as a fraction of full scale.

    The cells are about 45 pixels wide. Each cell has one colour. The fraction `textured` of the cells has a texture.
    """
    places = np.moveaxis(np.mgrid[: SHAPE[0], : SHAPE[1]], 0, -1)
    number = cKDTree(rng.uniform((0, 0), SHAPE, (CELLS, 2))).query(places)[1]
    colours = rng.uniform(0.02, 0.85, (CELLS, len(camera.channels)))
    texture = gaussian_filter(rng.standard_normal(SHAPE), 1.5)
    relief = 1.0 + 2.0 * texture * (rng.random(CELLS) < textured)[number]
    return np.clip(colours[number, camera.channel_map(SHAPE)] * relief, 0.0, 1.0)


def taken(camera: CameraModel, share: np.ndarray, gain: float, seed: int = 0) -> np.ndarray:
    """Simulate raw values of a scene, given as a fraction of full scale, at an analog gain."""
    there = with_analog_gain(camera, gain)
    electrons = (share * there.full_scale).astype(np.float32)
    return sensor.expose(there, electrons, 0.0, np.random.default_rng(seed))
