"""Exact sums of products, from which the transforms are solved (docs/method.md#exact-sums).

The sums are the normal equations of the least-squares fit. There is one set of sums for each class of each canonical site. A
canonical site represents all CFA sites that are symmetric to it. The columns of a sample are its taps, the intercept (the
constant 1) and its outputs. A *moment* is the sum of the products of two columns. Moment matrices are symmetric, so only
their upper triangle is stored, with one number per *pair* of columns.

Every product is rounded to a multiple of a fixed grid step before it is added. As long as a sum stays below 2⁵³ grid steps,
float64 adds such multiples without any rounding. The result is therefore the same to the last bit for any order, and for any
number of processes and shards.
"""

import functools
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import ClassSums, LayerSums, noise_columns
from l3cli.classes import level
from l3cli.errors import L3Error

PRODUCT_STEP = 2.0**-24  # grid step for a product of two columns whose values are about 1
MAX_EXACT_STEPS = 2.0**53  # largest number of steps that float64 counts without rounding
PIECE_SAMPLES = 1024  # number of samples that are computed and multiplied together
MAX_CLASS_PIECE_SAMPLES = 4096  # largest number of samples in a piece that contains a single class

Array = NDArray[np.float64]


@functools.cache
def pairs(width: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the row indices and the column indices of the upper triangle of a moment matrix."""
    return np.triu_indices(width)


def width_of(packed: Array) -> int:
    """Return the number of columns of a moment matrix whose upper triangle is stored in the last axis of `packed`."""
    return (math.isqrt(8 * packed.shape[-1] + 1) - 1) // 2


def empty_sums(rule: ClassRule, outputs: int, camera: CameraModel) -> ClassSums:
    """Return sums without patches for one site."""
    classes, width = rule.classes_per_site, rule.patch**2 + 1 + outputs
    shapes = (classes, width * (width + 1) // 2), (classes, noise_columns(rule, camera)), (classes,)
    return ClassSums(*map(np.zeros, shapes))


def same_shapes(sums: ClassSums | LayerSums, others: ClassSums | LayerSums) -> bool:
    """Return whether two sets of sums have equal types and shapes, and can therefore be added."""
    return type(sums) is type(others) and all(
        (getattr(sums, name).dtype, getattr(sums, name).shape) == (np.float64, getattr(others, name).shape)
        for name in ("moments", "noise", "count")
    )


def rounding_number(step: Array | float) -> Array:
    """Return 1.5 · 2⁵² steps. Adding this number to a float64 value rounds the value to whole steps."""
    return np.asarray(step * (1.5 * 2.0**52))


def add_rounded(total: Array, more: NDArray[np.float32], large: Array) -> None:
    """Round numbers to whole grid steps, and add the rounded numbers to a total in place.

    Parameters
    ----------
    total : ndarray of float64
        Total, which is changed in place.
    more : ndarray of float32
        Numbers to add.
    large : ndarray of float64
        Results of `rounding_number`, with which `more` is rounded to grid steps.
    """
    rounded = more + large
    rounded -= large
    total += rounded


def runs_of(label: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """Return (class, first sample, end sample) for each class in `label`. The samples must be sorted by class."""
    changes = (np.flatnonzero(label[1:] != label[:-1]) + 1).tolist()
    first, last = [0, *changes], [*changes, len(label)]
    return list(zip(label[first].tolist(), first, last, strict=True)) if len(label) else []


def pieces_of(label: NDArray[np.integer]) -> Iterator[slice]:
    """Divide samples into slices of about `PIECE_SAMPLES` samples.

    `label` contains the class of each sample. The samples are sorted by class. Several small classes share a slice, because
    a matrix product takes little more time for many samples than for a few. A class is divided between slices only if its
    samples would not fit into a slice of `MAX_CLASS_PIECE_SAMPLES` samples.
    """
    start = np.array([first for _, first, _ in runs_of(label)], np.int64)
    first = start[np.unique(start // PIECE_SAMPLES, return_index=True)[1]].tolist()
    for begin, end in itertools.pairwise([*first, len(label)]):
        for part in range(begin, end, MAX_CLASS_PIECE_SAMPLES):
            yield slice(part, min(part + MAX_CLASS_PIECE_SAMPLES, end))


def add_products(
    total: Array,
    samples: NDArray[np.float32],
    runs: list[tuple[int, int, int]],
    large: Sequence[Array],
    columns: NDArray[np.integer] | None = None,
) -> None:
    """Multiply the columns of samples with each other, and add the products to the moments of each class.

    Parameters
    ----------
    total : ndarray, (class, pair)
        Packed moments of all classes, which are changed in place.
    samples : ndarray, (sample, column)
        Taps, intercept and outputs of each sample. The samples are sorted by class.
    runs : list of (class, first sample, end sample)
        Result of `runs_of`.
    large : sequence of ndarray
        For each run, the results of `rounding_number` with which the products are rounded to grid steps.
    columns : ndarray, optional
        Indices of the columns to multiply. [default: all columns]
    """
    columns = np.arange(samples.shape[1]) if columns is None else columns
    row, col = pairs(columns.size)
    place = columns[row] * samples.shape[1] + columns[col]
    for (index, first, last), number in zip(runs, large, strict=True):
        block = samples[first:last]
        add_rounded(total[index], (block.T @ block).reshape(-1).take(place), number)


def add(sums: ClassSums | LayerSums, more: ClassSums | LayerSums) -> None:
    """Add the sums `more` to `sums` in place. The addition is exact, so the order of the calls does not matter."""
    for total, part in ((sums.moments, more.moments), (sums.noise, more.noise), (sums.count, more.count)):
        np.add(total, part, out=total)


def grid_steps(rule: ClassRule, camera: CameraModel, outputs: int) -> Array:
    """Return the grid steps (level, pair) of the products in the first layer.

    Products are rounded to multiples of these steps before they are added. All steps are powers of two.
    """
    return steps_of_columns(intercept_scale(rule, camera), rule.patch**2, outputs)


def intercept_scale(rule: ClassRule, camera: CameraModel) -> Array:
    """Return the scale of the intercept column at each level, as a power of two.

    Samples are divided by their level. The taps and outputs are therefore about 1, and the intercept is about 1/level.
    """
    lower = np.maximum(level.inner_bounds(rule, camera.black_level, camera.white_level), 1e-4)
    return np.asarray(2.0 ** np.rint(-np.log2(np.append(lower[0] / 2, lower))))


def steps_of_columns(intercept: Array, taps: int, outputs: int) -> Array:
    """Return the grid steps (level, pair) for products of columns.

    `intercept` contains the scale of the intercept column at each level. All other columns have a scale of 1.
    """
    scale = np.ones((len(intercept), taps + 1 + outputs))
    scale[:, taps] = intercept
    row, col = pairs(scale.shape[1])
    return PRODUCT_STEP * scale[:, row] * scale[:, col]


def require_exact(sums: ClassSums, rule: ClassRule, steps: Array) -> None:
    """Raise an L3Error if a sum is too large for exact addition in float64.

    Only sums of squares are tested, because no sum of products of two columns exceeds the larger sum of squares.
    """
    row, col = pairs(width_of(sums.moments))
    squares = rule.by_feature(sums.moments[:, row == col])[0] / steps[:, None, None, None, row == col]
    if max(squares.max(), sums.noise.max() / PRODUCT_STEP) >= MAX_EXACT_STEPS:
        raise L3Error(
            "a class has too many patches for exact sums; reduce learning.patches or learning.draws in the class recipe"
        )


def turned_places(turn: NDArray[np.integer], width: int) -> NDArray[np.intp]:
    """Return the order of the stored products of column pairs after the taps are permuted by `turn`.

    The first columns are the taps. The remaining columns, up to `width`, keep their order.
    """
    row, col = pairs(width)
    place = np.empty((width, width), dtype=np.intp)
    place[row, col] = place[col, row] = np.arange(row.size)
    order = np.append(turn, np.arange(turn.size, width))
    return np.asarray(place[order[row], order[col]])


def moment_matrix(packed: Array, width: int) -> Array:
    """Unpack stored upper triangles into symmetric moment matrices.

    The last axis of `packed` contains the pairs of columns. The result has two axes of columns instead.
    """
    matrix = np.empty((*packed.shape[:-1], width, width))
    row, col = pairs(width)
    matrix[..., row, col] = packed
    matrix[..., col, row] = packed
    return matrix
