"""Layers at work on training mosaics: what the next one reads (docs/method.md#layers)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.layers import PLANE_TOP, PlaneLayer
from l3cli.classes.decide import labels as classes_of
from l3cli.classes.later import label_planes, mirrored
from l3cli.classes.level import unclipped_level
from l3cli.classes.planes import COARSE, FixedPoint, coarse, later_fixed_point
from l3cli.classes.statistics import mosaic_statistics, truncation
from l3cli.classes.windows import Integers, neighbourhoods
from l3cli.frame import pad_mosaic
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
        self._near = neighbourhoods(camera.cfa, rule.patch, len(camera.channels))
        self._apply = _Transforms(fixed)

    def see(self, mosaic: Mosaic) -> Seen:
        """Classes and planes of a mosaic."""
        camera, rule = self.camera, self.rule
        statistics = mosaic_statistics(mosaic.values, rule, self._near, camera.cfa, (0, 0))
        within = classes_of(rule, statistics)
        mean = (statistics.sums / self._near.count[statistics.site]).mean(axis=-1) * 2**rule.shift
        share = (mean + truncation(rule.shift) - camera.black_level) / (camera.white_level - camera.black_level)
        brightness = unclipped_level(share, camera.sensitivity)
        label = rule.on_site(within, statistics.site)
        padded = pad_mosaic(mosaic.values, rule.radius, camera.cfa.shape)
        noisy = self._apply.planes(_windows(padded[None], rule.patch), label)
        clean = self._apply.clean(_windows(pad_mosaic(mosaic.clean, rule.radius, camera.cfa.shape)[None], rule.patch), label)
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
        self._apply = _Transforms(later_fixed_point(layer, basis))

    def see(self, seen: Seen) -> Seen:
        """The mosaic after one layer more."""
        label = label_planes(seen.noisy, seen.label, self.layer.rule, self.first)
        noisy, clean = (
            _windows(mirrored(planes, self.layer.radius), self.layer.side)
            for planes in (coarse(seen.noisy), seen.clean / np.float32(2**COARSE))
        )
        return replace(seen, noisy=self._apply.planes(noisy, label), clean=self._apply.clean(clean, label))


class _Transforms:
    """Transforms in fixed point, applied to windows by class."""

    def __init__(self, fixed: FixedPoint) -> None:
        self.fixed = fixed
        # Integers, which float64 adds exactly. Contiguous in every process: strides, which pickling does not always keep,
        # decide how products of float32 are rounded.
        self._weights = np.ascontiguousarray(np.swapaxes(fixed.weights, 1, 2), np.float64)
        self._light_weights = self._weights.astype(np.float32)

    def planes(self, windows: NDArray, label: Integers) -> NDArray[np.int32]:
        """Planes (plane, row, col) of windows (source, row, col, …) of whole numbers, of the classes `label` (row, col)."""
        return self.fixed.planes(self._sums(windows, label, self._weights).astype(np.int64), label)

    def clean(self, windows: NDArray, label: Integers) -> Floats:
        """The same without rounding, of windows without noise."""
        scale = (2.0 ** -self.fixed.fraction[label]).astype(np.float32)
        return np.clip(self._sums(windows, label, self._light_weights) * scale, -PLANE_TOP, PLANE_TOP)

    def _sums(self, windows: NDArray, label: Integers, weights: NDArray) -> NDArray:
        """Σ W · value + B (plane, row, col)."""
        rows, cols = label.shape
        flat = label.reshape(-1)
        order = np.argsort(flat, kind="stable")
        sums = np.empty((flat.size, weights.shape[2]), weights.dtype)
        for first in range(0, flat.size, AT_ONCE):
            part = order[first : first + AT_ONCE]
            taps = np.swapaxes(windows[:, part // cols, part % cols], 0, 1).reshape(len(part), -1).astype(weights.dtype)
            for index, run in runs_of(flat[part]):
                sums[part[run]] = taps[run] @ weights[index] + self.fixed.intercept[index].astype(weights.dtype)
        return sums.T.reshape(-1, rows, cols)


def _windows(padded: NDArray, side: int) -> NDArray:
    """Windows (source, row, col, window row, window col) of padded sources."""
    return np.lib.stride_tricks.sliding_window_view(padded, (side, side), (1, 2))


def runs_of(label: Integers) -> list[tuple[int, slice]]:
    """Each class of sorted labels, and where it lies."""
    start = np.flatnonzero(np.diff(label, prepend=-1)).tolist()
    return [(int(label[a]), slice(a, b)) for a, b in zip(start, [*start[1:], len(label)], strict=True)]
