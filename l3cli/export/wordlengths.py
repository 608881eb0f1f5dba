"""Convert the last layer's weights to fixed point, and measure the effect on a synthetic mosaic.

    weight ≈ whole · 2^−F

`whole` is a signed integer with a given word length. The number of fractional bits, F, is as large as the largest weight of
the class or of the whole table permits.

Intercepts are not converted. All layers before the last one always use 16-bit weights (docs/method.md#planes).
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
from l3cli.classes.clipping import limited_to_white, replaced
from l3cli.classes.planes import raw_middle
from l3cli.classes.windows import Integers, window_channels
from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.rendering.reference import (
    ReferenceRenderer,
    least_luminance,
    mosaic_of,
    output_planes,
    refinement_outputs,
    smoothed_chroma,
)

# Rows and columns of the test vector. It is wider than a block of pixels in the C source, and its width is not a multiple of
# common CFA periods.
VECTOR_SHAPE = (40, 150)
VECTOR_SEED = 3
MOST_OUTPUT_FRACTION = 12  # maximum number of fractional bits in a 16-bit output, for a range of ±8
OUTPUT_TOP = 2**15 - 1  # largest 16-bit output
HIGH_BITS = 12  # bits in the high part of a value, including the sign
# Limits of a weight before rounding, and of a sum of products. The limit of the sum leaves headroom for the low part of the
# value and for the rounding constant, which are added later.
MAX_WEIGHT, MAX_SUM = 2.0**15 - 8, 2.0**31 - 2**26
MAX_FRACTION = 24
# The correlation R between the values of two taps is assumed to be exp(−distance / CORRELATION_PIXELS), with the distance in
# pixels. For taps of different channels, it is multiplied by CROSS_CHANNEL. NOISE_VARIANCE is added to a tap's correlation
# with itself.
CORRELATION_PIXELS, CROSS_CHANNEL, NOISE_VARIANCE = 8.0, 0.8, 0.2
LENGTHS = (8, 10, 12, 14, 16)  # word lengths to compare, in bits
SHAPE, SEED = (64, 256), 4  # (rows, columns) and seed of the mosaic for the comparison
ENOUGH_PSNR_DB = 60.0  # sufficient PSNR, an RMS error of 0.001 for a peak of 1
Scale = Literal["class", "table"]  # whether each class has its own binary point, or the whole table has one


@dataclass(frozen=True)
class Vector:
    """Test vector: a mosaic, its class maps in all layers, and its outputs."""

    raw: NDArray[np.uint16]  # (row, col) mosaic in DN, at the table's black and white levels
    phase: tuple[int, int]  # CFA row and CFA column of the first pixel
    labels: Integers  # (layer, row, col) classes
    outputs: NDArray[np.float32]  # (output, row, col)

    def files(self) -> dict[str, bytes]:
        """Return the arrays as files, in row-major and little-endian order: the content by file name."""
        return {
            "test_raw.bin": self.raw.astype("<u2").tobytes(),
            "test_labels.bin": self.labels.astype("<u4").tobytes(),
            "test_outputs.bin": self.outputs.astype("<f4").tobytes(),
        }


def drawn_mosaic(table: TransformTable, shape: tuple[int, int], seed: int) -> NDArray[np.uint16]:
    """Generate a random mosaic (row, col) at the table's black and white levels.

    It contains uniform and textured areas, and gets brighter from the left (dark) to the right (saturated).
    """
    rng = np.random.default_rng(seed)
    level = np.geomspace(0.002, 1.5, shape[1]) * (table.white_level - table.black_level)
    blocks = rng.normal(size=(shape[0] // 8 + 1, shape[1] // 8 + 1)).repeat(8, 0).repeat(8, 1)[: shape[0], : shape[1]]
    values = table.black_level + level * (1 + 0.3 * blocks + 0.2 * rng.normal(size=shape) * (blocks > 0))
    return np.clip(np.rint(values), 0, 2**table.bits - 1).astype(np.uint16)


def make_vector(table: TransformTable) -> Vector:
    """Compute the test vector of a table."""
    frame = _vector_frame(table)
    exact, labels = ReferenceRenderer(table).exact_classified(frame)
    return Vector(frame.values, frame.phase, np.stack(labels), exact.astype(np.float32))


def _vector_frame(table: TransformTable) -> RawFrame:
    """Return the frame of the test vector. If the CFA period permits, its phase is not (0, 0), to detect phase errors."""
    phase = (1 % table.cfa.shape[0], 1 % table.cfa.shape[1])
    raw = drawn_mosaic(table, VECTOR_SHAPE, VECTOR_SEED)
    return RawFrame("test vector", raw, table.black_level, table.white_level, phase)


@dataclass(frozen=True)
class ShortWords:
    """The last layer's transforms as 16-bit words, with the taps in the table's order."""

    whole: NDArray[np.int32]  # (class, output, tap) at most 16 bits, except for the largest weight of each window
    intercept: NDArray[np.int32]  # (class, output)
    fraction: NDArray[np.uint8]  # (class, output) number of fractional bits of the weights, minus `split`
    split: int  # number of bits in the low part of an input value

    def in_floats(self, table: TransformTable) -> NDArray[np.float32]:
        """Convert the words back to the table's float weights (class, output, tap)."""
        shift = -(self.fraction.astype(np.int32) + self.split + output_fraction(table))
        return np.ldexp(self.whole.astype(np.float64) / _value_step(table), shift[..., None]).astype(np.float32)


