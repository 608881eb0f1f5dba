"""Short word lengths: the weights of the last layer in fixed point, and the resulting change of outputs on a synthetic
mosaic.

    weight ≈ whole · 2^−F

`whole` is a signed integer with a given number of bits. F is the largest number of fractional bits for which the largest
weight fits, of the whole table or of each class separately.

Intercepts are not changed. Layers before the last always have 16-bit words (docs/method.md#planes).
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANE_TOP, RATIO_TAPS
from l3cli.artifacts.table import TransformTable
from l3cli.classes.clipping import limited_to_white
from l3cli.classes.planes import raw_middle
from l3cli.classes.windows import Integers, window_channels
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.rendering.reference import ReferenceRenderer, output_planes, refinement_outputs

VECTOR_SHAPE = (40, 150)  # rows, columns; more than a block, and no multiple of any array's period
VECTOR_SEED = 3
OUTPUT_FRACTION = 12  # fractional bits of an output, so that words reach ±8
OUTPUT_TOP = 2**15 - 1
HIGH_BITS = 12  # bits of the high part of a value, including the sign
MAX_WEIGHT, MAX_SUM = 2.0**15 - 8, 2.0**31 - 2**26  # before rounding, and before the low part and 2^(F − 1) are added
MAX_FRACTION = 24
# Assumed correlation R of taps: falls to 1/e over REACH pixels, is OTHER times as large between channels, plus NOISE on the
# diagonal.
REACH, OTHER, NOISE = 8.0, 0.8, 0.2
LENGTHS = (8, 10, 12, 14, 16)  # bits
SHAPE, SEED = (64, 256), 4  # rows, columns and seed of the mosaic
ENOUGH_PSNR_DB = 60.0  # dB, PSNR relative to a full output, which is an error of a thousandth
Scale = Literal["class", "table"]  # whether each class has a binary point, or the table has one


@dataclass(frozen=True)
class Vector:
    """A test vector: a mosaic, its classes in every layer, and its outputs."""

    raw: NDArray[np.uint16]  # (row, col) DN at the table's levels
    phase: tuple[int, int]  # CFA row and column of its first pixel
    labels: Integers  # (layer, row, col)
    outputs: NDArray[np.float32]  # (output, row, col)

    def files(self) -> dict[str, bytes]:
        """Return the arrays as files: little-endian, row by row."""
        return {
            "test_raw.bin": self.raw.astype("<u2").tobytes(),
            "test_labels.bin": self.labels.astype("<u4").tobytes(),
            "test_outputs.bin": self.outputs.astype("<f4").tobytes(),
        }


def drawn_mosaic(table: TransformTable, shape: tuple[int, int], seed: int) -> NDArray[np.uint16]:
    """Return a mosaic (row, col) at the table's levels, dark at the left, saturated at the right, of plain areas and
    texture."""
    rng = np.random.default_rng(seed)
    level = np.geomspace(0.002, 1.5, shape[1]) * (table.white_level - table.black_level)
    blocks = rng.normal(size=(shape[0] // 8 + 1, shape[1] // 8 + 1)).repeat(8, 0).repeat(8, 1)[: shape[0], : shape[1]]
    values = table.black_level + level * (1 + 0.3 * blocks + 0.2 * rng.normal(size=shape) * (blocks > 0))
    return np.clip(np.rint(values), 0, 2**table.bits - 1).astype(np.uint16)


def make_vector(table: TransformTable) -> Vector:
    """Return the test vector of a table: its second site first, so that phases count."""
    phase = (1 % table.cfa.shape[0], 1 % table.cfa.shape[1])
    raw = drawn_mosaic(table, VECTOR_SHAPE, VECTOR_SEED)
    frame = RawFrame("test vector", raw, table.black_level, table.white_level, phase)
    reference = ReferenceRenderer(table)
    labels = np.stack([reference.labels(frame, layer) for layer in range(len(table.layers))])
    return Vector(raw, phase, labels, reference.outputs(frame))


@dataclass(frozen=True)
class ShortWords:
    """Transforms of the last layer in 16-bit words, with taps in the table's order."""

    whole: NDArray[np.int32]  # (class, output, tap) within 16 bits, except the largest weight of a window
    intercept: NDArray[np.int32]  # (class, output)
    fraction: NDArray[np.uint8]  # (class, output) F minus the split
    split: int  # bits of the low part

    def in_floats(self, table: TransformTable) -> NDArray[np.float32]:
        """Return the weights (class, output, tap) of the table's last layer that these words represent."""
        shift = -(self.fraction.astype(np.int32) + self.split + OUTPUT_FRACTION)
        return np.ldexp(self.whole.astype(np.float64) / _value_step(table), shift[..., None]).astype(np.float32)


