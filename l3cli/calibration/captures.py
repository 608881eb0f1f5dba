"""Evaluate the captures in a measurement file, and compute defect maps and flat fields.

The captures are dark and white frames, monochromatic captures, charts (docs/method.md#calibration), charts through
narrow-band filters (docs/method.md#sweeps-and-band-series), and frames behind a rotating polariser
(docs/method.md#polarisers). docs/method.md#corrections describes defect maps and flat fields.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, FlatField, Noise
from l3cli.artifacts.fit import Fit, PolariserFit, SeriesFit
from l3cli.calibration import agreement, noise, polarisers, responsivity, statistics
from l3cli.calibration.blinking import BlinkingPixels, find_blinking
from l3cli.calibration.responsivity import COVERAGE, Curves, light_centre
from l3cli.errors import InputFileError, raised_as
from l3cli.frames.measurement import (
    PATCHES,
    BandCapture,
    Body,
    Capture,
    ChartCapture,
    Measurements,
    MonoCapture,
    SensorFigures,
)
from l3cli.physics import spectra

OVEREXPOSED = 1e-3  # a monochromatic capture is not used for channels with at least this fraction of saturated pixels
CUT_OFF = 0.05  # a monochromatic spectrum is incomplete if its ends exceed this fraction of its peak
Array = NDArray[np.float64]
DEGREE = 4  # degree of the polynomial that models the shading
CELLS = (36, 54)  # largest numbers of rows and columns of cells; the polynomial is fitted to the means of the cells
GRID = (33, 49)  # rows and columns of the stored grid, fine enough to interpolate cos⁴ with an accuracy of 0.1 %
UNEVEN = 0.05  # largest relative RMS deviation of the cell means from the polynomial; lens shading stays below this limit
LEAST_SIGNAL = 0.02  # smallest median of white frames, as a fraction of full scale
MOST_DEFECTIVE = 0.05  # if a larger fraction of the pixels seems defective, the frames are unsuitable


@dataclass(frozen=True)
class Sensor:
    """Sensor properties, measured in dark and white frames."""

    dark: noise.DarkNoise
    transfer: noise.PhotonTransfer
    response: noise.ResponseNoise
    exposure: Array  # (capture,): exposure times of the white captures in s
    defects: statistics.Defects
    blinking: BlinkingPixels | None = None  # None if there are too few dark frames to find blinking pixels
    # the blinking pixels in `defects`; empty if the measurement file does not request their correction
    blinking_defects: statistics.Defects = field(default_factory=statistics.no_defects)

    @property
    def saturation(self) -> float:
        """Raw value in DN at and above which a pixel counts as saturated."""
        black_level = self.dark.black_level.mean()
        return float(black_level + noise.SATURATED * (self.transfer.white_level - black_level))


@dataclass(frozen=True)
class Charts:
    """Patch values measured in the chart captures, and the photons that pixels received from these patches."""

    illuminants: tuple[str, ...]  # illuminant of each chart capture
    values: Array  # (chart, patch, channel): mean value in DN, without dark signal
    # (chart, patch, wavelength): photons that a pixel receives, weighted by each hat function (triangular basis function);
    # includes lens falloff
    photons: Array


def measure_sensor(measurements: Measurements, each: statistics.Each = map) -> Sensor:
    """Measure noise, black level, saturation and defects in dark and white frames (docs/method.md#dark-and-white-frames).

    Parameters
    ----------
    measurements : Measurements
        Measurements with dark and white captures.
    each : callable
        Function with the signature of the built-in `map`, which may use several processes.

    Raises
    ------
    InputFileError
        If a capture cannot be used, or if captures contradict each other.
    """
    body = measurements.body
    dark = noise.dark_noise(measurements.darks, body, each)
    whites = sorted(measurements.whites, key=lambda capture: capture.exposure)
    levels = list(each(functools.partial(statistics.measure_level, body=body, defects=dark.hot), whites))
    signal = np.array(
        [statistics.mean_value(level.counts) - dark.black_level - dark.slope * level.exposure for level in levels]
    )
    agreement.check_whites(whites, np.array([level.lit for level in levels]), signal)
    transfer = noise.photon_transfer(levels, body, dark)
    response = noise.response_noise(whites, levels, transfer.used, body, dark, each)
    exposure = np.array([level.exposure for level in levels])
    blinking = find_blinking(measurements.darks, dark.trials, body)
    listed = statistics.no_defects() if blinking is None or not measurements.blinking_defects else blinking.position
    defects = statistics.joined_defects(dark.hot, response.dead, listed)
    return Sensor(dark, transfer, response, exposure, defects, blinking, listed)


def photons_on_pixel(capture: MonoCapture | ChartCapture, nodes: Array, body: Body) -> Array:
    """Compute the photons that a pixel on the optical axis receives during a capture.

    The spectrum is integrated with hat functions (triangles) that are centred on the wavelengths `nodes` in nm.

    Returns
    -------
    ndarray, (…, node)
        Number of photons in each hat function. For charts, the first axis contains the patches.
    """
    photons = responsivity.node_photons(capture.wavelength, capture.radiance, nodes)
    return body.photons_per_radiance * capture.lit * photons


def measure_sweep(
    captures: Sequence[MonoCapture], body: Body, sensor: Sensor, each: statistics.Each = map
) -> tuple[responsivity.Sweep, tuple[str, ...]]:
    """Set up the linear systems for computing the responsivities (docs/method.md#responsivity).

    Each monochromatic capture contributes one equation per channel, from the mean signal of the whole frame. Both sides are
    divided by the number of photons. Lens falloff is the same in all captures, so it affects only the scale of the
    responsivities. The charts later determine this scale.

    Parameters
    ----------
    captures : sequence of MonoCapture
        Monochromatic captures.
    body : Body
        Geometry and optics of the camera.
    sensor : Sensor
        Noise and defects from the dark and white captures.
    each : callable
        Function with the signature of the built-in `map`, which may use several processes.

    Returns
    -------
    sweep : Sweep
        The linear systems of all channels. A channel ignores the captures in which it is saturated.
    left_out : tuple of str
        One line for each capture with a saturated channel.

    Raises
    ------
    InputFileError
        If a channel is saturated or has no signal in all captures, or if a capture's spectrum does not fall to zero at both
        ends.
    """
    for capture in captures:
        if max(capture.radiance[0], capture.radiance[-1]) > CUT_OFF * capture.radiance.max():
            raise InputFileError(
                f"{capture.name}: the spectrum does not fall to zero at the ends of its wavelength range; measure the "
                "spectrum over a wider range"
            )
    nodes = responsivity.node_grid([(capture.wavelength, capture.radiance) for capture in captures])
    design, values, valid = [], [], []
    histograms = each(functools.partial(statistics.count_values, body=body, defects=sensor.defects), captures)
    for capture, counts in zip(captures, histograms, strict=True):
        photons = photons_on_pixel(capture, nodes, body)
        signal = statistics.mean_value(counts) - sensor.dark.black_level - sensor.dark.slope * capture.exposure
        design.append(photons / photons.sum())
        values.append(signal / photons.sum())
        valid.append(statistics.share_from(counts, sensor.saturation) < OVEREXPOSED)
    sweep = responsivity.Sweep(nodes, np.array(design), np.array(values), np.array(valid))
    for channel, name in enumerate(body.channels):
        usable = sweep.values[sweep.valid[:, channel], channel]
        if not usable.size:
            raise InputFileError(f"channel {name} is saturated in every monochromatic capture; shorten the exposures")
        if usable.max() <= 0:
            raise InputFileError(
                f'channel {name} has no signal in any monochromatic capture; check the frames and "cfa.pattern"'
            )
    left_out = [
        f"{capture.name}: saturated in {' '.join(name for name, ok in zip(body.channels, usable, strict=True) if not ok)}"
        for capture, usable in zip(captures, sweep.valid, strict=True)
        if not usable.all()
    ]
    return sweep, tuple(left_out)


def measure_charts(
    captures: Sequence[ChartCapture], nodes: Array, body: Body, sensor: Sensor, each: statistics.Each = map
) -> Charts:
    """Measure each patch's mean value, and compute the photons that pixels receive from the patch.

    Raises InputFileError if the measured radiances do not cover the wavelengths `nodes`, or if a patch is saturated.
    """
    for capture in captures:
        first, last = capture.wavelength[[0, -1]]
        if first > nodes[0] + responsivity.NODE_STEP or last < nodes[-1] - responsivity.NODE_STEP:
            raise InputFileError(
                f"{capture.name}: the radiances cover {first:g}…{last:g} nm, but the monochromatic captures cover "
                f"{nodes[0]:g}…{nodes[-1]:g} nm; measure the radiances over a wider range"
            )
    read = functools.partial(responsivity.unsaturated_values, body=body, limit=sensor.saturation, defects=sensor.defects)
    dark = [sensor.dark.slope * capture.exposure for capture in captures]
    values = [mean - signal for mean, signal in zip(each(read, captures), dark, strict=True)]
    light = [responsivity.patch_illumination(capture, body, sensor.defects) for capture in captures]
    photons = [share * photons_on_pixel(capture, nodes, body) for share, capture in zip(light, captures, strict=True)]
    return Charts(tuple(capture.illuminant for capture in captures), np.array(values), np.array(photons))


def flat_field(response: Array, body: Body) -> FlatField:
    """Compute the gains that equalise the response to an evenly lit white target over the frame.

    A polynomial is fitted to the square root of the gain. For cos⁴ falloff, this root is exactly a polynomial of degree 2.

    Parameters
    ----------
    response : ndarray, (row, col)
        Response of each pixel to an evenly lit white target, above black, in any unit.
    body : Body
        Filter array and size of the sensor.

    Raises
    ------
    InputFileError
        If the response is not positive and smooth, or if it falls off more steeply than FlatField allows.
    """
    gains = []
    for channel, name in enumerate(body.channels):
        y, x, mean = _means(response, body, channel)
        if mean.min() <= 0:
            raise InputFileError(
                f"channel {name}: parts of the white frames are dark; use frames of an evenly lit white target"
            )
        terms = np.linalg.lstsq(_surface(y, x), mean**-0.5, rcond=None)[0]
        rough = float(np.sqrt(np.mean((mean * (_surface(y, x) @ terms) ** 2 - 1.0) ** 2)))
        if rough > UNEVEN:
            raise InputFileError(
                f"channel {name}: the white frames deviate by {rough:.0%} RMS from a smooth surface; use frames of an "
                "evenly lit white target"
            )
        lines = np.meshgrid(np.linspace(-1, 1, GRID[0]), np.linspace(-1, 1, GRID[1]), indexing="ij")
        root = (_surface(*map(np.ravel, lines)) @ terms).reshape(GRID)
        gains.append((root / terms[0]) ** 2)
    with raised_as(InputFileError, "l3 cannot compute a flat field from the white frames"):
        return FlatField(np.linspace(0, body.rows - 1, GRID[0]), np.linspace(0, body.cols - 1, GRID[1]), np.array(gains))


def corner_falloff(field: FlatField) -> Array:
    """Return each channel's relative loss of light in the darkest corner, from 0 to 1."""
    corners = field.shading_gain[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    return np.asarray(1.0 - 1.0 / corners.max(axis=1))


def _surface(y: Array, x: Array) -> Array:
    """Evaluate the terms of the polynomial at coordinates from −1 to 1: (point, term). The first term is 1."""
    powers = [(down, across) for down in range(DEGREE + 1) for across in range(DEGREE + 1 - down)]
    return np.stack([y**down * x**across for down, across in powers], axis=1)


def _means(response: Array, body: Body, channel: int) -> tuple[Array, Array, Array]:
    """Return the mean y, mean x and mean response of a channel's pixels in each cell.

    The coordinates y and x range from −1 to 1 over the frame.
    """
    places: list[tuple[Array, Array, Array]] = []
    y, x = (np.linspace(-1.0, 1.0, length) for length in response.shape)
    down = np.broadcast_to(y[:, None], response.shape)
    across = np.broadcast_to(x, response.shape)
    for parts in zip(*(statistics.by_site(each, body.cfa) for each in (response, down, across)), strict=True):
        if parts[0][0] == channel:
            value, row, col = (_by_cell(site) for _, site in parts)
            places.append((row, col, value))
    row, col, value = (np.concatenate(each) for each in zip(*places, strict=True))
    return row, col, value


def _by_cell(site: Array) -> Array:
    """Divide an array into a grid of nearly equal cells, at most CELLS (rows, columns), and return the mean of each cell."""
    starts = [
        np.linspace(0, length, min(length, most) + 1).astype(int) for length, most in zip(site.shape, CELLS, strict=True)
    ]
    sums = np.add.reduceat(np.add.reduceat(site, starts[0][:-1], axis=0), starts[1][:-1], axis=1)
    return (sums / np.outer(*map(np.diff, starts))).ravel()


def with_corrections(camera: CameraModel, sensor: Sensor, body: Body) -> CameraModel:
    """Add a defect map to the camera model and, if the white frames are evenly lit, a flat field.

    Uneven white frames are not an error, because they are sufficient to measure noise.
    """
    shape = (body.rows, body.cols)
    defects = statistics.defect_map(sensor.defects, sensor.dark.hot, shape, sensor.blinking_defects)
    try:
        return replace(camera, defects=defects, flat_field=flat_field(sensor.response.slopes, body))
    except InputFileError:
        return replace(camera, defects=defects)


def correct_by_frames(camera: CameraModel, measurements: Measurements) -> CameraModel:
    """Replace the corrections of a camera model with new measurements. Its other properties stay unchanged.

    White frames replace the defect map and the flat field. Frames behind a rotating polariser replace the polarisers. A
    single exposure time is sufficient for dark and white frames.

    Raises
    ------
    InputFileError
        If the white frames are too dark, clipped or uneven, if too many pixels seem to be defective, or if the frames
        behind the polariser are unsuitable.
    """
    if measurements.polariser:
        fit = measure_polarisers(measurements, figures_of(camera))
        measured = polarisers.polarisers_of(fit, measurements.body, camera.wavelength)
        camera = replace(camera, polarisers=measured, fit=replace(camera.fit or Fit(), polarisers=fit))
    if not measurements.whites:
        return camera
    body, darks = measurements.body, measurements.darks
    means = [statistics.mean_frame(capture).astype(np.float64) for capture in darks]
    hot = statistics.joined_defects(statistics.no_defects(), *(statistics.outliers(mean, body.cfa) for mean in means))
    response = np.zeros((body.rows, body.cols))
    for capture in measurements.whites:
        both = statistics.mean_frame(capture).astype(np.float64), means[_nearest(darks, capture.exposure)]
        mean, dark = (statistics.patched(each, body.cfa, hot) for each in both)
        _check_level(mean, camera, capture.name)
        response += mean - dark
    dead, response = noise.dead_pixels(response, body.cfa)
    every, blinking = statistics.joined_defects(hot, dead), statistics.no_defects()
    if measurements.blinking_defects:
        found = find_blinking(darks, [sum(1 for _ in capture.frames) for capture in darks], body)
        blinking = blinking if found is None else found.position
        every = statistics.joined_defects(every, blinking)
    if len(every) > MOST_DEFECTIVE * response.size:
        raise InputFileError(
            f"{len(every) / response.size:.0%} of the pixels seem to be defective; check that no light reached the sensor "
            "in the dark frames and that the white frames are evenly lit"
        )
    defects = statistics.defect_map(every, hot, (body.rows, body.cols), blinking)
    return replace(camera, defects=defects, flat_field=flat_field(response, body), fit=camera.fit or Fit())


def _nearest(darks: Sequence[Capture], exposure: float) -> int:
    """Return the index of the dark capture with the most similar exposure time, on a logarithmic scale."""
    return int(np.argmin([abs(np.log(dark.exposure / exposure)) for dark in darks]))


def _check_level(mean: NDArray[np.floating], camera: CameraModel, name: str) -> None:
    span = camera.white_level - camera.black_level
    for channel, label in enumerate(camera.channels):
        values = mean[camera.channel_map(mean.shape) == channel]
        if np.quantile(values, 0.999) >= camera.black_level + noise.SATURATED * span:
            raise InputFileError(f"{name}: channel {label} is clipped; use a shorter exposure for the white frames")
        if np.median(values) < camera.black_level + LEAST_SIGNAL * span:
            raise InputFileError(f"{name}: channel {label} is too dark; use a longer exposure for the white frames")


@dataclass(frozen=True)
class Series:
    """Patch values in all captures of a chart through narrow-band filters."""

    lights: tuple[str, ...]  # names of the filters, sorted by central wavelength
    light: NDArray[np.int64]  # (capture,): index of the filter of each capture
    lit: Array  # (capture,): exposure time in s, corrected for the brightness of the lamp
    values: Array  # (capture, patch, channel): mean value in DN, without dark signal
    valid: NDArray[np.bool_]  # (capture, patch, channel): whether the patch is unsaturated


def fit_series(
    captures: Sequence[BandCapture], darks: Sequence[Capture], body: Body, black_level: float, white_level: float
) -> tuple[Curves, SeriesFit]:
    """Fit each channel's response to light through each narrow-band filter, and measure the linearity.

    Saturated patches are ignored.

    Parameters
    ----------
    captures : sequence of BandCapture
        Captures of the chart through each filter, with at least two exposure times per filter.
    darks : sequence of Capture
        Dark captures. The sequence may be empty.
    body : Body
        Geometry of the camera.
    black_level, white_level : float
        Levels of the sensor in DN.

    Returns
    -------
    Curves
        Relative responsivity at the central wavelengths of the filters.
    SeriesFit
        Details of the fit.

    Raises
    ------
    InputFileError
        If a channel has fewer than two unsaturated exposure times with a filter, or if captures contradict each other.
    """
    limit = black_level + noise.SATURATED * (white_level - black_level)
    series = measure_series(captures, darks, body, black_level, limit)
    agreement.check_series(captures, series.light, series.values, series.valid)
    rates, predicted, used = follow_exposure(series)
    for band, name in enumerate(series.lights):
        if not used[series.light == band].any(axis=(0, 1)).all():
            raise InputFileError(
                f"filter {name}: one channel is unsaturated at fewer than two exposure times; add shorter exposures"
            )
    centres, photons = band_photons(captures, series)
    response, spread = respond(rates, photons)
    compared = [(series.values[..., c][used[..., c]], predicted[..., c][used[..., c]]) for c in range(len(body.channels))]
    band = COVERAGE * response * spread / np.sqrt(PATCHES)
    fit = SeriesFit(
        lights=series.lights,
        light=series.light,
        exposure=np.array([capture.exposure for capture in captures]),
        response=response / response.max(),
        spread=spread,
        linearity_error=linearity_errors(series, white_level - black_level),
        r_squared=np.array([1.0 - np.mean((m - p) ** 2) / m.var() for m, p in compared]),
        relative_rmse=np.array([np.sqrt(np.mean((m - p) ** 2)) / m.mean() for m, p in compared]),
        left_out=named(captures, series, body),
        used=used,
        measured=series.values,
        predicted=np.where(used, predicted, 0.0),
    )
    return Curves(centres, response.T, band.T).to_common_peak(), fit


def measure_polarisers(
    measurements: Measurements, sensor: Sensor | SensorFigures, each: statistics.Each = map
) -> PolariserFit | None:
    """Measure the channels' polarisers in frames taken through a rotating polariser.

    Parameters
    ----------
    measurements : Measurements
        Captures and settings from a measurement file.
    sensor : Sensor or SensorFigures
        Noise and levels of the sensor, either measured in dark and white frames (Sensor) or known (SensorFigures).
    each : callable
        Function with the signature of the built-in `map`, which may use several processes.

    Returns
    -------
    PolariserFit or None
        None if no frames were taken through a rotating polariser.

    Raises
    ------
    InputFileError
        If the captures cannot be used, contradict each other, or contradict the polarisers that the file states.
    """
    captures, body = measurements.polariser, measurements.body
    if not captures:
        return None
    electronics = electronics_of(measurements, sensor)
    return polarisers.measure_polarisers(captures, measurements.rotator, body, electronics, each)


def electronics_of(measurements: Measurements, sensor: Sensor | SensorFigures) -> polarisers.Electronics:
    """Return the sensor properties that are needed to evaluate the captures behind a rotating polariser."""
    body, exposures = measurements.body, [capture.exposure for capture in measurements.polariser]
    if isinstance(sensor, Sensor):
        return polarisers.Electronics(
            dark=sensor.dark.black_level + np.outer(exposures, sensor.dark.slope),
            saturation=sensor.saturation,
            gain=sensor.transfer.gain,
            dark_variance=sensor.dark.variance,
            defects=sensor.defects,
        )
    black_level, white_level = sensor.black_level, sensor.white_level
    gain = sensor.gain * body.channel_gains
    return polarisers.Electronics(
        dark=dark_levels(exposures, measurements.darks, body, black_level),
        saturation=black_level + noise.SATURATED * (white_level - black_level),
        gain=gain,
        dark_variance=(gain * sensor.noise.dark_noise) ** 2,
        defects=statistics.no_defects(),
    )


def check_polarisers(measurements: Measurements) -> None:
    """Check frames taken through a rotating polariser, before the long calibration starts.

    If there are no such frames, or if the black level is unknown, nothing is checked.

    Raises
    ------
    InputFileError
        If `measure_polarisers` fails, for example because the polarisers of two channels are swapped.
    """
    base, sensor = measurements.base, measurements.datasheet
    if base is not None:
        sensor = figures_of(base)
    elif sensor is None and measurements.darks:
        # The dark frames provide the black level. The noise affects only the weights of the captures, so any values are good
        # enough for this check.
        sensor = SensorFigures(1.0, 0.0, 2.0**measurements.body.bits - 1.0, Noise(0.0, 0.0, 0.0, 0.0, math.inf))
    if sensor is not None:
        measure_polarisers(measurements, sensor)


def figures_of(camera: CameraModel) -> SensorFigures:
    """Return gain, levels and noise of a camera."""
    return SensorFigures(camera.gain, camera.black_level, camera.white_level, camera.noise)


def measure_series(
    captures: Sequence[BandCapture], darks: Sequence[Capture], body: Body, black_level: float, limit: float
) -> Series:
    """Measure the patches in all captures through narrow-band filters, and subtract the dark signal.

    Parameters
    ----------
    captures : sequence of BandCapture
        Captures of the chart through each filter.
    darks : sequence of Capture
        Dark captures. The sequence may be empty.
    body : Body
        Geometry of the camera.
    black_level : float
        Black level in DN. It is used only if there are no dark captures.
    limit : float
        Value in DN at and above which a pixel counts as saturated. Patches with too many saturated pixels are invalid.

    Returns
    -------
    Series
        Values of the patches. The filters are sorted by central wavelength.
    """
    names = list(dict.fromkeys(capture.illuminant for capture in captures))
    names.sort(key=lambda name: next(band_centre(capture) for capture in captures if capture.illuminant == name))
    dark = dark_levels([capture.exposure for capture in captures], darks, body, black_level)
    readings = [responsivity.patch_values(capture, body, limit, statistics.no_defects()) for capture in captures]
    return Series(
        lights=tuple(names),
        light=np.array([names.index(capture.illuminant) for capture in captures]),
        lit=np.array([capture.lit for capture in captures]),
        values=np.array([values for values, _ in readings]) - dark[:, None],
        valid=~np.array([saturated for _, saturated in readings]),
    )


def dark_levels(exposures: Sequence[float], darks: Sequence[Capture], body: Body, black_level: float) -> Array:
    """Estimate the mean raw value in the dark at each exposure time.

    The value is interpolated between dark captures, or taken from the nearest one outside their range of exposure times. If
    there are no dark captures, all values are `black_level`.

    Returns
    -------
    ndarray, (exposure, channel)
        Mean value in DN.
    """
    if not darks:
        return np.full((len(exposures), len(body.channels)), black_level)
    known = np.array([capture.exposure for capture in darks])
    means = np.array(
        [statistics.mean_value(statistics.count_values(capture, body, statistics.no_defects())) for capture in darks]
    )
    order = np.argsort(known)
    return np.array([np.interp(exposures, known[order], column[order]) for column in means.T]).T


def follow_exposure(series: Series) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fit the signal per second of each patch behind each filter.

    Each capture is also predicted from the other captures that were taken with the same filter.

    Returns
    -------
    rates : ndarray, (filter, patch, channel)
        Signal per second in DN/s, fitted to all unsaturated captures with a filter. NaN if all captures are saturated.
    predicted : ndarray, (capture, patch, channel)
        Predicted signal in DN, or 0 if there is no prediction.
    used : ndarray of bool, (capture, patch, channel)
        Whether the patch is unsaturated and has a prediction.
    """
    weight = series.lit[:, None, None] * series.valid
    products, squares = weight * series.values, weight * series.lit[:, None, None]
    same = series.light == np.arange(len(series.lights))[:, None]
    sums, norms = (np.tensordot(same, terms, 1) for terms in (products, squares))
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = sums / norms
        others = (sums[series.light] - products) / (norms[series.light] - squares)
    used = series.valid & (norms[series.light] - squares > 0)
    return rates, np.where(used, others * series.lit[:, None, None], 0.0), used


def band_centre(capture: BandCapture) -> float:
    """Return the central wavelength, in nm, of a filter's light, averaged over the patches."""
    return light_centre(capture.wavelength, capture.radiance.sum(axis=0))


def band_photons(captures: Sequence[BandCapture], series: Series) -> tuple[Array, Array]:
    """Return each filter's central wavelength, and each patch's photon radiance through each filter.

    Returns
    -------
    centres : ndarray, (filter,)
        Central wavelengths in nm.
    photons : ndarray, (filter, patch)
        Photon radiance of each patch, integrated over wavelength.
    """
    first = [captures[int(np.argmax(series.light == band))] for band in range(len(series.lights))]
    photons = [capture.radiance @ spectra.bin_widths(capture.wavelength) for capture in first]
    return np.array([band_centre(capture) for capture in first]), np.array(photons)


def respond(rates: Array, photons: Array) -> tuple[Array, Array]:
    """Compute the response through each filter, averaged over the patches, and its relative spread.

    Uneven illumination multiplies a patch's signal by the same factor through all filters. For each filter, this factor is
    estimated from the channel with the largest response, and removed before the spread is computed.

    Parameters
    ----------
    rates : ndarray, (filter, patch, channel)
        Signal per second of exposure. NaN values, from patches that are saturated in all captures, are ignored.
    photons : ndarray, (filter, patch)
        Photons per second from each patch.

    Returns
    -------
    response : ndarray, (filter, channel)
        Mean signal per photon.
    spread : ndarray, (filter, channel)
        Standard deviation over the patches, relative to the mean.
    """
    each = rates / photons[..., None]
    response = np.nanmean(each, axis=1)
    relative = each / response[:, None]
    brightest = np.take_along_axis(relative, response.argmax(axis=1)[:, None, None], axis=2)[..., 0]
    spread = np.nanstd(relative / np.nanmedian(brightest, axis=0)[:, None], axis=1, ddof=1)
    return response, spread


def linearity_errors(series: Series, span: float) -> Array:
    """Return each channel's linearity error, averaged over filters and patches.

    Only captures in which a patch's signal is between 5 % and 95 % of full scale (`span`, in DN) are used. If fewer than
    three such captures remain for a filter, the patch is ignored for this filter. If no patch is usable, the error is 0.
    """
    low, high = (share * span for share in noise.LINEAR)
    errors: list[list[float]] = [[] for _ in range(series.values.shape[2])]
    chosen = series.valid & (series.values >= low) & (series.values <= high)
    for band in range(len(series.lights)):
        for patch, channel in np.ndindex(series.values.shape[1:]):
            usable = chosen[:, patch, channel] & (series.light == band)
            if usable.sum() > 2:
                errors[channel].append(noise.linearity_error(series.lit[usable], series.values[usable, patch, channel]))
    return np.array([np.mean(deviations) if deviations else 0.0 for deviations in errors])


def named(captures: Sequence[BandCapture], series: Series, body: Body) -> tuple[str, ...]:
    """Describe each capture that has saturated patches in one line, with the number of such patches per channel."""
    lines = []
    for capture, valid in zip(captures, series.valid, strict=True):
        counts = zip(body.channels, (~valid).sum(axis=0), strict=True)
        saturated = ", ".join(f"{count} in {channel}" for channel, count in counts if count)
        if saturated:
            lines.append(f"{capture.name}: patches saturated: {saturated}")
    return tuple(lines)
