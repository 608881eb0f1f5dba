"""Lenses that lose light towards the corners, by channel."""

import numpy as np

from l3cli.artifacts.camera import CameraModel, FlatField


def gain(camera: CameraModel, rows: np.ndarray, cols: np.ndarray, corner: float = 2.0) -> np.ndarray:
    """(channel, row, col) of what undoes a lens that leaves 1/`corner` of the light in the corners, as cos⁴ falls; of the
    first channel still less, of the last more, askew."""
    y, x = rows - (camera.rows - 1) / 2, cols - (camera.cols - 1) / 2
    far = (y[:, None] ** 2 + x**2) / (y[:, None] ** 2 + x**2).max().clip((camera.rows**2 + camera.cols**2) / 4)
    each = np.linspace(0.06, -0.04, len(camera.channels))[:, None, None]
    return np.asarray((1 + (np.sqrt(corner) - 1) * far) ** 2 * (1 + each * far + each * 0.3 * x / camera.cols))


def flat_field(camera: CameraModel, corner: float = 2.0) -> FlatField:
    """The flat field of a camera with such a lens."""
    rows, cols = np.linspace(0, camera.rows - 1, 33), np.linspace(0, camera.cols - 1, 49)
    return FlatField(rows, cols, gain(camera, rows, cols, corner))
