"""Weight and sum the training samples of a refinement layer (docs/method.md#learning-on-mosaics).

A sample consists of the taps of a window and the ideal outputs at its central pixel.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANE_STEP, PLANES, PlaneRule
from l3cli.artifacts.partial_sums import LayerSums
from l3cli.classes.planes import LUMINANCE
from l3cli.classes.refinement import mirrored, taps_behind, window_means
from l3cli.classes.windows import Integers
from l3cli.errors import L3Error
from l3cli.training.layers.mosaics import Floats, Seen
from l3cli.training.recipe import LearningRecipe
from l3cli.training.sample_weighting import ERROR_FLOOR, TARGET_FLOOR, lab_error
from l3cli.training.sums import (
    MAX_EXACT_STEPS,
    PRODUCT_STEP,
    add_products,
    intercept_scale,
    pairs,
    pieces_of,
    rounding_number,
    runs_of,
    steps_of_columns,
    width_of,
)

MEAN_FLOOR = 1e-5  # added to each mosaic's mean squared error, so that mosaics with tiny errors have similar weights
# Mean squared error at which a mosaic has the weight 1. This value keeps all weights below 10, so that sums over 7 million
# samples are exact.
MEAN_ERROR = 2.0**-10


@dataclass(frozen=True)
class Reading:
    """Order of the taps and other columns in a training sample.

    Symmetric CFA sites share the filters of one *canonical site*. The window at each site is turned to the orientation of
    its canonical site.
    """

    canonical: Integers  # (site) canonical site
    order: Integers  # (site, tap) position of each tap in the window
    ratio_taps: int = 0  # number of ratio taps, which follow the window taps and do not depend on the orientation
    outputs: int = PLANES  # number of outputs
    corrects: bool = False  # whether the layer corrects the first layer's outputs; the ideal corrections then contain noise

    @property
    def side(self) -> int:
        return int(np.sqrt(self.order.shape[1]))

    @property
    def noisy(self) -> int:
        """Number of columns with noise: all taps and, if the layer corrects the first layer's outputs, the ideal outputs."""
        return self.taps + (self.outputs if self.corrects else 0)

    @property
    def taps(self) -> int:
        """Number of taps: the window's pixels in all planes, plus the ratio taps."""
        return PLANES * self.order.shape[1] + self.ratio_taps

    def offsets(self, cols: int) -> Integers:
        """Return each tap's offset from the central pixel, in elements of a flattened plane.

        Samples store four values per tap: three planes and one of the remaining columns (see `columns`). If there are more
        remaining columns than taps, the offsets are padded with zeros, so that every column has a place.

        Parameters
        ----------
        cols : int
            Number of columns of the planes.

        Returns
        -------
        ndarray, (site, tap)
        """
        reach = np.arange(self.side) - self.side // 2
        steps = (reach[:, None] * cols + reach).ravel()[self.order]
        return np.pad(steps, ((0, 0), (0, max(self.ratio_taps + 1 + self.outputs - steps.shape[1], 0))))

    @property
    def columns(self) -> Integers:
        """Index of each sample column in the rows returned by `_weighted`.

        Each row has four values per window tap. The first three are the planes. The fourth values of successive taps are the
        ratio taps, the constant 1 and the ideal outputs.
        """
        window, behind = np.arange(self.order.shape[1]), np.arange(self.ratio_taps + 1 + self.outputs)
        return np.concatenate([4 * window, 4 * window + 1, 4 * window + 2, 4 * behind + 3])


