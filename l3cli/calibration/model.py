"""Estimate a camera model from measurements (docs/method.md#calibration)."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import AnalogGains, CameraModel, Noise, Readout
from l3cli.artifacts.fit import ChartFit, DriftFit, Fit, NoiseFit, SweepFit
from l3cli.calibration import agreement, responsivity
from l3cli.calibration.captures import (
    Charts,
    Sensor,
    correct_by_frames,
    figures_of,
    fit_series,
    measure_charts,
    measure_polarisers,
    measure_sensor,
    measure_sweep,
    with_corrections,
)
from l3cli.calibration.drift import DriftError, estimate_drift
from l3cli.calibration.photo.responsivity import fit_photos
from l3cli.calibration.pixel_polarisers import with_pixel_polarisers
from l3cli.calibration.polarisers import with_polarisers
from l3cli.calibration.responsivity import Curves, check_efficiency, efficiency
from l3cli.calibration.statistics import Each, channel_shares
from l3cli.errors import InputFileError, raised_as
from l3cli.frames.measurement import Body, Measurements, SensorFigures

DELTAS = np.geomspace(1e-7, 1e1, 33)  # smoothing weights to try in Eq. 1 (docs/method.md#responsivity)
LEAST_R_SQUARED = 0.5  # a lower R² means that the measurement file describes the charts incorrectly
Array = NDArray[np.float64]
TOLERANCE = 0.1  # largest relative difference between a gain or exposure in the measurement file and its measured value
SAME_SPEED = 1.25  # largest factor between a measured gain and the gain that the ISO speed implies
# Row or column noise below this fraction of the temporal dark noise is omitted from the camera model, because it would slow
# down training. Stripes become visible only at about twice this strength.
LEAST_LINE_NOISE = 0.05
CERTAIN = 4.0  # a measured gain contradicts the file only if it deviates by more than this number of standard deviations


def calibrate(measurements: Measurements, each: Each = map) -> CameraModel:
    """Estimate a camera model from measurements (docs/method.md#calibration).

    Parameters
    ----------
    measurements : Measurements
        Captures and settings from a measurement file.
    each : callable
        Function with the signature of the built-in `map`, which may process several captures in parallel.

    Returns
    -------
    CameraModel
        The camera model. Its attribute `fit` contains the results of all fits.

    Raises
    ------
    InputFileError
        If a capture is unsuitable, or if captures contradict each other. The message names the capture.
    """
    body, drift = measurements.body, measurements.lamp_drift
    if measurements.base is not None:
        camera = correct_by_frames(measurements.base, measurements)
        return with_pixel_polarisers(camera, measurements, figures_of(measurements.base), each)
    if measurements.photos:
        return from_photos(measurements, each)
    if measurements.datasheet is not None:
        return from_data_sheet(measurements, measurements.datasheet, each)
    sensor = measure_sensor(measurements, each)
    figures = describe_noise(sensor, body)
    sweep_fit, drifted = None, None
    if measurements.curve is None:
        sweep, left_out = measure_sweep(measurements.mono, body, sensor, each)
        charts = measure_charts(measurements.charts, sweep.nodes, body, sensor, each)
        curves, sweep_fit, drifted = fit_curves(sweep, charts, sensor.dark.black_level, measurements, left_out)
        if not sweep_fit.odd:
            check_charts(measurements, charts, sweep, sweep_fit.chosen_smoothing, sensor.dark.black_level)
    else:
        curves = responsivity.without_fit(measurements.curve, body, drift, measurements.wavelength_uncertainty)
        if measurements.charts:
            curves = curves.to_channel_peaks()
            charts = measure_charts(measurements.charts, curves.wavelength, body, sensor, each)
    odd = sweep_fit.odd if sweep_fit else ()
    chart_fit = (
        fit_charts(charts, curves.relative, sensor.dark.black_level, drift, body, odd) if measurements.charts else None
    )
    drift_fit = None
    if drifted is not None and chart_fit is not None:
        drift_fit = DriftFit(deviation=drifted.deviation, declared=drift)
        error = np.maximum(chart_fit.alpha_error, drifted.scale_error * chart_fit.alpha)
        chart_fit = replace(chart_fit, alpha_error=error)
    polariser_fit = measure_polarisers(measurements, sensor, each)
    fit = Fit(noise=figures, sweep=sweep_fit, chart=chart_fit, drift=drift_fit, polarisers=polariser_fit)
    camera = assemble(body, summarise(sensor, figures, body), curves, fit)
    camera = replace(camera, gains=measure_gains(measurements, camera, each))
    return with_pixel_polarisers(with_corrections(camera, sensor, body), measurements, sensor, each)


def measure_gains(measurements: Measurements, camera: CameraModel, each: Each = map) -> AnalogGains | None:
    """Measure gain and read noise at each ISO speed, from dark and white frames (docs/method.md#gains).

    Returns
    -------
    AnalogGains or None
        Gains relative to the gain of `camera`, or None if the measurement file does not specify an ISO speed.

    Raises
    ------
    InputFileError
        If a measured gain contradicts its ISO speed, or if a capture is unsuitable.
    """
    body, found = measurements.body, {}
    if measurements.iso is None:
        return None
    for captures in measurements.gains:
        with raised_as(InputFileError, f"ISO {captures.iso:g}", InputFileError):
            sensor = measure_sensor(replace(measurements, darks=captures.darks, whites=captures.whites), each)
        noise = summarise(sensor, describe_noise(sensor, body), body)
        times, stated = noise.gain / camera.gain, captures.iso / measurements.iso
        if not 1 / SAME_SPEED < times / stated < SAME_SPEED:
            raise InputFileError(
                f"the gain at ISO {captures.iso:g} is {times:.3g} times the gain at ISO {measurements.iso:g}, but the ISO "
                f'speeds imply a factor of {stated:.3g}; use frames with analog gain only, or correct "iso"'
            )
        # The camera model assumes that row and column noise scale with the read noise when the gain changes.
        found[times] = noise.noise.dark_noise * (
            camera.noise.read_noise / camera.noise.dark_noise if camera.noise.lines else 1
        )
    known = sorted(found)
    return AnalogGains(np.array(known), np.array([found[gain] for gain in known]), measurements.iso)


def from_photos(measurements: Measurements, each: Each = map) -> CameraModel:
    """Build a camera model with relative responsivities from photos of charts.

    Noise and levels come from white and dark frames, if there are any. Otherwise, the levels come from the photos' raw
    files, and the noise is estimated from the patches.

    Raises
    ------
    InputFileError
        If no responsivities explain the patch values.
    """
    try:
        curves, fit, sensor = fit_photos(measurements)
    except np.linalg.LinAlgError as error:
        name = measurements.photos[0].name
        raise InputFileError(
            f"{name}: no responsivities explain the patch values; check the chart, the illuminant, the black level and the "
            "white level"
        ) from error
    if not measurements.whites:
        polarisers = measure_polarisers(measurements, sensor, each)
        camera = assemble(measurements.body, sensor, curves, Fit(photo=fit, polarisers=polarisers))
        return with_pixel_polarisers(camera, measurements, sensor, each)
    measured = measure_sensor(measurements, each)
    body, noise = measurements.body, describe_noise(measured, measurements.body)
    polarisers = measure_polarisers(measurements, measured, each)
    camera = assemble(body, summarise(measured, noise, body), curves, Fit(noise=noise, photo=fit, polarisers=polarisers))
    return with_pixel_polarisers(with_corrections(camera, measured, body), measurements, measured, each)


def from_data_sheet(measurements: Measurements, figures: SensorFigures, each: Each = map) -> CameraModel:
    """Build a camera model with relative responsivities, and with noise and levels from a data sheet.

    If the measurements contain a table of responsivities, or a sweep with a photodiode as reference, the responsivities come
    from it. Otherwise, they are fitted to captures of a chart through narrow-band filters.
    """
    body, drift, shift = measurements.body, measurements.lamp_drift, measurements.wavelength_uncertainty
    polarisers = measure_polarisers(measurements, figures, each)
    if measurements.curve is not None:
        curves, series = responsivity.without_fit(measurements.curve, body, drift, shift), None
    else:
        curves, series = fit_series(measurements.bands, measurements.darks, body, figures.black_level, figures.white_level)
        curves = curves.widened(drift, shift)
    camera = assemble(body, figures, curves, Fit(series=series, polarisers=polarisers))
    return with_pixel_polarisers(camera, measurements, figures, each)


# -------------------------------------------------------------------------------------------------------- fitting


def fit_curves(
    sweep: responsivity.Sweep, charts: Charts, black_level: Array, measurements: Measurements, left_out: tuple[str, ...]
) -> tuple[Curves, SweepFit, DriftError | None]:
    """Fit the responsivity curves (Eq. 1 in docs/method.md#responsivity), and estimate the lamp drift from the charts.

    The smoothing weight is chosen so that the curves predict the charts best.

    Returns
    -------
    Curves
        Relative responsivities with confidence bands. Each channel has a peak of 1.
    SweepFit
        Details of the fit.
    DriftError or None
        The estimated lamp drift, which the confidence bands include. None if the declared drift explains the disagreements
        between the charts.
    """
    errors = np.array([_validation_error(sweep, charts, delta, black_level) for delta in DELTAS])
    delta = responsivity.choose_smoothing(DELTAS, errors)
    curves = responsivity.solve_channels(sweep, delta)
    drift, shift = measurements.lamp_drift, measurements.wavelength_uncertainty
    band = responsivity.confidence_bands(sweep, curves, delta, drift, shift)
    odd = agreement.odd_steps(measurements.mono, sweep)
    drifted = None if odd else estimate_drift(sweep, charts, curves, delta, black_level, drift)
    if drifted is not None:
        band = np.hypot(band, responsivity.COVERAGE * drifted.curve_error)
    fit = SweepFit(responsivity.residuals(sweep, curves), left_out, DELTAS, errors, delta, odd)
    return Curves(sweep.nodes, curves, band).to_channel_peaks(), fit, drifted


def _validation_error(sweep: responsivity.Sweep, charts: Charts, delta: float, black_level: Array) -> float:
    """Return the mean relative RMSE of a cross-validation over the charts, for curves with the smoothing weight `delta`."""
    photons = charts.photons @ responsivity.solve_channels(sweep, delta).T
    channels = range(len(black_level))
    return float(
        np.mean([responsivity.cross_validate(photons[..., c], charts.values[..., c], black_level[c]) for c in channels])
    )


def check_charts(
    measurements: Measurements, charts: Charts, sweep: responsivity.Sweep, smoothing: float, black_level: Array
) -> None:
    """Raise InputFileError if a chart contradicts the other charts, or if the charts contradict the sweep.

    `smoothing` is the smoothing weight with which the curves are computed from the sweep.
    """
    curves = responsivity.solve_channels(sweep, smoothing)
    measured = (charts.values - black_level).sum(axis=1)
    predicted = (charts.photons @ curves.T).sum(axis=1)
    absolute = all(capture.absolute for capture in measurements.mono)
    agreement.check_charts(measurements.charts, measured, predicted, absolute)


def fit_charts(
    charts: Charts, relative: Array, black_level: Array, drift: float, body: Body, odd: tuple[str, ...] = ()
) -> ChartFit:
    """Fit each channel's gain and offset (Eq. 2 in docs/method.md#gain-and-offset), and check the fit.

    Parameters
    ----------
    charts : Charts
        Measured values and photons of the patches.
    relative : ndarray, (channel, wavelength)
        Relative responsivity curves.
    black_level : ndarray, (channel,)
        Black level of each channel in DN.
    drift : float
        Relative standard deviation of the lamp drift.
    body : Body
        Geometry and channels of the camera.
    odd : tuple of str
        Descriptions of implausible monochromatic captures. An error message quotes the first one.

    Raises
    ------
    InputFileError
        If a channel's R² is below LEAST_R_SQUARED.
    """
    photons = charts.photons @ relative.T
    fits = []
    for channel, level in enumerate(black_level):
        seen, values = photons[..., channel], charts.values[..., channel]
        alpha, beta = responsivity.fit_gain(seen.ravel(), values.ravel(), level)
        fits.append((alpha, beta, responsivity.gain_error(seen, values, level, alpha, beta, drift)))
    alphas, betas, errors = np.array(fits).T
    predicted = alphas * photons + betas
    r_squared = responsivity.r_squared(charts.values, predicted)
    worst = int(r_squared.argmin())
    if r_squared[worst] < LEAST_R_SQUARED:
        cure = (
            f"check {odd[0]}" if odd else 'check "corners", the order of the radiances, the exposure times and "cfa.pattern"'
        )
        raise InputFileError(
            f"channel {body.channels[worst]}: the responsivity predicts the chart values poorly (R² "
            f"{r_squared[worst]:.2f}); {cure}"
        )
    return ChartFit(
        alpha=alphas,
        alpha_error=errors,
        beta=betas,
        r_squared=r_squared,
        relative_rmse=responsivity.relative_rmse(charts.values, predicted, black_level),
        illuminants=charts.illuminants,
        measured=charts.values,
        predicted=predicted,
    )


# ----------------------------------------------------------------------------------------------------- assembling


def describe_noise(sensor: Sensor, body: Body) -> NoiseFit:
    """Collect the results from dark and white frames, and convert noise from DN to electrons.

    Raises InputFileError if the measured channel gains contradict the measurement file.
    """
    dark, transfer, pixel_noise = sensor.dark, sensor.transfer, None
    gain = conversion_gain(sensor, body)
    own = gain * body.channel_gains  # (channel,): conversion gain in DN/e-
    check_gains(transfer.gain, transfer.gain_error, body)
    if dark.pixel_variance is not None and (dark.rows.deviation or dark.columns.deviation):
        pixel_noise = np.sqrt(dark.pixel_variance) / own
    return NoiseFit(
        conversion_gain=transfer.gain,
        conversion_gain_error=transfer.gain_error,
        read_noise=np.sqrt(dark.variance) / own,
        dark_current=dark.slope / (own * body.channel_exposures),
        dsnu=dark.dsnu / own,
        prnu=sensor.response.prnu,
        saturation_capacity=(transfer.white_level - dark.black_level) / own,
        linearity_error=transfer.linearity_error,
        white_level_reached=transfer.white_level_reached,
        defects=sensor.defects,
        exposure=sensor.exposure,
        photon_transfer_mean=transfer.mean,
        photon_transfer_variance=transfer.variance,
        row_temporal_noise=dark.rows.deviation / gain,
        row_temporal_noise_error=dark.rows.error / gain,
        column_temporal_noise=dark.columns.deviation / gain,
        column_temporal_noise_error=dark.columns.error / gain,
        pixel_noise=pixel_noise,
        dsnu_error=None if dark.dsnu_error is None else dark.dsnu_error / own,
        prnu_error=sensor.response.prnu_error,
        row_noise=dark.fixed_rows.deviation / gain,
        row_noise_error=dark.fixed_rows.error / gain,
        column_noise=dark.fixed_columns.deviation / gain,
        column_noise_error=dark.fixed_columns.error / gain,
        row_prnu=sensor.response.rows.deviation,
        row_prnu_error=sensor.response.rows.error,
        column_prnu=sensor.response.columns.deviation,
        column_prnu_error=sensor.response.columns.error,
        dark_current_variance=_in_electrons(dark.variance_slope, own**2 * body.channel_exposures),
        dark_current_variance_error=_in_electrons(dark.variance_slope_error, own**2 * body.channel_exposures),
        dark_pattern=None if dark.pattern is None else dark.pattern.divided_by(gain),
        response_pattern=sensor.response.pattern,
        **_blinking(sensor, body),
    )


def _in_electrons(values: Array | None, unit: Array) -> Array | None:
    return None if values is None else values / unit


def _blinking(sensor: Sensor, body: Body) -> dict[str, Any]:
    """Return the fields of NoiseFit that describe blinking pixels."""
    found = sensor.blinking
    if found is None:
        return {}
    if not len(found.position):
        return {"blinking_frames": found.frames}
    (down, across), (row, col) = body.cfa.shape, found.position.T
    gains = conversion_gain(sensor, body) * body.channel_gains[body.cfa[row % down, col % across]]
    return {"blinking_frames": found.frames, "blinking": found.position, "blinking_step": found.step / gains}


def conversion_gain(sensor: Sensor, body: Body) -> float:
    """Return the conversion gain K of the whole sensor in DN/e-.

    K is the mean of the channels' conversion gains, weighted by the numbers of pixels. If the channels have different
    exposure times or gains, each conversion gain is first divided by the channel's relative gain, and the mean is weighted
    by the inverse variances.
    """
    each = sensor.transfer.gain / body.channel_gains
    if body.readout is None:
        return float(channel_shares(body) @ each)
    return float(np.average(each, weights=(body.channel_gains / sensor.transfer.gain_error) ** 2))


def summarise(sensor: Sensor, figures: NoiseFit, body: Body) -> SensorFigures:
    """Average the noise parameters over all channels, weighted by the numbers of pixels.

    The read noise is averaged only over the channels with the lowest gain.
    """
    pixels = channel_shares(body)
    conversion, black_level = conversion_gain(sensor, body), float(pixels @ sensor.dark.black_level)

    def quadratic(deviation: Array) -> float:
        return float(np.sqrt(pixels @ deviation**2))

    lowest = body.channel_gains == body.channel_gains.min()
    share = float(pixels[lowest].sum()) ** 0.5
    read_noise, dsnu, prnu = (
        quadratic(np.where(lowest, figures.read_noise, 0.0)) / share,
        quadratic(figures.dsnu),
        quadratic(figures.pixel_prnu[0]),
    )
    dark_current = max(float(pixels @ figures.dark_current), 0.0)
    well = (sensor.transfer.white_level - black_level) / conversion
    rows, columns, fixed_rows, fixed_columns = (
        deviation if deviation >= LEAST_LINE_NOISE * read_noise else 0.0
        for deviation in (
            figures.row_temporal_noise,
            figures.column_temporal_noise,
            figures.row_noise,
            figures.column_noise,
        )
    )
    if (rows or columns) and figures.pixel_noise is not None:
        read_noise = quadratic(np.where(lowest, figures.pixel_noise, 0.0)) / share
    noise = Noise(
        read_noise=read_noise,
        dark_current=dark_current,
        dsnu=dsnu,
        prnu=prnu,
        well_capacity=well,
        column_noise=fixed_columns,
        row_temporal_noise=rows,
        column_temporal_noise=columns,
        row_noise=fixed_rows,
        row_prnu=figures.row_prnu,
        column_prnu=figures.column_prnu,
    )
    return SensorFigures(conversion, black_level, sensor.transfer.white_level, noise)


def assemble(body: Body, sensor: SensorFigures, curves: Curves, fit: Fit) -> CameraModel:
    """Assemble the camera model from the results of all fits.

    If charts determine the scale of the curves, the responsivity is absolute. Otherwise, it is relative.

    Parameters
    ----------
    body : Body
        Geometry, filter array and optics.
    sensor : SensorFigures
        Noise and levels.
    curves : Curves
        Relative responsivities to unpolarised light.
    fit : Fit
        Results of all fits.

    Raises
    ------
    InputFileError
        If the values are implausible or do not form a valid camera model.
    """
    curve, band = curves.relative, curves.band
    if fit.chart is not None:
        curve, band = efficiency(curves, fit, sensor.gain, body)
        # If the errors of the curves are unknown, bands from the error of the scale alone would be too narrow.
        band = band if curves.band.any() else np.zeros_like(band)
        check_exposures(curve, body)
        check_efficiency(curve, fit.sweep.odd if fit.sweep else ())
    elif body.readout is not None:
        curve, band = filter_curves(curve, band, body)
    with raised_as(InputFileError, "the measured values are not plausible", cure="; check the dark and white frames"):
        camera = CameraModel(
            name=body.name,
            rows=body.rows,
            cols=body.cols,
            pixel_pitch=body.pixel_pitch,
            bits=body.bits,
            channels=body.channels,
            cfa=body.cfa,
            wavelength=curves.wavelength,
            responsivity=curve,
            responsivity_band=band,
            absolute=fit.chart is not None,
            gain=sensor.gain,
            black_level=sensor.black_level,
            white_level=sensor.white_level,
            fixed_pattern_seed=0,
            noise=sensor.noise,
            optics=body.optics,
            declared=_declared(fit),
            fit=fit,
            readout=measured_readout(body, fit.noise, sensor.noise),
            masked=body.masked,
        )
        return with_polarisers(camera, fit.polarisers, body)


def _declared(fit: Fit) -> tuple[str, ...]:
    """List the quantities that were not measured, but come from a data sheet or are assumed."""
    if fit.noise is not None:
        return ()
    if fit.photo is None:
        return ("gain", "black level", "white level", "noise")
    return ("dark current", "DSNU", "PRNU") if fit.photo.noise_from_patches else ("gain", "noise")


def check_gains(measured: Array, error: Array, body: Body) -> None:
    """Raise InputFileError if measured conversion gains contradict the relative channel gains in the measurement file.

    Parameters
    ----------
    measured : ndarray, (channel,)
        Measured conversion gain of each channel in DN/e-.
    error : ndarray, (channel,)
        Standard deviation of each measured gain in DN/e-.
    body : Body
        The camera, with the channel gains from the measurement file.
    """
    if body.readout is None:
        return
    relative = measured / body.channel_gains
    lowest = body.channel_gains == body.channel_gains.min()
    usual = float(np.average(relative[lowest], weights=1.0 / error[lowest] ** 2))
    certain = np.abs(relative - usual) > CERTAIN * error / body.channel_gains
    for channel in np.flatnonzero(certain & (np.abs(relative / usual - 1.0) > TOLERANCE)).tolist():
        name, seen = body.channels[channel], measured[channel] / usual
        raise InputFileError(
            f"the white frames imply a relative gain of {seen:.3g} for channel {name}, but the measurement file states "
            f'{body.channel_gains[channel]:.3g}; correct "channel.{name}.gain"'
        )


def check_exposures(responsivity: Array, body: Body) -> None:
    """Raise InputFileError if two channels with the same filter have different quantum efficiencies.

    Such a difference means that an exposure time in the measurement file is wrong. `responsivity` has the shape (channel,
    wavelength).
    """
    if body.readout is None:
        return
    whole = responsivity.sum(axis=1)
    for channel, first in enumerate(body.readout.same_filter.tolist()):
        ratio = float(whole[channel] / whole[first])
        if abs(ratio - 1.0) > TOLERANCE:
            name, seen = body.channels[channel], body.channel_exposures[channel] * ratio
            raise InputFileError(
                f"compared with channel {body.channels[first]}, the relative exposure time of channel {name} is {seen:.3g}, "
                f"but the measurement file states {body.channel_exposures[channel]:.3g}; correct "
                f'"channel.{name}.exposure"'
            )


def filter_curves(curves: Array, band: Array, body: Body) -> tuple[Array, Array]:
    """Divide curves and bands (channel, wavelength) by each channel's gain and exposure, and scale the highest peak to 1."""
    setting = (body.channel_gains * body.channel_exposures)[:, None]
    peak = float((curves / setting).max())
    return curves / setting / peak, band / setting / peak


def measured_readout(body: Body, fit: NoiseFit | None, noise: Noise) -> Readout | None:
    """Return each channel's exposure, gain and read noise, or None if all channels have the same readout.

    If the noise was not measured (`fit` is None), the read noise comes from `noise`.
    """
    if body.readout is None:
        return None
    each = np.full(len(body.channels), noise.read_noise)
    if fit is not None:
        each = fit.pixel_noise if noise.lines and fit.pixel_noise is not None else fit.read_noise
    return replace(body.readout, channel_read_noise=np.asarray(each, np.float64))
