"""Convert layers to fixed-point arithmetic, so that their output planes are identical on every device.

See docs/method.md#planes. The weights of each channel are rounded so that their sum is the correctly rounded sum. If each
weight were rounded to the nearest integer, uniform areas would have a different tint at every CFA site. Weights have 16
bits, because processors multiply 16-bit integers twice as fast as floats.
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.windows import Integers, window_channels
from l3cli.errors import InputFileError

MAX_FRACTION = 16
MAX_WEIGHT, MAX_SUM = 2.0**15 - 2, 2.0**31 - 2**MAX_FRACTION  # limits before rounding, which adds less than 1 to a weight
# The input planes of intermediate layers are shifted right by COARSE bits and clamped to ±COARSE_TOP.
COARSE, COARSE_TOP = 5, 2**15 - 1
CLASSES_AT_ONCE = 256  # number of classes that are converted together, small enough for the processor cache
LUMINANCE, CHROMA = 1, [0, 2]  # index of the luminance plane Y, and indices of the chroma planes


@dataclass(frozen=True)
class FixedPoint:
    """Integer transforms of a layer, which compute output planes from the layer's input."""

    weights: NDArray[np.int16]  # (class, plane, tap): W
    intercept: NDArray[np.int64]  # (class, plane): B
    fraction: NDArray[np.int32]  # (class,): number of fractional bits of W and B

    def planes(self, sums: Integers, label: Integers) -> NDArray[np.int32]:
        """Convert weighted sums to output planes: round off the fractional bits, and clamp the result.

        Parameters
        ----------
        sums : ndarray, (plane, …)
            Σ W · input + B. The inputs are raw values in the first layer, and coarse planes in refinement layers.
        label : ndarray, (…)
            Class of each pixel.

        Returns
        -------
        ndarray, (plane, …)
            Planes in units of PLANE_STEP.
        """
        fraction = self.fraction.astype(np.int64)[label]
        rounded = (sums + (1 << fraction >> 1)) >> fraction
        return np.clip(rounded, -PLANE_TOP, PLANE_TOP).astype(np.int32)


