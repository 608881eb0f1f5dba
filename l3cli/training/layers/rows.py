"""Rows of a plane layer's equations from training mosaics, and their sums (docs/method.md#layers)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP
from l3cli.artifacts.structure_rule import StructureRule
from l3cli.classes.structure import REACH, structures
from l3cli.training.layers.first import Floats, Seen, mirrored
from l3cli.training.sums import STEP, add_rounded, pairs
from l3cli.training.weighing import lab_error

BORDER = 12  # pixels at a mosaic's edge without rows: their windows are mirrored
ROWS = 4096  # rows taken at once


@dataclass(frozen=True)
class LayerSums:
    """Sums of one canonical site over its rows. A column is a tap, the intercept or an output of the opponent basis."""

    moments: NDArray[np.float64]  # (class, pair of columns) products without noise
    noise: NDArray[np.float64]  # (class, pair of taps) products of what noise adds to the taps
    count: NDArray[np.float64]  # (class)


def empty_sums(rule: StructureRule, taps: int, outputs: int) -> LayerSums:
    """Sums of no rows."""
    classes, width = rule.classes_per_site, taps + 1 + outputs
    return LayerSums(
        np.zeros((classes, width * (width + 1) // 2)), np.zeros((classes, taps * (taps + 1) // 2)), np.zeros(classes)
    )


def classes(seen: Seen, rule: StructureRule) -> NDArray[np.int64]:
    """Class within its site (row, col) of every pixel of a mosaic."""
    luminance = mirrored(seen.noisy[1].astype(np.int64), REACH)
    structure = structures(luminance, mirrored(seen.level, REACH - 1), seen.site, rule)
    return rule.join(seen.level // rule.level_step, rule.kind(structure, seen.case))


def inner_pixels(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Indices (pixel) of the pixels of a mosaic that may give rows."""
    rows, cols = shape
    row, col = np.arange(BORDER, rows - BORDER), np.arange(BORDER, cols - BORDER)
    return (row[:, None] * cols + col).ravel()


@dataclass(frozen=True)
class Turns:
    """How windows of planes are read: in the orientation in which a site is learned."""

    canonical: NDArray[np.int64]  # (site) that a site is learned as
    taps: NDArray[np.int64]  # (site, tap) place of each tap in the window


def taps_of(planes: NDArray, pixel: NDArray[np.int64], order: NDArray[np.int64], side: int) -> Floats:
    """Windows (pixel, plane · tap) of `planes` about pixels of one site, read in `order` (tap), in output units."""
    cols = planes.shape[2]
    reach = np.arange(side) - side // 2
    offset = (reach[:, None] * cols + reach).ravel()[order]
    flat = planes.reshape(len(planes), -1)
    place = pixel[:, None] + offset
    return np.concatenate([plane[place] for plane in flat], axis=1).astype(np.float32) * np.float32(PLANE_STEP)


def row_weights(seen: Seen, basis: NDArray[np.float64], white: NDArray[np.float64], brightness_power: float, error_power: float) -> Floats:
    """Weight (row, col) of every pixel: relative to its level, less for large errors of the layer before."""
    back = np.linalg.inv(basis)
    level = np.maximum(seen.brightness, 1e-4).astype(np.float32)
    clean, noisy = (np.einsum("prc,po->rco", planes.astype(np.float32) * np.float32(PLANE_STEP), back.astype(np.float32)) for planes in (seen.clean, seen.noisy))
    target = np.moveaxis(seen.mosaic.target, 0, -1)
    error = lab_error(clean - target, target, level, white) + box(lab_error(noisy - clean, target, level, white))
    relative = np.maximum(target[..., 1], 0) / level + np.float32(0.05)
    return (relative ** np.float32(-brightness_power) / level * (error + 0.25) ** np.float32(-error_power)).astype(np.float32)


def box(values: NDArray) -> NDArray:
    """Means over 5 × 5."""
    padded = mirrored(values, 2)
    rows = sum(padded[i : i + values.shape[0]] for i in range(5))
    return np.asarray(sum(rows[:, i : i + values.shape[1]] for i in range(5)) / 25)


def add_mosaic(
    sums: dict[int, LayerSums], seen: Seen, rule: StructureRule, turns: Turns, side: int, weight: Floats,
    basis: NDArray[np.float64], pixels: NDArray[np.int64],
) -> None:  # fmt: skip
    """Add the rows of `pixels` to the sums of their canonical sites."""
    label, site = classes(seen, rule).ravel(), seen.site.ravel()
    target = np.moveaxis(seen.mosaic.target, 0, -1).reshape(-1, len(seen.mosaic.target)) @ basis.astype(np.float32)
    weight = weight.ravel()
    for one in np.unique(site[pixels]).tolist():
        here = pixels[site[pixels] == one]
        here = here[np.argsort(label[here], kind="stable")]
        order = turns.taps[one]
        clean = taps_of(seen.clean, here, order, side)
        noise = taps_of(seen.noisy, here, order, side) - clean
        w = weight[here, None]
        rows = np.concatenate([clean, np.ones((len(here), 1), np.float32), target[here]], axis=1) * w
        noise *= w
        _add_classes(sums[int(turns.canonical[one])], label[here], rows, noise)


def _add_classes(sums: LayerSums, label: NDArray[np.int64], rows: Floats, noise: Floats) -> None:
    width, taps = rows.shape[1], noise.shape[1]
    place, noise_place = (np.ravel_multi_index(pairs(size), (size, size)) for size in (width, taps))
    start = np.flatnonzero(np.diff(label, prepend=-1))
    for a, b in zip(start, [*start[1:], len(label)], strict=True):
        index, block, spread = label[a], rows[a:b], noise[a:b]
        add_rounded(sums.moments[index], (block.T @ block).ravel().take(place), np.float64(STEP))
        add_rounded(sums.noise[index], (spread.T @ spread).ravel().take(noise_place), np.float64(STEP))
        sums.count[index] += b - a
