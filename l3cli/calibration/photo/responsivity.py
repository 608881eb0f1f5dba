"""Estimate responsivities from photos of charts, or from the colour matrices in a raw file.

docs/method.md#charts-in-photographs describes the method.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import Noise
from l3cli.artifacts.fit import LightGuess, PhotoFit, PhotoWindow
from l3cli.calibration import noise
from l3cli.calibration.photo import estimate as priors
from l3cli.calibration.photo.estimate import (
    FLOOR,
    ROLES,
    WAVELENGTH,
    Posterior,
    Prior,
    Shot,
    camera_prior,
    estimate,
    evidence,
    placed,
    plausible,
    smooth,
)
from l3cli.calibration.responsivity import BAND_FLOOR, COVERAGE, Curves
from l3cli.errors import InputFileError, raised_as
from l3cli.frames.chart import (
    MIN_FIT,
    PatchValues,
    components,
    corner_cells,
    fit,
    homography,
    locate,
    patch_values,
    photon_transfer,
    through,
)
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import Body, CurveStatistics, Measurements, PhotoCapture, SensorFigures
from l3cli.physics import spectra
from l3cli.physics.mosaic import shifted_cfa

# Relative standard deviation of the illumination over a chart: uncorrected, and corrected with a photo of a white target.
UNEVEN, UNEVEN_LEFT = 0.2, 0.01
LEAST_SHARE = 0.5  # smallest acceptable fraction of usable patches in a channel
LEAST_SIGNAL = 20.0  # DN; smallest acceptable value of the brightest patch
CANDIDATES = (  # possible illuminants of photos with an unknown illuminant
    "A", "2400K", "3200K", "4000K", "D50", "D55", "D65", "D75", "F2", "F7", "F11", "LED-B1", "LED-B3", "LED-B5",
)  # fmt: skip
JUDGED_UNDER = ("A", "D65", "F11")  # illuminants under which the uncertainty of colours is evaluated
SURFACES_EVERY = 7  # only every seventh surface in the library is evaluated, to save time
# Outliers deviate from the fit by more than FAR standard deviations. At most MOST_FAR outliers are excluded.
FAR, MOST_FAR = 4.0, 4
Array = NDArray[np.floating]
ERROR = 0.02  # relative error of patch values predicted from a colour matrix, in addition to the model error


@dataclass(frozen=True)
class Photograph:
    """The measured patches of a photo."""

    capture: PhotoCapture
    corners: Array  # (4, 2): column and row of the corners of the chart
    values: PatchValues
    black_level: float  # DN
    white_level: float  # DN
    shot: Shot
    left_out: tuple[str, ...]  # one line per excluded patch and channel


def measure(capture: PhotoCapture, body: Body) -> Photograph:
    """Measure the chart patches in a photo.

    The black level comes from the dark frames or, without dark frames, from the raw file. Uneven illumination is corrected
    if there are photos of a white target.

    Raises
    ------
    InputFileError
        If the chart is not found, if too few patches are usable, or if the dark frames are too bright.
    """
    frame = capture.frames[0]
    black = frame.black_level if not capture.darks else float(np.mean([dark.values.mean() for dark in capture.darks]))
    if not black < frame.white_level:
        raise InputFileError(
            f"the dark frames of {capture.name} are as bright as the white level; use frames that were captured without "
            "light"
        )
    cfa = shifted_cfa(body.cfa, frame.phase)
    chart = capture.chart
    reflectance = spectra.average(chart.reflectance, chart.wavelength, WAVELENGTH)
    mosaics = [each.values.astype(np.float64) - black for each in capture.frames]
    to_pixels = _geometry(capture, np.mean(mosaics, axis=0), cfa, reflectance)
    saturation = noise.SATURATED * (frame.white_level - black)
    with raised_as(InputFileError, capture.name, cure="; use a photo with a larger chart, or correct its corners"):
        values = patch_values(mosaics, cfa, to_pixels, chart.grid, saturation)
    _check(capture, values, body, reflectance)
    light = _over_white(capture.whites, black, cfa, to_pixels, chart.grid, saturation) if capture.whites else 1.0
    rows, cols = chart.grid
    row, col = np.divmod(np.arange(rows * cols), cols)
    place = np.stack([2 * (col + 0.5) / cols - 1, 2 * (row + 0.5) / rows - 1], axis=1)
    shot = Shot(
        light_of(capture),
        reflectance,
        place,
        values.mean / light,
        values.deviation / light,
        values.used,
        UNEVEN_LEFT if capture.whites else UNEVEN,
    )
    corners = through(to_pixels, corner_cells(rows, cols))
    left_out = [
        f"{capture.name}: patch {patch + 1} in {body.channels[channel]}: {why}" for patch, channel, why in values.left_out
    ]
    return Photograph(capture, corners, values, black, frame.white_level, shot, tuple(left_out))


def light_of(capture: PhotoCapture) -> Array:
    """Return the photon radiance of a photo's illuminant, sampled at WAVELENGTH and divided by its mean."""
    light = np.maximum(spectra.resample(capture.radiance, capture.wavelength, WAVELENGTH), 0.0)
    return np.asarray(light / light.mean())


