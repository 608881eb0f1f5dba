"""Train the colours of uniform areas with clipped channels (docs/method.md#uniform-clipped-areas).

The training data are measured surfaces at increasing exposures.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.layers import Clipping
from l3cli.artifacts.training_set import LightSpectrum
from l3cli.classes.clipping import CLIPS, added_terms, grey_level, replaced_fraction
from l3cli.training.plain_surfaces import plain_surfaces

Array = NDArray[np.float64]
EXPOSURES = np.geomspace(0.35, 4.5, 24)  # exposures, relative to the exposure at which a surface's first channel clips
SURFACE_STEP = 7  # use every seventh surface, to save time
SAMPLE_RIDGE = 1e-3  # absolute ridge when fitting the corrections
COLOUR_RIDGE = 1e-3  # ridge when fitting the colour matrix, relative to the mean power of the deviations from grey
EXPOSURE_POWER = 2  # clipped samples have the weight exposure^−2, because brighter areas are rarer
CHANGE_WEIGHT = 3.0  # weight of errors in changes between exposures, because steps are more visible than wrong colours


def learned_clipping(camera: CameraModel, light: LightSpectrum | None, white: Array) -> Clipping | None:
    """Train the correction of uniform clipped areas for one illuminant.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : LightSpectrum or None
        Mean illuminant of the training frames, or None if the illuminant is unknown.
    white : ndarray, (output)
        X, Y, Z of a perfect white under the illuminant, with Y = 1.

    Returns
    -------
    Clipping or None
        None if the illuminant is unknown, if the channels differ in exposure or gain, or if the camera has a single channel
        (a clipped signal is predicted from other channels).
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
    features = (replaced_fraction(seen.T) * (added_terms(seen.T) - added_terms(grey.T))).reshape(-1, len(seen)).T
    missing = np.where(over[:, None] >= CLIPS, target - (seen - grey + level * of_white) @ colours, 0.0)
    weight = np.maximum(over, 1.0) ** -EXPOSURE_POWER / (len(signals) * target[:, 1] * seen.mean(axis=1))
    features, missing = (np.concatenate([each, _changes(each)]) for each in (features, missing))
    weight = np.concatenate([weight, CHANGE_WEIGHT * weight[len(weight) // EXPOSURES.size :]])
    # einsum instead of BLAS, because BLAS results depend on the number of threads
    system = np.einsum("r,ri,rj->ij", weight, features, features, optimize=False)
    right = np.einsum("r,ri,rj->ij", weight, features, missing, optimize=False)
    system += SAMPLE_RIDGE * np.eye(len(system))
    added = np.linalg.solve(system, right).reshape(len(of_white), -1, len(white))
    usual = np.append(colours, np.zeros((1, len(white))), axis=0)
    return Clipping(np.append(usual[None], added, axis=0), of_white)


def _changes(values: Array) -> Array:
    """Return the differences between successive exposures. The rows of `values` are sorted by exposure, then by surface."""
    by_exposure = values.reshape(EXPOSURES.size, -1, values.shape[1])
    return np.diff(by_exposure, axis=0).reshape(-1, values.shape[1])


def _colours(signals: Array, outputs: Array) -> Array:
    """Fit a matrix (channel, output) that converts signals to outputs, both relative to white, and preserves white."""
    weight = 1 / signals.mean(axis=1)
    about, wanted = (each - signals.mean(axis=1, keepdims=True) for each in (signals, outputs))
    power = np.einsum("s,si,sj->ij", weight**2, about, about, optimize=False)
    right = np.einsum("s,si,so->io", weight**2, about, wanted, optimize=False)
    channels = len(power)
    system = power + COLOUR_RIDGE * np.trace(power) / channels * np.eye(channels)
    by_colour = np.linalg.solve(system, right)
    return np.asarray(by_colour + (1 - by_colour.sum(axis=0)) / channels)


def _target(outputs: Array, over: Array, white: Array, brightest: float) -> Array:
    """Return the target outputs of surfaces that may clip.

    `over` is each surface's exposure, relative to the exposure at which its first channel just clips. Above 1, the target
    colour becomes paler. The target luminance is limited to `brightest`, the luminance of the darkest white that clips every
    channel.
    """
    luminance = np.minimum(outputs[:, 1:2], brightest)
    chroma = outputs / outputs[:, 1:2] - white
    return np.asarray(luminance * (white + chroma / (1 + np.maximum(over[:, None] - 1, 0.0) ** 2)))
