"""The basic pipeline, an untrained baseline (docs/method.md#basic-pipeline).

Its steps are white balance, demosaicking and a colour matrix.

Each channel clips at its own full scale, so clipped highlights can be coloured. Clipping all channels together would make
highlights neutral, but would increase the colour error of faces by 0.6 ΔE00 (mean over three light levels).
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
# Merges channels with the same colour filter but different exposures or gains. The first argument and the result are
# white-balanced planes (channel, row, col). The last argument contains the white-balance factors (channel,).
Merge = Callable[[Array, TrainingPair, CameraModel, Array], Array]
CLIPPED = 0.985  # raw values at or above this fraction of full scale count as clipped
TOUCHED = 0.02  # interpolated values count as clipped if clipped raw values contribute more than this fraction
# Ridge parameter, relative to the mean square of the channel differences. Larger values reduce noise but increase colour
# errors. This value increases the colour error of a chart by 1.7 ΔE.
RIDGE = 0.05
BLIND = 1e-6  # channels with a response to white below this fraction of the largest response are ignored
OBSERVED = (360.0, 830.0)  # nm; wavelength range of the CIE observers
UNNAMED = ("A", "D50", "D55", "D65", "D75", "E", "FL2", "FL11")  # candidates if only a frame's white point is known


@dataclass(frozen=True)
class Colour:
    """White balance and colour matrix of a camera for one illuminant.

    Together they convert photo-electrons per second to outputs. A perfect white of 1 cd/m² becomes 1 in all outputs.
    """

    balance: Array  # (channel,) white-balance factors; 0 for channels that do not respond to white
    matrix: Array  # (output, channel) each row sums to 1


def fit_colour(
    camera: CameraModel, light: LightSpectrum, wanted: LightSpectrum | None = None, channel_noise: float = 0.0
) -> Colour:
    """Fit a camera's white balance and colour matrix for an illuminant.

    The matrix is a ridge regression over measured reflectances, which reproduces a perfect white exactly.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : LightSpectrum
        Illuminant of the scene.
    wanted : LightSpectrum, optional
        Illuminant of the target XYZ. [default: `light`]
    channel_noise : float
        Standard deviation of each channel's noise, relative to white, which the matrix should not amplify. This matters if
        several channels respond almost equally, for example behind polarisers at different angles.

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
    """Return each channel's signal for given radiance spectra, in photo-electrons per second.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    light : LightSpectrum
        Illuminant with the same wavelengths as `radiances`.
    radiances : ndarray, (sample, wavelength)
        Radiance spectra.

    Returns
    -------
    ndarray, (sample, channel)
        Photo-electrons per second.
    """
    return radiances @ (camera.electron_weights @ spectra.sampling_matrix(light.wavelength, camera.wavelength)).T


def lit_library(light: LightSpectrum) -> tuple[Array, Array]:
    """Return measured reflectances at an illuminant's wavelengths, and the radiance of a perfect white.

    Returns
    -------
    reflectances : ndarray, (sample, wavelength)
        A perfect white, then the measured surfaces.
    radiance : ndarray, (wavelength,)
        Radiance of the perfect white, scaled to 1 cd/m².

    Raises
    ------
    InputFileError
        If the illuminant contains no visible light.
    """
    radiance = light.radiance.astype(np.float64)
    if not spectra.xyz_weights(light.wavelength)[1] @ radiance > 0:
        raise InputFileError(
            "a frame's illuminant contains no visible light; simulate the frame under a different illuminant"
        )
    library = np.vstack([np.ones(light.wavelength.size), spectra.reflectance_library(light.wavelength)])
    return library, spectra.at_luminance(radiance, light.wavelength, 1.0)


def white_preserving_ridge(channels: Array, outputs: Array, channel_noise: float = 0.0) -> Array:
    """Fit a matrix from white-balanced channels to outputs that preserves white.

    The fit is a ridge regression. Before the fit, the mean of each sample's channels is subtracted from its channels and
    outputs.

    Parameters
    ----------
    channels : ndarray, (sample, channel)
        White-balanced channels.
    outputs : ndarray, (sample, output)
        Outputs relative to white.
    channel_noise : float
        Standard deviation of each channel's noise, relative to white.

    Returns
    -------
    ndarray, (output, channel)
        Colour matrix. Each row sums to 1.
    """
    mean = channels.mean(axis=1, keepdims=True)
    differences = channels - mean
    gram = differences.T @ differences
    ridge = (RIDGE * np.trace(gram) / len(gram) + channel_noise**2 * len(channels)) * np.eye(len(gram))
    # lstsq instead of solve, because with a single channel the equation is 0 = 0.
    matrix = np.linalg.lstsq(gram + ridge, differences.T @ (outputs - mean))[0].T
    return matrix - matrix.mean(axis=1, keepdims=True) + 1.0 / len(gram)


def develop(
    frame: TrainingPair, camera: CameraModel, colour: Colour, demosaic: Demosaic, merge: Merge | None = None
) -> Array:
    """Convert a raw frame to XYZ with the basic pipeline.

    Parameters
    ----------
    frame : TrainingPair
        Raw frame with its target.
    camera : CameraModel
        Camera that took the frame.
    colour : Colour
        White balance and colour matrix for the frame's illuminant.
    demosaic : callable
        Demosaicking method.
    merge : callable, optional
        Merges channels with different exposures or gains, if the camera has any.

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
    """Demosaick a raw frame to the camera's bands (docs/method.md#baselines-for-bands).

    The steps are: subtract the black level and the dark signal, apply the white balance, demosaick, and multiply by the
    target's white.

    Parameters
    ----------
    frame : TrainingPair
        Raw frame with its target.
    camera : CameraModel
        Camera that took the frame.
    relit : bool
        Whether the target has another illuminant than the frame.
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
    share = camera.saturation_exposure / camera.full_scale  # value of a target band per electron per second
    white = white_electrons(frame, camera) if relit else frame.white / (share * camera.channel_gains)
    return balanced_bands(frame, camera, white, demosaic) * frame.white[:, None, None]


