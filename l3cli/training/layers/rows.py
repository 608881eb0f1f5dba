"""Rows of a plane layer's equations from training mosaics, and their sums (docs/method.md#layers)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANE_STEP, PlaneRule
from l3cli.artifacts.partial_sums import LayerSums
from l3cli.classes.ratios import shaded_chroma
from l3cli.classes.refinement import mirrored, window_means
from l3cli.classes.windows import Integers
from l3cli.errors import L3Error
from l3cli.training.accumulate import LARGEST_PIECE, TARGET_FLOOR
from l3cli.training.layers.first import Floats, Seen, runs_of
from l3cli.training.recipe import LearningRecipe
from l3cli.training.row_weighting import ERROR_FLOOR, lab_error
from l3cli.training.sums import EXACT, STEP, add_rounded, intercept_scale, pairs, rounding_number, steps_of_columns, width_of

MEAN_FLOOR = 1e-5  # squared error, in output units, below which mosaics count alike
GATHERED = 64 << 20  # bytes of rows that are added up at once, from several mosaics of a frame
BORDER = 12  # pixels at a mosaic's edge without rows: what they see is mirrored
Y = 1


@dataclass(frozen=True)
class Reading:
    """Reading of windows of planes: in the orientation in which a site is learned."""

    canonical: Integers  # (site) that a site is learned as
    order: Integers  # (site, tap) place of each tap in the window
    ratio_taps: int = 0  # behind those of the windows, the same in every orientation

    @property
    def side(self) -> int:
        return int(np.sqrt(self.order.shape[1]))

    @property
    def taps(self) -> int:
        """Number of taps of a window of all planes, and behind it."""
        return 3 * self.order.shape[1] + self.ratio_taps

    def taps_of(self, planes: NDArray, pixels: Integers, site: int, ratios: NDArray[np.float64]) -> Floats:
        """Taps (pixel, tap) of planes (plane, row, col) about pixels of a site, those of `ratios` (tap, row, col)
        behind them."""
        windows = windows_of(planes, pixels, self.order[site])
        ratio_columns = ratios.reshape(len(ratios), planes[0].size)[:, pixels].T * PLANE_STEP
        return np.concatenate([windows, ratio_columns.astype(np.float32)], axis=1)


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
    context = (seen.target, seen.brightness, white.astype(np.float32))
    error = lab_error(clean - seen.target, *context) + _averaged(lab_error(noisy - clean, *context))
    return np.asarray(weight * (error + np.float32(ERROR_FLOOR)) ** np.float32(-recipe.error_power), np.float32)


def _of_mosaic(seen: Seen, basis: NDArray[np.float64]) -> float:
    """Mean squared error of what the layers before make of a mosaic, above a floor: errors of what is no picture are judged
    mosaic by mosaic, as PSNR does."""
    error = np.moveaxis(seen.noisy, 0, -1) @ (np.linalg.inv(basis) * PLANE_STEP) - seen.target
    return float((error[BORDER:-BORDER, BORDER:-BORDER] ** 2).mean()) + MEAN_FLOOR


def _averaged(values: Floats) -> Floats:
    """Means over 5 × 5."""
    return window_means(mirrored(values, 2), 5)


class Rows(NamedTuple):
    """Rows of one canonical site, weighted."""

    label: Integers  # (row) class within the site
    values: Floats  # (row, column) taps without noise, intercept, outputs
    noise: Floats  # (row, tap) what noise adds to the taps

    @classmethod
    def by_class(cls, parts: list["Rows"]) -> "Rows":
        """All rows of `parts`, of non-decreasing class."""
        label, values, noise = (np.concatenate(each) for each in zip(*parts, strict=True))
        order = np.argsort(label, kind="stable")
        return cls(label[order], values[order], noise[order])


class GatheredRows:
    """Rows of several mosaics on their way into the sums: a class's product costs little more for many rows than for few,
    and one mosaic has few of each class. What is gathered decides how products of float32 are rounded, so that it may depend
    on nothing but the frame."""

    def __init__(
        self, sums: Mapping[int, LayerSums], rule: PlaneRule, reading: Reading, basis: NDArray[np.float64],
        steps: NDArray[np.float64],
    ) -> None:  # fmt: skip
        """Rows for the `sums` of canonical sites, outputs in planes of the `basis`; `steps` (level, pair) of the grid."""
        self.sums, self.rule, self.reading, self.basis, self.steps = sums, rule, reading, basis.astype(np.float32), steps
        self._waiting: dict[int, list[Rows]] = {site: [] for site in sums}
        self._bytes = 0

    def add(self, seen: Seen, label: Integers, pixels: Integers, weight: Floats) -> None:
        """Gather the rows of `pixels` of a mosaic, with classes `label` (row, col) and weights `weight` (row, col)."""
        reading = self.reading
        site, within = self.rule.within_site(label.ravel())
        weight = weight.ravel()
        ratios = [shaded_chroma(planes, reading.side)[: reading.ratio_taps] for planes in (seen.clean, seen.noisy)]
        target = seen.target.reshape(-1, seen.target.shape[-1]) @ self.basis
        for one in np.unique(site[pixels]).tolist():
            of_site = pixels[site[pixels] == one]
            clean, noisy = map(reading.taps_of, (seen.clean, seen.noisy), (of_site, of_site), (one, one), ratios)
            weights = weight[of_site, None]
            values = np.concatenate([clean * weights, weights, target[of_site] * weights], axis=1)
            rows = Rows(within[of_site], values, (noisy - clean) * weights)
            self._waiting[int(reading.canonical[one])].append(rows)
            self._bytes += rows.values.nbytes + rows.noise.nbytes
        if self._bytes > GATHERED:
            self.add_up()

    def add_up(self) -> None:
        """Add what has been gathered to the sums."""
        for site, parts in self._waiting.items():
            if parts:
                _add_classes(self.sums[site], self.rule, self.steps, Rows.by_class(parts))
                parts.clear()
        self._bytes = 0


def _add_classes(sums: LayerSums, rule: PlaneRule, steps: NDArray[np.float64], rows: Rows) -> None:
    widths = rows.values.shape[1], rows.noise.shape[1]
    places, noise_places = (np.ravel_multi_index(pairs(width), (width, width)) for width in widths)
    large, noise_large = rounding_number(steps), rounding_number(STEP)
    runs = runs_of(rows.label)
    levels = rule.split(np.array([index for index, _ in runs])).level.tolist()
    for (index, run), level in zip(runs, levels, strict=True):
        for first in range(run.start, run.stop, LARGEST_PIECE):
            piece = slice(first, min(first + LARGEST_PIECE, run.stop))
            block, spread = rows.values[piece], rows.noise[piece]
            add_rounded(sums.moments[index], (block.T @ block).ravel().take(places), large[level])
            add_rounded(sums.noise[index], (spread.T @ spread).ravel().take(noise_places), noise_large)
        sums.count[index] += run.stop - run.start
