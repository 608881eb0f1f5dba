"""Measure sensor noise as defined in EMVA 1288 (docs/method.md#dark-and-white-frames).

Temporal variances come from differences between two frames, in which the fixed pattern cancels. Spatial variances come from
averaged frames, and are corrected for the remaining temporal noise. Hot and dead pixels are excluded.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION
from l3cli.artifacts.fit import Nonuniformity
from l3cli.calibration import agreement
from l3cli.calibration.nonuniformity import NoiseLeft, centred, describe
from l3cli.calibration.statistics import (
    LEAST_LOSS,
    Defects,
    Each,
    Level,
    LineSquares,
    by_site,
    channel_shares,
    joined_defects,
    line_squares,
    mean_squares,
    mean_value,
    measure_level,
    no_defects,
    outliers,
    patched,
    pixel_variance,
    pooled,
    share_from,
    weighted_sums,
)
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, Capture

SATURATED = 0.985  # pixels at or above this fraction of full scale are saturated
TOLERATED = 1e-4  # variances are computed only from frames with at most this fraction of saturated pixels
LINEAR = (0.05, 0.95)  # fractions of saturation between which EMVA 1288 evaluates linearity
CHANCE = 0.01  # significance level of the tests for row noise and column noise
# Side of the window for local means, in samples of one CFA site. With more than 9 samples, dust would increase the PRNU.
WINDOW = 7
# A sample is part of its own local mean. This reduces the variance of deviations from local means to these fractions, for
# pixel noise and for line noise (row or column noise).
PIXELS_LEFT, LINES_LEFT = 1.0 - 1.0 / WINDOW**2, 1.0 - 1.0 / WINDOW
# Neighbouring lines' deviations from local means are correlated, which reduces the effective number of independent lines by
# this factor. It is the sum of squared autocorrelation coefficients, for white noise minus its moving average over 7
# samples.
LINE_CORRELATION = 1.0 + 2.0 * (8**2 + 9**2 + 10**2 + 3**2 + 2**2 + 1**2) / 42**2
Array = NDArray[np.float64]


@dataclass(frozen=True)
class DarkNoise:
    """Noise measured in dark frames. All arrays except `hot` contain one value per channel."""

    black_level: Array  # DN; mean value at zero exposure time
    slope: Array  # DN/s; dark signal per second of exposure
    variance: Array  # DN²; temporal variance at zero exposure time, without quantisation noise
    dsnu: Array  # DN
    hot: Defects = field(default_factory=no_defects)
    pixel_variance: Array | None = None  # DN²; part of `variance` that pixels do not share with their row or column
    dsnu_error: Array | None = None  # DN; standard error of `dsnu`
    # temporal row and column noise in the channels with the lowest gain; included in `variance`
    rows: "LineNoise" = field(default_factory=lambda: LineNoise(0.0, 0.0))
    columns: "LineNoise" = field(default_factory=lambda: LineNoise(0.0, 0.0))
    # fixed row and column offsets in the channels with the lowest gain; not included in `dsnu`
    fixed_rows: "LineNoise" = field(default_factory=lambda: LineNoise(0.0, 0.0))
    fixed_columns: "LineNoise" = field(default_factory=lambda: LineNoise(0.0, 0.0))
    trials: tuple[int, ...] = ()  # number of frames of each capture
    # DN²/s; increase in the pixels' temporal variance per second of exposure, and its standard error
    variance_slope: Array | None = None
    variance_slope_error: Array | None = None
    pattern: Nonuniformity | None = None  # spectra, profiles and histograms, in DN at the lowest channel gain


@dataclass(frozen=True)
class LineNoise:
    """Noise that all pixels of a row or column share. If it is not significant, both values are 0."""

    deviation: float  # DN for offsets, relative to the response for PRNU
    error: float  # standard error of `deviation`, in the same unit


@dataclass(frozen=True)
class ResponseNoise:
    """PRNU and dead pixels, measured from each pixel's response to light."""

    prnu: Array  # (channel,): relative standard deviation of the response, including rows and columns
    prnu_error: Array  # (channel,): standard error of `prnu`
    rows: LineNoise  # part of the PRNU that all pixels of a row share
    columns: LineNoise  # part of the PRNU that all pixels of a column share
    dead: Defects  # pixels with a response at least 10 % above or below the local mean
    slopes: Array  # (row, col): response in DN/s, interpolated at defective pixels
    pattern: Nonuniformity | None = None  # spectra, profiles and histograms, as fractions


