"""Correct row and column offsets without masked pixels (docs/method.md#offsets-from-the-picture).

The following description is for rows. Columns are corrected in the same way, after the rows.

1. *Differences.* For each pair of rows that are one row, or one CFA period, apart, l3 computes the mean difference between
   pixels of the same channel. A pixel difference *votes* (enters the mean) only if noise can explain it and no edge is close
   to it in the same column. Differences at edges, clipped pixels and hot pixels do not vote.
2. *Variance.* The frame is divided into blocks of columns. A row has the same offset in all blocks, so the variance between
   the blocks, beyond the noise of the pixels, is due to the scene. It increases the variance of the mean difference.
3. *Rejection.* Pairs of rows with few votes are left out. Pairs with a mean difference that is too large for row offsets,
   such as the two rows at a horizon, are also left out, together with the pairs directly above and below. Lenses blur edges,
   so the scene also changes there.
4. *Offsets.* The most probable offsets are computed from the differences. Their prior distribution has the mean 0 and the
   variance of the camera's row noise. A slow trend of the differences, as in a sky, is attributed to the scene.
5. *Limits.* The local mean of the offsets is subtracted, because it cannot be distinguished from the scene. If neighbouring
   offsets are larger than the camera's row noise, the scene causes them, and they are reduced.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_LINE_PIXELS, MIN_LINE_PIXELS, QUANTISATION, SMOOTHED_LINES, CameraModel
from l3cli.frames.frame import RawFrame
from l3cli.frames.masked import without_offsets
from l3cli.frames.shading import CLIPPED
from l3cli.physics.mosaic import shifted_cfa, tiled

BLOCKS = 16  # number of blocks of columns
MIN_BLOCK_COLUMNS = 16  # smallest width of a block
MAX_COLUMN_DISTANCE = 2  # largest distance, in columns, between two pixels of the same channel that are compared
# A pixel difference votes if it is at most this many standard deviations. The standard deviation includes pixel noise and
# row offsets.
VOTE = 3.0
# Lenses blur edges. A pixel difference does not vote if an edge starts up to EDGE_ABOVE rows above its upper pixel, or up to
# EDGE_BELOW rows below.
EDGE_ABOVE, EDGE_BELOW = 2, 1
FLAT = 4.0  # two pixels are averaged only if their difference is at most this many standard deviations of the pixel noise
# A pair of lines is left out if noise can explain the differences of a smaller fraction of its unclipped pixels.
MIN_VOTES = 0.5
# The variance between blocks counts several times, because neighbouring blocks often contain the same object.
BLOCK_CORRELATION = 3.0
POOLED_PAIRS = 4  # number of pairs before and after a pair that contribute to its variance between blocks
# A pair's own variance between blocks replaces the pooled variance if it is larger, and if it exceeds its expected value by
# more than this many standard deviations.
SIGNIFICANT = 3.0
MAX_DIFFERENCE = 4.0 * np.sqrt(2)  # largest difference between two lines' offsets, in standard deviations of an offset
TREND_PASSES = 2  # number of times that the trend of the differences is estimated
# Neighbouring offsets are reduced if their mean square exceeds PLAUSIBLE times the variance of the camera's offsets. At
# IMPLAUSIBLE times this variance, they become 0.
PLAUSIBLE, IMPLAUSIBLE = 1.5, 3.0
MAX_OFFSET = 3.0  # largest estimated offset, in standard deviations of an offset
Floats = NDArray[np.float64]
Pixels = NDArray[np.float32]


def without_picture_offsets(frame: RawFrame, camera: CameraModel) -> RawFrame:
    """Subtract the row and column offsets that are estimated from the picture itself. Clipped pixels are unchanged.

    Rows are corrected only if the camera has row noise, and columns only if it has column noise. If the camera has neither,
    or if the frame shows no offsets, the frame is returned unchanged.

    Parameters
    ----------
    frame : RawFrame
        Frame with its gain.
    camera : CameraModel
        Camera of the frame.
    """
    if not camera.has_line_noise:
        return frame
    there = camera.at_gain(frame.gain)
    noise, cfa = there.noise, shifted_cfa(camera.cfa, frame.phase)
    for axis, variance, other in _directions(there):
        span = frame.white_level - frame.black_level
        gain = there.channel_gains * (there.gain * span / (there.white_level - there.black_level))  # (channel) DN per e-
        read = np.full(len(gain), noise.read_noise) if there.readout is None else there.readout.channel_read_noise
        fixed = read**2 + noise.dsnu**2 + QUANTISATION / gain**2 + other
        values, array = (frame.values, cfa) if axis == 0 else (frame.values.T, cfa.T)
        levels = frame.black_level, frame.black_level + CLIPPED * span
        mosaic = _Mosaic.of(values, array, levels, gain, fixed, noise.prnu**2)
        offset = line_offsets(mosaic, variance)
        if offset.any():
            in_dn = offset[:, None] * (gain[0] if there.readout is None else gain[tiled(array, values.shape)])
            frame = without_offsets(frame, in_dn if axis == 0 else in_dn.T)
    return frame


def _directions(camera: CameraModel) -> list[tuple[int, float, float]]:
    """List the axes along which a camera has line offsets (0 for rows, 1 for columns).

    Each entry contains the axis, and the variances of the offsets along this axis and along the other axis in (e-)².
    """
    noise = camera.noise
    rows = noise.row_temporal_noise**2 + noise.row_noise**2
    columns = noise.column_temporal_noise**2 + noise.column_noise**2
    return [each for each in ((0, rows, columns), (1, columns, rows)) if each[1]]


class _Mosaic(NamedTuple):
    """A mosaic in electrons, and the noise of its pixels."""

    electrons: Pixels  # (row, col) signal and dark signal above black; NaN if clipped
    cfa: NDArray[np.uint8]  # (cfa_row, cfa_col)
    fixed: Floats  # (channel) noise variance of a pixel without signal, in (e-)²
    uneven: float  # relative variance of the response of the pixels

    @staticmethod
    def of(
        values: NDArray[np.uint16], cfa: NDArray[np.uint8], levels: tuple[float, float], gain: Floats, fixed: Floats,
        uneven: float,
    ) -> "_Mosaic":  # fmt: skip
        """Convert values in DN to electrons. `levels` are the black level and the lowest value that counts as clipped."""
        black, clipped = levels
        electrons = np.empty(values.shape, np.float32)
        rows, cols = cfa.shape
        for row, col in np.ndindex(cfa.shape):
            part = values[row::rows, col::cols]
            scaled = (part - np.float32(black)) * np.float32(1 / gain[cfa[row, col]])
            scaled[(part == 0) | (part >= clipped)] = np.nan
            electrons[row::rows, col::cols] = scaled
        return _Mosaic(electrons, cfa, fixed, uneven)


class _Differences(NamedTuple):
    """Mean differences between pairs of lines at a distance of `lag` lines."""

    lag: int
    mean: Floats  # (pair) e-
    weight: Floats  # (pair) inverse of the variance, 1/(e-)²; 0 if the pair is left out


def line_offsets(mosaic: _Mosaic, variance: float) -> Floats:
    """Estimate the offset of each row of a mosaic, in electrons.

    Parameters
    ----------
    mosaic : _Mosaic
        The mosaic.
    variance : float
        Variance of the row offsets in (e-)².

    Returns
    -------
    ndarray, (row,)
        Estimated offsets. All 0 if the mosaic is too narrow, or if no pixels can be compared.
    """
    rows, cols = mosaic.electrons.shape
    if cols < MIN_LINE_PIXELS:
        return np.zeros(rows)
    period = len(mosaic.cfa)
    edges = _near_edges(mosaic, variance)
    found = [_differences(mosaic, edges, lag, variance) for lag in sorted({1, period}) if lag < rows]
    if not any(each.weight.any() for each in found):
        return np.zeros(rows)
    trends = [np.zeros(len(each.mean)) for each in found]
    offset = _most_probable(rows, found, trends, variance)
    for _ in range(TREND_PASSES):
        trends = [_trend(each, offset) for each in found]
        offset = _most_probable(rows, found, trends, variance)
    offset -= _local_mean(offset)
    plausible = (IMPLAUSIBLE - _local_mean(offset**2) / variance) / (IMPLAUSIBLE - PLAUSIBLE)
    limit = MAX_OFFSET * np.sqrt(variance)
    return np.asarray(np.clip(offset * np.clip(plausible, 0.0, 1.0), -limit, limit))


def _near_edges(mosaic: _Mosaic, variance: float) -> NDArray[np.bool_]:
    """Return whether each pixel is close to an edge in its column, (row, col).

    An edge starts at a pixel if the pixel one CFA period below differs by more than the noise can explain.
    """
    electrons, period = mosaic.electrons, len(mosaic.cfa)
    rows, cols = electrons.shape
    starts, near = np.zeros((2, rows, cols), bool)
    for phase in range(min(period, rows - period)):
        fixed = mosaic.fixed[np.resize(mosaic.cfa[phase], cols)].astype(np.float32)
        difference, noise = _compare(
            electrons[phase : rows - period : period], electrons[phase + period :: period], fixed, mosaic.uneven
        )
        starts[phase : rows - period : period] = difference**2 > np.float32(2 * VOTE**2) * (noise + np.float32(variance))
    for distance in range(-EDGE_BELOW, EDGE_ABOVE + 1):
        first, last = max(distance, 0), rows + min(distance, 0)
        near[first:last] |= starts[first - distance : last - distance]
    return near


def _compare(upper: Pixels, lower: Pixels, fixed: Pixels | np.float32, uneven: float) -> tuple[Pixels, Pixels]:
    """Return the differences lower − upper in e-, and the noise variance of one pixel in (e-)² at their mean signal."""
    signal = np.maximum(lower + upper, 0) * np.float32(0.5)
    return lower - upper, fixed + signal * (1 + np.float32(uneven) * signal)


def _differences(mosaic: _Mosaic, edges: NDArray[np.bool_], lag: int, variance: float) -> _Differences:
    """Compare the rows of a mosaic with the rows `lag` further down."""
    votes = _count_votes(mosaic, edges, lag, variance)
    mean, error = _mean_of_blocks(votes.weight, votes.weighted)
    enough = (votes.share >= MIN_VOTES) & (error > 0)
    level = mean - _weighted_local_mean(mean, enough.astype(np.float64))
    usual = enough & (np.abs(level) <= MAX_DIFFERENCE * np.sqrt(variance + np.minimum(error / 2, variance)))
    kept = _window_sum(~usual, 1) < 0.5
    return _Differences(lag, mean, np.where(kept, 1 / np.where(kept, error, 1.0), 0.0))


class _Votes(NamedTuple):
    weight: Floats  # (pair, block) sum of the votes' weights, 1/(e-)²
    weighted: Floats  # (pair, block) sum of the votes' weighted differences, 1/e-
    share: Floats  # (pair) fraction of the unclipped pixels whose difference the noise can explain


def _count_votes(mosaic: _Mosaic, edges: NDArray[np.bool_], lag: int, variance: float) -> _Votes:
    """Sum the differences that the noise can explain, weighted by the inverse of their variance.

    Pixels close to `edges` (row, col) do not vote.
    """
    electrons, (period, across) = mosaic.electrons, mosaic.cfa.shape
    rows, cols = electrons.shape
    blocks = min(BLOCKS, cols // MIN_BLOCK_COLUMNS)
    block_starts = np.arange(blocks) * cols // blocks
    step = across * -(-cols // MAX_LINE_PIXELS)
    weight, weighted = np.zeros((2, rows - lag, blocks))
    votes, unclipped = np.zeros((2, rows - lag))
    for row in range(min(period, rows - lag)):
        pairs = slice(row, rows - lag, period)
        upper_rows, lower_rows = electrons[pairs], electrons[row + lag :: period]
        for col, distance in _comparable(mosaic.cfa, row, lag):
            first = col if col >= distance else col + step
            place = np.arange(first, cols - distance, step)
            upper = upper_rows[:, first : cols - distance : step]
            lower, flat = lower_rows[:, first - distance : cols - 2 * distance : step], None
            terms = 2.0
            fixed = np.float32(mosaic.fixed[mosaic.cfa[row, col]])
            if distance:
                right = lower_rows[:, first + distance : cols : step]
                flat, lower, terms = right - lower, (lower + right) * np.float32(0.5), 1.5
            difference, noise = _compare(upper, lower, fixed, mosaic.uneven)
            accepted = difference**2 <= np.float32(VOTE**2) * (np.float32(terms) * noise + np.float32(2 * variance))
            if flat is not None:
                accepted &= flat**2 <= np.float32(2 * FLAT**2) * noise
            votes[pairs] += accepted.sum(axis=1)
            unclipped[pairs] += np.isfinite(difference).sum(axis=1)
            accepted &= ~edges[pairs][:, first : cols - distance : step]
            each = np.where(accepted, 1 / (np.float32(terms) * noise), np.float32(0))
            starts = np.searchsorted(place, block_starts)
            weight[pairs] += np.add.reduceat(each, starts, axis=1, dtype=np.float64)
            weighted[pairs] += np.add.reduceat(
                np.where(accepted, each * difference, np.float32(0)), starts, axis=1, dtype=np.float64
            )
    return _Votes(weight, weighted, votes / np.maximum(unclipped, 1))


def _comparable(cfa: NDArray[np.uint8], row: int, lag: int) -> list[tuple[int, int]]:
    """Return pairs (CFA column, distance) for comparing pixels in a row with the same channel `lag` rows further down.

    A pixel in the CFA column is compared with the mean of two pixels in the lower row, `distance` columns to its left and to
    its right. The distance is 0 if the pixel directly below belongs to the channel.
    """
    period, across = cfa.shape
    below = cfa[(row + lag) % period]
    found = []
    for col in range(across):
        for distance in range(MAX_COLUMN_DISTANCE + 1):
            if {int(below[(col - distance) % across]), int(below[(col + distance) % across])} == {int(cfa[row, col])}:
                found.append((col, distance))
                break
    return found


def _mean_of_blocks(weight: Floats, weighted: Floats) -> tuple[Floats, Floats]:
    """Return the mean difference of each pair and its variance. The variance is 0 for pairs without votes.

    This is a random-effects mean: the variance between blocks is added to the variance of each block (DerSimonian and Laird,
    Controlled Clinical Trials 7, 1986).
    """
    voted = weight > 0
    of_block = weighted / np.where(voted, weight, 1.0)
    total = weight.sum(axis=1)
    positive = np.where(total > 0, total, 1.0)
    mean = weighted.sum(axis=1) / positive
    freedom = np.maximum(voted.sum(axis=1) - 1, 0)
    excess = (weight * (of_block - mean[:, None]) ** 2).sum(axis=1) - freedom
    scale = total - (weight**2).sum(axis=1) / positive
    own = np.maximum(excess, 0.0) / np.where(scale > 0, scale, 1.0)
    pooled_scale = _window_sum(scale, POOLED_PAIRS)
    between = np.maximum(_window_sum(excess, POOLED_PAIRS), 0.0) / np.where(pooled_scale > 0, pooled_scale, 1.0)
    between = np.maximum(between, np.where(excess > SIGNIFICANT * np.sqrt(2 * freedom), own, 0.0))
    variance = 1 / np.where(voted, weight, 1.0) + BLOCK_CORRELATION * between[:, None]
    inverse = np.where(voted, 1 / variance, 0.0)
    whole = inverse.sum(axis=1)
    divisor = np.where(whole > 0, whole, 1.0)
    return (inverse * of_block).sum(axis=1) / divisor, np.where(whole > 0, 1 / divisor, 0.0)


def _most_probable(rows: int, found: list[_Differences], trends: list[Floats], variance: float) -> Floats:
    """Solve for the offsets with the highest posterior probability, given the differences without their trends.

    Differences at several lags contain the same changes of the scene, so their weights are divided by the number of lags.
    """
    from scipy.linalg import solveh_banded  # slow import that only cameras with row or column noise need

    reach = found[-1].lag
    band, right = np.zeros((reach + 1, rows)), np.zeros(rows)  # upper form: the last row of `band` is the diagonal
    band[-1] = 1 / variance
    for each, trend in zip(found, trends, strict=True):
        lag, weight = each.lag, each.weight / len(found)
        band[-1, :-lag] += weight
        band[-1, lag:] += weight
        band[reach - lag, lag:] -= weight
        right[:-lag] -= weight * (each.mean - trend)
        right[lag:] += weight * (each.mean - trend)
    return np.asarray(solveh_banded(band, right))


def _trend(found: _Differences, offset: Floats) -> Floats:
    """Return the weighted local mean of the differences that the offsets do not explain."""
    lag = found.lag
    return _weighted_local_mean(found.mean - (offset[lag:] - offset[:-lag]), found.weight)


def _local_mean(values: Floats) -> Floats:
    """Return the mean over SMOOTHED_LINES lines around each line, or over the part of them that exists."""
    return _weighted_local_mean(values, np.ones(len(values)))


def _weighted_local_mean(values: Floats, weight: Floats) -> Floats:
    total = _window_sum(weight, SMOOTHED_LINES // 2)
    return _window_sum(weight * values, SMOOTHED_LINES // 2) / np.where(total > 0, total, 1.0)


def _window_sum(values: Floats, half: int) -> Floats:
    """Return the sum over each value and the `half` values before and after it."""
    return np.convolve(values, np.ones(2 * half + 1))[half : half + len(values)]