def empty_sums(rule: PlaneRule, reading: Reading) -> LayerSums:
    classes, width = rule.classes_per_site, reading.taps + 1 + reading.outputs
    moments, noise = (np.zeros((classes, each * (each + 1) // 2)) for each in (width, reading.noisy))
    return LayerSums(moments, noise, np.zeros(classes))


def grid_steps(rule: PlaneRule, first: ClassRule, camera: CameraModel, taps: int, outputs: int) -> NDArray[np.float64]:
    """Return the rounding steps for a refinement layer's products of columns: (level, pair of columns).

    Products are rounded to multiples of these steps, so that their sums are exact in any order. If a level of the refinement
    layer combines several levels of the first layer, the darkest of these levels determines the step.
    """
    darkest = np.searchsorted(rule.level_of(np.arange(first.levels)), np.arange(rule.levels))
    return steps_of_columns(intercept_scale(first, camera)[darkest], taps, outputs)


def require_exact(sums: LayerSums, rule: PlaneRule, steps: NDArray[np.float64]) -> None:
    """Raise L3Error if a sum is too large for exact addition in float64."""
    (row, col), (tap, other) = pairs(width_of(sums.moments)), pairs(width_of(sums.noise))
    level = rule.split(np.arange(rule.classes_per_site)).level
    squares = sums.moments[:, row == col] / steps[level][:, row == col]
    if max(squares.max(), sums.noise[:, tap == other].max() / PRODUCT_STEP) >= MAX_EXACT_STEPS:
        raise L3Error("a class has too many samples for exact sums; reduce layer.mosaics or layer.rows in the class recipe")


def sample_weights(
    seen: Seen, basis: NDArray[np.float64], white: NDArray[np.float64], recipe: LearningRecipe, pictures: bool
) -> Floats:
    """Compute every pixel's training weight (docs/method.md#sample-weights, docs/method.md#second-pass).

    Bright pixels, and pixels with a large squared error after the previous layers, have small weights. For X, Y, Z, the
    squared error is the sum of two terms: the pixel's own squared error without noise, and the mean, over 5 × 5 pixels, of
    the squared error due to noise. For other outputs, the squared error is averaged over the mosaic.

    Parameters
    ----------
    seen : Seen
        Mosaics after all previous layers.
    basis : ndarray, (output, plane)
        Opponent basis, which converts outputs to planes.
    white : ndarray, (output)
        Outputs of a perfect white under the training illuminant, with Y = 1.
    recipe : LearningRecipe
        The [learning] section of the class recipe.
    pictures : bool
        Whether the outputs are X, Y, Z.

    Returns
    -------
    ndarray, (row, col)
    """
    luminance = seen.target @ basis[:, LUMINANCE].astype(np.float32)
    relative = np.maximum(luminance, 0) / seen.brightness + np.float32(TARGET_FLOOR)
    weight = relative ** np.float32(-recipe.brightness_power) / seen.brightness ** np.float32(recipe.level_power)
    if not recipe.error_power:
        return np.asarray(weight, np.float32)
    if not pictures:
        of_mosaic = np.repeat(_of_mosaics(seen, basis) ** -recipe.error_power, len(weight) // seen.count)
        return np.asarray(weight * of_mosaic[:, None], np.float32)
    back = (np.linalg.inv(basis) * PLANE_STEP).astype(np.float32)
    clean = np.moveaxis(seen.light, 0, -1).astype(np.float32) @ back
    context = (seen.target, seen.brightness, white.astype(np.float32))
    error = lab_error(clean - seen.target, *context)
    if seen.clean is not None:
        noise = np.moveaxis(seen.noisy, 0, -1).astype(np.float32) @ back - clean
        error = error + window_means(mirrored(lab_error(noise, *context), 2), 5)
    return np.asarray(weight * (error + np.float32(ERROR_FLOOR)) ** np.float32(-recipe.error_power), np.float32)


def _of_mosaics(seen: Seen, basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each mosaic's mean squared error plus `MEAN_FLOOR`, divided by `MEAN_ERROR`.

    The error is averaged over whole mosaics, because outputs other than X, Y and Z are evaluated by the PSNR.
    """
    if seen.missing is not None:
        error = seen.missing if seen.spread is None else seen.missing - seen.spread
    else:
        error = np.moveaxis(seen.noisy, 0, -1) @ (np.linalg.inv(basis) * PLANE_STEP) - seen.target
    return np.asarray(((error**2).reshape(seen.count, -1).mean(axis=1) + MEAN_FLOOR) / MEAN_ERROR)


class _Samples(NamedTuple):
    """Samples from one or more stacks of mosaics, and the planes that contain their windows."""

    clean: Floats  # (pixel, 4) three planes in output units, padded to four values, which numpy gathers as fast as one
    noise: Floats  # (pixel, 4) noise of the three planes, padded with a zero
    pixel: Integers  # (sample) index of the central pixel
    site: Integers  # (sample) CFA site
    label: Integers  # (sample) class within the site
    weight: Floats  # (sample)
    behind: Floats  # (sample, column) noise-free ratio taps, the constant 1, and ideal outputs in the opponent basis
    noise_behind: Floats  # (sample, column) noise of the ratio taps, then of the ideal outputs if the layer corrects outputs


class GatheredSamples:
    """Collects samples from many mosaics, then accumulates their products class by class.

    A single mosaic has few samples per class, and one large matrix product is faster than many small ones. Rounding errors
    depend on which samples a product combines. Samples are therefore combined only within a block of frames, the unit of
    work that one process handles.
    """

    def __init__(
        self, sums: Mapping[int, LayerSums], rule: PlaneRule, reading: Reading, basis: NDArray[np.float64],
        steps: NDArray[np.float64], noise: bool = True,
    ) -> None:  # fmt: skip
        """Start with an empty collection.

        Parameters
        ----------
        sums : mapping of int to LayerSums
            Sums of the canonical sites, changed in place.
        rule : PlaneRule
            Class rule of the refinement layer.
        reading : Reading
            How the windows at each site are read.
        basis : ndarray, (output, plane)
            Opponent basis, which converts outputs to planes.
        steps : ndarray, (level, pair)
            Grid steps of the moments.
        noise : bool
            Whether to accumulate the noise covariance as well.
        """
        self.sums, self.rule, self.reading, self.basis, self.steps = sums, rule, reading, basis.astype(np.float32), steps
        self._noise = noise
        self._sheets: list[_Samples] = []
        self._cols = 0  # width, in pixels, of the collected sheets

    def add(self, seen: Seen, label: Integers, pixels: Integers, weight: Floats) -> None:
        """Collect samples from mosaics.

        Only mosaics of equal width can be collected together. If the width changes, the samples collected so far are first
        added to the sums.

        Parameters
        ----------
        seen : Seen
            Mosaics after all previous layers.
        label : ndarray, (row, col)
            Class of each pixel.
        pixels : ndarray, (sample)
            Index of the central pixel of each sample.
        weight : ndarray, (row, col)
            Sample weight of each pixel.
        """
        if seen.label.shape[1] != self._cols:
            self.add_up()
            self._cols = seen.label.shape[1]
        planes = seen.light
        clean, light = _in_fours(planes), self._ratios(planes, pixels)
        noise, spread = np.empty((0, 4), np.float32), np.empty((pixels.size, 0), np.float32)
        if self._noise:
            noise, spread = _in_fours(seen.noisy) - clean, self._ratios(seen.noisy, pixels) - light
            if self.reading.corrects:
                added = np.zeros_like(seen.target) if seen.spread is None else seen.spread
                spread = np.concatenate([spread, added.reshape(-1, added.shape[-1])[pixels]], axis=1)
        target = seen.target if seen.missing is None else seen.missing
        target = target.reshape(-1, target.shape[-1])[pixels]
        target = target @ self.basis if seen.missing is None else target
        behind = np.concatenate([light, np.ones((pixels.size, 1), np.float32), target], axis=1)
        site, within_site = self.rule.within_site(label.reshape(-1)[pixels])
        about = pixels, site, within_site, weight.reshape(-1)[pixels]
        self._sheets.append(_Samples(clean, noise, *about, behind, spread))

    def _ratios(self, planes: NDArray, pixels: Integers) -> Floats:
        """Return the ratio taps of selected pixels: (pixel, tap)."""
        taps = taps_behind(planes, self.reading.side, self.reading.ratio_taps)
        return (taps.reshape(len(taps), planes[0].size)[:, pixels].T * PLANE_STEP).astype(np.float32)

    def add_up(self) -> None:
        """Add the products of all collected samples to the sums, and discard the samples."""
        if not self._sheets:
            return
        starts = np.cumsum([0, *(len(sheet.clean) for sheet in self._sheets)])
        moved = (sheet._replace(pixel=sheet.pixel + start) for sheet, start in zip(self._sheets, starts, strict=False))
        samples = _Samples(*(np.concatenate(each) for each in zip(*moved, strict=True)))
        self._sheets.clear()
        learned_as = self.reading.canonical[samples.site]
        for site, sums in self.sums.items():
            chosen = np.flatnonzero(learned_as == site)
            self._add_site(sums, samples, chosen[np.argsort(samples.label[chosen], kind="stable")])

    def _add_site(self, sums: LayerSums, samples: _Samples, order: Integers) -> None:
        """Add the samples of one site to `sums`, the sums of this site.

        `order` contains the indices of these samples in `samples`, sorted by class.
        """
        offsets, columns = self.reading.offsets(self._cols), self.reading.columns
        samples = samples._replace(**{name: getattr(samples, name).take(order, axis=0) for name in _Samples._fields[2:]})
        levels = self.rule.split(samples.label).level
        large, noise_large = list(rounding_number(self.steps)), rounding_number(PRODUCT_STEP)
        for piece in pieces_of(samples.label):
            places = (samples.pixel[piece, None] + offsets[samples.site[piece]]).reshape(-1)
            runs, weight = runs_of(samples.label[piece]), samples.weight[piece]
            values = _weighted(samples.clean.take(places, axis=0), samples.behind[piece], weight)
            add_products(sums.moments, values, runs, [large[levels[piece][first]] for _, first, _ in runs], columns)
            if self._noise:
                values = _weighted(samples.noise.take(places, axis=0), samples.noise_behind[piece], weight)
                add_products(sums.noise, values, runs, [noise_large] * len(runs), columns[: self.reading.noisy])
            for index, first, last in runs:
                sums.count[index] += last - first


def _in_fours(planes: NDArray) -> Floats:
    """Convert three planes to output units, padded with a plane of zeros: (pixel, 4)."""
    fours = np.zeros((planes[0].size, 4), np.float32)
    np.multiply(planes.reshape(3, -1).T, np.float32(PLANE_STEP), out=fours[:, :3])
    return fours


def _weighted(windows: Floats, behind: Floats, weight: Floats) -> Floats:
    """Combine each sample's window taps and remaining columns in one row, multiplied by the sample's weight.

    Parameters
    ----------
    windows : ndarray, (sample · tap, 4)
        Three planes at each tap, and an unused fourth value. The array is overwritten.
    behind : ndarray, (sample, column)
        Remaining columns. Column i replaces the fourth value at tap i.
    weight : ndarray, (sample)
        Weight of each sample.

    Returns
    -------
    ndarray, (sample, 4 · tap)
        Rows with the columns in the order of `Reading.columns`.
    """
    values = windows.reshape(len(weight), -1)
    values[:, 3 : 3 + 4 * behind.shape[1] : 4] = behind
    values *= weight[:, None]
    return values
