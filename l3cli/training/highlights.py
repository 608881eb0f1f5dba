"""Clipped areas are learned as grey, the more channels clip the surer (docs/method.md#clipped-areas).

Where channels clip, the colour of a surface is lost with them, and the mean colour of all training surfaces that clip alike
is no good guess: it gives highlights a cast. Highlights are mostly neutral, and a neutral error is the one that nobody sees.
So every plain class near saturation is taught, beside its patches, flat greys of the training light that clip as its patches
do; among textures, where other pixels tell the colour, they would only cost detail.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.class_rule import ClassRule
from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.classes import level, saturation
from l3cli.physics import spectra
from l3cli.training.sums import moment_matrix

Array = NDArray[np.float64]

DARKEST, BRIGHTEST, STEP = 0.3, 1.6, 1.02  # greys, of those that just clip the first and the last channel: paper is brighter
NEARLY = (0.94, 0.97, 1.0)  # of the saturation threshold: noise lets greys this bright clip
ODDS = 4.0  # greys a patch of the class, times clipped channels per one that is not; 1 leaves seams between classes
SUREST = 30.0  # greys a patch where every channel clips
NOTHING_LOST = 0.2  # share of clipped filters that stands for none: a grey a patch, so that they have no cast
FARTHEST = 0.1  # white's signals from what patches make likely, or as far as measured surfaces mislead about them
FAINTEST = 1e-6  # of the largest: directions in which the outputs vary less are not followed


def grey_patches(
    sums: ClassSums,
    rule: ClassRule,
    window: NDArray[np.int64],
    white: Array,
    black_level: float,
    white_level: float,
    signal: Array | None,
    filters: tuple[int, ...] = (),
    sensitivity: Array | None = None,
) -> dict[int, Array]:
    """Return moments (column, column) of flat greys for the classes near saturation in which greys come to lie: their mean
    times the number of greys a patch of the class (ODDS). Where every channel clips they are fully clipped.

    `window` (tap) names the channel of each tap, `white` (output) is that of the training light at Y = 1 and `signal`
    (channel) what the camera sees of it, `black_level` and `white_level` are the camera's, in DN. A filter of which one
    channel clips and another does not has not: `filters` and `sensitivity` (channel) are those of Goal.
    """
    if signal is None:
        return {}
    same = np.array(filters or range(signal.size))[:, None] == np.unique(filters or range(signal.size))  # (channel, filter)
    relative = np.ones(signal.size) if sensitivity is None else sensitivity
    rows: dict[tuple[int, int], list[Array]] = {}  # by level and saturation case
    threshold = (rule.saturation - black_level) / (white_level - black_level)
    for grey in np.exp(np.arange(np.log(DARKEST / signal.max()), np.log(BRIGHTEST / signal.min()), np.log(STEP))):
        clipped = np.minimum(grey * signal, 1.0)
        at = level.level_of_mean(rule, float((clipped * (white_level - black_level) + black_level).sum()))
        seen = level.unclipped_level(clipped.mean(), relative)
        row = np.concatenate([clipped[window], [1.0], grey * white]) / np.sqrt(seen * grey)
        for nearly in NEARLY:
            saturated = clipped >= nearly * threshold
            case = int(saturation.cases(rule, saturation.code_of(saturated)))
            # Where all channels clip, greys are one point. Those whose last channel is still short of it would lay all that
            # greys rise by into its last per cent, and textures, whose taps are far from it, came out black.
            if not case or (saturated.all() and clipped.min() < 1.0):
                continue
            share = (saturated[:, None] | ~same).all(axis=0).mean() or NOTHING_LOST  # of the filters
            weight = np.sqrt(min(ODDS * share / max(1.0 - share, 1e-9), SUREST))
            for neighbour in {max(at - 1, 0), at, min(at + 1, rule.levels - 1)}:
                rows.setdefault((neighbour, case), []).append(weight * row)
    taught: dict[int, Array] = {}
    for (neighbour, case), greys in rows.items():
        classes = rule.join(neighbour, 0, rule.kinds_of(case), further=np.arange(rule.further))
        taught |= dict.fromkeys(classes.ravel().tolist(), np.array(greys).T @ np.array(greys) / len(greys))
    return taught


def steps_back(
    common: Array, clipping: NDArray[np.int64], rule: ClassRule, signal: Array, black_level: float, white_level: float
) -> tuple[NDArray[np.int64], Array]:
    """Return places in `clipping` of the classes that a grey falls into where every channel clips, and how much luminance
    each lacks there, beside the brightest that greys are given on the way; `clipping` are the classes with something
    saturated, `common` (class, channel + 1) what each adds to luminance for a flat patch of one channel, or at all, and
    `signal` (channel) what the camera sees of the training light's white."""
    threshold = (rule.saturation - black_level) / (white_level - black_level)
    greys = np.exp(np.arange(np.log(threshold / signal.max()), np.log(threshold / signal.min()), np.log(STEP)))
    clipped = np.append(np.minimum(greys[:, None] * signal, 1.0), np.ones((1, signal.size)), axis=0)
    totals = (clipped * (white_level - black_level) + black_level).sum(axis=1)
    levels = np.array([level.level_of_mean(rule, float(total)) for total in totals])
    kinds = rule.kind(0, saturation.cases(rule, saturation.code_of(clipped >= threshold)))
    passed = np.searchsorted(clipping, rule.join(levels, 0, kinds)).clip(max=clipping.size - 1)
    known = clipping[passed] == rule.join(levels, 0, kinds)
    shown = (common[passed, :-1] * clipped).sum(axis=1) + common[passed, -1]
    _, at, _, _, kind = rule.split(clipping)
    last = np.flatnonzero((at == levels[-1]) & (kind == kinds[-1]))
    return last, np.maximum(shown[:-1].max(initial=0.0, where=known[:-1]) - common[last].sum(axis=1), 0.0)


