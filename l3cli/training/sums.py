"""The sums of one canonical site from which the transforms of its classes are solved (docs/method.md#exact-sums).

Sums are float64 numbers on a grid. Each contribution is rounded to a multiple of 2⁻²⁴ of the scale of its columns before it
is added. As long as no sum reaches 2⁵³ grid steps, float64 adds such numbers without rounding. A sum is then the same to the
last bit in any order, with any number of processes and of shards.
"""

import functools
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import ClassSums, LayerSums
from l3cli.classes import level
from l3cli.errors import L3Error

PRODUCT_STEP = 2.0**-24  # grid step for a product of columns of scale one
MAX_EXACT_STEPS = 2.0**53  # largest number of steps that float64 counts without rounding
PIECE_SAMPLES = 1024  # samples that are computed and multiplied at a time
MAX_CLASS_PIECE_SAMPLES = 4096  # the same if all belong to one class

Array = NDArray[np.float64]


@functools.cache
def pairs(width: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the column indices (pair), (pair) of the upper triangle of a moment matrix, row by row."""
    return np.triu_indices(width)


def width_of(packed: Array) -> int:
    """Return the number of columns of matrices whose upper triangles are packed (…, pair)."""
    return (math.isqrt(8 * packed.shape[-1] + 1) - 1) // 2


def empty_sums(rule: ClassRule, outputs: int) -> ClassSums:
    """Return the sums of a site before any patch is added."""
    classes, taps = rule.classes_per_site, rule.patch**2
    width = taps + 1 + outputs
    return ClassSums(np.zeros((classes, width * (width + 1) // 2)), np.zeros((classes, taps)), np.zeros(classes))


def rounding_number(step: Array | float) -> Array:
    """Return 1.5 · 2⁵² steps.

    A float64 number to which this is added is rounded to whole steps, because no smaller digit is left.
    """
    return np.asarray(step * (1.5 * 2.0**52))


def add_rounded(total: Array, more: NDArray[np.float32], large: Array) -> None:
    """Add numbers, rounded to whole steps, to a total in place.

    Parameters
    ----------
    total : ndarray of float64
    more : ndarray of float32
    large : ndarray of float64
        The `rounding_number` of the steps.
    """
    rounded = more + large
    rounded -= large
    total += rounded


def runs_of(label: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """Return (class, first sample, end sample) of each run of equal classes in sorted `label`."""
    changes = (np.flatnonzero(label[1:] != label[:-1]) + 1).tolist()
    first, last = [0, *changes], [*changes, len(label)]
    return list(zip(label[first].tolist(), first, last, strict=True)) if len(label) else []


def pieces_of(label: NDArray[np.integer]) -> Iterator[slice]:
    """Yield slices of about `PIECE_SAMPLES` samples, given their sorted classes.

    A piece ends where a class ends unless the class is large, because the product of a class costs little more for many
    samples than for few.
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
    """Add the products of columns, class by class, rounded to whole steps.

    Parameters
    ----------
    total : ndarray, (class, pair)
        Packed moments, changed in place.
    samples : ndarray, (sample, column)
        Equations, sorted by class: taps, intercept and outputs.
    runs : list of (class, first sample, end sample)
        From `runs_of`.
    large : sequence of ndarray, (run)
        The `rounding_number` of the steps of each run.
    columns : ndarray, optional
        Columns to use. [default: all]
    """
    columns = np.arange(samples.shape[1]) if columns is None else columns
    row, col = pairs(columns.size)
    place = columns[row] * samples.shape[1] + columns[col]
    for (index, first, last), number in zip(runs, large, strict=True):
        block = samples[first:last]
        add_rounded(total[index], (block.T @ block).reshape(-1).take(place), number)


def add(sums: ClassSums | LayerSums, more: ClassSums | LayerSums) -> None:
    """Add the sums `more` to `sums` in place. The addition is exact, so the order does not matter."""
    for total, part in ((sums.moments, more.moments), (sums.noise, more.noise), (sums.count, more.count)):
        np.add(total, part, out=total)


def grid_steps(rule: ClassRule, camera: CameraModel, outputs: int) -> Array:
    """Return the grid steps of the moments (level, pair), which are powers of two."""
    return steps_of_columns(intercept_scale(rule, camera), rule.patch**2, outputs)


def intercept_scale(rule: ClassRule, camera: CameraModel) -> Array:
    """Return the scale of the intercept column (level), a power of two.

    Samples are relative to their level. So taps and outputs are of the order of one, and the intercept of one over the
    level.
    """
    lower = np.maximum(level.inner_bounds(rule, camera.black_level, camera.white_level), 1e-4)
    return np.asarray(2.0 ** np.rint(-np.log2(np.append(lower[0] / 2, lower))))


def steps_of_columns(intercept: Array, taps: int, outputs: int) -> Array:
    """Return grid steps (level, pair) for taps, an intercept of scale `intercept` (level), and outputs."""
    scale = np.ones((len(intercept), taps + 1 + outputs))
    scale[:, taps] = intercept
    row, col = pairs(scale.shape[1])
    return PRODUCT_STEP * scale[:, row] * scale[:, col]


def require_exact(sums: ClassSums, rule: ClassRule, steps: Array) -> None:
    """Raise an L3Error if sums are so large that additions may have been rounded.

    The sum of products of two columns is at most the larger of the sums of their squares, so only squares are tested.
    """
    row, col = pairs(width_of(sums.moments))
    squares = rule.by_feature(sums.moments[:, row == col])[0] / steps[:, None, None, None, row == col]
    if max(squares.max(), sums.noise.max() / PRODUCT_STEP) >= MAX_EXACT_STEPS:
        raise L3Error("a class has more patches than can be added exactly; lower learning.patches or learning.draws")


def turned_places(turn: NDArray[np.integer], width: int) -> NDArray[np.intp]:
    """Return where each pair of columns goes (pair) when `turn` permutes the taps, which are the first columns."""
    row, col = pairs(width)
    place = np.empty((width, width), dtype=np.intp)
    place[row, col] = place[col, row] = np.arange(row.size)
    order = np.append(turn, np.arange(turn.size, width))
    return np.asarray(place[order[row], order[col]])


def moment_matrix(packed: Array, width: int) -> Array:
    """Return the symmetric matrices (…, column, column) of packed moments (…, pair)."""
    matrix = np.empty((*packed.shape[:-1], width, width))
    row, col = pairs(width)
    matrix[..., row, col] = packed
    matrix[..., col, row] = packed
    return matrix