def split_of(table: TransformTable) -> int:
    """Return the number of bits in the low part of the values that a table's last layer reads."""
    return PLANE_TOP.bit_length() + 1 - HIGH_BITS if table.later else max(0, table.bits - HIGH_BITS)


def offset_of(table: TransformTable) -> int:
    """Return the offset of the values that a table's last layer reads."""
    return 0 if table.later else raw_middle(table.bits)


def short_words(table: TransformTable) -> ShortWords:
    """Return the last layer of a table in 16-bit words; InputFileError if its transforms are too large."""
    split, offset = split_of(table), offset_of(table)
    layer, black = table.layers[-1], 0.0 if table.later else table.black_level - offset
    weights = layer.weights.astype(np.float64) * (_value_step(table) * 2**OUTPUT_FRACTION)  # per unit of a value
    intercept = layer.intercept.astype(np.float64) * 2**OUTPUT_FRACTION - black * weights.sum(axis=-1)
    values = PLANE_TOP if table.later else max(2**table.bits - 1 - offset, offset)
    size = np.abs(weights)
    windows = weights.shape[-1] - (table.later[-1].ratio_taps if table.later else 0)
    twice = size[..., windows + RATIO_TAPS[1] :].sum(axis=-1)  # bilateral chroma is a difference of values
    sums = (size.sum(axis=-1) + twice) * values + np.abs(intercept)
    second = np.sort(size[..., :windows], axis=-1)[..., -2:].min(axis=-1)
    second = np.maximum(second, size[..., windows:].max(axis=-1, initial=0.0))
    most = np.minimum(MAX_WEIGHT / (second + 1e-30), MAX_SUM * 2.0**split / (sums + 1e-30))
    fraction = np.minimum(MAX_FRACTION + split, np.floor(np.log2(most)))
    if fraction.min() < split:
        raise InputFileError(
            "transforms of the last layer are too large for words of 16 bits; export them as float32 (‹words›)"
        )
    scaled = weights * 2.0 ** fraction[..., None]
    of_windows = [_rounded(scaled[members, :, :windows], likeness) for members, likeness in _likenesses(table)]
    whole = np.concatenate([np.concatenate(of_windows), np.rint(scaled[..., windows:])], axis=-1)
    intercept = (intercept + black * weights.sum(axis=-1)) * 2.0 ** (fraction - split) - black * whole.sum(
        axis=-1
    ) / 2**split
    return ShortWords(
        whole.astype(np.int32), np.rint(intercept).astype(np.int32), (fraction - split).astype(np.uint8), split
    )


def _value_step(table: TransformTable) -> float:
    """Return the unit of the last layer's weights, relative to the values that words multiply."""
    return PLANE_STEP if table.later else 1 / (table.white_level - table.black_level)


def _likenesses(table: TransformTable) -> list[tuple[NDArray[np.bool_], NDArray[np.float64]]]:
    """Return the correlation R (tap, tap) of the windows of the last layer, and the classes that it applies to.

    The classes of a layer that reads the mosaic have one R per site.
    """
    layer = table.layers[-1]
    if table.later:
        source = np.repeat(np.arange(len(table.outputs)), table.later[-1].side ** 2)
        return [(np.ones(len(layer.weights), bool), _likeness(source, 0.0))]
    site = table.first.rule.split(np.arange(len(layer.weights))).site
    channels = window_channels(table.cfa, table.first.rule.patch)
    return [(site == number, _likeness(channel, OTHER)) for number, channel in enumerate(channels)]


def _likeness(source: NDArray[np.int64], other: float) -> NDArray[np.float64]:
    """Return the correlation R (tap, tap) of the taps of square windows, given plane by plane by their `source`."""
    side = math.isqrt(len(source) if other else np.count_nonzero(source == source[0]))
    row, column = np.divmod(np.arange(len(source)) % side**2, side)
    distance = np.hypot(row[:, None] - row, column[:, None] - column)
    alike = np.where(source[:, None] == source, 1.0, other) * np.exp(-distance / REACH)
    return alike + NOISE * np.eye(len(source))


