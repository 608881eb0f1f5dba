"""A sensor with defective pixels, clusters and lines, and a lens with a different fall-off for each channel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.simulation.sensor import expose

HOT, DEAD = 1, 2


@dataclass(frozen=True)
class Flaws:
    """Defects and shading of all pixels of a sensor."""

    light: NDArray[np.float64]  # (row, col) fraction of the light that the lens transmits
    kind: NDArray[np.uint8]  # (row, col) 0, HOT or DEAD
    offset: NDArray[np.float64]  # (row, col) DN added to hot pixels


def shading(camera: CameraModel, corners: tuple[float, ...]) -> NDArray[np.float64]:
    """Return a cos⁴-like fall-off (row, col) with the given values (channel) in the corners."""
    rows, cols = camera.rows, camera.cols
    y, x = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, cols)
    down, across = camera.cfa.shape
    channel = camera.cfa[np.ix_(np.arange(rows) % down, np.arange(cols) % across)]
    steep = (np.array(corners) ** -0.5 - 1)[channel]  # 1 / (1 + steep)² is the fraction in the corner
    return np.asarray(1 / (1 + steep * (y**2 + x**2) / 2) ** 2)


def flaws(camera: CameraModel, corners: tuple[float, ...], share: float = 0.001, lines: bool = True, seed: int = 0) -> Flaws:
    """Draw defects. About the fraction `share` of the pixels is defective.

    Defects are single pixels, pairs, and clusters of 3 × 3 pixels. With `lines`, there is also a column and a row.
    """
    rng = np.random.default_rng(seed)
    shape = (camera.rows, camera.cols)
    kind = np.zeros(shape, np.uint8)
    wanted = max(round(share * kind.size), 3) if share else 0
    while np.count_nonzero(kind) < wanted:
        row, col = int(rng.integers(0, shape[0])), int(rng.integers(0, shape[1]))
        down, across = [(1, 1), (1, 1), (1, 1), (1, 2), (3, 3)][int(rng.integers(5))]
        kind[row : row + down, col : col + across] = rng.integers(HOT, DEAD + 1)
    if lines:
        kind[:, shape[1] // 3] = DEAD
        kind[shape[0] // 4] = HOT
    return Flaws(shading(camera, corners), kind, rng.uniform(0.1, 0.9, shape) * (camera.white_level - camera.black_level))


def seen(
    camera: CameraModel, wrong: Flaws, electrons: NDArray[np.floating], rng: np.random.Generator, noises: str = "all"
) -> NDArray[np.uint16]:
    """Simulate a raw frame (row, col) with flaws from mean photoelectrons, exposed for 10 ms."""
    values = expose(camera, electrons * wrong.light * (wrong.kind != DEAD), 0.01, rng, noises).astype(np.float64)
    return np.minimum(values + wrong.offset * (wrong.kind == HOT), camera.white_level).astype(np.uint16)
