"""The basic pipeline, an untrained baseline (docs/method.md#basic-pipeline).

Its steps are white balance, demosaicking and a colour matrix.

Each channel clips at its own full scale, so clipped highlights can be coloured. If all channels were clipped together at the
signal at which the first channel clips, highlights would be neutral, but the colour error of faces would increase by 0.6
ΔE00 (mean over three light levels). The pipeline therefore clips each channel separately, because a baseline should be as
good as possible.
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
# Function that merges several exposures of the same colour filter. The first argument and the result are white-balanced
# planes (channel, row, col). The last argument contains one white-balance factor per channel.
Merge = Callable[[Array, TrainingPair, CameraModel, Array], Array]
CLIPPED = 0.985  # raw values at or above this fraction of full scale are clipped
TOUCHED = 0.02  # an interpolated value is clipped if clipped raw values contribute more than this fraction
# Ridge parameter, relative to the mean square of the channel differences. A larger value reduces noise but increases colour
# errors. This value increases the colour error of a chart by 1.7 ΔE.
RIDGE = 0.05
BLIND = 1e-6  # channels whose response to white is less than this fraction of the largest response are ignored
# Ends of the wavelength range of the CIE observers. Each entry contains the function that extends the range to the
# wavelengths of cameras, the wavelength in nm, and the index of this end in an array of wavelengths.
ENDS = ((min, 360.0, 0), (max, 830.0, -1))
UNNAMED = ("A", "D50", "D55", "D65", "D75", "E", "FL2", "FL11")  # candidates if only the white point of a frame is known


@dataclass(frozen=True)
class Colour:
    """White balance and colour matrix of a camera for one illuminant.

    The white balance and the matrix convert photo-electrons per second to outputs. A perfect white of 1 cd/m² is 1 in all
    outputs.
    """

    balance: Array  # (channel,): white-balance factors; 0 for channels that do not respond to white
    matrix: Array  # (output, channel): each row sums to 1


def fit_colour(
    camera: CameraModel, light: LightSpectrum, wanted: LightSpectrum | None = None, channel_noise: float = 0.0
) -> Colour:
    """Fit a white balance and a colour matrix of a camera for an illuminant.

    The matrix is fitted by ridge regression over measured reflectances. The matrix reproduces a perfect white exactly.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : LightSpectrum
        Illuminant of the scene.
    wanted : LightSpectrum, optional
        Illuminant of the target XYZ. [default: `light`]
    channel_noise : float
        Standard deviation of the noise of each channel, relative to white. The regression takes this noise into account, so
        that the matrix does not amplify the noise. This matters if several channels respond almost equally, for example
        behind polarisers with different angles.

    Raises
    ------
    InputFileError
        If an illuminant is invisible to the eye or to the camera.
    """
    library, falling = lit_library(light)
    electrons = electrons_of(camera, light, library * falling)
    seen = electrons[0] > BLIND * electrons[0].max()
    if not seen.any():
        raise InputFileError(
            f"camera {camera.name} does not respond to the illuminant of a frame; "
            "simulate the frame under a different illuminant"
        )
    library, falling = lit_library(wanted or light)
    xyz = library * falling @ spectra.xyz_weights((wanted or light).wavelength).T
    balance, matrix = np.zeros(len(seen)), np.zeros((3, len(seen)))
    balance[seen] = 1.0 / electrons[0, seen]
    white = np.where(xyz[0] > 0, xyz[0], 1.0)  # under deep red light, Z of white is 0
    matrix[:, seen] = white_preserving_ridge(electrons[1:, seen] * balance[seen], xyz[1:] / white, channel_noise)
    return Colour(balance, matrix)


def electrons_of(camera: CameraModel, light: LightSpectrum, radiances: Array) -> Array:
    """Return the photo-electrons per second that radiance spectra cause in a pixel of each channel.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : LightSpectrum
        Illuminant that determines the wavelengths of `radiances`.
    radiances : ndarray, (sample, wavelength)
        Radiance spectra.

    Returns
    -------
    ndarray, (sample, channel)
        Photo-electrons per second.
    """
    return radiances @ (camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)).T


def lit_library(light: LightSpectrum) -> tuple[Array, Array]:
    """Return measured reflectances at the wavelengths of an illuminant, and the radiance of a perfect white.

    Returns
    -------
    reflectances : ndarray, (sample, wavelength)
        A perfect white, followed by the measured surfaces.
    radiance : ndarray, (wavelength,)
        Radiance of the perfect white, scaled to a luminance of 1 cd/m².

    Raises
    ------
    InputFileError
        If the illuminant contains no visible light.
    """
    radiance = light.radiance.astype(np.float64)
    if not spectra.xyz_weights(light.wavelength)[1] @ radiance > 0:
        raise InputFileError(
            "the illuminant of a frame contains no visible light; simulate the frame under a different illuminant"
        )
    library = np.vstack([np.ones(light.wavelength.size), spectra.reflectance_library(light.wavelength)])
    return library, spectra.at_luminance(radiance, light.wavelength, 1.0)


def white_preserving_ridge(channels: Array, outputs: Array, channel_noise: float = 0.0) -> Array:
    """Fit a matrix that converts white-balanced channels to outputs and preserves white.

    For each sample, the mean over the channels is subtracted from the channels and from the outputs. The matrix for these
    differences is then fitted by ridge regression.

    Parameters
    ----------
    channels : ndarray, (sample, channel)
        White-balanced channels.
    outputs : ndarray, (sample, output)
        Outputs relative to white.
    channel_noise : float
        Standard deviation of noise in each channel, relative to white.

    Returns
    -------
    ndarray, (output, channel)
        Colour matrix. Each row sums to 1.
    """
    mean = channels.mean(axis=1, keepdims=True)
    differences = channels - mean
    gram = differences.T @ differences
    ridge = (RIDGE * np.trace(gram) / len(gram) + channel_noise**2 * len(channels)) * np.eye(len(gram))
    # lstsq instead of solve, because the equation is 0 = 0 if there is only one channel.
    matrix = np.linalg.lstsq(gram + ridge, differences.T @ (outputs - mean))[0].T
    return matrix - matrix.mean(axis=1, keepdims=True) + 1.0 / len(gram)


def develop(
    frame: TrainingPair, camera: CameraModel, colour: Colour, demosaic: Demosaic, merge: Merge | None = None
) -> Array:
    """Convert a raw frame to XYZ with the basic pipeline.

    Parameters
    ----------
    frame : TrainingPair
        Raw frame, with the white of its target.
    camera : CameraModel
        Camera of the frame.
    colour : Colour
        White balance and colour matrix for the illuminant of the frame.
    demosaic : callable
        Demosaicking method.
    merge : callable, optional
        Function that merges exposures, if the channels of the camera have different exposures or gains.

    Returns
    -------
    ndarray, (3, row, col)
        XYZ in the unit of the target.
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
    """Demosaick a raw frame to the bands of its camera (docs/method.md#baselines-for-bands).

    The steps are: subtraction of the black level and the dark signal, white balance, demosaicking, and multiplication by the
    white of the target.

    Parameters
    ----------
    frame : TrainingPair
        Raw frame, with the white of its target.
    camera : CameraModel
        Camera of the frame.
    relit : bool
        Whether the illuminant of the target differs from the illuminant of the frame.
    demosaic : callable
        Demosaicking method.

    Returns
    -------
    ndarray, (channel, row, col)
        Bands in the unit of the target.

    Raises
    ------
    InputFileError
        If the illuminant is invisible to the camera.
    """
    share = camera.saturation_exposure / camera.full_scale  # increase of a band in the target per electron per second
    white = white_electrons(frame, camera) if relit else frame.white / (share * camera.channel_gains)
    return balanced_bands(frame, camera, white, demosaic) * frame.white[:, None, None]