def _rounded(weights: NDArray[np.float64], likeness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights (class, output, tap) rounded such that the error eᵀ R e is small."""
    flat = weights.reshape(-1, weights.shape[-1])
    whole = np.rint(flat)
    slope = (whole - flat) @ likeness  # half the derivative of eᵀ R e by each weight
    own = np.diag(likeness)
    for _ in range(2 * flat.shape[1]):
        change = own - 2 * np.abs(slope)  # change of eᵀ R e by a step of one, up or down, whichever is better
        tap = change.argmin(axis=1)
        moved = np.flatnonzero(change[np.arange(len(flat)), tap] < -1e-9)
        if not moved.size:
            break
        taken = tap[moved]
        step = -np.sign(slope[moved, taken])
        whole[moved, taken] += step
        slope[moved] += step[:, None] * likeness[taken]
    return whole.reshape(weights.shape)


@dataclass(frozen=True)
class Words:
    """Weights in fixed point."""

    whole: NDArray[np.int16]  # (class, output, tap)
    fraction: NDArray[np.int8]  # (class) binary point F
    bits: int
    scale: Scale

    @property
    def weights(self) -> NDArray[np.float32]:
        """The weights (class, output, tap) as floats."""
        return np.ldexp(self.whole.astype(np.float32), -self.fraction[:, None, None].astype(np.int32))


@dataclass(frozen=True)
class Cost:
    """Difference between the outputs of shortened weights and those of float weights."""

    bits: int
    scale: Scale
    psnr: float  # dB, relative to a full output of 1


def in_words(weights: NDArray[np.float32], bits: int, scale: Scale) -> Words:
    """Return weights (class, output, tap) as words with this number of bits."""
    largest = np.abs(weights).max(axis=(1, 2)).astype(np.float64)
    if scale == "table":
        largest[:] = largest.max()
    top = 2 ** (bits - 1) - 1
    fraction = np.clip(np.floor(np.log2(top / np.maximum(largest, 2.0**-100))), -100, 100).astype(np.int8)
    whole = np.rint(np.ldexp(weights.astype(np.float64), fraction[:, None, None].astype(np.int32)))
    return Words(np.clip(whole, -top, top).astype(np.int16), fraction, bits, scale)


def word_costs(table: TransformTable) -> tuple[Cost, ...]:
    """Return the cost of every word length, with a binary point per class and with one for the table."""
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
    """Return the cost of 16-bit words: PSNR in dB relative to a full output, and the largest error in steps of an unrounded
    output.

    Coarse chroma, which is added to two of three outputs, is rounded separately.
    """
    outputs, step = _outputs(table), 2.0**-OUTPUT_FRACTION
    expected, short = outputs(table.layers[-1].weights), outputs(words.in_floats(table))
    rounded = np.clip(np.rint(short / step), -OUTPUT_TOP, OUTPUT_TOP) * step
    whole = np.clip(expected, -OUTPUT_TOP * step, OUTPUT_TOP * step)
    if table.clipped_white is not None:
        whole = limited_to_white(whole, table.clipped_white)
        rounded = np.rint(limited_to_white(rounded / step, np.rint(table.clipped_white / step))) * step
    error = np.square(rounded - whole).mean()
    if table.later and table.later[-1].coarse_chroma:
        error += step**2 / 12 * 2 / 3
    return float(-10 * np.log10(max(error, 1e-20))), float(np.abs(short - expected).max() / step)


def chosen_words(table: TransformTable, costs: tuple[Cost, ...]) -> Words:
    """Return the shortest words with a binary point per class whose PSNR reaches ENOUGH, otherwise the longest."""
    enough = [cost.bits for cost in costs if cost.scale == "class" and cost.psnr >= ENOUGH_PSNR_DB]
    return in_words(table.layers[-1].weights, min(enough, default=LENGTHS[-1]), "class")


def _outputs(table: TransformTable) -> Callable[[NDArray[np.float32]], NDArray[np.float64]]:
    """Return a function from weights of the last layer to the outputs (output, row, col) of the synthetic mosaic."""
    frame = RawFrame("drawn", drawn_mosaic(table, SHAPE, SEED), table.black_level, table.white_level)
    reference = ReferenceRenderer(table)
    labels = reference.labels(frame, len(table.layers) - 1)
    if not table.later:
        first = table.first
        return lambda weights: output_planes(frame, labels, table, dataclasses.replace(first, weights=weights))
    last, planes = table.later[-1], reference.planes(frame)
    return lambda weights: refinement_outputs(planes, labels, dataclasses.replace(last, weights=weights))