def output_fraction(table: TransformTable) -> int:
    """Return the number of fractional bits in 16-bit outputs: 12, or fewer if clipped white is much brighter than white.

    Clipped white may use only half of the output range, because pixels next to edges can be brighter. It is much brighter
    than white if some channels clip at a much higher exposure than others, for example in arrays with unfiltered pixels.
    """
    if table.clipped_white is None:
        return MOST_OUTPUT_FRACTION
    return min(MOST_OUTPUT_FRACTION, math.floor(math.log2(2**14 / table.clipped_white.max())))


def split_of(table: TransformTable) -> int:
    """Return the number of bits in the low part of an input value. The last layer splits values into high and low parts."""
    return PLANE_TOP.bit_length() + 1 - HIGH_BITS if table.later else max(0, table.bits - HIGH_BITS)


def offset_of(table: TransformTable) -> int:
    """Return the offset that the last layer subtracts from its input values."""
    return 0 if table.later else raw_middle(table.bits)


def short_words(table: TransformTable) -> ShortWords:
    """Convert the last layer's transforms to 16-bit words.

    Each class and output has as many fractional bits as possible, so that weights fit into 16 bits and sums into 32 bits.
    Raises InputFileError if the transforms are too large.
    """
    split, offset = split_of(table), offset_of(table)
    layer, black = table.layers[-1], 0.0 if table.later else table.black_level - offset
    # weights in output steps per input step
    steps = 2 ** output_fraction(table)
    weights = layer.weights.astype(np.float64) * (_value_step(table) * steps)
    intercept = layer.intercept.astype(np.float64) * steps - black * weights.sum(axis=-1)
    values = PLANE_TOP if table.later else max(2**table.bits - 1 - offset, offset)
    size = np.abs(weights)
    windows = weights.shape[-1] - (table.later[-1].ratio_taps if table.later else 0)
    # Bilateral chroma is a difference between two values, so it can be twice as large as a value.
    twice = size[..., windows + RATIO_TAPS[1] :].sum(axis=-1)
    sums = (size.sum(axis=-1) + twice) * values + np.abs(intercept)
    second = np.sort(size[..., :windows], axis=-1)[..., -2:].min(axis=-1)
    second = np.maximum(second, size[..., windows:].max(axis=-1, initial=0.0))
    most = np.minimum(MAX_WEIGHT / (second + 1e-30), MAX_SUM * 2.0**split / (sums + 1e-30))
    fraction = np.minimum(MAX_FRACTION + split, np.floor(np.log2(most)))
    if fraction.min() < split:
        raise InputFileError(
            "the last layer's transforms are too large for 16-bit words; export the table with ‹words› float32"
        )
    scaled = weights * 2.0 ** fraction[..., None]
    of_windows = [_rounded(scaled[members, :, :windows], correlation) for members, correlation in _correlations(table)]
    whole = np.concatenate([np.concatenate(of_windows), np.rint(scaled[..., windows:])], axis=-1)
    intercept = (intercept + black * weights.sum(axis=-1)) * 2.0 ** (fraction - split) - black * whole.sum(
        axis=-1
    ) / 2**split
    return ShortWords(
        whole.astype(np.int32), np.rint(intercept).astype(np.int32), (fraction - split).astype(np.uint8), split
    )


def _value_step(table: TransformTable) -> float:
    """Return the value of one step of the last layer's integer inputs, in the unit of the float inputs."""
    return PLANE_STEP if table.later else 1 / (table.white_level - table.black_level)


