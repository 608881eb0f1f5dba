"""Layers in fixed point: planes whose integers are the same wherever they are computed (docs/method.md#planes).

    plane = clamp(Σ W · DN + B + 2^(F − 1) >> F, ±4194303)

The planes are X − aY, Y and Z − bY, with (a, 1, b) the white under the training light, so that greys have no chroma. W and
B are the layer's weights and intercept per DN and PLANE_STEP, times 2^F, rounded: weights so that those of each channel add
up to their rounded sum, or else what is rounded off would colour plain areas, and differently at every site. F is that of
the class, the largest for which weights fit 16 bits and no sum over any values leaves 32: processors multiply 16 bits twice
as fast as floats. A layer between reads planes in steps 2^COARSE times as large, so that they fit 16 bits, for DN and for
channels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.windows import Integers, window_channels
from l3cli.errors import InputFileError

MOST_FRACTION = 16
MOST_WEIGHT, MOST_SUM = 2.0**15 - 2, 2.0**31 - 2**MOST_FRACTION  # before rounding, which adds less than 1 to a weight
COARSE, COARSE_TOP = 5, 2**15 - 1  # bits by which a layer between reads planes coarser, and within which size
LUMINANCE = 1  # the plane that is Y


@dataclass(frozen=True)
class FixedPoint:
    """A layer's transforms to planes, as integers."""

    weights: NDArray[np.int16]  # (class, plane, tap)
    intercept: NDArray[np.int64]  # (class, plane)
    fraction: NDArray[np.int32]  # (class) F

    def planes(self, sums: Integers, label: Integers) -> NDArray[np.int32]:
        """Planes (plane, …) of sums Σ W · DN + B, or of coarse planes, of pixels (…) of the classes `label`."""
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
    rule, step = table.first.rule, (table.white_level - table.black_level) * PLANE_STEP
    basis = opponent_basis(table.white_point)
    weights = np.moveaxis(_to_planes(np.moveaxis(table.first.weights, 1, -1), basis), -1, 1) / step
    intercept = _to_planes(table.first.intercept, basis) / PLANE_STEP
    fraction = _fraction(_raw_room(weights, intercept, table.bits, table.black_level))
    site = rule.split(np.arange(len(weights))).site
    scale = 2.0 ** fraction[:, None]
    whole = _rounded(weights * scale[..., None], window_channels(table.cfa, rule.patch), site)
    back = np.rint(intercept * scale - table.black_level * whole.sum(axis=-1))
    return FixedPoint(whole.astype(np.int16), back.astype(np.int64), fraction)


def later_fixed_point(layer: PlaneLayer, basis: NDArray[np.float64]) -> FixedPoint:
    """A layer that reads planes and after which another does; InputFileError if its transforms are beyond all planes."""
    weights = np.moveaxis(_to_planes(np.moveaxis(layer.weights, 1, -1), basis), -1, 1) * 2**COARSE
    intercept = _to_planes(layer.intercept, basis) / PLANE_STEP
    fraction = _fraction(_room(weights, COARSE_TOP, np.abs(intercept)))
    scale = 2.0 ** fraction[:, None]
    source = np.repeat(np.arange(weights.shape[1]), layer.side**2)
    whole = _rounded(weights * scale[..., None], source[None], np.zeros(len(weights), np.int64))
    return FixedPoint(whole.astype(np.int16), np.rint(intercept * scale).astype(np.int64), fraction)


def coarse(planes: NDArray[np.int32]) -> NDArray[np.int32]:
    """Planes as a layer between reads them."""
    return np.clip(planes + (1 << COARSE >> 1) >> COARSE, -COARSE_TOP, COARSE_TOP)


def raw_middle(bits: int) -> int:
    """What is taken off raw values of so many bits, so that they fit 16 bits with a sign."""
    return 2**15 if bits == 16 else 0


def room_for(
    weights: NDArray[np.float64], intercept: NDArray[np.float64], bits: int, black_level: float, white_level: float
) -> NDArray[np.float64]:
    """How many times larger transforms (class, plane, tap) of taps in units of full scale, with an intercept (class, plane),
    could be (class) for their planes to be computed as integers; below 1 they are too large."""
    step = (white_level - black_level) * PLANE_STEP
    return _raw_room(weights / step, intercept / PLANE_STEP, bits, black_level)


def room_between(weights: NDArray[np.float64], intercept: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same (class) of transforms (class, plane, tap) of planes to planes that a further layer reads."""
    return _room(weights * 2**COARSE, COARSE_TOP, np.abs(intercept) / PLANE_STEP)


def _raw_room(
    weights: NDArray[np.float64], intercept: NDArray[np.float64], bits: int, black_level: float
) -> NDArray[np.float64]:
    """Room (class) of weights per DN (class, plane, tap) and an intercept (class, plane), in steps."""
    middle = raw_middle(bits)
    back = np.abs(intercept) + abs(black_level - middle) * np.abs(weights.sum(axis=-1))
    return _room(weights, max(2**bits - 1 - middle, middle), back)


def _room(weights: NDArray[np.float64], largest: float, offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """How many times larger (class) weights (class, plane, tap) of values of at most a `largest` size and with an offset
    (class, plane) could be."""
    size = np.abs(weights)
    sums = (size.sum(axis=-1) * largest + offset).max(axis=-1)
    rounding = 2 * weights.shape[-1] * largest  # what it may add to sum and offset
    return np.minimum(MOST_WEIGHT / (size.max(axis=(1, 2)) + 1e-30), (MOST_SUM - rounding) / (sums + 1e-30))


def _fraction(room: NDArray[np.float64]) -> NDArray[np.int32]:
    """F (class) of transforms that could be `room` (class) times larger."""
    fraction = np.minimum(MOST_FRACTION, np.floor(np.log2(room)))
    if fraction.min() < 0:
        raise InputFileError("transforms of a layer are too large for the next; train the table again")
    return fraction.astype(np.int32)


def _rounded(weights: NDArray[np.float64], channels: Integers, layout: Integers) -> NDArray[np.float64]:
    """Weights (class, plane, tap) as whole numbers less than one away, of sums over each channel that are the nearest; the
    taps' channels (layout, tap) are those of the class's `layout` (class)."""
    whole = np.floor(weights)
    for number, channel in enumerate(channels):
        members = np.flatnonzero(layout == number)
        for index in range(int(channel.max()) + 1):
            part = np.ix_(members, np.arange(weights.shape[1]), np.flatnonzero(channel == index))
            wanted, least = weights[part], whole[part]
            order = np.argsort(least - wanted, axis=-1, kind="stable")  # those that lose most first
            up = np.rint(wanted.sum(axis=-1)) - least.sum(axis=-1)
            first = np.empty(order.shape, bool)
            np.put_along_axis(first, order, np.arange(order.shape[-1]) < up[..., None], axis=-1)
            whole[part] = least + first
    return whole


def _to_planes(values: NDArray[np.float32], basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """(…, X Y Z) → (…, plane), one product after the other, so that every machine rounds alike."""
    x, y, z = np.moveaxis(values.astype(np.float64), -1, 0)
    return np.stack([x + basis[1, 0] * y, y, z + basis[1, 2] * y], axis=-1)
