"""Plausibility of a frame's values for a table's camera: mistakes about depth, byte order, black level and size, and
where its colour filter array begins: sites of one channel see alike on average."""

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame, shifted_cfa

BEYOND = 1.5  # times the white level: no saturated pixel lies so far above it …
SHALLOW = 0.55  # of it: nor do pixels of the same depth clip so far below
CLIPPED, FEW = 1e-3, 0.05  # shares of the pixels that have the highest value where a sensor clips; that say something
BELOW = 0.5  # of the black level: pixels without light lie above, since black is there for their noise to have room
NEAR_BLACK = 0.75  # of it, at least, and its inverse at most: what is about black
LEAST_BLACK = 16.0  # DN: of less nothing can be said
DARKEST = 0.1  # percentile of the values: about black in most pictures
SAME_DEPTH = 0.02  # of the white level
TORN = 1.5  # times as much as with rows and columns exchanged that rows may differ by
LINES = 64  # pairs of rows that are compared
SAMPLES = 128  # super-pixels along either axis that are looked at, at most
LEAST_SIGNAL = 1e-3  # of full scale: the mean of a frame below which it is dark


def mistaken(frame: RawFrame, table: TransformTable) -> Iterator[str]:
    """Yield a warning for values that the table's camera hardly gives, as the frame's levels and size are taken."""
    top = int(frame.values.max())
    too_high = top > BEYOND * frame.white_level
    lower = "" if too_high else _clips_lower(frame, top) or _below_black(frame) or _fog(frame, table)
    if text := _too_high(frame, table.bits, top) if too_high else beyond_converter(frame, table) or lower:
        yield text
    if text := _torn(frame, table.cfa.shape[0]):
        yield text


def _too_high(frame: RawFrame, bits: int, top: int) -> str:
    """Return a warning of values beyond the white level, or nothing."""
    every, most = int(np.bitwise_or.reduce(frame.values, axis=None)), 2**bits - 1
    step = every & -every
    if 0 < every & 0xFF <= most >> 8 and bits < 16:
        return f"the bytes of its values are exchanged: no low byte is above {every & 0xFF}; give them lower byte first"
    if step >= 4 and top // step <= most:
        return (
            f"all its values are multiples of {step} and reach {top}, its white level is {frame.white_level:g} DN: they are "
            f"shifted up; divide them by {step}, or give ‹black_level› and ‹white_level› of values as these"
        )
    if top <= most:
        return ""  # it is only called clipped too early
    return (
        f"its values reach {top} DN, its white level is {frame.white_level:g}: they are of another depth, or not raw; "
        "give ‹black_level› and ‹white_level›"
    )


def beyond_converter(frame: RawFrame, table: TransformTable) -> str:
    """Return what to say of values that the table's converter cannot give, of a frame at the table's levels; else ""."""
    most = 2**table.bits - 1
    levels = (frame.black_level, frame.white_level) == (table.black_level, table.white_level)
    if not levels or frame.values.max() <= most:
        return ""
    return (
        f"some of its values are above {most} DN, the most that the table's {table.bits} bits hold, and are taken for "
        "clipped: it is of another depth, or not raw; give ‹black_level› and ‹white_level›"
    )


def _clips_lower(frame: RawFrame, top: int) -> str:
    """Return a warning of values that end at all ones of fewer bits, or nothing."""
    depth = top.bit_length()
    if not (top > frame.black_level and 8 <= depth < 16 and top == 2**depth - 1 and top < SHALLOW * frame.white_level):
        return ""
    share = float((frame.values == top).mean())
    if share < CLIPPED:
        return ""
    return (
        f"{share:.1%} of its pixels have {top} DN and none has more: it clips there, as {depth} bits do, and its "
        f"white level is {frame.white_level:g}; give ‹black_level› and ‹white_level›"
    )


