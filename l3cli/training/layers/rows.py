"""Rows of a plane layer's equations from training mosaics, and their sums (docs/method.md#layers)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layer_sums import LayerSums
from l3cli.artifacts.layers import PLANE_STEP, PlaneRule
from l3cli.classes.later import mirrored, window_means
from l3cli.classes.ratios import shaded_chroma
from l3cli.classes.windows import Integers
from l3cli.errors import L3Error
from l3cli.training.accumulate import TARGET_FLOOR
from l3cli.training.layers.first import Floats, Seen, runs_of
from l3cli.training.recipe import LearningRecipe
from l3cli.training.row_weighting import ERROR_FLOOR, lab_error
from l3cli.training.sums import EXACT, STEP, add_rounded, intercept_scale, pairs, steps_of_columns, width_of

MEAN_FLOOR = 1e-5  # squared error, in output units, below which mosaics count alike
BORDER = 12  # pixels at a mosaic's edge without rows: what they see is mirrored
Y = 1


@dataclass(frozen=True)
class Reading:
    """How windows of planes are read: in the orientation in which a site is learned."""

    canonical: Integers  # (site) that a site is learned as
    order: Integers  # (site, tap) place of each tap in the window
    ratio_taps: int = 0  # behind those of the windows, the same in every orientation

    @property
    def side(self) -> int:
        return int(np.sqrt(self.order.shape[1]))

    @property
    def taps(self) -> int:
        """Of a window of all planes, and behind it."""
        return 3 * self.order.shape[1] + self.ratio_taps

    def taps_of(self, planes: NDArray, pixels: Integers, site: int, ratios: NDArray[np.float64]) -> Floats:
        """Taps (pixel, tap) of planes (plane, row, col) about pixels of a site, those of `ratios` (tap, row, col)
        behind them."""
        windows = windows_of(planes, pixels, self.order[site])
        behind = ratios.reshape(len(ratios), planes[0].size)[:, pixels].T * PLANE_STEP
        return np.concatenate([windows, behind.astype(np.float32)], axis=1)


def empty_sums(rule: PlaneRule, taps: int, outputs: int) -> LayerSums:
    """Sums of no rows."""
    classes, width = rule.classes_per_site, taps + 1 + outputs
    return LayerSums(
        np.zeros((classes, width * (width + 1) // 2)), np.zeros((classes, taps * (taps + 1) // 2)), np.zeros(classes)
    )


def grid_steps(rule: PlaneRule, first: ClassRule, camera: CameraModel, taps: int, outputs: int) -> NDArray[np.float64]:
    """Grid steps of the moments (level, pair); the darkest of the first layer's levels tells for those made one."""
    darkest = np.searchsorted(rule.level_of(np.arange(first.levels)), np.arange(rule.levels))
    return steps_of_columns(intercept_scale(first, camera)[darkest], taps, outputs)


def require_exact(sums: LayerSums, rule: PlaneRule, steps: NDArray[np.float64]) -> None:
    """L3Error if sums have grown so large that additions may have been rounded, as that of the first layer."""
    (row, col), (tap, other) = pairs(width_of(sums.moments)), pairs(width_of(sums.noise))
    level = rule.split(np.arange(rule.classes_per_site)).level
    squares = sums.moments[:, row == col] / steps[level][:, row == col]
    if max(squares.max(), sums.noise[:, tap == other].max() / STEP) >= EXACT:
        raise L3Error("a class has more rows than can be added exactly; lower layer.mosaics or layer.rows")


def inner_pixels(shape: tuple[int, ...]) -> Integers:
    """Indices (pixel) of the pixels of a mosaic that may give rows."""
    rows, cols = shape
    row, col = np.arange(BORDER, rows - BORDER), np.arange(BORDER, cols - BORDER)
    return (row[:, None] * cols + col).ravel()


def windows_of(planes: NDArray, pixels: Integers, order: Integers) -> Floats:
    """Windows (pixel, plane · tap) of planes (plane, row, col) about pixels of one site, read in `order` (tap), in output
    units."""
    side = int(np.sqrt(order.size))
    reach = np.arange(side) - side // 2
    offset = (reach[:, None] * planes.shape[2] + reach).ravel()[order]
    places = pixels[:, None] + offset
    taps = np.concatenate([plane[places] for plane in planes.reshape(len(planes), -1)], axis=1)
    return taps.astype(np.float32) * np.float32(PLANE_STEP)


