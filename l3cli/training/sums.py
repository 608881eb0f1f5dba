"""Accumulate exact sums of products, the normal equations from which transforms are solved (docs/method.md#exact-sums).

Each class of each canonical site has one set of sums. A canonical site represents all CFA sites that are symmetric to it. A
sample has one *column* per tap, one for the intercept (the constant 1) and one per output. A *moment* is the sum, over all
samples, of the product of two columns. Moment matrices are symmetric, so only the upper triangle is stored, with one number
per *pair* of columns.

Every product is rounded to a multiple of a fixed grid step before it is added. As long as a sum stays below 2⁵³ grid steps,
float64 adds such multiples without rounding. The result is therefore bit-identical for any order of additions and any number
of processes and shards.
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

PRODUCT_STEP = 2.0**-24  # grid step for products of two columns with values near 1
MAX_EXACT_STEPS = 2.0**53  # largest integer up to which float64 represents every integer
PIECE_SAMPLES = 1024  # approximate number of samples that are processed together
MAX_CLASS_PIECE_SAMPLES = 4096  # largest number of samples in a piece with a single class

Array = NDArray[np.float64]


@functools.cache
def pairs(width: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the row and column indices of the upper triangle of a moment matrix."""
    return np.triu_indices(width)


def width_of(packed: Array) -> int:
    """Return the number of columns of moment matrices. The last axis of `packed` contains their upper triangles."""
    return (math.isqrt(8 * packed.shape[-1] + 1) - 1) // 2


def empty_sums(rule: ClassRule, outputs: int, camera: CameraModel) -> ClassSums:
    classes, width = rule.classes_per_site, rule.patch**2 + 1 + outputs
    shapes = (classes, width * (width + 1) // 2), (classes, noise_columns(rule, camera)), (classes,)
    return ClassSums(*map(np.zeros, shapes))


def same_shapes(sums: ClassSums | LayerSums, others: ClassSums | LayerSums) -> bool:
    """Whether two sets of sums have equal types and shapes, and can therefore be added."""
    return type(sums) is type(others) and all(
        (getattr(sums, name).dtype, getattr(sums, name).shape) == (np.float64, getattr(others, name).shape)
        for name in ("moments", "noise", "count")
    )


def rounding_number(step: Array | float) -> Array:
    """Return 1.5 · 2⁵² steps. Adding this number and subtracting it again rounds a float64 value to whole steps."""
    return np.asarray(step * (1.5 * 2.0**52))


def add_rounded(total: Array, more: NDArray[np.float32], large: Array) -> None:
    """Round numbers to whole grid steps, and add them to a total in place.

    Parameters
    ----------
    total : ndarray of float64
        Total, changed in place.
    more : ndarray of float32
        Numbers to add.
    large : ndarray of float64
        Results of `rounding_number` for the grid steps.
    """
    rounded = more + large
    rounded -= large
    total += rounded


def runs_of(label: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """Return each class's range of samples, (class, first sample, end sample). `label` must be sorted."""
    changes = (np.flatnonzero(label[1:] != label[:-1]) + 1).tolist()
    first, last = [0, *changes], [*changes, len(label)]
    return list(zip(label[first].tolist(), first, last, strict=True)) if len(label) else []


def pieces_of(label: NDArray[np.integer]) -> Iterator[slice]:
    """Divide samples into slices of about `PIECE_SAMPLES` samples.

    `label` contains the class of each sample, in increasing order. Small classes share a slice, to reduce the overhead. A
    class is divided only if it has more than `MAX_CLASS_PIECE_SAMPLES` samples.
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
    """Multiply the columns of samples pairwise, and add the products to the moments of each class.

    Parameters
    ----------
    total : ndarray, (class, pair)
        Packed moments of all classes, changed in place.
    samples : ndarray, (sample, column)
        Weighted taps, intercept and outputs of each sample, sorted by class.
    runs : list of (class, first sample, end sample)
        Result of `runs_of`.
    large : sequence of ndarray
        For each run, the results of `rounding_number` for the grid steps of the products.
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
    """Add `more` to `sums` in place. The addition is exact, so the order of calls does not matter."""
    for total, part in ((sums.moments, more.moments), (sums.noise, more.noise), (sums.count, more.count)):
        np.add(total, part, out=total)


def grid_steps(rule: ClassRule, camera: CameraModel, outputs: int) -> Array:
    """Return the grid steps (level, pair), powers of two, for products of columns in the first layer."""
    return steps_of_columns(intercept_scale(rule, camera), rule.patch**2, outputs)


def intercept_scale(rule: ClassRule, camera: CameraModel) -> Array:
    """Return the intercept column's typical magnitude at each level, rounded to a power of two.

    Samples are divided by their level. Taps and outputs are therefore of order 1. The intercept's column, a constant, is of
    order 1 / level.
    """
    lower = np.maximum(level.inner_bounds(rule, camera.black_level, camera.white_level), 1e-4)
    return np.asarray(2.0 ** np.rint(-np.log2(np.append(lower[0] / 2, lower))))


def steps_of_columns(intercept: Array, taps: int, outputs: int) -> Array:
    """Return the grid steps (level, pair) for products of columns.

    `intercept` (level) is the result of `intercept_scale`. All other columns have a typical magnitude of 1.
    """
    scale = np.ones((len(intercept), taps + 1 + outputs))
    scale[:, taps] = intercept
    row, col = pairs(scale.shape[1])
    return PRODUCT_STEP * scale[:, row] * scale[:, col]


def require_exact(sums: ClassSums, rule: ClassRule, steps: Array) -> None:
    """Raise L3Error if a sum is too large for exact addition in float64.

    It is sufficient to test sums of squares, because no sum of products of two columns exceeds the larger sum of squares.
    """
    row, col = pairs(width_of(sums.moments))
    squares = rule.by_feature(sums.moments[:, row == col])[0] / steps[:, None, None, None, row == col]
    if max(squares.max(), sums.noise.max() / PRODUCT_STEP) >= MAX_EXACT_STEPS:
        raise L3Error(
            "a class has too many patches for exact sums; reduce learning.patches or learning.draws in the class recipe"
        )


def turned_places(turn: NDArray[np.integer], width: int) -> NDArray[np.intp]:
    """Return the permutation of packed moments that results from the permutation `turn` of the taps.

    The first columns are the taps. All other columns, up to `width`, keep their order.
    """
    row, col = pairs(width)
    place = np.empty((width, width), dtype=np.intp)
    place[row, col] = place[col, row] = np.arange(row.size)
    order = np.append(turn, np.arange(turn.size, width))
    return np.asarray(place[order[row], order[col]])


def moment_matrix(packed: Array, width: int) -> Array:
    """Unpack upper triangles (…, pair) into symmetric moment matrices (…, column, column)."""
    matrix = np.empty((*packed.shape[:-1], width, width))
    row, col = pairs(width)
    matrix[..., row, col] = packed
    matrix[..., col, row] = packed
    return matrix
