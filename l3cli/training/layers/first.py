"""Layers at work on training mosaics: what the next one reads (docs/method.md#layers)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANE_TOP, PlaneLayer
from l3cli.classes.decide import labels as classes_of
from l3cli.classes.level import unclipped_level
from l3cli.classes.planes import COARSE, FixedPoint, coarse, refined_fixed_point
from l3cli.classes.refinement import label_planes, mirrored
from l3cli.classes.statistics import mosaic_statistics, truncation
from l3cli.classes.windows import Integers, neighbourhoods
from l3cli.frames.frame import pad_mosaic
from l3cli.training.layers.mosaics import Mosaic

Floats = NDArray[np.float32]
AT_ONCE = 1 << 14  # pixels
DARKEST_LEVEL = 1e-4  # share of full scale: rows of darker pixels get no more weight


@dataclass(frozen=True)
class Seen:
    """A mosaic after one or several layers."""

    target: Floats  # (row, col, output)
    label: Integers  # (row, col) class of the first layer
    brightness: Floats  # (row, col) mean over the channels of their means, share of full scale, were none clipped
    noisy: NDArray[np.int32]  # (plane, row, col) what the next layer reads, in steps
    clean: Floats  # (plane, row, col) the same without noise, by the classes of the noisy one


class FirstLayer:
    """A first layer in fixed point."""

    def __init__(self, camera: CameraModel, rule: ClassRule, fixed: FixedPoint) -> None:
        self.camera, self.rule, self.fixed = camera, rule, fixed
        self._neighbours = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
        self._apply = _Transforms(fixed)

    def see(self, mosaic: Mosaic) -> Seen:
        """Classes and planes of a mosaic."""
        camera, rule = self.camera, self.rule
        statistics = mosaic_statistics(mosaic.values, rule, self._neighbours, camera.cfa, (0, 0))
        within = classes_of(rule, statistics)
        mean = (statistics.sums / self._neighbours.count[statistics.site]).mean(axis=-1) * 2**rule.shift
        share = (mean + truncation(rule.shift) - camera.black_level) / (camera.white_level - camera.black_level)
        brightness = unclipped_level(share, camera.sensitivity)
        label = rule.on_site(within, statistics.site)
        padded = [pad_mosaic(each, rule.radius, camera.cfa.shape)[None] for each in (mosaic.values, mosaic.clean)]
        noisy, clean = self._apply(padded[0], padded[1], rule.patch, label)
        return Seen(
            target=np.moveaxis(mosaic.target, 0, -1),
            label=label,
            brightness=np.maximum(brightness, DARKEST_LEVEL).astype(np.float32),
            noisy=noisy,
            clean=clean,
        )


class PlaneStage:
    """A layer in fixed point that reads planes and after which another does."""

    def __init__(self, layer: PlaneLayer, first: ClassRule, basis: NDArray[np.float64]) -> None:
        self.layer, self.first = layer, first
        self._apply = _Transforms(refined_fixed_point(layer, basis))

    def see(self, seen: Seen) -> Seen:
        """The mosaic after one layer more."""
        label = label_planes(seen.noisy, seen.label, self.layer.rule, self.first)
        read = (coarse(seen.noisy), seen.clean / np.float32(2**COARSE))
        padded = [mirrored(planes, self.layer.radius) for planes in read]
        noisy, clean = self._apply(padded[0], padded[1], self.layer.side, label)
        return replace(seen, noisy=noisy, clean=clean)


class _Transforms:
    """Transforms in fixed point, applied to windows by class; half of the time that a later layer takes to learn."""

    def __init__(self, fixed: FixedPoint) -> None:
        self.fixed = fixed
        # Contiguous in every process: strides, which pickling does not always keep, may decide how products are rounded.
        self._weights = np.ascontiguousarray(np.swapaxes(fixed.weights, 1, 2), np.float64)

    def __call__(self, noisy: NDArray, clean: NDArray, side: int, label: Integers) -> tuple[NDArray[np.int32], Floats]:
        """Planes (plane, row, col) of the windows of `side` in padded sources (source, row, col), of the classes `label`
        (row, col): of noisy ones, which are whole numbers, that float64 adds exactly; and without rounding, of those without
        noise. Both in one product a class, of which a mosaic has hundreds with few pixels each."""
        flat = label.reshape(-1)
        order = np.argsort(flat, kind="stable")
        windows = _windows(np.stack([noisy, clean]).astype(np.float64), side)
        sums = np.empty((flat.size, 2, self._weights.shape[2]))
        for first in range(0, flat.size, AT_ONCE):
            part = order[first : first + AT_ONCE]
            taps = windows[part // label.shape[1], part % label.shape[1]].reshape(2 * part.size, -1)
            made = np.empty((2 * part.size, sums.shape[2]))
            for index, run in runs_of(flat[part]):
                both = slice(2 * run.start, 2 * run.stop)
                np.matmul(taps[both], self._weights[index], out=made[both])
            sums[part] = made.reshape(part.size, 2, -1)
        sums += self.fixed.intercept[flat, None]
        exact, light = np.ascontiguousarray(np.moveaxis(sums, 0, -1)).reshape(2, -1, *label.shape)
        scale = (2.0 ** -self.fixed.fraction[label]).astype(np.float32)
        return self.fixed.planes(exact.astype(np.int64), label), np.clip(
            light.astype(np.float32) * scale, -PLANE_TOP, PLANE_TOP
        )


def _windows(padded: NDArray, side: int) -> NDArray:
    """Windows (row, col, …, window row, window col) of padded sources (…, row, col)."""
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side), (-2, -1))
    return np.moveaxis(windows, (-4, -3), (0, 1))


def runs_of(label: Integers) -> list[tuple[int, slice]]:
    """Each class of sorted labels, and where it lies."""
    start = np.flatnonzero(np.diff(label, prepend=-1)).tolist()
    return [(int(label[a]), slice(a, b)) for a, b in zip(start, [*start[1:], len(label)], strict=True)]
