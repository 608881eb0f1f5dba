"""The pipeline of a laboratory without training: white balance, demosaicking, colour matrix (docs/method.md#basic-pipeline).

Clipped channels remain as they are. Clipping all channels where the first one clips would keep highlights neutral, but
costs 0.6 ΔE00 on faces at three light levels, and a baseline should be as strong as possible.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.training_set import LightSpectrum, TrainingPair
from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.demosaic import Demosaic, interpolate
from l3cli.physics import spectra

Array = NDArray[np.floating]
# Combines balanced planes (channel, row, col) of several exposures, given the balance (channel), into one per filter
Merge = Callable[[Array, TrainingPair, CameraModel, Array], Array]
CLIPPED = 0.985  # fraction of full scale from which a sample counts as clipped
TOUCHED = 0.02  # fraction of clipped samples in an interpolation above which its result counts as clipped
# Regularisation relative to the mean square of the channels' differences, which trades noise for colour (ΔE 1.7 on a chart)
RIDGE = 0.05
BLIND = 1e-6  # a channel with a smaller response to white, relative to the brightest channel, does not see a light
ENDS = ((min, 360.0, 0), (max, 830.0, -1))  # nm, range of the CIE observers
UNNAMED = ("A", "D50", "D55", "D65", "D75", "E", "FL2", "FL11")  # candidates for a light of which only the white is known


@dataclass(frozen=True)
class Colour:
    """Colour correction of a camera for one light, relative to a perfect white."""

    balance: Array  # (channel) fraction of a white of 1 cd/m² per photo-electron per second; 0 if blind to the light
    matrix: Array  # (output, channel), rows sum to 1


def fit_colour(camera: CameraModel, light: LightSpectrum, wanted: LightSpectrum | None = None) -> Colour:
    """Fit a colour matrix by ridge regression over measured reflectances. White remains exactly white.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : LightSpectrum
        Light on the scene.
    wanted : LightSpectrum, optional
        Light of the target XYZ. [default: `light`]

    Raises
    ------
    InputFileError
        If the eye or the camera does not see a light.
    """
    library, falling = lit_library(light)
    electrons = electrons_of(camera, light, library * falling)
    seen = electrons[0] > BLIND * electrons[0].max()
    if not seen.any():
        raise InputFileError(f"camera {camera.name} sees nothing of a frame's light; simulate it under another")
    library, falling = lit_library(wanted or light)
    xyz = library * falling @ spectra.xyz_weights((wanted or light).wavelength).T
    balance, matrix = np.zeros(len(seen)), np.zeros((3, len(seen)))
    balance[seen] = 1.0 / electrons[0, seen]
    white = np.where(xyz[0] > 0, xyz[0], 1.0)  # deep red has no Z at all
    matrix[:, seen] = white_preserving_ridge(electrons[1:, seen] * balance[seen], xyz[1:] / white)
    return Colour(balance, matrix)


def electrons_of(camera: CameraModel, light: LightSpectrum, radiances: Array) -> Array:
    """Return the photo-electrons per second (sample, channel) from `radiances` (sample, wavelength) on a light's grid."""
    return radiances @ (camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)).T


def lit_library(light: LightSpectrum) -> tuple[Array, Array]:
    """Return white and the measured reflectances (sample, wavelength), and the light (wavelength) at 1 cd/m² on white."""
    radiance = light.radiance.astype(np.float64)
    if not spectra.xyz_weights(light.wavelength)[1] @ radiance > 0:
        raise InputFileError("a frame's light cannot be seen; simulate it again")
    library = np.vstack([np.ones(light.wavelength.size), spectra.reflectance_library(light.wavelength)])
    return library, spectra.at_luminance(radiance, light.wavelength, 1.0)


def white_preserving_ridge(channels: Array, outputs: Array) -> Array:
    """Fit a matrix (output, channel) whose rows sum to 1, from white-balanced channels to outputs.

    Both arrays are (sample, channel) and (sample, output). The ridge regression is between the differences of outputs and
    channels from the mean of the channels.
    """
    mean = channels.mean(axis=1, keepdims=True)
    differences = channels - mean
    gram = differences.T @ differences
    ridge = RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    # lstsq instead of solve, because a single channel gives the equation 0 = 0
    matrix = np.linalg.lstsq(gram + ridge, differences.T @ (outputs - mean))[0].T
    return matrix - matrix.mean(axis=1, keepdims=True) + 1.0 / len(gram)


def develop(
    frame: TrainingPair, camera: CameraModel, colour: Colour, demosaic: Demosaic, merge: Merge | None = None
) -> Array:
    """Convert a raw frame to XYZ (3, row, col) in the target's unit.

    Parameters
    ----------
    frame : TrainingPair
        The frame.
    camera : CameraModel
        Its camera.
    colour : Colour
        White balance and matrix.
    demosaic : callable
        Demosaicking method.
    merge : callable, optional
        Combines the exposures of a camera that has several.
    """
    electrons = _electrons(frame, camera)
    balance = colour.balance / (frame.luminance * frame.exposure)
    balanced = electrons * balance[camera.channel_map(frame.raw.shape)]
    channels = demosaic(balanced, camera.cfa)
    if merge is not None:
        channels = merge(channels, frame, camera, balance)
    planes = np.einsum("oc,crk->ork", colour.matrix, channels)
    return planes * frame.white[:, None, None]