def _correlations(table: TransformTable) -> list[tuple[NDArray[np.bool_], NDArray[np.float64]]]:
    """Return the groups of classes with the same assumed correlation R (tap, tap) between window taps.

    Each item is a mask of classes, and R. If the table has a single layer, each CFA site is a group. In a refinement layer,
    all classes are one group.
    """
    layer = table.layers[-1]
    if table.later:
        source = np.repeat(np.arange(len(table.outputs)), table.later[-1].side ** 2)
        return [(np.ones(len(layer.weights), bool), _correlation(source, 0.0))]
    site = table.first.rule.split(np.arange(len(layer.weights))).site
    channels = window_channels(table.cfa, table.first.rule.patch)
    return [(site == number, _correlation(channel, CROSS_CHANNEL)) for number, channel in enumerate(channels)]


def _correlation(source: NDArray[np.int64], other: float) -> NDArray[np.float64]:
    """Return the assumed correlation R (tap, tap) between the taps of a square window.

    `source` is the channel or plane of each tap. Between different sources, the correlation is multiplied by `other`.
    """
    side = math.isqrt(len(source) if other else np.count_nonzero(source == source[0]))
    row, column = np.divmod(np.arange(len(source)) % side**2, side)
    distance = np.hypot(row[:, None] - row, column[:, None] - column)
    correlation = np.where(source[:, None] == source, 1.0, other) * np.exp(-distance / CORRELATION_PIXELS)
    return correlation + NOISE_VARIANCE * np.eye(len(source))


def _rounded(weights: NDArray[np.float64], correlation: NDArray[np.float64]) -> NDArray[np.float64]:
    """Round weights (class, output, tap) to integers, so that the error eᵀ R e is small.

    e is the vector of rounding errors, and R is `correlation`. The search starts from the nearest integers. In each step, it
    changes the weight for which the error decreases most.
    """
    flat = weights.reshape(-1, weights.shape[-1])
    whole = np.rint(flat)
    slope = (whole - flat) @ correlation  # half of the derivative of eᵀ R e with respect to each weight
    own = np.diag(correlation)
    for _ in range(2 * flat.shape[1]):
        change = own - 2 * np.abs(slope)  # change of eᵀ R e if a weight changes by 1 in the better direction
        tap = change.argmin(axis=1)
        moved = np.flatnonzero(change[np.arange(len(flat)), tap] < -1e-9)
        if not moved.size:
            break
        taken = tap[moved]
        step = -np.sign(slope[moved, taken])
        whole[moved, taken] += step
        slope[moved] += step[:, None] * correlation[taken]
    return whole.reshape(weights.shape)


@dataclass(frozen=True)
class Words:
    """The last layer's weights in fixed point, with a given word length."""

    whole: NDArray[np.int16]  # (class, output, tap)
    fraction: NDArray[np.int8]  # (class,) number of fractional bits, F
    bits: int  # word length
    scale: Scale

    @property
    def weights(self) -> NDArray[np.float32]:
        """Weights (class, output, tap), converted back to floats."""
        return np.ldexp(self.whole.astype(np.float32), -self.fraction[:, None, None].astype(np.int32))


@dataclass(frozen=True)
class Cost:
    """Accuracy of outputs from fixed-point weights, relative to float weights."""

    bits: int  # word length
    scale: Scale
    psnr: float  # PSNR in dB for a peak of 1


def in_words(weights: NDArray[np.float32], bits: int, scale: Scale) -> Words:
    """Convert weights (class, output, tap) to fixed point with a word length of up to 16 bits."""
    largest = np.abs(weights).max(axis=(1, 2)).astype(np.float64)
    if scale == "table":
        largest[:] = largest.max()
    top = 2 ** (bits - 1) - 1
    fraction = np.clip(np.floor(np.log2(top / np.maximum(largest, 2.0**-100))), -100, 100).astype(np.int8)
    whole = np.rint(np.ldexp(weights.astype(np.float64), fraction[:, None, None].astype(np.int32)))
    return Words(np.clip(whole, -top, top).astype(np.int16), fraction, bits, scale)


def word_costs(table: TransformTable) -> tuple[Cost, ...]:
    """Measure the accuracy of fixed-point weights on a random mosaic, for each word length in LENGTHS and each `Scale`."""
    weights = table.layers[-1].weights
    outputs = _outputs(table, _drawn_frame(table))
    expected = outputs(weights)
    scales: tuple[Scale, ...] = ("class", "table")
    costs = []
    for bits in LENGTHS:
        for scale in scales:
            error = np.square(outputs(in_words(weights, bits, scale).weights) - expected).mean()
            costs.append(Cost(bits, scale, float(-10 * np.log10(max(error, 1e-20)))))
    return tuple(costs)


