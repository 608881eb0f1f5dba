"""The first layer in fixed point: planes whose integers are the same wherever they are computed (docs/method.md#layers).

    plane = clamp(Σ W · DN + B + 2^(F − 1) >> F, ±4194303)

The planes are X − aY, Y and Z − bY, with (a, 1, b) the white under the training light, so that greys have no chroma. W and
B are the layer's weights and intercept per DN and PLANE_STEP, times 2^F, rounded; F is the largest for which no sum of any
class and any DN leaves 32 bits.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP
from l3cli.artifacts.table import TransformTable
from l3cli.classes.windows import Integers

MOST_FRACTION = 16
ROOM = 1.01  # for what rounding adds
LUMINANCE = 1  # the plane that is Y


@dataclass(frozen=True)
class FixedPoint:
    """A layer's transforms to planes, as integers."""

    weights: NDArray[np.int32]  # (class, plane, tap)
    intercept: NDArray[np.int32]  # (class, plane)
    fraction: int  # F

    def planes(self, sums: Integers) -> NDArray[np.int32]:
        """Planes of sums Σ W · DN + B."""
        rounded = (sums + (1 << self.fraction >> 1)) >> self.fraction
        return np.clip(rounded, -PLANE_TOP, PLANE_TOP).astype(np.int32)


def opponent_basis(white_point: NDArray[np.floating]) -> NDArray[np.float64]:
    """Columns X − aY, Y, Z − bY of outputs X, Y, Z: rows of outputs times it are planes."""
    basis = np.eye(3)
    basis[LUMINANCE, 0], basis[LUMINANCE, 2] = -white_point[0] / white_point[1], -white_point[2] / white_point[1]
    return basis


def fixed_point(table: TransformTable) -> FixedPoint:
    """The first layer of a table whose outputs are X, Y, Z."""
    basis, step = opponent_basis(table.white_point), (table.white - table.black) * PLANE_STEP
    weights = np.moveaxis(_to_planes(np.moveaxis(table.first.weights, 1, -1), basis), -1, 1) / step
    intercept = _to_planes(table.first.intercept, basis) / PLANE_STEP
    offset = intercept - table.black * weights.sum(axis=-1)
    largest = (np.abs(weights).sum(axis=-1) * (2**table.bits - 1) + np.abs(offset)).max()
    fraction = int(min(MOST_FRACTION, np.floor(np.log2((2.0**31 - 1) / (ROOM * largest + 1)))))
    whole = np.rint(weights * 2.0**fraction)
    back = np.rint(intercept * 2.0**fraction - table.black * whole.sum(axis=-1))
    return FixedPoint(whole.astype(np.int32), back.astype(np.int32), fraction)


def _to_planes(values: NDArray[np.float32], basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, X Y Z) → (…, plane), one product after the other, so that every machine rounds alike."""
    x, y, z = np.moveaxis(values.astype(np.float64), -1, 0)
    return np.stack([x + basis[1, 0] * y, y, z + basis[1, 2] * y], axis=-1)