def _below_black(frame: RawFrame) -> str:
    """Return a warning of values further below black than noise explains, or nothing."""
    limit = BELOW * frame.black_level
    share = float((frame.values < limit).mean()) if frame.black_level >= LEAST_BLACK else 0.0
    if share < FEW:
        return ""
    return (
        f"{share:.0%} of its pixels have less than {limit:.0f} DN, its black level is {frame.black_level:g}: black has been "
        "taken off it, or its values are of another depth; give ‹black_level› and ‹white_level›"
    )


def _fog(frame: RawFrame, table: TransformTable) -> str:
    """Return a warning of darkest values where the table's camera has its black, and a black level far below, or nothing."""
    black = table.black_level
    other_depth = abs(frame.white_level - table.white_level) > SAME_DEPTH * table.white_level
    if black < LEAST_BLACK or frame.black_level > black / 2 or other_depth:
        return ""
    darkest = float(np.percentile(frame.values[::3, ::3], DARKEST))
    if not NEAR_BLACK * black <= darkest <= black / NEAR_BLACK:
        return ""
    return (
        f"its darkest values lie at {darkest:.0f} DN, as those of the table's camera, whose black level is {black:g}; with "
        f"{frame.black_level:g} they are fog, and colours pale; leave ‹black_level› out, or give it as {black:g}"
    )


def _torn(frame: RawFrame, period: int) -> str:
    """Return a warning of rows that would follow one another far more smoothly with rows and columns exchanged, or
    nothing."""
    rows, cols = frame.values.shape
    if not frame.exchangeable or rows == cols:
        return ""
    if _step(frame.values, period) <= TORN * _step(frame.values.reshape(cols, rows), period):
        return ""
    return f"{rows}×{cols} pixels tear it, {cols}×{rows} do not; give ‹size› {cols}x{rows}: rows first, then columns"


def _step(values: NDArray[np.uint16], period: int) -> float:
    """Mean difference between rows of the same channels, `period` apart."""
    last = len(values) - period
    if last < 1:
        return 0.0
    first = np.unique(np.linspace(0, last - 1, LINES).astype(int))
    return float(np.abs(values[first + period].astype(np.float32) - values[first]).mean())


def site_means(frame: RawFrame, cfa_shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Mean signal (row, col) in DN above black and dark current of each site of a super-pixel, the frame's first pixel being
    the first, over super-pixels evenly spread."""
    rows, cols = cfa_shape
    down, across = frame.values.shape[0] // rows, frame.values.shape[1] // cols
    whole = frame.values[: down * rows, : across * cols].reshape(down, rows, across, cols)
    some = whole[:: -(-down // SAMPLES)][:, :, :: -(-across // SAMPLES)] if whole.size else whole
    return np.asarray(some.mean(axis=(0, 2)) - frame.black_level - frame.dark) if some.size else np.zeros((rows, cols))


def disagreement(means: NDArray[np.float64], cfa: NDArray[np.uint8], phase: tuple[int, int]) -> float:
    """The largest difference between the means (row, col) of sites of one channel, over the channel's mean."""
    channel = shifted_cfa(cfa, phase)
    seen = [means[channel == each] for each in set(channel.flat)]
    return max(float(np.ptp(of_channel) / max(of_channel.mean(), 1e-9)) for of_channel in seen)


def best_phases(frame: RawFrame, table: TransformTable) -> tuple[float, float, list[tuple[int, int]]]:
    """The disagreement of a frame's sites, the least one that another phase would leave, and the phases that leave about as
    little; zeros and none of dark frames, and of arrays no channel of which has two sites."""
    means = site_means(frame, table.cfa.shape)
    if not means.mean() > LEAST_SIGNAL * (frame.white_level - frame.black_level):
        return 0.0, 0.0, []
    rows, cols = table.cfa.shape
    of_phase = {phase: disagreement(means, table.cfa, phase) for phase in itertools.product(range(rows), range(cols))}
    least = min(of_phase.values())
    return of_phase[frame.phase], least, [phase for phase, each in of_phase.items() if each <= least * 1.5]
