"""Noise of a sensor from stacks of frames: photon transfer, dark current, DSNU, PRNU (METHOD 1.4 (3), 1.5; EMVA 1288).

Every temporal variance comes from differences of frames taken in pairs, in which the fixed pattern cancels; every spatial
one has the variance of its own estimator subtracted.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.measurement import Body, Capture

QUANTISATION = 1.0 / 12.0  # DN², variance of rounding
SATURATED = 0.985  # share of the span from black to white that counts as saturated
TOLERATED = 1e-4  # share of saturated pixels that leaves a variance unharmed
WINDOW = 7  # samples of one CFA site that make a local mean: 5–9, wider ones see dust as pattern (METHOD 1.5)
Array = NDArray[np.float64]
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class Level:
    """Statistics of the frames of one exposure."""

    exposure: float  # s
    trials: int
    counts: Counts  # (channel, value) pixels of all frames
    variance: Array  # (channel) DN², temporal


@dataclass(frozen=True)
class DarkNoise:
    """What lens-cap frames tell, each (channel)."""

    black: Array  # DN at zero exposure
    slope: Array  # DN/s
    variance: Array  # DN² at zero exposure, quantisation taken out
    dsnu: Array  # DN


@dataclass(frozen=True)
class PhotonTransfer:
    """Temporal variance against signal of the white frames."""

    mean: Array  # (level, channel) DN above black
    variance: Array  # (level, channel) DN²
    used: NDArray[np.bool_]  # (level, channel) below saturation
    white: float  # DN at which pixels saturate
    white_reached: bool  # False: no frame saturates, white is the converter's top
    gain: Array  # (channel) DN/e-, conversion gain K


# ------------------------------------------------------------------------------------------------ frame statistics


def by_site(values: NDArray, cfa: NDArray[np.uint8]) -> Iterator[tuple[int, NDArray]]:
    """(channel, the pixels of one site of the super-pixel as a picture of their own), site by site."""
    rows, cols = cfa.shape
    for row in range(rows):
        for col in range(cols):
            yield int(cfa[row, col]), values[row::rows, col::cols]


def pooled(per_site: Sequence[float], cfa: NDArray[np.uint8]) -> Array:
    """(channel) mean over its sites of one figure a site, sites in the order of `by_site`."""
    count = np.bincount(cfa.ravel())
    return np.bincount(cfa.ravel(), weights=np.asarray(per_site, dtype=np.float64)) / count


def histogram(values: NDArray[np.uint16], body: Body) -> Counts:
    """(channel, value) how many pixels of each channel have each value."""
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    for channel, site in by_site(values, body.cfa):
        counts[channel] += np.bincount(site.ravel(), minlength=2**body.bits)
    return counts


def count_values(capture: Capture, body: Body) -> Counts:
    """(channel, value) histogram of all frames of a capture."""
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    for frame in capture.frames:
        counts += histogram(frame, body)
    return counts


def mean_value(counts: Counts) -> Array:
    """(channel) mean DN of a histogram (channel, value)."""
    return counts @ np.arange(counts.shape[1]) / counts.sum(axis=1)


def share_from(counts: Counts, value: float) -> Array:
    """(channel) share of the pixels that lie at `value` DN or above."""
    return counts[:, int(np.ceil(value)) :].sum(axis=1) / counts.sum(axis=1)


def measure_level(capture: Capture, body: Body) -> Level:
    """Histogram and temporal variance of a capture of even light or none; InputFileError if it is a single frame.

    The variance is half that of the difference of two frames, centred, so that neither fixed pattern nor a drift of the
    lamp or of the black level enters; frames 1 and 2 make a pair, 3 and 4 the next.
    """
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    variances, trials = [], 0
    previous = None
    for frame in capture.frames:
        counts += histogram(frame, body)
        trials += 1
        if previous is None:
            previous = frame.astype(np.int32)
            continue
        variances.append(
            pooled([site.var(dtype=np.float64) / 2 for _, site in by_site(previous - frame, body.cfa)], body.cfa)
        )
        previous = None
    if not variances:
        raise InputFileError(f"{capture.name} is a single frame; noise needs two or more of each exposure")
    return Level(capture.exposure, trials, counts, np.mean(variances, axis=0))


def weighted_sum(captures: Sequence[Capture], weights: Array, body: Body) -> Array:
    """Picture (row, col): Σ over captures of weights (capture, channel) × mean frame, read one by one."""
    total = np.zeros((body.rows, body.cols))
    for capture, weight in zip(captures, weights, strict=True):
        if not weight.any():
            continue
        stack, trials = np.zeros((body.rows, body.cols), dtype=np.uint32), 0
        for frame in capture.frames:
            stack += frame
            trials += 1
        sums = zip(by_site(total, body.cfa), by_site(stack, body.cfa), strict=True)
        for (channel, into), (_, mean) in sums:
            into += mean * (weight[channel] / trials)
    return total


# ------------------------------------------------------------------------------------------------------------ dark


def line_weights(exposures: Array) -> tuple[Array, Array]:
    """Weights (level) whose sums with values give intercept and slope of the least-squares line over `exposures`."""
    centred = exposures - exposures.mean()
    slope = centred / (centred @ centred)
    return 1.0 / exposures.size - exposures.mean() * slope, slope


def dark_noise(captures: Sequence[Capture], body: Body) -> DarkNoise:
    """Black level, dark signal, read noise and DSNU from lens-cap frames; InputFileError without two exposures."""
    exposures = np.array([capture.exposure for capture in captures])
    if np.unique(exposures).size < 2:
        raise InputFileError("the dark frames have a single exposure; dark current needs two or more, up to a second")
    levels = [measure_level(capture, body) for capture in captures]
    intercept, slope = line_weights(exposures)
    mean = np.array([mean_value(level.counts) for level in levels])
    variance = np.array([level.variance for level in levels])
    offsets = weighted_sum(captures, np.repeat(intercept[:, None], len(body.channels), axis=1), body)
    own = (intercept**2 / [level.trials for level in levels]) @ variance
    spatial = pooled([_pixel_variance(site) for _, site in by_site(offsets, body.cfa)], body.cfa)
    return DarkNoise(
        black=intercept @ mean,
        slope=slope @ mean,
        variance=np.maximum(intercept @ variance - QUANTISATION, 0.0),
        dsnu=np.sqrt(np.maximum(spatial - own, 0.0)),
    )


def _pixel_variance(site: Array) -> float:
    """Variance of a picture without what its rows and columns have in common (column noise is no DSNU of pixels)."""
    centred = site - site.mean(axis=0, keepdims=True)
    centred -= centred.mean(axis=1, keepdims=True)
    rows, cols = site.shape
    return float((centred**2).sum() / max((rows - 1) * (cols - 1), 1))


# ----------------------------------------------------------------------------------------------------------- white


def photon_transfer(levels: Sequence[Level], body: Body, dark: DarkNoise) -> PhotonTransfer:
    """Conversion gain from the photon-transfer line of white levels sorted by exposure (METHOD 1.5).

    Saturation is where the variance falls, be it the well or the converter; levels from there on stay out.
    InputFileError if a channel has fewer than two levels below saturation.
    """
    mean = np.array([mean_value(level.counts) for level in levels]) - dark.black
    variance = np.array([level.variance for level in levels])
    if not variance.max(axis=0).all():
        raise InputFileError("the white frames hold no noise: all are saturated, or copies of one frame; take them again")
    white, reached = saturation(levels, variance, 2**body.bits - 1)
    limit = dark.black.mean() + SATURATED * (white - dark.black.mean())
    clipped = np.array([share_from(level.counts, limit) for level in levels]) > TOLERATED
    before_fall = np.arange(len(levels))[:, None] <= variance.argmax(axis=0)
    used = before_fall & ~clipped & (variance > 0)
    gains = []
    for channel, name in enumerate(body.channels):
        chosen = used[:, channel]
        exposures = {level.exposure for level, usable in zip(levels, chosen, strict=True) if usable}
        if len(exposures) < 2:
            raise InputFileError(
                f"channel {name} has {len(exposures)} white exposures below saturation; give two or more, shorter ones"
            )
        # The error of a variance is proportional to it, hence the weights.
        line = np.polyfit(mean[chosen, channel], variance[chosen, channel], 1, w=1.0 / variance[chosen, channel])
        gains.append(line[0])
    if min(gains) <= 0:
        raise InputFileError("the noise of the white frames does not grow with exposure; check exposures and frames")
    return PhotonTransfer(mean, variance, used, white, reached, np.array(gains))


def saturation(levels: Sequence[Level], variance: Array, top: int) -> tuple[float, bool]:
    """DN at which pixels saturate, and whether any did: the median of a channel whose variance has collapsed."""
    fallen = variance[-1] / variance.max(axis=0)
    channel = int(fallen.argmin())
    if fallen[channel] > 0.5:
        return float(top), False
    cumulated = levels[-1].counts[channel].cumsum()
    return float(np.searchsorted(cumulated, cumulated[-1] / 2)), True


def prnu(captures: Sequence[Capture], levels: Sequence[Level], used: NDArray[np.bool_], body: Body) -> Array:
    """(channel) relative spread of the pixels' slopes over exposure about their local mean (uneven light cancels)."""
    weights = np.zeros(used.shape)
    for channel in range(used.shape[1]):
        chosen = used[:, channel]
        weights[chosen, channel] = line_weights(np.array([level.exposure for level in levels])[chosen])[1]
    variance = np.array([level.variance for level in levels])
    trials = np.array([level.trials for level in levels])
    own = (weights**2 * variance / trials[:, None]).sum(axis=0)
    slopes = weighted_sum(captures, weights, body)
    spread = [_local_spread(site, own[channel]) for channel, site in by_site(slopes, body.cfa)]
    return np.sqrt(np.maximum(pooled(spread, body.cfa), 0.0))


def _local_spread(site: Array, own: float) -> float:
    """Variance of site / local mean − 1, without the estimator's own variance `own` of each sample."""
    from scipy.ndimage import uniform_filter

    inner = slice(WINDOW // 2, -(WINDOW // 2))
    local = uniform_filter(site, WINDOW)[inner, inner]
    deviation = site[inner, inner] / local - 1.0
    # A sample is part of its own local mean, which shrinks its deviation by 1 − 1/n.
    return float(np.mean(deviation**2) / (1.0 - 1.0 / WINDOW**2) - own * np.mean(1.0 / local**2))
