"""Train clipped areas to render grey (docs/method.md#clipped-areas).

Where channels clip, the colour of a surface is lost. A class that is trained only on patches renders the mean colour of all
training surfaces that clip in the same channels, which gives highlights a colour cast. Most highlights are neutral, and an
error towards neutral is hardly visible. Saturated classes for uniform areas are therefore also trained on uniform greys that
clip in the same channels. The more channels clip, the more weight the greys have. Classes for textured areas are not trained
on greys: their unclipped pixels still show the colour, and greys would suppress detail.
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

MIN_GREY = 0.3  # darkest grey, relative to the grey that just clips the first channel
MAX_GREY = 1.6  # brightest grey, relative to the grey that just clips the last channel
GREY_RATIO = 1.02  # brightness ratio of successive greys
# Saturation thresholds at which the channels of a noise-free grey count as clipped, relative to the class rule's threshold.
# Two of them are lower, because noise can clip pixels of a grey that is slightly below the class rule's threshold.
CLIPPING_FRACTIONS = (0.94, 0.97, 1.0)
# Number of greys per training patch, divided by the ratio of clipped to unclipped filters. With a value of 1, the borders
# between classes would be visible.
GREYS_PER_PATCH = 4.0
MAX_GREYS_PER_PATCH = 30.0  # upper limit of the number of greys per training patch, reached if every channel clips
UNCLIPPED_FRACTION = 0.2  # assumed fraction of clipped filters if no filter clips; it results in one grey per patch
# Largest relative difference between the camera model's signals of white and an estimate from the patches. If there are few
# scenes with strongly coloured materials, estimates differ by up to 16 %, although the camera model is right.
WHITE_TOLERANCE = 0.2
OUTPUT_CUTOFF = 1e-6  # relative cutoff of the singular values in the regression on the outputs


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
    """Compute the moments of uniform greys for the saturated classes of the lowest contrast.

    A class's moments are the weighted mean over its greys. The weight of a grey, relative to a training patch, is
    `GREYS_PER_PATCH` times the ratio of clipped to unclipped filters, up to `MAX_GREYS_PER_PATCH`. Each grey is also used in
    the classes one level below and one level above. The saturation case in which every channel clips uses only greys that
    are fully clipped in every channel.

    Parameters
    ----------
    sums : ClassSums
        Sums of all classes of a site.
    rule : ClassRule
        Class rule of the first layer.
    window : ndarray, (tap)
        Channel of each tap.
    white : ndarray, (output)
        Outputs of a perfect white under the training illuminant, with Y = 1.
    black_level, white_level : float
        Levels of the camera, in DN.
    signal : ndarray, (channel), or None
        Signals of the perfect white, as fractions of full scale, or None if they are unknown.
    filters : tuple of int
        For each channel, the first channel with the same filter, as in `Goal`. A filter counts as clipped only if all
        channels with this filter clip.
    sensitivity : ndarray, (channel), or None
        Relative sensitivity of each channel, as in `Goal`.

    Returns
    -------
    dict of int to ndarray, (column, column)
        Moments by class. The columns are taps, intercept and outputs. The dict is empty if `signal` is None.
    """
    if signal is None:
        return {}
    same = np.array(filters or range(signal.size))[:, None] == np.unique(filters or range(signal.size))  # (channel, filter)
    relative = np.ones(signal.size) if sensitivity is None else sensitivity
    samples: dict[tuple[int, int], list[Array]] = {}  # level and saturation case → weighted greys
    threshold = (rule.saturation - black_level) / (white_level - black_level)
    for grey in np.exp(np.arange(np.log(MIN_GREY / signal.max()), np.log(MAX_GREY / signal.min()), np.log(GREY_RATIO))):
        clipped = np.minimum(grey * signal, 1.0)
        at = level.level_of_mean(rule, float((clipped * (white_level - black_level) + black_level).sum()))
        seen = level.unclipped_level(clipped.mean(), relative)
        sample = np.concatenate([clipped[window], [1.0], grey * white]) / np.sqrt(seen * grey)
        for nearly in CLIPPING_FRACTIONS:
            saturated = clipped >= nearly * threshold
            case = int(saturation.cases(rule, saturation.code_of(saturated)))
            # Exclude greys with a channel just below clipping. From such greys, the class would learn a steep rise over the
            # top 1 % of this channel's range. It would then render textures black, because some taps are far below clipping.
            if not case or (saturated.all() and clipped.min() < 1.0):
                continue
            clipped_filters = (saturated[:, None] | ~same).all(axis=0).mean() or UNCLIPPED_FRACTION
            ratio = clipped_filters / max(1.0 - clipped_filters, 1e-9)
            weight = np.sqrt(min(GREYS_PER_PATCH * ratio, MAX_GREYS_PER_PATCH))
            for neighbour in {max(at - 1, 0), at, min(at + 1, rule.levels - 1)}:
                samples.setdefault((neighbour, case), []).append(weight * sample)
    moments: dict[int, Array] = {}
    for (neighbour, case), greys in samples.items():
        classes = rule.join(neighbour, 0, rule.kinds_of(case), combination=np.arange(rule.combinations))
        moments |= dict.fromkeys(classes.ravel().tolist(), np.array(greys).T @ np.array(greys) / len(greys))
    return moments


def steps_back(
    common: Array, clipping: NDArray[np.int64], rule: ClassRule, signal: Array, black_level: float, white_level: float
) -> tuple[NDArray[np.int64], Array]:
    """Compute by how much a grey's rendered luminance drops when its last channel clips.

    Parameters
    ----------
    common : ndarray, (class, channel + 1)
        For each class in `clipping`, the luminance per unit signal of each channel, followed by the intercept.
    clipping : ndarray, (class)
        Indices of the saturated classes.
    rule : ClassRule
        Class rule of the first layer.
    signal : ndarray, (channel)
        Signals of white under the training illuminant.
    black_level, white_level : float
        Levels of the camera, in DN.

    Returns
    -------
    last : ndarray of int
        Positions in `clipping` of the classes that can contain a fully clipped grey.
    missing : ndarray
        Drop in luminance for each class in `last`, from the brightest grey with an unclipped channel to the fully clipped
        grey. It is 0 if the fully clipped grey is at least as bright.
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
    """Determine the signals of a white with Y = 1 under the training illuminant.

    If the patches agree with the camera model, the signals come from the camera model. Otherwise, they are estimated from
    the patches. Patches can disagree, for example, if real frames were taken through another lens.

    Parameters
    ----------
    sums : ClassSums
        Sums of all classes of a site.
    rule : ClassRule
        Class rule of the first layer.
    window : ndarray, (tap)
        Channel of each tap.
    white : ndarray, (output)
        Outputs of the white.
    known : ndarray, (channel), or None
        Signals of the white according to the camera model, or None if they are unknown.
    white_error : ndarray, (channel), or float
        Expected relative error of an estimate from patches, from `error_of_white`.

    Returns
    -------
    ndarray, (channel), or None
        None if the patches do not allow an estimate, for example if no patch shows a uniform area.
    """
    estimate = _channels_of(flat_moments(sums, rule, window.size + 1 + white.size), window, white)
    if known is None or estimate is None or (np.abs(known / estimate - 1) > np.maximum(white_error, WHITE_TOLERANCE)).any():
        return estimate
    return known


