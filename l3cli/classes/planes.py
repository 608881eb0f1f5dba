"""The first layer in fixed point: planes whose integers are the same wherever they are computed (docs/method.md#layers).

    plane = clamp(Σ W · DN + B + 2^(F − 1) >> F, ±4194303)

The planes are X − aY, Y and Z − bY, with (a, 1, b) the white under the training light, so that greys have no chroma. W and
B are the layer's weights and intercept per DN and PLANE_STEP, times 2^F, rounded: weights so that those of each channel add
up to their rounded sum, or else what is rounded off would colour plain areas, and differently at every site. F is that of
the class, the largest for which no sum over any DN leaves 32 bits.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.windows import Integers, window_channels
from l3cli.errors import InputFileError

MOST_FRACTION, LATER_FRACTION = 16, 20
ROOM = 1.01  # for what rounding adds
LUMINANCE = 1  # the plane that is Y


@dataclass(frozen=True)
class FixedPoint:
    """A layer's transforms to planes, as integers."""

    weights: NDArray[np.signedinteger]  # (class, plane, tap); 32 bits for the first layer, 64 for those that read planes
    intercept: NDArray[np.signedinteger]  # (class, plane)
    fraction: NDArray[np.int32]  # (class) F

    def planes(self, sums: Integers, label: Integers) -> NDArray[np.int32]:
        """Planes (plane, …) of sums Σ W · DN + B, or Σ W · plane + B, of pixels (…) of the classes `label`."""
        fraction = self.fraction.astype(np.int64)[label]
        rounded = (sums + (1 << fraction >> 1)) >> fraction
        return np.clip(rounded, -PLANE_TOP, PLANE_TOP).astype(np.int32)


def opponent_basis(white_point: NDArray[np.floating]) -> NDArray[np.float64]:
    """Columns X − aY, Y, Z − bY of outputs X, Y, Z: rows of outputs times it are planes."""
    basis = np.eye(3)
    basis[LUMINANCE, 0], basis[LUMINANCE, 2] = -white_point[0] / white_point[1], -white_point[2] / white_point[1]
    return basis


def fixed_point(table: TransformTable) -> FixedPoint:
    """The first layer of a table whose outputs are X, Y, Z; InputFileError if its transforms are beyond all planes."""
    basis, step = opponent_basis(table.white_point), (table.white_level - table.black_level) * PLANE_STEP
    weights = np.moveaxis(_to_planes(np.moveaxis(table.first.weights, 1, -1), basis), -1, 1) / step
    intercept = _to_planes(table.first.intercept, basis) / PLANE_STEP
    offset = intercept - table.black_level * weights.sum(axis=-1)
    largest = (np.abs(weights).sum(axis=-1) * (2**table.bits - 1) + np.abs(offset)).max(axis=-1)
    fraction = np.minimum(MOST_FRACTION, np.floor(np.log2((2.0**31 - 1) / (ROOM * largest + 1))))
    if fraction.min() < 0:
        raise InputFileError("transforms of the table's first layer are too large for the second; train it again")
    scale = 2.0 ** fraction[:, None]
    whole = _rounded(weights * scale[..., None], table)
    back = np.rint(intercept * scale - table.black_level * whole.sum(axis=-1))
    return FixedPoint(whole.astype(np.int32), back.astype(np.int32), fraction.astype(np.int32))


def later_fixed_point(layer: PlaneLayer, basis: NDArray[np.float64]) -> FixedPoint:
    """A layer that reads planes and after which another does; InputFileError if its transforms are beyond all planes."""
    scale = 2.0**LATER_FRACTION
    weights = np.rint(np.moveaxis(_to_planes(np.moveaxis(layer.weights, 1, -1), basis), -1, 1) * scale)
    intercept = np.rint(_to_planes(layer.intercept, basis) / PLANE_STEP * scale)
    if (np.abs(weights).sum(axis=-1) * PLANE_TOP + np.abs(intercept)).max() >= 2.0**52:  # which float64 adds exactly
        raise InputFileError("transforms of a layer are too large for the next; train the table again")
    fraction = np.full(len(weights), LATER_FRACTION, np.int32)
    return FixedPoint(weights.astype(np.int64), intercept.astype(np.int64), fraction)


def _rounded(weights: NDArray[np.float64], table: TransformTable) -> NDArray[np.float64]:
    """Weights (class, plane, tap) as whole numbers less than one away, of sums over each channel that are the nearest."""
    rule = table.first.rule
    channel = window_channels(table.cfa, rule.patch)[rule.split(np.arange(len(weights))).site]
    whole = np.floor(weights)
    missing, order = weights - whole, np.empty(weights.shape, np.int64)
    for index in range(len(table.channels)):
        member = (channel == index)[:, None]
        left = np.where(member, missing, -1.0)  # a tap of another channel comes last
        np.put_along_axis(order, np.argsort(-left, axis=-1, kind="stable"), np.arange(weights.shape[-1]), axis=-1)
        up = np.rint((weights * member).sum(axis=-1)) - (whole * member).sum(axis=-1)
        whole += member & (order < up[..., None])
    return whole


def _to_planes(values: NDArray[np.float32], basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, X Y Z) → (…, plane), one product after the other, so that every machine rounds alike."""
    x, y, z = np.moveaxis(values.astype(np.float64), -1, 0)
    return np.stack([x + basis[1, 0] * y, y, z + basis[1, 2] * y], axis=-1)