def develop_stokes(frame: TrainingPair, camera: CameraModel, demosaic: Demosaic) -> Array:
    """Compute S1, S0 and S2 (in this order) of each pixel from a raw frame of a monochrome polarisation camera.

    The frame is demosaicked as in `develop_bands`. The Stokes parameters of a pixel are then fitted to its intensities by
    least squares. The angles and extinction ratios of the polarisers are known.

    Parameters
    ----------
    frame : TrainingPair
        Raw frame with its target. The target's second output must be S0.
    camera : CameraModel
        Camera that took the frame.
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
    """Return each channel's responses to S0, S1 and S2 of the illuminant, relative to its response to S0.

    The result has the shape (channel, 3).
    """
    light = light_of(frame, camera)
    radiance = spectra.sampling_matrix(light.wavelength, camera.wavelength) @ light.radiance
    response = (camera.stokes_weights @ radiance).T
    return np.asarray(response / response[:, :1])


def white_electrons(frame: TrainingPair, camera: CameraModel) -> Array:
    """Return each channel's signal from a perfect white under a frame's illuminant, in photo-electrons per second."""
    light = light_of(frame, camera)
    falling = spectra.at_luminance(light.radiance.astype(np.float64), light.wavelength, frame.luminance)
    return electrons_of(camera, light, falling[None])[0]


def balance_of(white: Array, exposure: float, camera: CameraModel) -> Array:
    """Return the factor of each channel (channel,) that scales the electrons of a perfect white to 1.

    The factor of a channel that does not respond to white is 0.

    Parameters
    ----------
    white : ndarray, (channel,)
        Signals of a perfect white in electrons per second.
    exposure : float
        Exposure time in s.
    camera : CameraModel
        Camera to name in the error message.

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
    """Demosaick a raw frame to bands (channel, row, col) in which a perfect white is 1.

    `white` (channel,) contains the signals of a perfect white in electrons per second.
    """
    balance = balance_of(white, frame.exposure, camera)
    return demosaic(_electrons(frame, camera) * balance[camera.channel_map(frame.raw.shape)], camera.cfa)


def _electrons(frame: TrainingPair, camera: CameraModel) -> Array:
    """Convert raw values to photo-electrons (row, col), without dark signal."""
    signal = (frame.raw - camera.black_level) / camera.gain
    dark = camera.noise.dark_current * frame.dark_time
    if camera.readout is None:
        return signal - dark
    channel = camera.channel_map(frame.raw.shape)
    return signal / camera.readout.channel_gain[channel] - dark * camera.readout.channel_exposure[channel]


def light_of(frame: TrainingPair, camera: CameraModel) -> LightSpectrum:
    """Return the spectrum of a frame's illuminant.

    The first of these spectra that is available is returned:

    1. the spectrum that is stored with the frame;
    2. the standard illuminant with the stored name;
    3. the illuminant in UNNAMED with the white point nearest to the frame's white.
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
    """Return a standard illuminant in steps of 1 nm, over the wavelength ranges of the CIE observers and the cameras."""
    first = min(OBSERVED[0], *(camera.wavelength[0] for camera in cameras))
    last = max(OBSERVED[1], *(camera.wavelength[-1] for camera in cameras))
    grid = np.arange(np.floor(first), last + 1.0)
    light = spectra.at_luminance(spectra.illuminant(name, grid), grid, 1.0)
    return LightSpectrum(grid, light.astype(np.float32))


# -------------------------------------------------------------------------------------------- several exposures or gains


def merges(camera: CameraModel) -> dict[str, Merge | None]:
    """Return the basic pipelines for a camera: name → function that merges exposures.

    "basic" averages the exposures, and two more pipelines use only one of them. If all channels have the same sensitivity,
    the only pipeline is "basic", with None instead of a function.
    """
    if camera.readout is None or np.ptp(camera.sensitivity) == 0:
        return {"basic": None}
    names = ("long", "short") if np.ptp(camera.readout.channel_exposure) else ("high gain", "low gain")
    return {"basic": merged, names[0]: most_sensitive, names[1]: least_sensitive}


def merged(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Average the exposures of each colour filter, weighted by their inverse noise variances.

    Exposures that clip near a pixel are ignored there. If all exposures of a filter clip, the least sensitive one is used.
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
    """Copy the plane with the longest exposure or highest gain to all channels with the same colour filter."""
    return _chosen(planes, camera, np.argmax)


def least_sensitive(planes: Array, frame: TrainingPair, camera: CameraModel, balance: Array) -> Array:
    """Copy the plane with the shortest exposure or lowest gain to all channels with the same colour filter."""
    return _chosen(planes, camera, np.argmin)


def _chosen(planes: Array, camera: CameraModel, which: Callable[[Array], np.intp]) -> Array:
    whole = np.empty_like(planes)
    for group in _groups(camera):
        whole[group] = planes[group[which(camera.sensitivity[group])]]
    return whole


def _groups(camera: CameraModel) -> list[NDArray[np.intp]]:
    assert camera.readout is not None
    first = camera.readout.same_filter
    return [np.flatnonzero(first == one) for one in np.unique(first)]
