"""Defects of a real sensor, added to the model of docs/method.md#sensor: hot and dead pixels, dust, column noise."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Recipe, Share

MOST_SPECKS, LARGEST_SPECK = 10_000, 1000  # per million pixels; pixels in radius


class DefectRecipe(Recipe):
    """The defects of the virtual lab's sensor."""

    hot_pixels_per_million: float = 25.0
    hot_current_e_per_s: float = 4000.0  # dark current of a hot pixel
    dead_pixels_per_million: float = 10.0
    dust_specks_per_million: float = 4.0  # soft shadows of a few pixels' radius
    dust_depth: Share = 0.03  # share of the light that a speck takes in its middle
    dust_radius_px: float = 12.0
    column_noise_e: float = 2.0  # standard deviation of the columns' offsets


def defect_faults(recipe: DefectRecipe) -> Iterator[Fault]:
    """Yield the faults of defects that are more than pixels, or of dust from which no frame could be cleaned."""
    for key in ("hot_pixels_per_million", "dead_pixels_per_million"):
        if getattr(recipe, key) > 1e6:
            yield fault("defects: of a million pixels no more than a million can be hot or dead", f"defects.{key}")
    if not (recipe.dust_specks_per_million <= MOST_SPECKS and 0 < recipe.dust_radius_px <= LARGEST_SPECK):
        message = f"defects: give up to {MOST_SPECKS} specks of dust per million pixels, 0…{LARGEST_SPECK} px in radius"
        yield fault(message, "defects.dust_radius_px", "defects.dust_specks_per_million")


@dataclass(frozen=True)
class SensorDefects:
    """The defects of one sensor, the same in every frame."""

    hot: NDArray[np.int64]  # (pixel, 2) row, col
    dead: NDArray[np.int64]  # (pixel, 2) row, col
    shade: NDArray[np.float32]  # (row, col) share of the light that dust lets through
    columns: NDArray[np.float32]  # (col) e-, offset


def defects_of(camera: CameraModel, recipe: DefectRecipe) -> SensorDefects:
    """Return the defects of a camera, drawn from its fixed-pattern seed."""
    return _draw(camera.fixed_pattern_seed, camera.rows, camera.cols, msgspec.structs.astuple(recipe))


@functools.lru_cache(maxsize=1)
def _draw(seed: int, rows: int, cols: int, figures: tuple[float, ...]) -> SensorDefects:
    recipe = DefectRecipe(*figures)
    rng = np.random.default_rng([seed, 1])

    def scattered(per_million: float) -> NDArray[np.int64]:
        count = round(per_million * 1e-6 * rows * cols)
        return np.stack([rng.integers(0, rows, count), rng.integers(0, cols, count)], axis=1)

    hot, dead = scattered(recipe.hot_pixels_per_million), scattered(recipe.dead_pixels_per_million)
    shade = np.ones((rows, cols), dtype=np.float32)
    reach = int(np.ceil(4 * recipe.dust_radius_px))
    for row, col in scattered(recipe.dust_specks_per_million):
        top, left = max(row - reach, 0), max(col - reach, 0)
        part = shade[top : row + reach, left : col + reach]
        y, x = np.arange(part.shape[0]) + top - row, np.arange(part.shape[1]) + left - col
        part -= (recipe.dust_depth * np.exp(-0.5 * (y[:, None] ** 2 + x**2) / recipe.dust_radius_px**2)).astype(np.float32)
    columns = (recipe.column_noise_e * rng.standard_normal(cols)).astype(np.float32)
    return SensorDefects(hot, dead, shade, columns)