def develop_stokes(frame: TrainingPair, camera: CameraModel, demosaic: Demosaic) -> Array:
    """Demosaick a raw frame of a monochrome polarisation camera, and compute S1, S0 and S2 of each pixel.

    The channels are demosaicked as in `develop_bands`. The Stokes parameters are the least-squares solution, given the
    angles and the extinction ratios of the polarisers.

    Parameters
    ----------
    frame : TrainingPair
        Raw frame, with the white of its target. The second output of the target must be S0.
    camera : CameraModel
        Camera of the frame.
    demosaic : callable
        Demosaicking method.

    Returns
    -------
    ndarray, (3, row, col)
        S1, S0 and S2 in the unit of the target.
    """
    bands = balanced_bands(frame, camera, white_electrons(frame, camera), demosaic)
    stokes = np.einsum("sc,crk->srk", np.linalg.pinv(stokes_response(frame, camera)), bands)
    return np.asarray(stokes[[1, 0, 2]] * frame.white[1])


def stokes_response(frame: TrainingPair, camera: CameraModel) -> Array:
    """Return the response of each channel to S0, S1 and S2, relative to its response to S0: (channel, stokes).

    The light has the spectrum of the frame's illuminant.
    """
    light = light_of(frame, camera)
    radiance = spectra.sampling_matrix(light.wavelength, camera.wavelength) @ light.radiance
    response = (camera.stokes_weights @ radiance).T
    return np.asarray(response / response[:, :1])


