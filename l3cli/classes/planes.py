"""Layers in fixed point: planes whose integers are the same wherever they are computed (docs/method.md#planes).

Weights of each channel are rounded so that they add up to their rounded sum: else what is rounded off would colour plain
areas, and differently at every site. They fit 16 bits, which processors multiply twice as fast as floats.
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import PLANE_STEP, PLANE_TOP, PlaneLayer, TransformTable
from l3cli.classes.windows import Integers, window_channels
from l3cli.errors import InputFileError

MOST_FRACTION = 16
MOST_WEIGHT, MOST_SUM = 2.0**15 - 2, 2.0**31 - 2**MOST_FRACTION  # before rounding, which adds less than 1 to a weight
COARSE, COARSE_TOP = 5, 2**15 - 1  # bits by which a layer between reads planes coarser, and within which size
BLOCK = 256  # classes that are turned into integers at a time, in a processor's cache
LUMINANCE, CHROMA = 1, [0, 2]  # the plane that is Y, and the others


@dataclass(frozen=True)
class FixedPoint:
    """A layer's transforms to planes, as integers."""

    weights: NDArray[np.int16]  # (class, plane, tap)
    intercept: NDArray[np.int64]  # (class, plane)
    fraction: NDArray[np.int32]  # (class) F

    def planes(self, sums: Integers, label: Integers) -> NDArray[np.int32]:
        """Return the planes (plane, …) of sums Σ W · DN + B, or of coarse planes, of pixels (…) of the classes `label`."""
        fraction = self.fraction.astype(np.int64)[label]
        rounded = (sums + (1 << fraction >> 1)) >> fraction
        return np.clip(rounded, -PLANE_TOP, PLANE_TOP).astype(np.int32)


def opponent_basis(white_point: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the columns X − aY, Y, Z − bY of outputs X, Y, Z: rows of outputs times it are planes."""
    basis = np.eye(3)
    basis[LUMINANCE, 0], basis[LUMINANCE, 2] = -white_point[0] / white_point[1], -white_point[2] / white_point[1]
    return basis


def planes_basis(table: TransformTable) -> NDArray[np.float64]:
    """Return the columns (output, plane) that make planes of rows of a table's outputs."""
    return opponent_basis(table.white_point) if table.components is None else table.components.basis


def fixed_point(table: TransformTable) -> FixedPoint:
    """Return the first layer of a table as integers; InputFileError if its transforms are beyond all planes."""
    first, read = table.first, _raw(table.bits, table.black_level, table.white_level)
    channels, basis = window_channels(table.cfa, first.rule.patch), planes_basis(table)
    sites = [(first.rule.of_site(site), channel) for site, channel in enumerate(channels)]
    return _fixed_point(first.weights, first.intercept, basis, read, sites)


def refined_fixed_point(layer: PlaneLayer, basis: NDArray[np.float64]) -> FixedPoint:
    """Return a layer that reads planes and after which another does; InputFileError if its transforms are beyond all
    planes."""
    plane = np.repeat(np.arange(len(basis)), layer.side**2)
    return _fixed_point(layer.weights, layer.intercept, basis, BETWEEN, [(slice(0, len(layer.weights)), plane)])


def coarse(planes: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the planes as a layer between reads them."""
    return np.clip(planes + (1 << COARSE >> 1) >> COARSE, -COARSE_TOP, COARSE_TOP)


def raw_middle(bits: int) -> int:
    """Return the offset that brings raw values of so many bits into 16 bits with a sign."""
    return 2**15 if bits == 16 else 0


@dataclass(frozen=True)
class _Read:
    """Input of a layer's transforms."""

    step: float  # weights are per so many of the values
    zero: float  # the value that stands for nothing
    largest: float  # size of the values as kernels read them
    farthest: float  # size of `zero`, as kernels read it


BETWEEN = _Read(step=2.0**-COARSE, zero=0.0, largest=COARSE_TOP, farthest=0.0)  # planes


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
    """Return the factor (class) by which transforms (class, plane, tap) of taps in units of full scale, with an intercept
    (class, plane), could be larger for their planes to be computed as integers; below 1 they are too large."""
    read = _raw(bits, black_level, white_level)
    return _room(weights.transpose(2, 1, 0) / read.step, intercept.T / PLANE_STEP, read)


def room_between(weights: NDArray[np.float64], intercept: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same (class) of transforms (class, plane, tap) of planes to planes that a further layer reads."""
    return _room(weights.transpose(2, 1, 0) / BETWEEN.step, intercept.T / PLANE_STEP, BETWEEN)


def _fixed_point(
    weights: NDArray[np.float32], intercept: NDArray[np.float32], basis: NDArray[np.float64], read: _Read,
    layouts: Iterable[tuple[slice, Integers]],
) -> FixedPoint:  # fmt: skip
    """Return transforms (class, output, tap), (class, output) as integers; `layouts`: classes, channels of taps."""
    offset = _to_planes(intercept.T, basis) / PLANE_STEP
    shape = len(weights), basis.shape[1]
    made = FixedPoint(
        np.empty((*shape, weights.shape[2]), np.int16), np.empty(shape, np.int64), np.empty(shape[0], np.int32)
    )
    for classes, channel in layouts:
        order = np.argsort(channel, kind="stable")
        ends = [0, *np.cumsum(np.bincount(channel)).tolist()]
        distinct, like = _distinct(weights[classes], intercept[classes])
        for start in range(0, len(distinct), BLOCK):
            block = distinct[start : start + BLOCK] + classes.start
            # Sums over the first axis are sums of long rows, which numpy does several times as fast.
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
    """Return the first of each class of equal transforms (distinct), and for every class the place of its like among these:
    classes without patches of their own, half of those of many channels, have a neighbour's."""
    rows = np.concatenate([weights.reshape(len(weights), -1), intercept], axis=1)
    _, first, like = np.unique(
        rows.view(np.dtype((np.void, rows[0].nbytes))).ravel(), return_index=True, return_inverse=True
    )
    return first, like


def _room(weights: NDArray[np.float64], offset: NDArray[np.float64], read: _Read) -> NDArray[np.float64]:
    """Return the factor (class) by which weights (tap, plane, class) of an input, with an offset (plane, class), could be
    larger."""
    size = np.abs(weights)
    offset = np.abs(offset) + read.farthest * np.abs(weights.sum(axis=0))
    sums = (size.sum(axis=0) * read.largest + offset).max(axis=0)
    rounding = 2 * len(weights) * read.largest  # what it may add to sum and offset
    return np.minimum(MOST_WEIGHT / (size.max(axis=(0, 1)) + 1e-30), (MOST_SUM - rounding) / (sums + 1e-30))


def _fraction(room: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return F (class) of transforms that could be `room` (class) times larger."""
    fraction = np.minimum(MOST_FRACTION, np.floor(np.log2(room)))
    if fraction.min() < 0:
        raise InputFileError("transforms of a layer are too large for the next; train the table again")
    return fraction.astype(np.int32)


def _rounded(weights: NDArray[np.float64], ends: list[int]) -> NDArray[np.float64]:
    """Return the weights (tap, …), a channel's taps between two of the `ends`, as whole numbers less than one away, of sums
    over each channel that are the nearest: those that lose most are rounded up, of equal ones the first."""
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
    """Return (output, …) → (plane, …), one product after the other, so that every machine rounds alike."""
    exact = values.astype(np.float64)

    def plane(column: NDArray[np.float64]) -> NDArray[np.float64]:
        return functools.reduce(np.add, [column[output] * exact[output] for output in np.flatnonzero(column)])

    return np.stack(list(map(plane, basis.T)))
