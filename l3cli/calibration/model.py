"""Build a camera model from measurements. The steps follow docs/method.md#calibration in order."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import AnalogGains, CameraModel, Noise, Readout
from l3cli.artifacts.fit import ChartFit, DriftFit, Fit, NoiseFit, SweepFit
from l3cli.calibration import agreement, responsivity
from l3cli.calibration.captures import (
    Charts,
    Sensor,
    correct_by_frames,
    fit_series,
    measure_charts,
    measure_sensor,
    measure_sweep,
    with_corrections,
)
from l3cli.calibration.drift import DriftError, estimate_drift
from l3cli.calibration.photo.responsivity import fit_photos
from l3cli.calibration.responsivity import Curves, check_efficiency, efficiency
from l3cli.calibration.statistics import Each, channel_shares
from l3cli.errors import InputFileError, raised_as
from l3cli.frames.measurement import Body, Measurements, SensorFigures

DELTAS = np.geomspace(1e-7, 1e1, 33)  # smoothing weights that are tried in Eq. 1 (docs/method.md#responsivity)
LEAST_R_SQUARED = 0.5  # if R² is lower, the measurement file does not describe the charts correctly
Array = NDArray[np.float64]
TOLERANCE = 0.1  # largest relative difference between a setting in the measurement file and in the frames
SAME_SPEED = 1.25  # largest factor, up or down, between a measured gain and the gain that the ISO speed implies
CERTAIN = 4.0  # a gain counts as wrong only if it differs by more than this number of standard deviations


def calibrate(measurements: Measurements, each: Each = map) -> CameraModel:
    """Estimate a camera model from measurements (docs/method.md#calibration).

    Parameters
    ----------
    measurements : Measurements
        Captures and settings from a measurement file.
    each : callable
        Maps a function over captures: the built-in `map`, or a map that spreads the work over several processes.

    Returns
    -------
    CameraModel
        The camera, with the results of each fit in `fit`.

    Raises
    ------
    InputFileError
        If a capture cannot be used or contradicts the others. The message identifies the capture.
    """
    body, drift = measurements.body, measurements.lamp_drift
    if measurements.base is not None:
        return correct_by_frames(measurements.base, measurements)
    if measurements.photos:
        return from_photos(measurements, each)
    if measurements.datasheet is not None:
        return from_data_sheet(measurements, measurements.datasheet)
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
    fit = Fit(noise=figures, sweep=sweep_fit, chart=chart_fit, drift=drift_fit)
    camera = assemble(body, summarise(sensor, figures, body), curves, fit)
    camera = replace(camera, gains=measure_gains(measurements, camera, each))
    return with_corrections(camera, sensor, body)


def measure_gains(measurements: Measurements, camera: CameraModel, each: Each = map) -> AnalogGains | None:
    """Measure gain and read noise at each ISO speed from dark and white frames (docs/method.md#gains).

    Returns None if the measurement file has no ISO speed. Raises InputFileError if a measured gain does not match the ISO
    speed.
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
                f"the gain at ISO {captures.iso:g} is {times:.3g} times the gain at ISO {measurements.iso:g}, but should be "
                f"{stated:.3g} times; give frames with analog gain only, or correct iso"
            )
        found[times] = noise.noise.read_noise
    known = sorted(found)
    return AnalogGains(np.array(known), np.array([found[gain] for gain in known]), measurements.iso)


def from_photos(measurements: Measurements, each: Each = map) -> CameraModel:
    """Build a camera with relative curves from photographs of charts.

    The noise and levels of the sensor come from dark and white frames. Without these, they come from the photos and the data
    sheet.
    """
    try:
        curves, fit, sensor = fit_photos(measurements)
    except np.linalg.LinAlgError as error:
        name = measurements.photos[0].name
        raise InputFileError(f"{name}: no responsivities fit its patches; check chart, light and levels") from error
    if not measurements.whites:
        return assemble(measurements.body, sensor, curves, Fit(photo=fit))
    measured = measure_sensor(measurements, each)
    body, noise = measurements.body, describe_noise(measured, measurements.body)
    camera = assemble(body, summarise(measured, noise, body), curves, Fit(noise=noise, photo=fit))
    return with_corrections(camera, measured, body)


def from_data_sheet(measurements: Measurements, figures: SensorFigures) -> CameraModel:
    """Build a camera with relative curves from the figures in a data sheet.

    The curves come from a sweep beside a photodiode, from finished curves, or from a chart photographed behind filters.
    """
    body, drift, shift = measurements.body, measurements.lamp_drift, measurements.wavelength_uncertainty
    if measurements.curve is not None:
        return assemble(body, figures, responsivity.without_fit(measurements.curve, body, drift, shift), Fit())
    curves, fit = fit_series(measurements.bands, measurements.darks, body, figures.black_level, figures.white_level)
    return assemble(body, figures, curves.widened(drift, shift), Fit(series=fit))


# -------------------------------------------------------------------------------------------------------- fitting


def fit_curves(
    sweep: responsivity.Sweep, charts: Charts, black_level: Array, measurements: Measurements, left_out: tuple[str, ...]
) -> tuple[Curves, SweepFit, DriftError | None]:
    """Fit the curves (Eq. 1 in docs/method.md#responsivity), and estimate the lamp drift from the charts.

    The smoothing with the best prediction of the charts is used. Each channel is scaled to a peak of 1. If the charts
    disagree by more than the declared drift explains, the estimated drift is returned and included in the confidence band.
    Otherwise the drift is None.
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
    """Return the cross-validated relative RMSE over the charts with the smoothing `delta`, averaged over channels."""
    photons = charts.photons @ responsivity.solve_channels(sweep, delta).T
    channels = range(len(black_level))
    return float(
        np.mean([responsivity.cross_validate(photons[..., c], charts.values[..., c], black_level[c]) for c in channels])
    )


def check_charts(
    measurements: Measurements, charts: Charts, sweep: responsivity.Sweep, smoothing: float, black_level: Array
) -> None:
    """Raise InputFileError if one chart contradicts the others, or if all charts contradict the monochromator."""
    curves = responsivity.solve_channels(sweep, smoothing)
    measured = (charts.values - black_level).sum(axis=1)
    predicted = (charts.photons @ curves.T).sum(axis=1)
    absolute = all(capture.absolute for capture in measurements.mono)
    agreement.check_charts(measurements.charts, measured, predicted, absolute)


def fit_charts(
    charts: Charts, relative: Array, black_level: Array, drift: float, body: Body, odd: tuple[str, ...] = ()
) -> ChartFit:
    """Fit the gain and offset of every channel (Eq. 2 in docs/method.md#gain-and-offset), and check the fit.

    Raises InputFileError if the charts contradict the curves. `odd` describes suspicious monochromatic captures. If there
    are any, the message tells the user to check the first.
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
        cure = f"check {odd[0]}" if odd else "check the order of corners and radiances, exposures and cfa.pattern"
        raise InputFileError(
            f"channel {body.channels[worst]}: the charts do not fit the responsivity (R² {r_squared[worst]:.2f}); {cure}"
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
    """Convert the noise in dark and white frames to electrons, with the conversion gain of the whole sensor.

    Raises InputFileError if the channels' measured gains contradict the measurement file.
    """
    dark, transfer = sensor.dark, sensor.transfer
    own = conversion_gain(sensor, body) * body.channel_gains  # (channel) DN/e-
    check_gains(transfer.gain, transfer.gain_error, body)
    return NoiseFit(
        conversion_gain=transfer.gain,
        conversion_gain_error=transfer.gain_error,
        read_noise=np.sqrt(dark.variance) / own,
        dark_current=dark.slope / (own * body.channel_exposures),
        dsnu=dark.dsnu / own,
        prnu=sensor.prnu,
        saturation_capacity=(transfer.white_level - dark.black_level) / own,
        linearity_error=transfer.linearity_error,
        white_level_reached=transfer.white_level_reached,
        defects=sensor.defects,
        exposure=sensor.exposure,
        photon_transfer_mean=transfer.mean,
        photon_transfer_variance=transfer.variance,
    )


def conversion_gain(sensor: Sensor, body: Body) -> float:
    """Return the conversion gain K of the whole sensor in DN/e-.

    K is the mean of the gains of all channels, weighted by the number of pixels in each channel. If channels differ in
    exposure time or amplification, the weights are the inverse variances of the gains.
    """
    each = sensor.transfer.gain / body.channel_gains
    if body.readout is None:
        return float(channel_shares(body) @ each)
    return float(np.average(each, weights=(body.channel_gains / sensor.transfer.gain_error) ** 2))


def summarise(sensor: Sensor, figures: NoiseFit, body: Body) -> SensorFigures:
    """Average the figures of the channels, weighted by the number of pixels, into one set for the whole sensor."""
    pixels = channel_shares(body)
    conversion, black_level = conversion_gain(sensor, body), float(pixels @ sensor.dark.black_level)

    def quadratic(deviation: Array) -> float:
        return float(np.sqrt(pixels @ deviation**2))

    lowest = np.where(body.channel_gains == body.channel_gains.min(), figures.read_noise, 0.0)
    share = float(pixels[body.channel_gains == body.channel_gains.min()].sum())
    read_noise, dsnu, prnu = quadratic(lowest) / share**0.5, quadratic(figures.dsnu), quadratic(figures.prnu)
    dark_current = max(float(pixels @ figures.dark_current), 0.0)
    well = (sensor.transfer.white_level - black_level) / conversion
    return SensorFigures(
        conversion, black_level, sensor.transfer.white_level, Noise(read_noise, dark_current, dsnu, prnu, well)
    )


def assemble(body: Body, sensor: SensorFigures, curves: Curves, fit: Fit) -> CameraModel:
    """Assemble the camera model. Its responsivity is absolute if charts gave the scale.

    Raises InputFileError if the values do not make a valid camera.
    """
    curve, band = curves.relative, curves.band
    if fit.chart is not None:
        curve, band = efficiency(curves, fit, sensor.gain, body)
        band = band if curves.band.any() else np.zeros_like(band)  # the error of the scale alone is not a confidence band
        check_exposures(curve, body)
        check_efficiency(curve, fit.sweep.odd if fit.sweep else ())
    elif body.readout is not None:
        curve, band = filter_curves(curve, band, body)
    with raised_as(InputFileError, "the measurements do not give a valid camera", cure="; check dark and white frames"):
        return CameraModel(
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
            readout=measured_readout(body, fit.noise, sensor.noise.read_noise),
        )


def _declared(fit: Fit) -> tuple[str, ...]:
    """Return the names of the quantities that were not measured."""
    if fit.noise is not None:
        return ()
    if fit.photo is None:
        return ("gain", "black level", "white level", "noise")
    return ("dark current", "DSNU", "PRNU") if fit.photo.noise_from_patches else ("gain", "noise")


def check_gains(measured: Array, error: Array, body: Body) -> None:
    """Raise InputFileError if measured conversion gains contradict the channel gains of the measurement file.

    `measured` and its standard deviation `error` are per channel, in DN/e-.
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
            f"channel {name}: the white frames give {seen:.3g} times the gain of the other channels, the measurement "
            f"file {body.channel_gains[channel]:.3g} times; correct channel.{name}.gain"
        )


def check_exposures(responsivity: Array, body: Body) -> None:
    """Raise InputFileError if channels with the same filter differ in efficiency (channel, wavelength).

    They differ if the exposure time of a channel is wrong in the measurement file.
    """
    if body.readout is None:
        return
    whole = responsivity.sum(axis=1)
    for channel, first in enumerate(body.readout.same_filter.tolist()):
        ratio = float(whole[channel] / whole[first])
        if abs(ratio - 1.0) > TOLERANCE:
            name, seen = body.channels[channel], body.channel_exposures[channel] * ratio
            raise InputFileError(
                f"channel {name} responds as if exposed for {seen:.3g} of the frame's time, compared with "
                f"{body.channels[first]}, but the measurement file states {body.channel_exposures[channel]:.3g}; correct "
                f"channel.{name}.exposure"
            )


def filter_curves(curves: Array, band: Array, body: Body) -> tuple[Array, Array]:
    """Divide curves and bands (channel, wavelength) by gain and exposure of each channel. Scale the highest peak to 1."""
    setting = (body.channel_gains * body.channel_exposures)[:, None]
    peak = float((curves / setting).max())
    return curves / setting / peak, band / setting / peak


def measured_readout(body: Body, noise: NoiseFit | None, read_noise: float) -> Readout | None:
    """Return the exposure, gain and read noise of each channel, or None if all channels have the same exposure and gain.

    Without noise measurements, `read_noise` (e-) is used for every channel.
    """
    if body.readout is None:
        return None
    each = np.full(len(body.channels), read_noise) if noise is None else noise.read_noise
    return replace(body.readout, channel_read_noise=np.asarray(each, np.float64))