def short_cost(table: TransformTable, words: ShortWords) -> tuple[float, float]:
    """Measure the accuracy of 16-bit words on a random mosaic.

    Returns
    -------
    psnr : float
        PSNR of the rounded outputs in dB, for a peak of 1. It includes all calculations after the last layer: correction of
        clipped areas, limit of the luminance, and smoothing of chroma. It also includes the rounding of coarse chroma, if
        any, in two of the three outputs.
    worst : float
        Largest error before rounding, in output steps (differences between successive integers).
    """
    frame, step = _drawn_frame(table), 2.0 ** -output_fraction(table)
    expected, short = _both_outputs(table, words, frame)
    error = np.square(_finished(short, table, frame, rounded=True) - _finished(expected, table, frame, rounded=False)).mean()
    if table.later and table.later[-1].coarse_chroma:
        error += step**2 / 12 * 2 / 3
    return float(-10 * np.log10(max(error, 1e-20))), float(np.abs(short - expected).max() / step)


def vector_steps(table: TransformTable, words: ShortWords) -> int:
    """Return the largest error of the outputs of the test vector with 16-bit words, in output steps.

    It includes all calculations after the last layer, as in `short_cost`.
    """
    frame, step = _vector_frame(table), 2.0 ** -output_fraction(table)
    expected, short = _both_outputs(table, words, frame)
    whole = np.rint(_finished(expected, table, frame, rounded=False) / step)
    return round(np.abs(_finished(short, table, frame, rounded=True) / step - whole).max())


def _both_outputs(
    table: TransformTable, words: ShortWords, frame: RawFrame
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Render a frame to the outputs (output, row, col) of the last layer, with float weights and with 16-bit words."""
    outputs = _outputs(table, frame)
    return outputs(table.layers[-1].weights), outputs(words.in_floats(table))


def _finished(outputs: NDArray[np.float64], table: TransformTable, frame: RawFrame, *, rounded: bool) -> NDArray[np.float64]:
    """Apply the range of 16-bit outputs and all calculations after the last layer to outputs (output, row, col).

    If `rounded` is true, the outputs are rounded to output steps before and after each calculation, as in the C source.
    """
    step = 2.0 ** -output_fraction(table)

    def in_steps(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.rint(values / step) * step if rounded else values

    made = np.clip(in_steps(outputs), -OUTPUT_TOP * step, OUTPUT_TOP * step)
    if table.later and (clipping := table.later[-1].clipping):
        made = in_steps(replaced(made, mosaic_of(frame, table), clipping.response, clipping.white))
    if table.clipped_white is not None:
        made = in_steps(limited_to_white(made, in_steps(table.clipped_white)))
    if smoothing := table.chroma_smoothing:
        made = in_steps(smoothed_chroma(made, smoothing, table.white_point, least_luminance(frame, table)))
    return made


def chosen_words(table: TransformTable, costs: tuple[Cost, ...]) -> Words:
    """Convert the last layer's weights to the shortest words with a PSNR of at least ENOUGH_PSNR_DB.

    Each class has its own binary point. If no word length reaches this PSNR, the longest one is used.
    """
    enough = [cost.bits for cost in costs if cost.scale == "class" and cost.psnr >= ENOUGH_PSNR_DB]
    return in_words(table.layers[-1].weights, min(enough, default=LENGTHS[-1]), "class")


def _drawn_frame(table: TransformTable) -> RawFrame:
    return RawFrame("drawn", drawn_mosaic(table, SHAPE, SEED), table.black_level, table.white_level)


def _outputs(table: TransformTable, frame: RawFrame) -> Callable[[NDArray[np.float32]], NDArray[np.float64]]:
    """Return a function that renders a frame to outputs (output, row, col) with given last-layer weights."""
    reference = ReferenceRenderer(table)
    if not table.later:
        first, labels = table.first, reference.labels(frame)
        return lambda weights: output_planes(frame, labels, table, dataclasses.replace(first, weights=weights))
    last, (planes, refined_labels) = table.later[-1], reference.last_layer(frame)
    return lambda weights: refinement_outputs(planes, refined_labels, dataclasses.replace(last, weights=weights))
