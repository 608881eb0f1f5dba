"""Noise of a sensor from stacks of frames, as EMVA 1288 defines it (docs/method.md#dark-and-white-frames).

Every temporal variance comes from differences of frames taken in pairs, in which the fixed pattern cancels; every spatial
one has the variance of its estimator subtracted. Hot and dead pixels stay out.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION
from l3cli.calibration import agreement
from l3cli.calibration.statistics import (
    LEAST_LOSS,
    Defects,
    Each,
    Level,
    by_site,
    joined_defects,
    mean_value,
    measure_level,
    no_defects,
    outliers,
    patched,
    pooled,
    share_from,
    weighted_sums,
)
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, Capture

SATURATED = 0.985  # share of the span from black to white level that counts as saturated
TOLERATED = 1e-4  # share of saturated pixels that leaves a variance unharmed
LINEAR = (0.05, 0.95)  # share of saturation over which EMVA 1288 judges linearity
WINDOW = 7  # samples of one CFA site in a local mean: 5–9, wider ones see dust (docs/method.md#dark-and-white-frames)
Array = NDArray[np.float64]


@dataclass(frozen=True)
class DarkNoise:
    """Results of lens-cap frames, each (channel)."""

    black_level: Array  # DN at zero exposure
    slope: Array  # DN/s
    variance: Array  # DN² at zero exposure, quantisation taken out
    dsnu: Array  # DN
    hot: Defects = field(default_factory=no_defects)


@dataclass(frozen=True)
class PhotonTransfer:
    """Temporal variance against signal of the white frames."""

    mean: Array  # (level, channel) DN above black
    variance: Array  # (level, channel) DN²
    used: NDArray[np.bool_]  # (level, channel) below saturation
    white_level: float  # DN at which pixels saturate
    white_level_reached: bool  # False: no frame saturates, the white level is the converter's top
    gain: Array  # (channel) DN/e-, conversion gain K
    gain_error: Array  # (channel) DN/e-, its standard deviation
    linearity_error: Array  # (channel) EMVA 1288 LE, relative


# ------------------------------------------------------------------------------------------------------------ dark


def line_weights(exposures: Array) -> tuple[Array, Array]:
    """Return the weights (level) whose sums with values give intercept and slope of the least-squares line over
    `exposures`."""
    centred = exposures - exposures.mean()
    slope = centred / (centred @ centred)
    return 1.0 / exposures.size - exposures.mean() * slope, slope


def dark_noise(captures: Sequence[Capture], body: Body, each: Each = map) -> DarkNoise:
    """Measure black level, dark signal, read noise, DSNU and hot pixels from lens-cap frames; InputFileError without two
    exposures."""
    exposures = np.array([capture.exposure for capture in captures])
    if np.unique(exposures).size < 2:
        raise InputFileError("the dark frames have a single exposure; dark current needs two or more, up to a second")
    intercept, slope = line_weights(exposures)
    weights = np.repeat(np.stack([intercept, slope])[..., None], len(body.channels), axis=2)
    offsets, slopes = weighted_sums(captures, weights, body, each)
    hot = joined_defects(outliers(offsets, body.cfa), outliers(slopes, body.cfa))
    offsets = patched(offsets, body.cfa, hot)
    levels = list(each(functools.partial(measure_level, body=body, defects=hot), captures))
    mean = np.array([mean_value(level.counts) for level in levels])
    agreement.check_darks(captures, mean.mean(axis=1))
    variance = np.array([level.variance for level in levels])
    temporal = (intercept**2 / [level.trials for level in levels]) @ variance
    spatial = pooled([_pixel_variance(site) for _, site in by_site(offsets, body.cfa)], body.cfa)
    return DarkNoise(
        black_level=intercept @ mean,
        slope=slope @ mean,
        variance=np.maximum(intercept @ variance - QUANTISATION, 0.0),
        dsnu=np.sqrt(np.maximum(spatial - temporal, 0.0)),
        hot=hot,
    )


def _pixel_variance(site: Array) -> float:
    """Return the variance of a picture without what its rows and columns have in common (column noise is no DSNU of
    pixels)."""
    centred = site - site.mean(axis=0, keepdims=True)
    centred -= centred.mean(axis=1, keepdims=True)
    rows, cols = site.shape
    return float((centred**2).sum() / max((rows - 1) * (cols - 1), 1))


# ----------------------------------------------------------------------------------------------------------- white


def photon_transfer(levels: Sequence[Level], body: Body, dark: DarkNoise) -> PhotonTransfer:
    """Fit the conversion gain to the line of white levels sorted by exposure (docs/method.md#dark-and-white-frames).

    Saturation is where the variance falls, be it the well or the converter; levels from there on stay out.
    InputFileError if a channel has fewer than two levels below saturation.
    """
    mean = np.array([mean_value(level.counts) for level in levels]) - dark.black_level
    variance = np.array([level.variance for level in levels])
    if not variance.max(axis=0).all():
        raise InputFileError("the white frames hold no noise: all are saturated, or copies of one frame; take them again")
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
                f"channel {name} has {len({level.exposure for level in chosen})} white exposures below saturation; "
                "give two or more, shorter ones"
            )
        lines.append(_transfer_line(chosen, mean[used[:, channel], channel], channel))
    gain, error = np.array(lines).T
    if gain.min() <= 0:
        raise InputFileError("the noise of the white frames does not grow with exposure; check exposures and frames")
    linearity = linearity_errors(levels, mean, used, dark, white_level)
    return PhotonTransfer(mean, variance, used, white_level, reached, gain, error, linearity)


def _transfer_line(levels: Sequence[Level], mean: Array, channel: int) -> tuple[float, float]:
    """Return the slope of variance over mean (level) and its standard deviation; that of a variance is √(2/n) of itself."""
    variance = np.array([level.variance[channel] for level in levels])
    samples = np.array([level.counts[channel].sum() / level.trials * (level.trials // 2) for level in levels])
    line, covariance = np.polyfit(mean, variance, 1, w=np.sqrt(samples / 2.0) / variance, cov="unscaled")
    return float(line[0]), float(np.sqrt(covariance[0, 0]))


def linearity_errors(
    levels: Sequence[Level], mean: Array, used: NDArray[np.bool_], dark: DarkNoise, white_level: float
) -> Array:
    """Return EMVA 1288's LE (channel): mean relative deviation of the signal from a line; 0 with fewer than three levels."""
    lit, exposure = np.array([(level.lit, level.exposure) for level in levels]).T
    errors = []
    for channel, signal in enumerate((mean - dark.slope * exposure[:, None]).T):
        share = mean[:, channel] / (white_level - dark.black_level[channel])
        chosen = used[:, channel] & (share >= LINEAR[0]) & (share <= LINEAR[1]) & (signal > 0)
        errors.append(linearity_error(lit[chosen], signal[chosen]) if chosen.sum() > 2 else 0.0)
    return np.array(errors)


def linearity_error(lit: Array, signal: Array) -> float:
    """Return the mean relative deviation of `signal` from the line over `lit` that makes relative deviations least."""
    line = np.polyval(np.polyfit(lit, signal, 1, w=1.0 / signal), lit)
    return float(np.mean(np.abs(signal / line - 1.0)))


def saturation(levels: Sequence[Level], variance: Array, top: int) -> tuple[float, bool]:
    """Return DN at which pixels saturate, and whether any did: the median of a channel whose variance has collapsed."""
    fallen = variance[-1] / variance.max(axis=0)
    channel = int(fallen.argmin())
    if fallen[channel] > 0.5:
        return float(top), False
    cumulated = levels[-1].counts[channel].cumsum()
    return float(np.searchsorted(cumulated, cumulated[-1] / 2)), True


def prnu(
    captures: Sequence[Capture], levels: Sequence[Level], used: NDArray[np.bool_], body: Body, hot: Defects, each: Each = map
) -> tuple[Array, Defects, Array]:
    """Return the relative spread (channel) of the pixels' slopes over exposure about their local mean (uneven light
    cancels), the dead pixels, whose slope differs from that mean by a tenth or more, and slopes (row, col) in DN/s, theirs
    patched."""
    weights = np.zeros(used.shape)
    for channel in range(used.shape[1]):
        chosen = used[:, channel]
        weights[chosen, channel] = line_weights(np.array([level.lit for level in levels])[chosen])[1]
    variance = np.array([level.variance for level in levels])
    trials = np.array([level.trials for level in levels])
    temporal = (weights**2 * variance / trials[:, None]).sum(axis=0)
    slopes = patched(weighted_sums(captures, weights[None], body, each)[0], body.cfa, hot)
    dead, slopes = dead_pixels(slopes, body.cfa)
    spread = [_local_spread(site, temporal[channel]) for channel, site in by_site(slopes, body.cfa)]
    return np.sqrt(np.maximum(pooled(spread, body.cfa), 0.0)), dead, slopes


def dead_pixels(response: Array, cfa: NDArray[np.uint8]) -> tuple[Defects, Array]:
    """Return the pixels whose response (row, col) to even light differs from its local mean by a tenth or more, and the
    responses with theirs patched. Neighbours of a line or cluster are judged by a mean that those have been taken out of."""
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
    """Return the ratio (row, col) of each pixel to the mean of its neighbours of its CFA site in `patched`, minus 1."""
    deviation = np.empty_like(picture)
    for (_, into), (_, site), (_, whole) in zip(
        *(by_site(each, cfa) for each in (deviation, picture, patched)), strict=True
    ):
        into[...] = site / _local_mean(whole) - 1.0
    return deviation


def _local_spread(site: Array, temporal: float) -> float:
    """Return the variance of site / local mean − 1, without the temporal variance `temporal` of each sample."""
    inner = slice(WINDOW // 2, -(WINDOW // 2))
    local = _local_mean(site)[inner, inner]
    deviation = site[inner, inner] / local - 1.0
    # A sample is part of its local mean, which shrinks its deviation by 1 − 1/n.
    return float(np.mean(deviation**2) / (1.0 - 1.0 / WINDOW**2) - temporal * np.mean(1.0 / local**2))