def row_weights(
    seen: Seen, basis: NDArray[np.float64], white: NDArray[np.float64], recipe: LearningRecipe, pictures: bool
) -> Floats:
    """Weight (row, col) of every pixel: relative to its level, less for large errors of the first layer, whose noise is
    averaged over 5 × 5 (docs/method.md#row-weights, docs/method.md#second-pass); of what is no picture, for those of the
    whole mosaic."""
    relative = np.maximum(seen.target[..., Y], 0) / seen.brightness + np.float32(TARGET_FLOOR)
    weight = relative ** np.float32(-recipe.brightness_power) / seen.brightness ** np.float32(recipe.level_power)
    if not recipe.error_power:
        return np.asarray(weight, np.float32)
    if not pictures:
        return np.asarray(weight * _of_mosaic(seen, basis) ** -recipe.error_power, np.float32)
    back = (np.linalg.inv(basis) * PLANE_STEP).astype(np.float32)
    clean, noisy = (np.moveaxis(planes, 0, -1).astype(np.float32) @ back for planes in (seen.clean, seen.noisy))
    near = (seen.target, seen.brightness, white.astype(np.float32))
    error = lab_error(clean - seen.target, *near) + _averaged(lab_error(noisy - clean, *near))
    return np.asarray(weight * (error + np.float32(ERROR_FLOOR)) ** np.float32(-recipe.error_power), np.float32)


def _of_mosaic(seen: Seen, basis: NDArray[np.float64]) -> float:
    """Mean squared error of what the layers before make of a mosaic, above a floor: errors of what is no picture are judged
    mosaic by mosaic, as PSNR does."""
    error = np.moveaxis(seen.noisy, 0, -1) @ (np.linalg.inv(basis) * PLANE_STEP) - seen.target
    return float((error[BORDER:-BORDER, BORDER:-BORDER] ** 2).mean()) + MEAN_FLOOR


def _averaged(values: Floats) -> Floats:
    """Means over 5 × 5."""
    return window_means(mirrored(values, 2), 5)


def add_rows(
    sums: Mapping[int, LayerSums], seen: Seen, label: Integers, rule: PlaneRule, reading: Reading, pixels: Integers,
    weight: Floats, basis: NDArray[np.float64], steps: NDArray[np.float64],
) -> None:  # fmt: skip
    """Add the rows of `pixels` with classes `label` (row, col) and weights `weight` (row, col) to the sums of their
    canonical sites, on the grid of `steps` (level, pair)."""
    site, within = rule.within_site(label.ravel())
    weight = weight.ravel()
    ratios = [shaded_chroma(planes, reading.side)[: reading.ratio_taps] for planes in (seen.clean, seen.noisy)]
    target = seen.target.reshape(-1, seen.target.shape[-1]) @ basis.astype(np.float32)
    for one in np.unique(site[pixels]).tolist():
        here = pixels[site[pixels] == one]
        here = here[np.argsort(within[here], kind="stable")]
        clean, noisy = map(reading.taps_of, (seen.clean, seen.noisy), (here, here), (one, one), ratios)
        noise = noisy - clean
        rows = np.concatenate([clean, np.ones((len(here), 1), np.float32), target[here]], axis=1)
        weighted = rows * weight[here, None], noise * weight[here, None]
        _add_classes(sums[int(reading.canonical[one])], rule, steps, within[here], *weighted)


def _add_classes(
    sums: LayerSums, rule: PlaneRule, steps: NDArray[np.float64], label: Integers, rows: Floats, noise: Floats
) -> None:
    places, noise_places = (np.ravel_multi_index(pairs(width), (width, width)) for width in (rows.shape[1], noise.shape[1]))
    for index, run in runs_of(label):
        block, spread = rows[run], noise[run]
        add_rounded(sums.moments[index], (block.T @ block).ravel().take(places), steps[rule.split(index).level])
        add_rounded(sums.noise[index], (spread.T @ spread).ravel().take(noise_places), np.float64(STEP))
        sums.count[index] += len(block)