def _geometry(capture: PhotoCapture, mosaic: Array, cfa: NDArray[np.uint8], reflectance: Array) -> Array:
    """Compute the homography from chart coordinates, in patches, to pixels.

    It follows from the corners in the measurement file. If they are missing, l3 searches the photo for the chart. Raises
    InputFileError if no chart is found, or if the corners are outside the photo or on a line.
    """
    rows, cols = capture.chart.grid
    if capture.corners is None:
        located = locate(mosaic, cfa, reflectance, capture.chart.grid)
        if located is None:
            raise InputFileError(
                f'{capture.name}: l3 found no chart with {rows}×{cols} patches; set "corners" in a measurement file, or '
                "take a photo in which the chart is larger, in focus and evenly lit"
            )
        return located.to_pixels
    height, width = mosaic.shape
    if (capture.corners < 0).any() or (capture.corners > (width, height)).any():
        raise InputFileError(
            f"{capture.name}: a corner of the chart is outside the photo, which has {width} columns and {height} rows; "
            'correct "corners", which contains the column and row of each corner'
        )
    try:
        matrix = homography(corner_cells(rows, cols), capture.corners)
        np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        raise InputFileError(
            f'{capture.name}: the corners of the chart are on a line; correct "corners" (begin at patch 1 and continue '
            "clockwise)"
        ) from None
    return matrix


def _check(capture: PhotoCapture, values: PatchValues, body: Body, reflectance: Array) -> None:
    """Raise InputFileError if too few patches are usable, a channel is too dark, or the patches do not match the chart."""
    count = len(values.mean)
    for channel, name in enumerate(body.channels):
        used = values.used[:, channel]
        if used.sum() < LEAST_SHARE * count:
            reasons = [why for _, each, why in values.left_out if each == channel]
            most = max(reasons, key=reasons.count)
            cure = "shorten the exposure" if most == "clipped" else "check the chart and its corners"
            raise InputFileError(
                f"{capture.name}: only {used.sum()} of {count} patches are usable in channel {name}, because most of the "
                f"remaining patches are {most}; {cure}"
            )
        if values.mean[used, channel].max() < LEAST_SIGNAL:
            raise InputFileError(
                f"{capture.name}: the chart is too dark in channel {name}; use a longer exposure, or check the black level"
            )
    if capture.corners is not None and fit(values.mean, components(reflectance)) < MIN_FIT / 2:
        cols = capture.chart.grid[1]
        raise InputFileError(
            f'{capture.name}: the patches within "corners" do not resemble the patches of the chart; write the column and '
            f"row of the outer corners of patches 1, {cols}, {count} and {count - cols + 1}, in this order"
        )


