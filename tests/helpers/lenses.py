"""Lenses whose brightness falls off towards the corners, differently for each channel."""

import numpy as np

from l3cli.artifacts.camera import CameraModel, FlatField


def gain(camera: CameraModel, rows: np.ndarray, cols: np.ndarray, corner: float = 2.0) -> np.ndarray:
    """Return the gains (channel, row, col) that correct a lens with cos⁴-like fall-off.

    The corners receive 1/`corner` of the light, slightly less in the first channel and slightly more in the last,
    asymmetrically.
    """
    y, x = rows - (camera.rows - 1) / 2, cols - (camera.cols - 1) / 2
    far = (y[:, None] ** 2 + x**2) / (y[:, None] ** 2 + x**2).max().clip((camera.rows**2 + camera.cols**2) / 4)
    each = np.linspace(0.06, -0.04, len(camera.channels))[:, None, None]
    return np.asarray((1 + (np.sqrt(corner) - 1) * far) ** 2 * (1 + each * far + each * 0.3 * x / camera.cols))


def flat_field(camera: CameraModel, corner: float = 2.0) -> FlatField:
    """Return the flat field of a camera with this lens."""
    rows, cols = np.linspace(0, camera.rows - 1, 33), np.linspace(0, camera.cols - 1, 49)
    return FlatField(rows, cols, gain(camera, rows, cols, corner))
