"""The basic pipeline, an untrained baseline: white balance, demosaicking, colour matrix (docs/method.md#basic-pipeline).

Channels are clipped individually. Clipping all channels at the level of the first one would keep highlights neutral, but
costs 0.6 ΔE00 on faces at three light levels. A baseline should be as strong as possible.
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
# Function that merges white-balanced planes (channel, row, col) of several exposures into one plane per colour filter. The
# last argument is the white balance (channel).
Merge = Callable[[Array, TrainingPair, CameraModel, Array], Array]
CLIPPED = 0.985  # fraction of full scale from which a sample counts as clipped
TOUCHED = 0.02  # an interpolated value counts as clipped if clipped samples contribute more than this fraction
# Regularisation relative to the mean square of the channel differences. It reduces noise at the cost of colour accuracy
# (ΔE 1.7 on a chart).
RIDGE = 0.05
BLIND = 1e-6  # a channel whose response to white, relative to the brightest channel, is smaller counts as blind
ENDS = ((min, 360.0, 0), (max, 830.0, -1))  # nm, range of the CIE observers
UNNAMED = ("A", "D50", "D55", "D65", "D75", "E", "FL2", "FL11")  # candidate illuminants if only the white point is known


@dataclass(frozen=True)
class Colour:
    """Colour correction of a camera for one illuminant, relative to a perfect white."""

    balance: Array  # (channel) fraction of a white of 1 cd/m² per photo-electron per second; 0 for a blind channel
    matrix: Array  # (output, channel) whose rows sum to 1


def fit_colour(camera: CameraModel, light: LightSpectrum, wanted: LightSpectrum | None = None) -> Colour:
    """Fit a colour matrix by ridge regression over measured reflectances. White remains exactly white.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : LightSpectrum
        Illuminant of the scene.
    wanted : LightSpectrum, optional
        Illuminant of the target XYZ. [default: `light`]

    Raises
    ------
    InputFileError
        If an illuminant is invisible to the eye or to the camera.
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
    white = np.where(xyz[0] > 0, xyz[0], 1.0)  # deep red light has Z = 0
    matrix[:, seen] = white_preserving_ridge(electrons[1:, seen] * balance[seen], xyz[1:] / white)
    return Colour(balance, matrix)


def electrons_of(camera: CameraModel, light: LightSpectrum, radiances: Array) -> Array:
    """Return the photo-electrons per second (sample, channel) for `radiances` (sample, wavelength).

    The radiances are sampled at the wavelengths of `light`.
    """
    return radiances @ (camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)).T


def lit_library(light: LightSpectrum) -> tuple[Array, Array]:
    """Return the reflectances (sample, wavelength) of white and of the measured surfaces, and the illuminant (wavelength).

    The illuminant is scaled so that white has 1 cd/m².
    """
    radiance = light.radiance.astype(np.float64)
    if not spectra.xyz_weights(light.wavelength)[1] @ radiance > 0:
        raise InputFileError("the light of a frame is invisible; simulate it again under another light")
    library = np.vstack([np.ones(light.wavelength.size), spectra.reflectance_library(light.wavelength)])
    return library, spectra.at_luminance(radiance, light.wavelength, 1.0)


def white_preserving_ridge(channels: Array, outputs: Array) -> Array:
    """Fit a matrix that maps white-balanced channels to outputs and preserves white.

    The mean of the channels is subtracted from channels and outputs, and ridge regression maps the differences.

    Parameters
    ----------
    channels : ndarray, (sample, channel)
        White-balanced channels.
    outputs : ndarray, (sample, output)
        Outputs relative to white.

    Returns
    -------
    ndarray, (output, channel)
        Matrix whose rows sum to 1.
    """
    mean = channels.mean(axis=1, keepdims=True)
    differences = channels - mean
    gram = differences.T @ differences
    ridge = RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    # lstsq instead of solve, because the equation of a single channel is 0 = 0
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
        White balance and colour matrix.
    demosaic : callable
        Demosaicking method.
    merge : callable, optional
        Merges the exposures of a camera whose channels are exposed differently.
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
    """Convert a raw frame to the camera's bands (docs/method.md#baselines-for-bands).

    The steps are black and dark subtraction, white balance, demosaicking, and the white balance of the target.

    Parameters
    ----------
    frame : TrainingPair
        The frame.
    camera : CameraModel
        Its camera.
    relit : bool
        Whether the target has another illuminant than the frame.
    demosaic : callable
        Demosaicking method.

    Returns
    -------
    ndarray, (channel, row, col)
        Bands in the target's unit.

    Raises
    ------
    InputFileError
        If the illuminant is invisible to the camera.
    """
    share = camera.saturation_exposure / camera.full_scale  # target value of a band per electron per second
    white = white_electrons(frame, camera) if relit else frame.white / (share * camera.channel_gains)
    return balanced_bands(frame, camera, white, demosaic) * frame.white[:, None, None]


def white_electrons(frame: TrainingPair, camera: CameraModel) -> Array:
    """Return the photo-electrons per second (channel) from a perfect white under the illuminant of a frame."""
    light = light_of(frame, camera)
    falling = spectra.at_luminance(light.radiance.astype(np.float64), light.wavelength, frame.luminance)
    return electrons_of(camera, light, falling[None])[0]


def balance_of(white: Array, exposure: float, camera: CameraModel) -> Array:
    """Return the fraction of a perfect white per photo-electron (channel), or 0 for channels that are blind to the light.

    `white` (channel) is the signal of white in electrons per second. Raises InputFileError if all channels are blind.
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
    """Return the spectrum of the illuminant of a frame.

    If the frame does not contain the spectrum, its illuminant is looked up by name. If the name is unknown, the result is
    the common illuminant whose white point is nearest to the frame's white.
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
    """Return a standard illuminant in steps of 1 nm over the range of the observer and of the cameras."""
    first, last = (bound(end, *(camera.wavelength[at] for camera in cameras)) for bound, end, at in ENDS)
    grid = np.arange(np.floor(first), last + 1.0)
    light = spectra.at_luminance(spectra.illuminant(name, grid), grid, 1.0)
    return LightSpectrum(grid, light.astype(np.float32))


# -------------------------------------------------------------------------------------------- several exposures or gains


def merges(camera: CameraModel) -> dict[str, Merge | None]:
    """Return the methods that merge the exposures of a camera, by name.

    "basic" is the best method. It is None if all channels have the same exposure.
    """
    if camera.readout is None or np.ptp(camera.sensitivity) == 0:
        return {"basic": None}
    names = ("long", "short") if np.ptp(camera.readout.channel_exposure) else ("high gain", "low gain")
    return {"basic": merged, names[0]: most_sensitive, names[1]: least_sensitive}


def merged(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Average the exposures of each colour filter, weighted by inverse noise variance.

    Exposures that clip around a pixel are left out. If all clip, the least sensitive exposure is used.
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
    """Use only the longest exposure or highest gain of each colour filter."""
    return _chosen(planes, camera, np.argmax)


def least_sensitive(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Use only the shortest exposure or lowest gain of each colour filter."""
    return _chosen(planes, camera, np.argmin)


def _chosen(planes: Array, camera: CameraModel, which: Callable[[Array], np.intp]) -> Array:
    whole = np.empty_like(planes)
    for group in _groups(camera):
        whole[group] = planes[group[which(camera.sensitivity[group])]]
    return whole


def _groups(camera: CameraModel) -> list[NDArray[np.intp]]:
    """Return the channels of each colour filter."""
    assert camera.readout is not None
    first = camera.readout.same_filter
    return [np.flatnonzero(first == one) for one in np.unique(first)]