def develop_bands(frame: TrainingPair, camera: CameraModel, relit: bool, demosaic: Demosaic) -> Array:
    """Convert a raw frame to the camera's bands (channel, row, col) in the target's unit.

    The steps are black and dark subtraction, white balance, demosaicking, and the white balance of the target
    (docs/method.md#baselines-for-bands). `relit` says that the target has another light than the frame. Raises
    InputFileError if the camera does not see the light.
    """
    share = camera.saturation_exposure / camera.full_scale  # target value of a band per electron per second
    white = white_electrons(frame, camera) if relit else frame.white / (share * camera.channel_gains)
    return balanced_bands(frame, camera, white, demosaic) * frame.white[:, None, None]


def white_electrons(frame: TrainingPair, camera: CameraModel) -> Array:
    """Return the photo-electrons per second (channel) from a perfect white under the light of a frame."""
    light = light_of(frame, camera)
    falling = spectra.at_luminance(light.radiance.astype(np.float64), light.wavelength, frame.luminance)
    return electrons_of(camera, light, falling[None])[0]


def balance_of(white: Array, exposure: float, camera: CameraModel) -> Array:
    """Return the fraction of a perfect white per photo-electron (channel), 0 for channels that do not see the light.

    `white` (channel) is the signal of white in electrons per second. Raises InputFileError if no channel sees the light.
    """
    if not white.max() > 0:
        raise InputFileError(f"camera {camera.name} sees nothing of a frame's light; simulate it under another")
    seen = white > BLIND * white.max()
    return np.where(seen, 1.0 / np.where(seen, white, 1.0), 0.0) / exposure


def balanced_bands(frame: TrainingPair, camera: CameraModel, white: Array, demosaic: Demosaic) -> Array:
    """Return the camera's bands (channel, row, col) of a raw frame, relative to a perfect white.

    `white` (channel) is the signal of white in electrons per second.
    """
    balance = balance_of(white, frame.exposure, camera)
    return demosaic(_electrons(frame, camera) * balance[camera.channel_map(frame.raw.shape)], camera.cfa)


def _electrons(frame: TrainingPair, camera: CameraModel) -> Array:
    """Return the photo-electrons (row, col) of a raw frame."""
    signal = (frame.raw - camera.black_level) / camera.gain
    dark = camera.noise.dark_current * frame.dark_time
    if camera.readout is None:
        return signal - dark
    channel = camera.channel_map(frame.raw.shape)
    return signal / camera.readout.channel_gain[channel] - dark * camera.readout.channel_exposure[channel]


def light_of(frame: TrainingPair, camera: CameraModel) -> LightSpectrum:
    """Return the light of a frame.

    If the frame does not contain it, it is the light with the frame's name, or the common light nearest to the frame's
    white.
    """

    def distance(white: Array) -> float:
        return float(np.hypot(*(white / white.sum() - frame.white / frame.white.sum())[:2]))

    if frame.light is not None:
        return frame.light
    try:
        spectra.illuminant(frame.illuminant, np.array([550.0]))
        name = frame.illuminant
    except RecipeError:
        name = min(UNNAMED, key=lambda each: distance(spectra.white_point(each)))
    return named_light(name, camera)


def named_light(name: str, *cameras: CameraModel) -> LightSpectrum:
    """Return a named light at 1 nm over the range of the observer and of the cameras."""
    first, last = (bound(end, *(camera.wavelength[at] for camera in cameras)) for bound, end, at in ENDS)
    grid = np.arange(np.floor(first), last + 1.0)
    light = spectra.at_luminance(spectra.illuminant(name, grid), grid, 1.0)
    return LightSpectrum(grid, light.astype(np.float32))


# -------------------------------------------------------------------------------------------- several exposures or gains


def merges(camera: CameraModel) -> dict[str, Merge | None]:
    """Return the methods to merge the exposures of a camera, by name. "basic" is the best. The method is None if all are
    alike.
    """
    if camera.readout is None or np.ptp(camera.sensitivity) == 0:
        return {"basic": None}
    names = ("long", "short") if np.ptp(camera.readout.channel_exposure) else ("high gain", "low gain")
    return {"basic": merged, names[0]: most_sensitive, names[1]: least_sensitive}


def merged(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Average the channels of each filter, weighted by inverse noise variance and without channels that clip around a pixel.

    Where all channels clip, the least sensitive one remains.
    """
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
    """Use only the longest exposure or highest gain of each filter."""
    return _chosen(planes, camera, np.argmax)


def least_sensitive(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Use only the shortest exposure or lowest gain of each filter."""
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