def error_of_white(light: LightSpectrum, camera: CameraModel) -> Array:
    """Return each channel's relative error if the signals of white are predicted from X, Y and Z by regression.

    The regression is fitted to measured surfaces. The error is a few per cent for visible light. It is large for a camera
    that is sensitive to infrared light, which X, Y and Z do not include. If a surface has no luminance, or if a channel has
    no signal for white, all errors are 0.

    Returns
    -------
    ndarray, (channel)
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
    """Return the second moments of channel means in uniform, unsaturated patches, scaled to a trace of 1.

    The result has the shape (channel, channel).
    """
    width = int((np.sqrt(8 * sums.moments.shape[1] + 1) - 1) / 2)
    means = (window == np.arange(window.max() + 1)[:, None]) / np.bincount(window)[:, None]
    colours = means @ flat_moments(sums, rule, width)[: window.size, : window.size] @ means.T
    colours += 1e-9 * np.eye(len(means)) * max(float(np.trace(colours)), 1e-9)
    return np.asarray(colours / np.trace(colours))


def flat_moments(sums: ClassSums, rule: ClassRule, width: int) -> Array:
    """Sum the moments of all unsaturated classes of the lowest contrast: (column, column), with `width` columns."""
    return moment_matrix(rule.by_feature(sums.moments)[0, :, 0, :, rule.kinds_of(0)].sum(axis=(0, 1, 2)), width)


def _channels_of(moments: Array, window: NDArray[np.int64], white: Array) -> Array | None:
    """Estimate the signals of white by a regression of the channels on the outputs, or return None if it is impossible.

    The estimate has an error of one or two per cent, because few training surfaces are white.
    """
    taps = window.size
    power = moments[taps + 1 :, taps + 1 :]
    if not power.any():
        return None
    of_outputs = moments[:taps, taps + 1 :] @ np.linalg.pinv(power, rcond=OUTPUT_CUTOFF, hermitian=True)
    signal = np.bincount(window, of_outputs @ white) / np.bincount(window)
    return signal if signal.min() > 0 else None