def _over_white(
    whites: Sequence[RawFrame],
    black: float,
    cfa: NDArray[np.uint8],
    to_pixels: Array,
    grid: tuple[int, int],
    saturation: float,
) -> Array:
    """Measure the illumination of each patch, relative to the mean of all patches: (patch, channel).

    The photos in `whites` show a white target in place of the chart. Raises InputFileError if the target is clipped, dark or
    uneven in this area.
    """
    mosaics = [white.values.astype(np.float64) - black for white in whites]
    values = patch_values(mosaics, cfa, to_pixels, grid, saturation)
    if not values.used.all() or values.mean.min() <= 0:
        raise InputFileError(
            f"{whites[0].name}: the photo of the white target is clipped, dark or uneven in the area of the chart; "
            "take a new photo of the white target"
        )
    return np.asarray(values.mean / values.mean.mean(axis=0))


def fit_photos(measurements: Measurements) -> tuple[Curves, PhotoFit, SensorFigures]:
    """Estimate a camera from photos of charts.

    Returns
    -------
    Curves
        Relative responsivities, scaled so that the highest peak of all channels is 1.
    PhotoFit
        Details of the fit.
    SensorFigures
        Levels of the sensor from the raw files, and its noise from the data sheet or from the patches.

    Raises
    ------
    InputFileError
        If a photo contains no usable chart, or if the noise of the sensor cannot be determined.
    """
    photographs = [measure(capture, measurements.body) for capture in measurements.photos]
    among = _priors(measurements)
    shots = _under_lights(photographs, among)
    prior = max(among, key=lambda each: evidence(shots, each))
    posterior, shots, far = _without_far_ones(shots, prior)
    likely = [priors.probabilities(shots, index, among, candidates()) for index in range(len(shots))]
    for index, photo in enumerate(photographs):
        if photo.capture.light is None:
            posterior = priors.unsure_of_light(posterior, shots, index, prior, likely[index], candidates())
    comparisons = [priors.compare(shots, index, among, candidates()) for index in range(len(shots))]
    judged = [candidates()[name] for name in JUDGED_UNDER]
    errors = [priors.response_errors(posterior.responsivity, posterior.covariance, light, _surfaces()) for light in judged]
    next_light, remaining = priors.next_light(shots[0], posterior, candidates(), judged, _surfaces())
    guessed = [photo.capture.light is None for photo in photographs]
    names = {id(light): name for name, light in candidates().items()}  # every guessed illuminant is a candidate
    named = [photo.capture.light or names[id(shot.light)] for photo, shot in zip(photographs, shots, strict=True)]
    sensor, from_patches = _sensor(photographs, measurements)
    fit = PhotoFit(
        names=tuple(photo.capture.name for photo in photographs),
        lights=tuple(named),
        guessed=np.array(guessed),
        nearest=tuple(nearest for nearest, _ in comparisons),
        deficit=np.array([deficit for _, deficit in comparisons]),
        charts=tuple(photo.capture.chart.name for photo in photographs),
        corners=np.array([photo.corners for photo in photographs], dtype=np.float64),
        prior=prior.source,
        error=posterior.error,
        illumination=posterior.illumination.astype(np.float64),
        glare=posterior.glare.astype(np.float64),
        noise_from_patches=from_patches,
        response_band=COVERAGE * np.sqrt(np.mean(np.square(errors), axis=0)),
        next_light=next_light,
        next_share=remaining,
        left_out=tuple(line for photo in photographs for line in photo.left_out)
        + _far_lines(far, photographs, measurements),
        used=_padded([shot.used for shot in shots], False),
        measured=_padded([shot.values for shot in shots], 0.0),
        predicted=_padded(list(posterior.predicted), 0.0),
        likely=LightGuess(CANDIDATES, np.array([[each[name] for name in CANDIDATES] for each in likely])),
        window=_window([capture.frames[0] for capture in measurements.photos], measurements.body),
    )
    return curves_of(posterior), fit, sensor


def _window(frames: Sequence[RawFrame], body: Body) -> PhotoWindow | None:
    """Return the CFA phase and size of each frame, or None if all frames cover the whole sensor."""
    if all(frame.phase == (0, 0) and frame.values.shape == (body.rows, body.cols) for frame in frames):
        return None
    return PhotoWindow(np.array([frame.phase for frame in frames]), np.array([frame.values.shape for frame in frames]))