@dataclass(frozen=True)
class PhotonTransfer:
    """The photon transfer curve, measured in white frames, and the quantities derived from it."""

    mean: Array  # (exposure, channel): mean signal above black in DN
    variance: Array  # (exposure, channel): temporal variance in DN²
    used: NDArray[np.bool_]  # (exposure, channel): whether the signal is below saturation
    white_level: float  # raw value of saturated pixels in DN
    white_level_reached: bool  # whether a frame saturates; if not, the white level is the maximum of the converter
    gain: Array  # (channel,): conversion gain K in DN/e-
    gain_error: Array  # (channel,): standard deviation of K in DN/e-
    linearity_error: Array  # (channel,): linearity error LE of EMVA 1288, as a fraction


# ------------------------------------------------------------------------------------------------------------ dark


def line_weights(exposures: Array) -> tuple[Array, Array]:
    """Return the weights with which measured values enter a linear regression over exposure time.

    Returns
    -------
    intercept, slope : ndarray, (exposure,)
        Weights for the intercept and for the slope of the fitted line.
    """
    centred = exposures - exposures.mean()
    slope = centred / (centred @ centred)
    return 1.0 / exposures.size - exposures.mean() * slope, slope


def dark_noise(captures: Sequence[Capture], body: Body, each: Each = map) -> DarkNoise:
    """Measure black level, dark signal, read noise, DSNU and hot pixels in dark frames.

    The DSNU is computed in three steps:

    1. The temporal variance is computed from differences between frames. It contains all noise that changes from frame to
       frame, including row and column noise. It also determines the read noise.
    2. The spatial variance is the variance of the mean frame, extrapolated to zero exposure time, minus the variances of row
       and column means (`fixed_line_noise` measures these separately). It consists of the DSNU and of temporal noise that
       averaging did not remove.
    3. This remaining temporal noise is subtracted. It is the temporal variance of the pixels, without row and column noise,
       divided by the number of frames.

    Raises
    ------
    InputFileError
        If all frames have the same exposure time, or if a capture contradicts the others.
    """
    exposures = np.array([capture.exposure for capture in captures])
    if np.unique(exposures).size < 2:
        raise InputFileError(
            "all dark frames have the same exposure time; use two or more exposure times, up to about 1 s, so that the "
            "dark current can be measured"
        )
    intercept, slope = line_weights(exposures)
    weights = np.repeat(np.stack([intercept, slope])[..., None], len(body.channels), axis=2)
    offsets, slopes = weighted_sums(captures, weights, body, each)
    hot = joined_defects(outliers(offsets, body.cfa), outliers(slopes, body.cfa))
    unpatched, offsets = offsets, patched(offsets, body.cfa, hot)
    levels = list(each(functools.partial(measure_level, body=body, defects=hot), captures))
    mean = np.array([mean_value(level.counts) for level in levels])
    squares = [level.lines for level in levels]
    of_means = [(each.rows + each.columns) / (body.rows * body.cols) for each in squares]
    agreement.check_darks(captures, mean.mean(axis=1), float(np.sqrt(max(of_means))))
    variance = np.array([level.variance for level in levels])
    trials = np.array([level.trials for level in levels])
    kept = intercept**2 / trials  # fraction of each exposure's temporal variance that remains in `offsets`
    of_pixels = np.array([level.pixel_variance for level in levels])
    left = kept @ of_pixels
    spatial = pooled([pixel_variance(site) for _, site in by_site(offsets, body.cfa)], body.cfa)
    pixels = channel_shares(body) * body.rows * body.cols
    spread = 2 * (spatial**2 + (kept**2 / (trials // 2)) @ of_pixels**2) / pixels  # squared error of `spatial` − `left`
    dsnu = np.sqrt(np.maximum(spatial - left, 0.0))
    fixed = mean_squares([line_squares(offsets, body)], body)
    row_squares = [(each.rows, each.pixels, each.row_freedom) for each in squares]
    column_squares = [(each.columns, each.pixels, each.column_freedom) for each in squares]
    picture, repaired = (centred(each, offsets, body, relative=False) for each in (unpatched, offsets))
    temporal = _noise_left(kept, squares, float(kept @ [each.pixels for each in squares]), body)
    return DarkNoise(
        black_level=intercept @ mean,
        slope=slope @ mean,
        variance=np.maximum(intercept @ variance - QUANTISATION, 0.0),
        dsnu=dsnu,
        hot=hot,
        pixel_variance=np.maximum(intercept @ of_pixels - QUANTISATION, 0.0),
        dsnu_error=error_of_root(dsnu, np.sqrt(spread)),
        rows=line_noise(row_squares, body.cols),
        columns=line_noise(column_squares, body.rows),
        fixed_rows=fixed_line_noise((fixed.rows, fixed.pixels, fixed.row_freedom), row_squares, kept, body.cols),
        fixed_columns=fixed_line_noise((fixed.columns, fixed.pixels, fixed.column_freedom), column_squares, kept, body.rows),
        trials=tuple(level.trials for level in levels),
        variance_slope=slope @ of_pixels,
        variance_slope_error=np.sqrt(slope**2 @ (2 * of_pixels**2 / ((trials // 2)[:, None] * pixels))),
        pattern=describe(picture, repaired, picture, temporal),
    )


def _noise_left(kept: Array, squares: Sequence[LineSquares], pixels: float, body: Body) -> NoiseLeft:
    """Return the temporal noise that remains in a mean of captures.

    `kept` contains the fraction of each capture's temporal variance that remains, and `pixels` is the remaining pixel
    variance.
    """
    rows = float(kept @ [each.rows - each.pixels for each in squares]) / body.cols
    columns = float(kept @ [each.columns - each.pixels for each in squares]) / body.rows
    return NoiseLeft(pixels, max(rows, 0.0), max(columns, 0.0))


def error_of_root(deviation: Any, error: Any) -> Any:
    """Convert a variance's standard error to the standard error of the standard deviation.

    Where `deviation` is close to 0, the result is limited to √`error`.
    """
    return np.sqrt(error) * np.minimum(np.sqrt(error) / np.maximum(2 * np.asarray(deviation), np.finfo(float).tiny), 1.0)


def line_noise(squares: Sequence[tuple[float, float, int]], pixels: int) -> LineNoise:
    """Estimate temporal row or column noise (docs/method.md#row-and-column-noise).

    A line is a row or a column. A chi-squared test compares the mean square of the lines with the mean square of the pixels.
    The noise is significant if, in a sensor without line noise, a ratio at least as large as the measured ratio would occur
    with a probability of at most `CHANCE`. Fixed patterns have no effect, because the mean squares come from differences
    between frames.

    Parameters
    ----------
    squares : sequence of (float, float, int)
        For each exposure time: mean square of the lines, mean square of the pixels, and degrees of freedom of the lines, as
        in `LineSquares`.
    pixels : int
        Number of pixels in a line.
    """
    from scipy.special import chdtrc

    lines, independent, freedom = np.array(squares, np.float64).T
    known = (independent > 0) & (freedom > 0)
    lines, independent, freedom = lines[known], independent[known], freedom[known]
    if not lines.size or chdtrc(freedom.sum(), float(freedom @ (lines / independent))) > CHANCE:
        return LineNoise(0.0, 0.0)
    weight = freedom / independent**2
    weight /= weight.sum()
    variance = float(weight @ (lines - independent)) / pixels
    error = float(np.sqrt((weight * lines) ** 2 @ (2 / freedom))) / pixels
    deviation = np.sqrt(max(variance, 0.0))
    return LineNoise(float(deviation), float(error / (2 * deviation)) if deviation else 0.0)


def fixed_line_noise(
    fixed: tuple[float, float, float], temporal: Sequence[tuple[float, float, int]], kept: Array, pixels: int
) -> LineNoise:
    """Estimate fixed row or column noise in a mean frame (docs/method.md#row-and-column-noise).

    Without fixed line noise, the expected mean square of the lines is the mean square of the pixels, plus the temporal line
    noise that remains after averaging. The line noise is significant if an F test rejects this hypothesis at the level
    `CHANCE`.

    Parameters
    ----------
    fixed : (float, float, float)
        In the mean frame: mean square of the lines, mean square of the pixels, and degrees of freedom of the lines.
    temporal : sequence of (float, float, int)
        The same three values for each capture's temporal noise, as in `line_noise`.
    kept : ndarray, (capture,)
        Fraction of each capture's temporal line noise variance that remains in the mean frame.
    pixels : int
        Number of pixels in a line.

    Returns
    -------
    LineNoise
        Fixed line noise. The standard error accounts for the finite number of lines.
    """
    from scipy.special import fdtrc

    lines, independent, freedom = fixed
    of_lines, of_pixels, freedoms = np.array(temporal, np.float64).T
    expected = max(independent + float(kept @ (of_lines - of_pixels)), 0.0)
    spread = float(kept**2 @ (2 * of_lines**2 / np.maximum(freedoms, 1)))  # squared error of `expected`
    if freedom <= 0 or lines <= expected:
        return LineNoise(0.0, 0.0)
    if expected > 0 and spread > 0 and fdtrc(freedom, 2 * expected**2 / spread, lines / expected) > CHANCE:
        return LineNoise(0.0, 0.0)
    deviation = np.sqrt((lines - expected) / pixels)
    error = np.sqrt(2 * lines**2 / freedom + spread) / pixels
    return LineNoise(float(deviation), float(error_of_root(deviation, error)))


# ----------------------------------------------------------------------------------------------------------- white


def photon_transfer(levels: Sequence[Level], body: Body, dark: DarkNoise) -> PhotonTransfer:
    """Determine the conversion gain from the photon transfer curve.

    The gain is the slope of the temporal variance over the mean signal. Exposures beyond the maximum variance are ignored,
    because the variance falls when the well or the converter saturates (docs/method.md#dark-and-white-frames).

    Parameters
    ----------
    levels : sequence of Level
        Statistics of the white captures, sorted by exposure time.
    body : Body
        Channels and bit depth of the camera.
    dark : DarkNoise
        Noise measured in dark frames.

    Raises
    ------
    InputFileError
        If a channel has fewer than two exposure times below saturation, or if the frames contain no photon noise.
    """
    mean = np.array([mean_value(level.counts) for level in levels]) - dark.black_level
    variance = np.array([level.variance for level in levels])
    if not variance.max(axis=0).all():
        raise InputFileError(
            "the white frames contain no noise, because they are saturated or are copies of one frame; use other white "
            "frames"
        )
    white_level, reached = saturation(levels, variance, 2**body.bits - 1)
    limit = dark.black_level.mean() + SATURATED * (white_level - dark.black_level.mean())
    clipped = np.array([share_from(level.counts, limit) for level in levels]) > TOLERATED
    before_fall = np.arange(len(levels))[:, None] <= variance.argmax(axis=0)
    used = before_fall & ~clipped & (variance > 0)
    lines = []
    for channel, name in enumerate(body.channels):
        chosen = [level for level, usable in zip(levels, used[:, channel], strict=True) if usable]
        if len({level.exposure for level in chosen}) < 2:
            raise InputFileError(
                f"channel {name} needs white frames with at least two exposure times below saturation, but has "
                f"{len({level.exposure for level in chosen})}; add shorter exposures"
            )
        lines.append(_transfer_line(chosen, mean[used[:, channel], channel], channel))
    gain, error = np.array(lines).T
    if gain.min() <= 0:
        raise InputFileError(
            "the noise of the white frames does not increase with exposure time; check the frames and their exposure times"
        )
    linearity = linearity_errors(levels, mean, used, dark, white_level)
    return PhotonTransfer(mean, variance, used, white_level, reached, gain, error, linearity)


def _transfer_line(levels: Sequence[Level], mean: Array, channel: int) -> tuple[float, float]:
    """Fit one channel's photon transfer curve with a line, and return the slope and its standard deviation.

    The weights follow from the relative standard deviation of a variance estimated from n samples, √(2/n).
    """
    variance = np.array([level.variance[channel] for level in levels])
    samples = np.array([level.counts[channel].sum() / level.trials * (level.trials // 2) for level in levels])
    line, covariance = np.polyfit(mean, variance, 1, w=np.sqrt(samples / 2.0) / variance, cov="unscaled")
    return float(line[0]), float(np.sqrt(covariance[0, 0]))


def linearity_errors(
    levels: Sequence[Level], mean: Array, used: NDArray[np.bool_], dark: DarkNoise, white_level: float
) -> Array:
    """Return the linearity error of each channel (LE in EMVA 1288), as a fraction.

    LE is the signal's mean relative deviation from a line. If fewer than three exposures are usable, it is set to 0.
    """
    lit, exposure = np.array([(level.lit, level.exposure) for level in levels]).T
    errors = []
    for channel, signal in enumerate((mean - dark.slope * exposure[:, None]).T):
        share = mean[:, channel] / (white_level - dark.black_level[channel])
        chosen = used[:, channel] & (share >= LINEAR[0]) & (share <= LINEAR[1]) & (signal > 0)
        errors.append(linearity_error(lit[chosen], signal[chosen]) if chosen.sum() > 2 else 0.0)
    return np.array(errors)


def linearity_error(lit: Array, signal: Array) -> float:
    """Return the mean absolute relative deviation of `signal` from a line over the exposure times `lit`.

    The line minimises the squared relative deviations.
    """
    line = np.polyval(np.polyfit(lit, signal, 1, w=1.0 / signal), lit)
    return float(np.mean(np.abs(signal / line - 1.0)))


def saturation(levels: Sequence[Level], variance: Array, top: int) -> tuple[float, bool]:
    """Return the white level in DN, and whether the longest exposure reaches it.

    A channel is saturated if its variance at the longest exposure is at most half its maximum variance. The white level is
    the median value of the channel with the strongest drop in variance. If no channel is saturated, the white level is
    `top`, the converter's maximum.
    """
    fallen = variance[-1] / variance.max(axis=0)
    channel = int(fallen.argmin())
    if fallen[channel] > 0.5:
        return float(top), False
    cumulated = levels[-1].counts[channel].cumsum()
    return float(np.searchsorted(cumulated, cumulated[-1] / 2)), True


def response_noise(
    captures: Sequence[Capture],
    levels: Sequence[Level],
    used: NDArray[np.bool_],
    body: Body,
    dark: DarkNoise,
    each: Each = map,
) -> ResponseNoise:
    """Measure the PRNU and find dead pixels.

    A pixel's response is the slope of its signal over exposure time. The PRNU is the relative standard deviation of the
    responses around their local means. Uneven light does not increase the PRNU, because it affects a response and the local
    mean equally.

    Parameters
    ----------
    captures : sequence of Capture
        White captures.
    levels : sequence of Level
        Statistics of the captures.
    used : ndarray of bool, (capture, channel)
        Whether the channel is below saturation in the capture.
    body : Body
        Size, CFA and channels of the camera.
    dark : DarkNoise
        Noise measured in dark frames.
    each : callable
        Function with the signature of the built-in `map`, which may use several processes.
    """
    weights = np.zeros(used.shape)
    for channel in range(used.shape[1]):
        chosen = used[:, channel]
        weights[chosen, channel] = line_weights(np.array([level.lit for level in levels])[chosen])[1]
    trials = np.array([level.trials for level in levels])
    unpatched = weighted_sums(captures, weights[None], body, each)[0]
    dead, slopes = dead_pixels(patched(unpatched, body.cfa, dark.hot), body.cfa)
    deviations = [relative_deviation(site) for _, site in by_site(slopes, body.cfa)]
    rows, columns = _response_lines(deviations, levels, weights / trials[:, None] ** 0.5, body)
    lines = any(line.deviation for line in (dark.rows, dark.columns, rows, columns))
    variance = np.array([level.pixel_variance if lines else level.variance for level in levels])
    temporal = (weights**2 * variance / trials[:, None]).sum(axis=0)
    measure = _spread_of_pixels if lines else _spread
    spread = pooled([measure(each) for each, _ in deviations], body.cfa)
    inverse = pooled([float(np.mean(1.0 / local**2)) for _, local in deviations], body.cfa)
    found = np.sqrt(np.maximum(spread - temporal * inverse, 0.0) + rows.deviation**2 + columns.deviation**2)
    pixels = channel_shares(body) * body.rows * body.cols
    squares = 2 * spread**2 / pixels + sum((2 * line.deviation * line.error) ** 2 for line in (rows, columns))
    error = error_of_root(found, np.sqrt(squares))
    pattern = _response_pattern(unpatched, slopes, levels, weights / trials[:, None] ** 0.5, body)
    return ResponseNoise(found, error, rows, columns, dead, slopes, pattern)


def _response_pattern(unpatched: Array, slopes: Array, levels: Sequence[Level], weights: Array, body: Body) -> Nonuniformity:
    """Compute the spectra, profiles and histograms of the PRNU.

    The spectra and profiles include lens shading. The histograms show deviations from local means. The last three parameters
    are the same as in `_response_lines`.
    """
    sites = list(by_site(slopes, body.cfa))
    # (capture, site): relative change in response per DN of deviation in a capture
    scale = np.stack([weights[:, channel] / site.mean() for channel, site in sites], axis=1)
    of_pixels = np.stack([[level.pixel_variance[channel] for level in levels] for channel, _ in sites], axis=1)
    of_lines = (scale * body.channel_gains[[channel for channel, _ in sites]]) ** 2
    left = _noise_left(
        of_lines.mean(axis=1), [each.lines for each in levels], float((scale**2 * of_pixels).sum() / len(sites)), body
    )
    picture, repaired = (centred(each, slopes, body, relative=True) for each in (unpatched, slopes))
    return describe(picture, repaired, _over_local_mean(unpatched, slopes, body.cfa), left)


def _spread(deviation: Array) -> float:
    """Return one CFA site's response variance, estimated from relative deviations from local means."""
    return float(np.mean(deviation**2)) / PIXELS_LEFT


def _spread_of_pixels(deviation: Array) -> float:
    """Return one CFA site's response variance, without the part that all pixels of a row or column share."""
    centred = deviation - deviation.mean()
    lines = sum(float(np.mean(centred.mean(axis=axis) ** 2)) for axis in (0, 1))
    return (float(np.mean(centred**2)) - lines) / (PIXELS_LEFT - LINES_LEFT * sum(1 / count for count in deviation.shape))


def relative_deviation(site: Array) -> tuple[Array, Array]:
    """Return each pixel's relative deviation from its local mean, and the local mean, for one CFA site.

    Both arrays exclude the border pixels, where the averaging window would extend beyond the frame.
    """
    inner = slice(WINDOW // 2, -(WINDOW // 2))
    local = _local_mean(site)[inner, inner]
    return site[inner, inner] / local - 1.0, local


def _response_lines(
    deviations: Sequence[tuple[Array, Array]], levels: Sequence[Level], weights: Array, body: Body
) -> tuple[LineNoise, LineNoise]:
    """Estimate the PRNU of rows and columns: differences in response that all pixels of a row or column share.

    Parameters
    ----------
    deviations : sequence of (ndarray, ndarray)
        Result of `relative_deviation` for each CFA site.
    levels : sequence of Level
        Statistics of the white captures.
    weights : ndarray, (capture, channel)
        Weight of each capture in the response, divided by the square root of its number of frames.
    body : Body
        Size, CFA and channel gains of the camera.
    """
    down, across = body.cfa.shape
    shape = (body.rows - (WINDOW - 1) * down, body.cols - (WINDOW - 1) * across)
    deviation = np.empty(shape)
    # (capture, cfa_row, cfa_col): relative change in response per DN of offset in a capture
    scale = np.empty((len(levels), down, across))
    places = zip(deviations, by_site(deviation, body.cfa), np.ndindex(down, across), strict=True)
    for (relative, local), (channel, target), (row, col) in places:
        target[...] = relative - relative.mean()
        scale[:, row, col] = weights[:, channel] * body.channel_gains[channel] / local.mean()
    row_square, column_square = (float(np.mean(deviation.mean(axis=axis) ** 2)) / LINES_LEFT for axis in (1, 0))
    of_pixels = _spread_of_pixels(deviation)
    lines = [level.lines for level in levels]
    return (
        fixed_line_noise(
            (row_square * shape[1], of_pixels, (shape[0] - down) / LINE_CORRELATION),
            [(each.rows, each.pixels, each.row_freedom) for each in lines],
            (scale.mean(axis=2) ** 2).mean(axis=1) * shape[1] / body.cols,
            shape[1],
        ),
        fixed_line_noise(
            (column_square * shape[0], of_pixels, (shape[1] - across) / LINE_CORRELATION),
            [(each.columns, each.pixels, each.column_freedom) for each in lines],
            (scale.mean(axis=1) ** 2).mean(axis=1) * shape[0] / body.rows,
            shape[0],
        ),
    )


def dead_pixels(response: Array, cfa: NDArray[np.uint8]) -> tuple[Defects, Array]:
    """Find pixels with a response at least 10 % above or below the local mean.

    The search runs twice. The second time, the local means exclude the pixels from the first search. Otherwise, intact
    pixels next to a defective row or cluster would also be found.

    Returns
    -------
    dead : ndarray, (defect, 2)
        Row and column of each dead pixel.
    response : ndarray, (row, col)
        The response, interpolated at dead pixels.
    """
    suspect = outliers(_over_local_mean(response, response, cfa), cfa, LEAST_LOSS)
    if not suspect.size:
        return suspect, response
    corrected = patched(response, cfa, suspect)
    dead = outliers(_over_local_mean(response, corrected, cfa), cfa, LEAST_LOSS)
    return dead, patched(response, cfa, dead)


def _local_mean(site: Array) -> Array:
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(site, WINDOW), dtype=np.float64)


def _over_local_mean(picture: Array, patched: Array, cfa: NDArray[np.uint8]) -> Array:
    """Return each pixel's relative deviation from its local mean. The local means are computed from `patched`."""
    deviation = np.empty_like(picture)
    for (_, into), (_, site), (_, whole) in zip(
        *(by_site(each, cfa) for each in (deviation, picture, patched)), strict=True
    ):
        into[...] = site / _local_mean(whole) - 1.0
    return deviation