def opponent_basis(white_point: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the matrix (output, plane) that converts X, Y, Z to opponent planes: planes = outputs @ matrix.

    The opponent planes are X − aY, Y and Z − bY, where a = X/Y and b = Z/Y of the white point. For greys, they are (0, Y,
    0).
    """
    basis = np.eye(3)
    basis[LUMINANCE, 0], basis[LUMINANCE, 2] = -white_point[0] / white_point[1], -white_point[2] / white_point[1]
    return basis


def planes_basis(table: TransformTable) -> NDArray[np.float64]:
    """Return the matrix (output, plane) that converts the outputs of a table's first layer to planes."""
    return opponent_basis(table.white_point) if table.components is None else table.components.basis


def fixed_point(table: TransformTable) -> FixedPoint:
    """Convert a table's first layer to fixed-point numbers. Raises InputFileError if its transforms are too large."""
    first, read = table.first, _raw(table.bits, table.black_level, table.white_level)
    channels, basis = window_channels(table.cfa, first.rule.patch), planes_basis(table)
    sites = [(first.rule.of_site(site), channel) for site, channel in enumerate(channels)]
    return _fixed_point(first.weights, first.intercept, basis, read, sites)


def refined_fixed_point(layer: PlaneLayer, basis: NDArray[np.float64]) -> FixedPoint:
    """Convert a refinement layer that is not the last one to fixed-point numbers.

    `basis` is the matrix (output, plane) that converts outputs to planes. Raises InputFileError if the transforms are too
    large.
    """
    plane = np.repeat(np.arange(len(basis)), layer.side**2)
    return _fixed_point(layer.weights, layer.intercept, basis, BETWEEN, [(slice(0, len(layer.weights)), plane)])


def coarse(planes: NDArray[np.int32]) -> NDArray[np.int32]:
    """Convert planes to coarse planes: round off COARSE bits, and clamp to ±COARSE_TOP.

    Coarse planes are the input of all layers between the first and the last layer.
    """
    return np.clip(planes + (1 << COARSE >> 1) >> COARSE, -COARSE_TOP, COARSE_TOP)


def raw_middle(bits: int) -> int:
    """Return the offset that kernels subtract from raw values to fit them into signed 16-bit integers."""
    return 2**15 if bits == 16 else 0


@dataclass(frozen=True)
class _Read:
    """Number format of a layer's input.

    Kernels subtract `raw_middle` from raw values, but nothing from coarse planes.
    """

    step: float  # input value per unit of signal (full scale or output unit), times PLANE_STEP
    zero: float  # input value for a signal of 0
    largest: float  # largest absolute input value after subtraction of `raw_middle`
    farthest: float  # absolute value of `zero` after subtraction of `raw_middle`


BETWEEN = _Read(step=2.0**-COARSE, zero=0.0, largest=COARSE_TOP, farthest=0.0)  # coarse planes


def _raw(bits: int, black_level: float, white_level: float) -> _Read:
    middle = raw_middle(bits)
    return _Read(
        step=(white_level - black_level) * PLANE_STEP,
        zero=black_level,
        largest=max(2**bits - 1 - middle, middle),
        farthest=abs(black_level - middle),
    )


def room_for(
    weights: NDArray[np.float64], intercept: NDArray[np.float64], bits: int, black_level: float, white_level: float
) -> NDArray[np.float64]:
    """Return the largest factors by which first-layer transforms can be multiplied without integer overflow.

    Parameters
    ----------
    weights : ndarray, (class, plane, tap)
        Weights for signals as fractions of full scale.
    intercept : ndarray, (class, plane)
        Intercepts in output units.
    bits : int
        Bit depth of the raw values.
    black_level, white_level : float
        Levels of the raw values in DN.

    Returns
    -------
    ndarray, (class,)
        Largest factor. If it is below 1, the class's transforms are too large.
    """
    read = _raw(bits, black_level, white_level)
    return _room(weights.transpose(2, 1, 0) / read.step, intercept.T / PLANE_STEP, read)


def room_between(weights: NDArray[np.float64], intercept: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the factors of `room_for` for a refinement layer that is not the last one."""
    return _room(weights.transpose(2, 1, 0) / BETWEEN.step, intercept.T / PLANE_STEP, BETWEEN)


def _fixed_point(
    weights: NDArray[np.float32], intercept: NDArray[np.float32], basis: NDArray[np.float64], read: _Read,
    layouts: Iterable[tuple[slice, Integers]],
) -> FixedPoint:  # fmt: skip
    """Convert the transforms of all classes to fixed-point numbers.

    The transforms are first converted from outputs to planes with `basis`. Each class then uses as many fractional bits as
    its weights and sums allow. `layouts` contains ranges of classes, and the channel or plane of each tap in these classes.
    """
    offset = _to_planes(intercept.T, basis) / PLANE_STEP
    shape = len(weights), basis.shape[1]
    made = FixedPoint(
        np.empty((*shape, weights.shape[2]), np.int16), np.empty(shape, np.int64), np.empty(shape[0], np.int32)
    )
    for classes, channel in layouts:
        order = np.argsort(channel, kind="stable")
        ends = [0, *np.cumsum(np.bincount(channel)).tolist()]
        distinct, like = _distinct(weights[classes], intercept[classes])
        for start in range(0, len(distinct), CLASSES_AT_ONCE):
            block = distinct[start : start + CLASSES_AT_ONCE] + classes.start
            # The classes become the last axis, because numpy sums over the first axis several times faster.
            exact = np.moveaxis(_to_planes(weights[block].transpose(1, 2, 0)[:, order], basis), 0, 1) / read.step
            fraction = _fraction(_room(exact, offset[:, block], read))
            scale = 2.0**fraction
            exact *= scale
            whole = _rounded(exact, ends)
            made.weights[block] = whole[np.argsort(order)].transpose(2, 1, 0)
            made.intercept[block] = np.rint(offset[:, block] * scale - read.zero * whole.sum(axis=0)).T
            made.fraction[block] = fraction
        for each in vars(made).values():
            each[classes] = each[distinct[like] + classes.start]
    return made


def _distinct(weights: NDArray[np.float32], intercept: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Group classes with equal transforms, so that each transform is converted only once.

    Classes without training patches have the transform of a similar class. If there are many channels, these are half of all
    classes.

    Returns
    -------
    first : ndarray, (group,)
        Index of the first class of each group.
    like : ndarray, (class,)
        Index of the group of each class.
    """
    rows = np.concatenate([weights.reshape(len(weights), -1), intercept], axis=1)
    _, first, like = np.unique(
        rows.view(np.dtype((np.void, rows[0].nbytes))).ravel(), return_index=True, return_inverse=True
    )
    return first, like


def _room(weights: NDArray[np.float64], offset: NDArray[np.float64], read: _Read) -> NDArray[np.float64]:
    """Return the largest factors (class) by which transforms can be multiplied without integer overflow.

    The transforms consist of `weights` (tap, plane, class) and `offset` (plane, class).
    """
    size = np.abs(weights)
    offset = np.abs(offset) + read.farthest * np.abs(weights.sum(axis=0))
    sums = (size.sum(axis=0) * read.largest + offset).max(axis=0)
    rounding = 2 * len(weights) * read.largest  # largest rounding error of the sum and the offset
    return np.minimum(MAX_WEIGHT / (size.max(axis=(0, 1)) + 1e-30), (MAX_SUM - rounding) / (sums + 1e-30))


def _fraction(room: NDArray[np.float64]) -> NDArray[np.int32]:
    """Choose the number of fractional bits of each class, given the result of `_room`.

    Raises InputFileError if a transform is too large even without fractional bits.
    """
    fraction = np.minimum(MAX_FRACTION, np.floor(np.log2(room)))
    if fraction.min() < 0:
        raise InputFileError("the transforms of a layer do not fit into fixed-point numbers; train the table again")
    return fraction.astype(np.int32)


def _rounded(weights: NDArray[np.float64], ends: list[int]) -> NDArray[np.float64]:
    """Round weights up or down, so that the sum over each channel's taps is rounded to the nearest integer.

    The weights with the largest fractional parts are rounded up. Among equal fractional parts, the first weights are rounded
    up. The taps are sorted by channel. Channel c has the taps ends[c] to ends[c + 1] − 1.
    """
    whole = np.floor(weights)
    loss = whole - weights
    for start, end in pairwise(ends):
        if start == end:
            continue
        least, lost = whole[start:end], loss[start:end]
        count = np.rint(weights[start:end].sum(axis=0)) - least.sum(axis=0)
        last = np.maximum(count - 1, 0).astype(np.int64)[None]
        limit = np.where(count > 0, np.take_along_axis(np.sort(lost, axis=0), last, axis=0)[0], -np.inf)
        up = lost <= limit
        if (tied := up.sum(axis=0, dtype=np.int16) > count).any():
            equal = lost[:, tied] == limit[tied]
            left = count[tied] - (lost[:, tied] < limit[tied]).sum(axis=0)
            up[:, tied] &= ~equal | (np.cumsum(equal, axis=0) <= left)
        least += up
    return whole


def _to_planes(values: NDArray[np.float32], basis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert outputs to planes along the first axis.

    The products are added in a fixed order, so that rounding errors are the same on every machine.
    """
    exact = values.astype(np.float64)

    def plane(column: NDArray[np.float64]) -> NDArray[np.float64]:
        return functools.reduce(np.add, [column[output] * exact[output] for output in np.flatnonzero(column)])

    return np.stack(list(map(plane, basis.T)))