def curves_of(posterior: Posterior) -> Curves:
    """Convert a posterior to responsivities with 95 % confidence bands, scaled to a highest peak of 1."""
    count, size = posterior.responsivity.shape
    deviation = np.sqrt(np.maximum(np.diag(posterior.covariance), 0.0)).reshape(count, size)
    relative = posterior.responsivity.astype(np.float64)
    return Curves(WAVELENGTH, relative, np.hypot(COVERAGE * deviation, BAND_FLOOR * relative.max())).to_common_peak()


@functools.cache
def candidates() -> Mapping[str, Array]:
    """Return the relative photon radiance of each illuminant in CANDIDATES, sampled at WAVELENGTH."""
    return {name: spectra.illuminant(name, WAVELENGTH) for name in CANDIDATES}


@functools.cache
def _surfaces() -> Array:
    return spectra.reflectance_library(WAVELENGTH)[::SURFACES_EVERY]


# ---------------------------------------------------------------------------------------------------- priors and lights


def _under_lights(photographs: Sequence[Photograph], among: Sequence[Prior]) -> list[Shot]:
    """Convert photos to shots. Each unknown illuminant is set to the most probable candidate."""
    shots = [photo.shot for photo in photographs]
    for index, photo in enumerate(photographs):
        if photo.capture.light is None:
            likely = priors.probabilities([shots[index]], 0, among, candidates())
            shots[index] = replace(shots[index], light=candidates()[max(likely, key=lambda name: likely[name])])
    return shots


def _priors(measurements: Measurements) -> list[Prior]:
    """Return the priors that may describe the camera's responsivities."""
    known = measurements.cameras
    table = known if known is None or isinstance(known, CurveStatistics) else priors.statistics(known)
    return plausible(measurements.body.channels, table)


# ---------------------------------------------------------------------------------------------------------- outliers


def _without_far_ones(shots: list[Shot], prior: Prior) -> tuple[Posterior, list[Shot], list[tuple[int, int, int]]]:
    """Fit the shots, remove outliers, and repeat the fit.

    Outliers deviate from the first fit by more than FAR standard deviations. If there are more than MOST_FAR, only those
    with the largest deviations are removed.

    Returns
    -------
    posterior : Posterior
        Result of the fit.
    shots : list of Shot
        The shots without outliers.
    outliers : list of tuple
        Indices of each outlier's shot, patch and channel.
    """
    posterior = estimate(shots, prior)
    far: list[tuple[float, int, int, int]] = []
    for index, (shot, predicted) in enumerate(zip(shots, posterior.predicted, strict=True)):
        floor = FLOOR * np.where(shot.used, shot.values, 0.0).max(axis=0)
        spread = np.sqrt(shot.deviation**2 + floor**2 + (posterior.error * predicted) ** 2)
        off = np.where(shot.used, np.abs(shot.values - predicted) / spread, 0.0)
        far += [(float(off[patch, channel]), index, int(patch), int(channel)) for patch, channel in np.argwhere(off > FAR)]
    chosen = [(index, patch, channel) for _, index, patch, channel in sorted(far, reverse=True)[:MOST_FAR]]
    if not chosen:
        return posterior, shots, []
    shots = [replace(shot, used=shot.used.copy()) for shot in shots]
    for index, patch, channel in chosen:
        shots[index].used[patch, channel] = False
    return estimate(shots, prior), shots, chosen


def _far_lines(
    far: Sequence[tuple[int, int, int]], photographs: Sequence[Photograph], measurements: Measurements
) -> tuple[str, ...]:
    names = measurements.body.channels
    return tuple(
        f"{photographs[shot].capture.name}: patch {patch + 1} in {names[channel]}: outlier in the fit of all patches"
        for shot, patch, channel in far
    )


def _padded(parts: Sequence[NDArray], fill: float | bool) -> NDArray:
    """Stack arrays, one per photo.

    If the charts have different numbers of patches, shorter arrays are padded with `fill`.
    """
    most = max(len(part) for part in parts)
    shape = (len(parts), most, parts[0].shape[1])
    result = np.full(shape, fill, dtype=bool if isinstance(fill, bool) else np.float64)
    for index, part in enumerate(parts):
        result[index, : len(part)] = part
    return result