def white_electrons(frame: TrainingPair, camera: CameraModel) -> Array:
    """Return the photo-electrons per second that a perfect white causes in each channel under the frame's illuminant."""
    light = light_of(frame, camera)
    falling = spectra.at_luminance(light.radiance.astype(np.float64), light.wavelength, frame.luminance)
    return electrons_of(camera, light, falling[None])[0]


def balance_of(white: Array, exposure: float, camera: CameraModel) -> Array:
    """Return the white-balance factor of each channel, by which photo-electrons are multiplied so that a perfect white is 1.

    The factor is 0 for channels that do not respond to white.

    Parameters
    ----------
    white : ndarray, (channel,)
        Signal of a perfect white in electrons per second.
    exposure : float
        Exposure time in s.
    camera : CameraModel
        The camera, for the error message.

    Raises
    ------
    InputFileError
        If no channel responds to white.
    """
    if not white.max() > 0:
        raise InputFileError(
            f"camera {camera.name} does not respond to the illuminant of a frame; "
            "simulate the frame under a different illuminant"
        )
    seen = white > BLIND * white.max()
    return np.where(seen, 1.0 / np.where(seen, white, 1.0), 0.0) / exposure


def balanced_bands(frame: TrainingPair, camera: CameraModel, white: Array, demosaic: Demosaic) -> Array:
    """Demosaick a raw frame to bands in which a perfect white is 1: (channel, row, col).

    `white`, (channel,), is the signal of a perfect white in electrons per second.
    """
    balance = balance_of(white, frame.exposure, camera)
    return demosaic(_electrons(frame, camera) * balance[camera.channel_map(frame.raw.shape)], camera.cfa)


def _electrons(frame: TrainingPair, camera: CameraModel) -> Array:
    """Convert raw values to photo-electrons, without dark signal: (row, col)."""
    signal = (frame.raw - camera.black_level) / camera.gain
    dark = camera.noise.dark_current * frame.dark_time
    if camera.readout is None:
        return signal - dark
    channel = camera.channel_map(frame.raw.shape)
    return signal / camera.readout.channel_gain[channel] - dark * camera.readout.channel_exposure[channel]


def light_of(frame: TrainingPair, camera: CameraModel) -> LightSpectrum:
    """Return the spectrum of a frame's illuminant. The first available spectrum in this list is used:

    1. the spectrum that is stored with the frame;
    2. the standard illuminant with the name that is stored with the frame;
    3. the illuminant in UNNAMED whose white point is nearest to the white of the frame.
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
    """Return a standard illuminant in steps of 1 nm, over all wavelengths of the CIE observers and of the cameras."""
    first, last = (bound(end, *(camera.wavelength[at] for camera in cameras)) for bound, end, at in ENDS)
    grid = np.arange(np.floor(first), last + 1.0)
    light = spectra.at_luminance(spectra.illuminant(name, grid), grid, 1.0)
    return LightSpectrum(grid, light.astype(np.float32))


# -------------------------------------------------------------------------------------------- several exposures or gains


def merges(camera: CameraModel) -> dict[str, Merge | None]:
    """Return the names of the basic pipelines for a camera, with the function that merges exposures in each pipeline.

    The pipeline "basic" averages the exposures. Two other pipelines use only one of the exposures. If all channels have
    the same sensitivity, there is only the pipeline "basic", with the value None.
    """
    if camera.readout is None or np.ptp(camera.sensitivity) == 0:
        return {"basic": None}
    names = ("long", "short") if np.ptp(camera.readout.channel_exposure) else ("high gain", "low gain")
    return {"basic": merged, names[0]: most_sensitive, names[1]: least_sensitive}


def merged(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Average the exposures of each colour filter, weighted by the inverse of their noise variances.

    At each pixel, exposures that clip nearby are ignored. If all exposures of a filter clip near a pixel, the least
    sensitive exposure is used.
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
    """For each colour filter, copy the plane of the most sensitive channel to all channels with this filter.

    The most sensitive channel has the longest exposure or the highest gain.
    """
    return _chosen(planes, camera, np.argmax)


def least_sensitive(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """For each colour filter, copy the plane of the least sensitive channel to all channels with this filter.

    The least sensitive channel has the shortest exposure or the lowest gain.
    """
    return _chosen(planes, camera, np.argmin)


def _chosen(planes: Array, camera: CameraModel, which: Callable[[Array], np.intp]) -> Array:
    whole = np.empty_like(planes)
    for group in _groups(camera):
        whole[group] = planes[group[which(camera.sensitivity[group])]]
    return whole


def _groups(camera: CameraModel) -> list[NDArray[np.intp]]:
    """Group the channels by colour filter, and return the indices of the channels in each group."""
    assert camera.readout is not None
    first = camera.readout.same_filter
    return [np.flatnonzero(first == one) for one in np.unique(first)]
