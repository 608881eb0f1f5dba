"""Learn the outputs of uniform areas in which channels clip (docs/method.md#plain-clipped-areas).

The training data are measured surfaces under increasing light.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.layers import Clipping
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.classes.clipping import CLIPS, added_terms, grey_level
from l3cli.training.plain_surfaces import plain_surfaces

Array = NDArray[np.float64]
EXPOSURES = np.geomspace(0.35, 4.5, 24)  # relative to the exposure that fills a surface's first channel
SURFACE_STEP = 7  # every seventh surface is used, because there are many
SAMPLE_RIDGE = 1e-3  # relative to the samples
COLOUR_RIDGE = 1e-3  # relative to the power of colour
EXPOSURE_POWER = 2  # exponent with which the weight falls with exposure, because brighter areas are rarer
CHANGE_WEIGHT = 3.0  # weight of changes between exposures, because steps are more visible than a wrong colour


def learned_clipping(camera: CameraModel, light: LightSpectrum | None, white: Array) -> Clipping | None:
    """Learn what plain clipped areas become under a light, or the mean light of a training with several.

    Parameters
    ----------
    camera : CameraModel
    light : LightSpectrum or None
        None if the light is not known.
    white : ndarray, (output)
        XYZ of a white of Y = 1 under the light.

    Returns
    -------
    Clipping or None
        None if the light is not known, if channels of one filter clip one after the other, or if the camera has only one
        channel: no other channel then tells what a clipped one would have seen.
    """
    if light is None or camera.readout is not None or len(camera.channels) == 1:
        return None
    surfaces = plain_surfaces(camera, light, light, white)
    if surfaces is None:
        return None
    of_white = surfaces.white * (camera.output_unit / camera.full_scale)
    signals, outputs = surfaces.signals[::SURFACE_STEP], surfaces.outputs[::SURFACE_STEP]
    colours = _colours(signals / of_white, outputs / white) * white / of_white[:, None]
    over = np.broadcast_to(EXPOSURES[:, None], (EXPOSURES.size, len(signals))).reshape(-1)
    scale = (EXPOSURES[:, None] / signals.max(axis=1)).reshape(-1, 1)
    signals, outputs = (np.tile(each, (EXPOSURES.size, 1)) for each in (signals, outputs))
    target, seen = _target(outputs * scale, over, white, 1 / of_white.min()), np.minimum(signals * scale, 1.0)
    level = grey_level(seen.T, of_white)[:, None]
    grey = np.minimum(level * of_white, 1.0)
    features = (added_terms(seen.T) - added_terms(grey.T)).reshape(-1, len(seen)).T
    missing = np.where(over[:, None] >= CLIPS, target - (seen - grey + level * of_white) @ colours, 0.0)
    weight = np.maximum(over, 1.0) ** -EXPOSURE_POWER / (len(signals) * target[:, 1] * seen.mean(axis=1))
    features, missing = (np.concatenate([each, _changes(each)]) for each in (features, missing))
    weight = np.concatenate([weight, CHANGE_WEIGHT * weight[len(weight) // EXPOSURES.size :]])
    # Not by BLAS, whose sums depend on how many threads it has.
    system = np.einsum("r,ri,rj->ij", weight, features, features, optimize=False)
    right = np.einsum("r,ri,rj->ij", weight, features, missing, optimize=False)
    system += SAMPLE_RIDGE * np.eye(len(system))
    added = np.linalg.solve(system, right).reshape(len(of_white), -1, len(white))
    usual = np.append(colours, np.zeros((1, len(white))), axis=0)
    return Clipping(np.append(usual[None], added, axis=0), of_white)


def _changes(values: Array) -> Array:
    """Return the changes of values (exposure · surface, value) from each exposure to the next."""
    by_exposure = values.reshape(EXPOSURES.size, -1, values.shape[1])
    return np.diff(by_exposure, axis=0).reshape(-1, values.shape[1])


def _colours(signals: Array, outputs: Array) -> Array:
    """Return outputs (channel, output) per signal of surfaces. Both are relative to white, which remains white."""
    weight = 1 / signals.mean(axis=1)
    about, wanted = (each - signals.mean(axis=1, keepdims=True) for each in (signals, outputs))
    power = np.einsum("s,si,sj->ij", weight**2, about, about, optimize=False)
    right = np.einsum("s,si,so->io", weight**2, about, wanted, optimize=False)
    channels = len(power)
    system = power + COLOUR_RIDGE * np.trace(power) / channels * np.eye(channels)
    by_colour = np.linalg.solve(system, right)
    return np.asarray(by_colour + (1 - by_colour.sum(axis=0)) / channels)


def _target(outputs: Array, over: Array, white: Array, brightest: float) -> Array:
    """Return the wanted outputs of surfaces at exposures `over`, relative to the exposure that fills their first channel.

    Outputs are no brighter than the white whose last channel just clips, and become paler as the exposure rises.
    """
    luminance = np.minimum(outputs[:, 1:2], brightest)
    chroma = outputs / outputs[:, 1:2] - white
    return np.asarray(luminance * (white + chroma / (1 + np.maximum(over[:, None] - 1, 0.0) ** 2)))