# ------------------------------------------------------------------------------------------------------------ sensor


def _sensor(photographs: Sequence[Photograph], measurements: Measurements) -> tuple[SensorFigures, bool]:
    """Return the sensor's gain, noise and levels, and whether gain and noise were estimated from the patches.

    Gain and noise come from the data sheet or, without a data sheet, from the patches. The levels come from the first photo.
    If there is no data sheet, InputFileError is raised in two cases: the white level exceeds the bit depth, or the noise of
    the patches does not increase with the signal.
    """
    first = photographs[0]
    if measurements.datasheet is not None:
        return replace(measurements.datasheet, black_level=first.black_level, white_level=first.white_level), False
    if first.white_level > 2**measurements.body.bits - 1:
        raise InputFileError(
            f"the white level of {first.capture.name} is {first.white_level:g} DN, which exceeds the largest value of "
            f'{measurements.body.bits} bits; correct "sensor.bits"'
        )
    transfer = photon_transfer([photo.values for photo in photographs])
    if transfer is None:
        raise InputFileError(
            f"{first.capture.name}: the noise does not increase with the signal, so the file seems to be processed; use an "
            "unprocessed raw file, or state gain and noise in [datasheet]"
        )
    gain, dark_noise = transfer
    well = (first.white_level - first.black_level) / gain
    return SensorFigures(gain, first.black_level, first.white_level, Noise(dark_noise / gain, 0.0, 0.0, 0.0, well)), True


@dataclass(frozen=True)
class ColourMatrix:
    """A camera's colour matrix for one illuminant, as in the ColorMatrix tags of DNG 1.7."""

    light: str  # name of the illuminant
    values: Array  # (channel, 3): converts XYZ to channel signals


def curves_of_matrices(matrices: Sequence[ColourMatrix], prior: Prior) -> Curves:
    """Estimate responsivities from colour matrices, with 95 % confidence bands.

    l3 uses the matrices to predict the channel values of a ColorChecker's patches. It then estimates the responsivities as
    if these values had been measured in a photo.
    """
    reflectance = spectra.colorchecker(WAVELENGTH)[1]
    shots = [_shot(matrix, reflectance) for matrix in matrices]
    return curves_of(estimate(shots, prior))


def usual_curves(prior: Prior) -> Curves:
    """Return the prior's mean curves with 95 % confidence bands, for a camera about which nothing else is known."""
    peaks = np.exp(prior.log_peak)[:, None]
    deviation = np.sqrt(np.diag(prior.covariance)).reshape(prior.mean.shape)
    mean = np.asarray(prior.mean * peaks, np.float64)
    return Curves(WAVELENGTH, mean, COVERAGE * deviation * peaks).to_common_peak()


def balanced_curves(curves: Curves, light: str) -> Curves:
    """Scale each channel's curve so that greys have equal signals in all channels under the illuminant `light`."""
    signals = curves.relative @ spectra.illuminant(light, curves.wavelength)
    scale = (signals.min() / signals)[:, None]
    return Curves(curves.wavelength, curves.relative * scale, curves.band * scale).to_common_peak()


def prior_of(channels: Sequence[str], known: CurveStatistics) -> Prior:
    """Return the prior for a camera with these channels.

    If the channels are r, g and b in any order, it is the prior of measured cameras. Otherwise, it is the smooth prior.
    """
    if sorted(channels) != sorted(ROLES):
        return smooth(len(channels))
    return placed(camera_prior(known), [channels.index(role) for role in ROLES], len(channels))


def _shot(matrix: ColourMatrix, reflectance: Array) -> Shot:
    """Predict, from a colour matrix, a shot of an evenly lit chart without glare."""
    light = spectra.illuminant(matrix.light, WAVELENGTH)
    weights = spectra.xyz_weights(WAVELENGTH)
    xyz = (reflectance * light) @ weights.T / (weights[1] @ light)
    values = np.asarray(xyz @ matrix.values.T, np.float64)
    place = np.zeros((len(values), 2))
    deviation = ERROR * np.abs(values)
    return Shot(light, reflectance, place, values, deviation, values > 0, uneven=0.0, glare=0.0)
