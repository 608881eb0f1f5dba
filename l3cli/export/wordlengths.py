"""Cost of short words: the weights of a table's last layer in fixed point, and the distance of its outputs from those of
float weights, on a synthetic mosaic.

    weight ≈ whole · 2^−F, whole of so many bits with sign, F the largest that lets the largest weight in: of
    the whole table, or of each class by itself

Intercepts stay as they are. Layers before the last are in words of 16 bits anyway (docs/method.md#planes).
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.export.short_words import OUTPUT_FRACTION, OUTPUT_TOP, ShortWords
from l3cli.export.vector import drawn_mosaic
from l3cli.frames.frame import RawFrame
from l3cli.rendering.later import later_outputs
from l3cli.rendering.reference import ReferenceRenderer, output_planes

LENGTHS = (8, 10, 12, 14, 16)  # bits
SHAPE, SEED = (64, 256), 4  # of the mosaic: rows, columns
ENOUGH = 60.0  # dB below a full output: a thousandth of it
Scale = Literal["class", "table"]  # what shares a binary point


@dataclass(frozen=True)
class Words:
    """Weights in fixed point."""

    whole: NDArray[np.int16]  # (class, output, tap)
    fraction: NDArray[np.int8]  # (class) binary point F
    bits: int
    scale: Scale

    @property
    def weights(self) -> NDArray[np.float32]:
        """(class, output, tap)"""
        return np.ldexp(self.whole.astype(np.float32), -self.fraction[:, None, None].astype(np.int32))


@dataclass(frozen=True)
class Cost:
    """Distance of outputs from those of float weights."""

    bits: int
    scale: Scale
    psnr: float  # dB, of a full output: 1


def in_words(weights: NDArray[np.float32], bits: int, scale: Scale) -> Words:
    """Return the weights (class, output, tap) in words of so many bits."""
    largest = np.abs(weights).max(axis=(1, 2)).astype(np.float64)
    if scale == "table":
        largest[:] = largest.max()
    top = 2 ** (bits - 1) - 1
    fraction = np.clip(np.floor(np.log2(top / np.maximum(largest, 2.0**-100))), -100, 100).astype(np.int8)
    whole = np.rint(np.ldexp(weights.astype(np.float64), fraction[:, None, None].astype(np.int32)))
    return Words(np.clip(whole, -top, top).astype(np.int16), fraction, bits, scale)


def word_costs(table: TransformTable) -> tuple[Cost, ...]:
    """Return the cost of every word length, with a binary point for each class and with one for all."""
    weights = table.layers[-1].weights
    outputs = _outputs(table)
    expected = outputs(weights)
    scales: tuple[Scale, ...] = ("class", "table")
    costs = []
    for bits in LENGTHS:
        for scale in scales:
            error = np.square(outputs(in_words(weights, bits, scale).weights) - expected).mean()
            costs.append(Cost(bits, scale, float(-10 * np.log10(max(error, 1e-20)))))
    return tuple(costs)


def short_cost(table: TransformTable, words: ShortWords) -> tuple[float, float]:
    """Return the cost of words of 16 bits: dB below a full output, and the largest error in steps of an output before it
    is rounded."""
    outputs, step = _outputs(table), 2.0**-OUTPUT_FRACTION
    expected, short = outputs(table.layers[-1].weights), outputs(words.in_floats(table))
    rounded = np.clip(np.rint(short / step), -OUTPUT_TOP, OUTPUT_TOP) * step
    error = np.square(rounded - np.clip(expected, -OUTPUT_TOP * step, OUTPUT_TOP * step)).mean()
    return float(-10 * np.log10(max(error, 1e-20))), float(np.abs(short - expected).max() / step)


def chosen_words(table: TransformTable, costs: tuple[Cost, ...]) -> Words:
    """Return the shortest words with a binary point for each class that cost no more than ENOUGH allows; else the
    longest."""
    enough = [cost.bits for cost in costs if cost.scale == "class" and cost.psnr >= ENOUGH]
    return in_words(table.layers[-1].weights, min(enough, default=LENGTHS[-1]), "class")


def _outputs(table: TransformTable) -> Callable[[NDArray[np.float32]], NDArray[np.float64]]:
    """Return the outputs (output, row, col) of the drawn mosaic with other weights of the last layer."""
    frame = RawFrame("drawn", drawn_mosaic(table, SHAPE, SEED), table.black_level, table.white_level)
    reference = ReferenceRenderer(table)
    labels = reference.labels(frame, len(table.layers) - 1)
    if not table.later:
        first = table.first
        return lambda weights: output_planes(frame, labels, table, dataclasses.replace(first, weights=weights))
    last, planes = table.later[-1], reference.planes(frame)
    return lambda weights: later_outputs(planes, labels, dataclasses.replace(last, weights=weights))
