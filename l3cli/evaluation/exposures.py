"""Arrays of several exposures or gains without training: one alone, or all merged (docs/method.md#basic-pipeline)."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import TrainingPair
from l3cli.evaluation.demosaic import interpolate

Array = NDArray[np.floating]
# Balanced planes (channel, row, col) of a frame and what each channel was balanced by (channel) → the same for each filter
Merge = Callable[[Array, TrainingPair, CameraModel, Array], Array]
CLIPPED = 0.985  # share of full scale from which a sample is clipped
TOUCHED = 0.02  # share of clipped samples among those that a pixel was interpolated from, above which it is clipped, too


def merges(camera: CameraModel) -> dict[str, Merge | None]:
    """Return the ways to merge the exposures of a camera, by name, "basic" the best of them; nothing where all are alike."""
    if camera.readout is None or np.ptp(camera.sensitivity) == 0:
        return {"basic": None}
    names = ("long", "short") if np.ptp(camera.readout.channel_exposure) else ("high gain", "low gain")
    return {"basic": merged, names[0]: most_sensitive, names[1]: least_sensitive}


def merged(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Return all channels of a filter weighed by the inverse of their noise, without those clipped about a pixel; where all
    are, the least sensitive."""
    span, channels = camera.white_level - camera.black_level, np.arange(len(camera.channels))
    clipped = interpolate((frame.raw >= camera.black_level + CLIPPED * span).astype(np.float64), camera.cfa) > TOUCHED
    in_dn = (camera.gain * camera.channel_gains / np.where(balance > 0, balance, np.inf))[:, None, None]
    variance = camera.noise_variance(np.minimum(planes * in_dn, span), channel=channels[:, None, None])
    weight = np.where(clipped, 0.0, in_dn**2 / variance)
    least = least_sensitive(planes, frame, camera, balance)
    whole = np.empty_like(planes)
    for group in _groups(camera):
        total = weight[group].sum(axis=0)
        mean = (weight[group] * planes[group]).sum(axis=0) / np.where(total > 0, total, 1.0)
        whole[group] = np.where(total > 0, mean, least[group[0]])
    return whole


def most_sensitive(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Return the longest exposure or highest gain of each filter alone."""
    return _chosen(planes, camera, np.argmax)


def least_sensitive(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Return the shortest exposure or lowest gain of each filter alone."""
    return _chosen(planes, camera, np.argmin)


def _chosen(planes: Array, camera: CameraModel, which: Callable[[Array], np.intp]) -> Array:
    whole = np.empty_like(planes)
    for group in _groups(camera):
        whole[group] = planes[group[which(camera.sensitivity[group])]]
    return whole


def _groups(camera: CameraModel) -> list[NDArray[np.intp]]:
    """Return the channels of each filter."""
    assert camera.readout is not None
    first = camera.readout.same_filter
    return [np.flatnonzero(first == one) for one in np.unique(first)]