def white_channels(
    sums: ClassSums,
    rule: ClassRule,
    window: NDArray[np.int64],
    white: Array,
    known: Array | None,
    white_error: Array | float = 0.0,
) -> Array | None:
    """Return signals (channel) of the training light's white at Y = 1: those `known`, unless the patches speak against it,
    as they do of frames through another lens; else those that they make likely. None if there are no patches. `white_error`
    (channel): how far off, relatively, surfaces are known to make them."""
    likely = _channels_of(flat_moments(sums, rule, window.size + 1 + white.size), window, white)
    if known is None or likely is None or (np.abs(known / likely - 1) > np.maximum(white_error, FARTHEST)).any():
        return likely
    return known


def error_of_white(light: LightSpectrum, camera: CameraModel) -> Array:
    """Return the relative error (channel) of the signals of white that measured surfaces under a light make likely: a few
    per cent for visible light, much where a camera sees infrared, of which X, Y, Z tell nothing."""
    radiance = spectra.resample(light.radiance.astype(np.float64), light.wavelength, camera.wavelength)
    lit = np.vstack([radiance, spectra.reflectance_library(camera.wavelength) * radiance])
    outputs, signals = lit @ spectra.xyz_weights(camera.wavelength).T, lit @ camera.signal_weights.T
    if not (outputs[:, 1].min() > 0 and signals[0].min() > 0):
        return np.zeros(len(camera.channels))
    outputs, signals = outputs / outputs[:, 1:2], signals / outputs[:, 1:2]
    of_outputs = np.linalg.lstsq(outputs[1:], signals[1:], rcond=None)[0]
    return np.abs(outputs[0] @ of_outputs / signals[0] - 1.0)


def plain_colours(sums: ClassSums, rule: ClassRule, window: NDArray[np.int64]) -> Array:
    """Return second moments (channel, channel) of the channels' means over all unsaturated patches of the lowest contrast,
    of trace 1."""
    width = int((np.sqrt(8 * sums.moments.shape[1] + 1) - 1) / 2)
    means = (window == np.arange(window.max() + 1)[:, None]) / np.bincount(window)[:, None]
    colours = means @ flat_moments(sums, rule, width)[: window.size, : window.size] @ means.T
    colours += 1e-9 * np.eye(len(means)) * max(float(np.trace(colours)), 1e-9)
    return np.asarray(colours / np.trace(colours))


def flat_moments(sums: ClassSums, rule: ClassRule, width: int) -> Array:
    """Return summed moments (column, column) of all unsaturated patches of the lowest contrast."""
    return moment_matrix(rule.by_axis(sums.moments)[0, :, 0, :, rule.kinds_of(0)].sum(axis=(0, 1, 2)), width)


def _channels_of(moments: Array, window: NDArray[np.int64], white: Array) -> Array | None:
    """Return signals (channel) of the training light's white at Y = 1, by regression of the channels on the outputs (a per
    cent or two off where the training surfaces differ from white). None if there are no patches."""
    taps = window.size
    power = moments[taps + 1 :, taps + 1 :]
    if not power.any():
        return None
    of_outputs = moments[:taps, taps + 1 :] @ np.linalg.pinv(power, rcond=FAINTEST, hermitian=True)
    signal = np.bincount(window, of_outputs @ white) / np.bincount(window)
    return signal if signal.min() > 0 else None
