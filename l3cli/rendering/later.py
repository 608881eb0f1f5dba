"""The plane layer after the first in the float64 reference (docs/method.md#layers)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.later import mirrored
from l3cli.classes.planes import FixedPoint, coarse
from l3cli.classes.ratios import shaded_chroma
from l3cli.classes.windows import Integers
from l3cli.frames.frame import RawFrame, pad_mosaic


def first_planes(frame: RawFrame, labels: Integers, table: TransformTable, fixed: FixedPoint) -> NDArray[np.int32]:
    """Planes (plane, row, col) that the first layer makes of a frame at the table's levels, by its classes (row, col)."""
    rows, cols = frame.values.shape
    patch = table.first.rule.patch
    padded = pad_mosaic(frame.values, table.first.rule.radius, table.cfa.shape).astype(np.int64)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (patch, patch))
    planes = np.empty((fixed.weights.shape[1], rows, cols), np.int32)
    for row in range(rows):
        patches, label = windows[row].reshape(cols, 1, patch**2), labels[row]
        sums = (fixed.weights[label] * patches).sum(axis=-1) + fixed.intercept[label]
        planes[:, row] = fixed.planes(sums.T, label)
    return planes


def later_planes(planes: NDArray[np.int32], labels: Integers, layer: PlaneLayer, fixed: FixedPoint) -> NDArray[np.int32]:
    """Planes (plane, row, col) that a layer makes of those of the layer before, by its classes (row, col)."""
    _, rows, cols = planes.shape
    windows = _windows(coarse(planes).astype(np.int64), layer)
    made = np.empty_like(planes)
    for row in range(rows):
        patches, label = np.moveaxis(windows[:, row], 0, 1).reshape(cols, 1, -1), labels[row]
        sums = (fixed.weights[label] * patches).sum(axis=-1) + fixed.intercept[label]
        made[:, row] = fixed.planes(sums.T, label)
    return made


def later_outputs(planes: NDArray[np.int32], labels: Integers, layer: PlaneLayer) -> NDArray[np.float64]:
    """Outputs (output, row, col) of a plane layer from what it reads and its classes (row, col)."""
    _, rows, cols = planes.shape
    windows = _windows(planes.astype(np.float64) * PLANE_STEP, layer)
    ratios = np.moveaxis(shaded_chroma(planes, layer.side), 0, -1)[..., : layer.ratio_taps] * PLANE_STEP
    outputs = np.empty((layer.weights.shape[1], rows, cols))
    for row in range(rows):
        patches = np.moveaxis(windows[:, row], 0, 1).reshape(cols, -1)
        patches = np.concatenate([patches, ratios[row]], axis=1)[..., None]
        weighted = layer.weights[labels[row]].astype(np.float64) @ patches
        outputs[:, row] = (weighted[..., 0] + layer.intercept[labels[row]]).T
    return outputs


def _windows(planes: NDArray, layer: PlaneLayer) -> NDArray:
    """Windows (plane, row, col, window row, window col) of planes (plane, row, col)."""
    return np.lib.stride_tricks.sliding_window_view(mirrored(planes, layer.radius), (layer.side, layer.side), (1, 2))
