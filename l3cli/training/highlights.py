"""Clipped areas are trained to be grey, more strongly the more channels clip (docs/method.md#clipped-areas).

When channels clip, the colour of a surface is lost. The mean colour of all training surfaces that clip in the same way is a
poor estimate, because it gives highlights a colour cast. Most highlights are neutral, and a neutral error is hardly visible.
So each class of uniform areas near saturation is trained, besides its patches, on uniform greys of the training light that
clip in the same way. Classes of textures are not, because there other pixels show the colour and detail would be lost.
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

MIN_GREY, MAX_GREY = 0.3, 1.6  # range of greys, relative to those that just clip the first and the last channel
GREY_RATIO = 1.02  # ratio of successive greys
CLIPPING_FRACTIONS = (0.94, 0.97, 1.0)  # fractions of the saturation threshold at which noise can make greys clip
# Greys per patch, times the ratio of clipped to unclipped channels; with 1, seams between classes show
GREYS_PER_PATCH = 4.0
MAX_GREYS_PER_PATCH = 30.0  # greys per patch if every channel clips
UNCLIPPED_FRACTION = 0.2  # fraction of clipped filters used if none clips: one grey per patch, which prevents a cast
WHITE_TOLERANCE = 0.1  # tolerated relative difference between known signals of white and those that patches suggest
OUTPUT_CUTOFF = 1e-6  # relative cut-off for directions in which the outputs hardly vary


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
    """Return moments of uniform greys for the classes of uniform areas near saturation.

    The moments are the mean over the greys that fall into a class, times the number of greys per patch. If every channel
    clips, only completely clipped greys are used.

    Parameters
    ----------
    sums : ClassSums
    rule : ClassRule
    window : ndarray, (tap)
        Channel of each tap.
    white : ndarray, (output)
        White under the training light, Y = 1.
    black_level, white_level : float
        Levels of the camera, in DN.
    signal : ndarray or None, (channel)
        Signals of that white, fractions of full scale; None if not known.
    filters : tuple of int, (channel)
        First channel with the same filter, as in `Goal`. A filter counts as clipped only if all of its channels clip.
    sensitivity : ndarray or None, (channel)
        Relative sensitivity of the channels, as in `Goal`; None if all are alike.

    Returns
    -------
    dict of int to ndarray, (column, column)
        Moments per class, over taps, intercept and outputs. It is empty if `signal` is None.
    """
    if signal is None:
        return {}
    same = np.array(filters or range(signal.size))[:, None] == np.unique(filters or range(signal.size))  # (channel, filter)
    relative = np.ones(signal.size) if sensitivity is None else sensitivity
    samples: dict[tuple[int, int], list[Array]] = {}  # by level and saturation case
    threshold = (rule.saturation - black_level) / (white_level - black_level)
    for grey in np.exp(np.arange(np.log(MIN_GREY / signal.max()), np.log(MAX_GREY / signal.min()), np.log(GREY_RATIO))):
        clipped = np.minimum(grey * signal, 1.0)
        at = level.level_of_mean(rule, float((clipped * (white_level - black_level) + black_level).sum()))
        seen = level.unclipped_level(clipped.mean(), relative)
        sample = np.concatenate([clipped[window], [1.0], grey * white]) / np.sqrt(seen * grey)
        for nearly in CLIPPING_FRACTIONS:
            saturated = clipped >= nearly * threshold
            case = int(saturation.cases(rule, saturation.code_of(saturated)))
            # Where all channels clip, all greys give the same values. Greys whose last channel is just below clipping would
            # concentrate the whole rise in its last per cent, and textures, whose taps are far from it, would become black.
            if not case or (saturated.all() and clipped.min() < 1.0):
                continue
            share = (saturated[:, None] | ~same).all(axis=0).mean() or UNCLIPPED_FRACTION  # of the filters
            weight = np.sqrt(min(GREYS_PER_PATCH * share / max(1.0 - share, 1e-9), MAX_GREYS_PER_PATCH))
            for neighbour in {max(at - 1, 0), at, min(at + 1, rule.levels - 1)}:
                samples.setdefault((neighbour, case), []).append(weight * sample)
    taught: dict[int, Array] = {}
    for (neighbour, case), greys in samples.items():
        classes = rule.join(neighbour, 0, rule.kinds_of(case), combination=np.arange(rule.combinations))
        taught |= dict.fromkeys(classes.ravel().tolist(), np.array(greys).T @ np.array(greys) / len(greys))
    return taught


def steps_back(
    common: Array, clipping: NDArray[np.int64], rule: ClassRule, signal: Array, black_level: float, white_level: float
) -> tuple[NDArray[np.int64], Array]:
    """Find by how much greys would become darker where the last channel clips.

    Parameters
    ----------
    common : ndarray, (class, channel + 1)
        What a uniform patch of one channel, and the intercept, add to the luminance of each class in `clipping`.
    clipping : ndarray, (class)
        Numbers of the saturated classes.
    rule : ClassRule
    signal : ndarray, (channel)
        Signals of white under the training light.
    black_level, white_level : float
        In DN.

    Returns
    -------
    last : ndarray of int
        Indices into `clipping` of the classes of a grey that clips every channel.
    missing : ndarray
        Luminance that each of them lacks relative to the brightest darker grey; at least 0.
    """
    threshold = (rule.saturation - black_level) / (white_level - black_level)
    greys = np.exp(np.arange(np.log(threshold / signal.max()), np.log(threshold / signal.min()), np.log(GREY_RATIO)))
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
    """Return the signals of white under the training light, Y = 1.

    Parameters
    ----------
    sums : ClassSums
    rule : ClassRule
    window : ndarray, (tap)
        Channel of each tap.
    white : ndarray, (output)
        Outputs of white.
    known : ndarray, (channel), or None
        Signals according to the camera model.
    white_error : ndarray, (channel), or float
        Relative error with which surfaces predict the signals of white.

    Returns
    -------
    ndarray, (channel), or None
        The known signals if the patches agree with them, otherwise those that the patches suggest, for example for frames
        that were taken through another lens. None without patches.
    """
    likely = _channels_of(flat_moments(sums, rule, window.size + 1 + white.size), window, white)
    if known is None or likely is None or (np.abs(known / likely - 1) > np.maximum(white_error, WHITE_TOLERANCE)).any():
        return likely
    return known


def error_of_white(light: LightSpectrum, camera: CameraModel) -> Array:
    """Return the relative error (channel) with which measured surfaces under a light predict the signals of white.

    It is a few per cent for visible light, and large for a camera that sees infrared, about which X, Y, Z say nothing.
    """
    radiance = spectra.resample(light.radiance.astype(np.float64), light.wavelength, camera.wavelength)
    lit = np.vstack([radiance, spectra.reflectance_library(camera.wavelength) * radiance])
    outputs, signals = lit @ spectra.xyz_weights(camera.wavelength).T, lit @ camera.signal_weights.T
    if not (outputs[:, 1].min() > 0 and signals[0].min() > 0):
        return np.zeros(len(camera.channels))
    outputs, signals = outputs / outputs[:, 1:2], signals / outputs[:, 1:2]
    of_outputs = np.linalg.lstsq(outputs[1:], signals[1:], rcond=None)[0]
    return np.abs(outputs[0] @ of_outputs / signals[0] - 1.0)


def plain_colours(sums: ClassSums, rule: ClassRule, window: NDArray[np.int64]) -> Array:
    """Return second moments (channel, channel) of the channel means over uniform, unsaturated patches.

    Uniform patches are those of the lowest contrast. The trace of the result is 1.
    """
    width = int((np.sqrt(8 * sums.moments.shape[1] + 1) - 1) / 2)
    means = (window == np.arange(window.max() + 1)[:, None]) / np.bincount(window)[:, None]
    colours = means @ flat_moments(sums, rule, width)[: window.size, : window.size] @ means.T
    colours += 1e-9 * np.eye(len(means)) * max(float(np.trace(colours)), 1e-9)
    return np.asarray(colours / np.trace(colours))


def flat_moments(sums: ClassSums, rule: ClassRule, width: int) -> Array:
    """Return summed moments (column, column) of all unsaturated patches of the lowest contrast."""
    return moment_matrix(rule.by_feature(sums.moments)[0, :, 0, :, rule.kinds_of(0)].sum(axis=(0, 1, 2)), width)


def _channels_of(moments: Array, window: NDArray[np.int64], white: Array) -> Array | None:
    """Return the signals (channel) of white, Y = 1, by regression of the channels on the outputs.

    The result is one or two per cent off if the training surfaces differ from white. None without patches.
    """
    taps = window.size
    power = moments[taps + 1 :, taps + 1 :]
    if not power.any():
        return None
    of_outputs = moments[:taps, taps + 1 :] @ np.linalg.pinv(power, rcond=OUTPUT_CUTOFF, hermitian=True)
    signal = np.bincount(window, of_outputs @ white) / np.bincount(window)
    return signal if signal.min() > 0 else None
