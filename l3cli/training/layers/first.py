"""Layers at work on training mosaics: what the next one reads (docs/method.md#layers)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.table import PLANE_TOP, PlaneLayer
from l3cli.classes.decide import labels as classes_of
from l3cli.classes.level import unclipped_level
from l3cli.classes.planes import COARSE, FixedPoint, coarse, refined_fixed_point
from l3cli.classes.refinement import label_planes
from l3cli.classes.statistics import mosaic_statistics, truncation
from l3cli.classes.structure import REACH
from l3cli.classes.windows import Integers, neighbourhoods
from l3cli.training.layers.mosaics import Mosaics
from l3cli.training.sums import runs_of

Floats = NDArray[np.float32]
AT_ONCE = 1 << 10  # pixels whose windows stay in the caches
DARKEST_LEVEL = 1e-4  # share of full scale: rows of darker pixels get no more weight


@dataclass(frozen=True)
class Seen:
    """Mosaics below one another after one or several layers, where these have read all that lies about a pixel."""

    count: int
    target: Floats  # (row, col, output)
    label: Integers  # (row, col) class of the first layer
    brightness: Floats  # (row, col) mean over the channels of their means, share of full scale, were none clipped
    noisy: NDArray[np.int32]  # (plane, row, col) what the next layer reads, in steps
    clean: Floats  # (plane, row, col) the same without noise, by the classes of the noisy one

    def inner_pixels(self, margin: int) -> Integers:
        """Indices (pixel) of the pixels that are at least `margin` away from the edge of their mosaic."""
        return within(np.arange(self.label.size).reshape(self.label.shape), self.count, margin).ravel()


def within(planes: NDArray, count: int, margin: int) -> NDArray:
    """Planes (…, row, col) of `count` mosaics without a margin of each."""
    rows, cols = planes.shape[-2] // count, planes.shape[-1]
    mosaics = planes.reshape(*planes.shape[:-2], count, rows, cols)[..., margin : rows - margin, margin : cols - margin]
    return mosaics.reshape(*planes.shape[:-2], count * mosaics.shape[-2], mosaics.shape[-1])


def margin_of(side: int) -> int:
    """Pixels about each that a layer of windows of `side` reads planes of, for its classes or its windows."""
    return max(REACH, side // 2)


class FirstLayer:
    """A first layer in fixed point."""

    def __init__(self, camera: CameraModel, rule: ClassRule, fixed: FixedPoint) -> None:
        self.camera, self.rule, self.fixed = camera, rule, fixed
        self._neighbours = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
        self._apply = _Transforms(fixed)

    def see(self, mosaics: Mosaics) -> Seen:
        """Classes and planes of mosaics."""
        camera, rule, count, margin = self.camera, self.rule, mosaics.count, self.rule.radius
        statistics = mosaic_statistics(mosaics.values, rule, self._neighbours, camera.cfa, (0, 0))
        mean = (statistics.sums / self._neighbours.count[statistics.site]).mean(axis=-1) * 2**rule.shift
        share = (mean + truncation(rule.shift) - camera.black_level) / (camera.white_level - camera.black_level)
        brightness = np.maximum(unclipped_level(share, camera.sensitivity), DARKEST_LEVEL).astype(np.float32)
        label = within(rule.on_site(classes_of(rule, statistics), statistics.site), count, margin)
        noisy, clean = self._apply(mosaics.values[None], mosaics.clean[None], rule.patch, count, label)
        target = np.moveaxis(within(mosaics.target, count, margin), 0, -1)
        return Seen(count, target, label, within(brightness, count, margin), noisy, clean)


class PlaneStage:
    """A layer in fixed point that reads planes and after which another does."""

    def __init__(self, layer: PlaneLayer, first: ClassRule, basis: NDArray[np.float64]) -> None:
        self.layer, self.first = layer, first
        self._apply = _Transforms(refined_fixed_point(layer, basis))

    def see(self, seen: Seen) -> Seen:
        """The mosaics after one layer more."""
        count, margin = seen.count, margin_of(self.layer.side)
        label = within(label_planes(seen.noisy, seen.label, self.layer.rule, self.first), count, margin)
        edge = margin - self.layer.radius
        read = within(coarse(seen.noisy), count, edge), within(seen.clean / np.float32(2**COARSE), count, edge)
        noisy, clean = self._apply(*read, self.layer.side, count, label)
        return replace(
            seen,
            target=np.moveaxis(within(np.moveaxis(seen.target, -1, 0), count, margin), 0, -1),
            label=within(seen.label, count, margin),
            brightness=within(seen.brightness, count, margin),
            noisy=noisy,
            clean=clean,
        )


class _Transforms:
    """Transforms in fixed point, applied to windows by class."""

    def __init__(self, fixed: FixedPoint) -> None:
        self.fixed = fixed
        # Contiguous in every process: strides, which pickling does not always keep, may decide how products are rounded.
        self._weights = list(np.ascontiguousarray(np.swapaxes(fixed.weights, 1, 2), np.float64))

    def __call__(
        self, noisy: NDArray, clean: NDArray, side: int, count: int, label: Integers
    ) -> tuple[NDArray[np.int32], Floats]:
        """Planes (plane, row, col) of the windows of `side` in sources (source, row, col) of `count` mosaics, of the
        classes `label` (row, col): of noisy ones, which are whole numbers, that float64 adds exactly; and without rounding,
        of those without noise."""
        _, rows, cols = noisy.shape
        reach = np.arange(side) - side // 2
        offset = ((np.arange(len(noisy))[:, None, None] * rows + reach[:, None]) * cols + reach).reshape(-1)
        sources = [each.astype(np.float64).reshape(-1) for each in (noisy, clean)]
        flat = label.reshape(-1)
        order = np.argsort(flat.astype(np.min_scalar_type(len(self._weights))), kind="stable")
        place = within(np.arange(rows * cols).reshape(rows, cols), count, side // 2).reshape(-1)[order]
        flat = flat[order]
        sums = np.empty((2, flat.size, 3))
        taps, windows = np.empty((AT_ONCE, offset.size), np.intp), np.empty((AT_ONCE, offset.size))
        for first in range(0, flat.size, AT_ONCE):
            part = slice(first, first + AT_ONCE)
            chosen = np.add(place[part, None], offset, out=taps[: flat.size - first])
            runs = [(self._weights[index], slice(start, stop)) for index, start, stop in runs_of(flat[part])]
            for source, made in zip(sources, sums[:, part], strict=True):
                source.take(chosen, out=windows[: len(chosen)], mode="clip")  # any other mode copies
                for weights, run in runs:
                    np.dot(windows[run], weights, out=made[run])
        sums += self.fixed.intercept[flat]
        planes, light = np.empty((3, flat.size), np.int32), np.empty((3, flat.size), np.float32)
        planes[:, order] = self.fixed.planes(sums[0].T.astype(np.int64), flat)
        scaled = sums[1].T.astype(np.float32) * (2.0**-self.fixed.fraction).astype(np.float32)[flat]
        light[:, order] = np.clip(scaled, -PLANE_TOP, PLANE_TOP)
        return planes.reshape(3, *label.shape), light.reshape(3, *label.shape)
