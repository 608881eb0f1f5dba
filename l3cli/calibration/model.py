"""Measurements → camera model: the steps of docs/method.md#calibration in their order."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Noise
from l3cli.artifacts.fit import ChartFit, Fit, NoiseFit, SweepFit
from l3cli.calibration import agreement, defects, gain, noise, responsivity
from l3cli.calibration import curves as finished
from l3cli.calibration.curves import Curves
from l3cli.calibration.noise import Each
from l3cli.calibration.series import fit_series
from l3cli.errors import InputFileError
from l3cli.measurement import Body, ChartCapture, Measurements, MonoCapture, SensorFigures

DELTAS = np.geomspace(1e-7, 1e1, 33)  # smoothings tried in Eq. 1
LEAST_R_SQUARED = 0.5  # charts that fit worse were not measured as the measurement file says
OVEREXPOSED = 1e-3  # share of saturated pixels that makes a monochromatic capture useless
CUT_OFF = 0.05  # share of a light's peak that may be left where its measured spectrum ends
USUAL = (0.03, 1.0)  # peak quantum efficiencies of cameras, lens and filters included
PHOTONS_PER_JOULE = 2.5e18  # at 500 nm
MISTAKES = {  # and by what each multiplies a quantum efficiency
    "exposures were in ms (exposure_ms)": 1e-3,
    "exposures were in µs (exposure_us)": 1e-6,
    'radiances were in watts (unit = "W/(sr m² nm)")': PHOTONS_PER_JOULE,
    'radiances were in milliwatts (unit = "mW/(sr m² nm)")': 1e-3 * PHOTONS_PER_JOULE,
    "radiances were per cm²": 1e4,
    "radiances were per µm": 1e-3,
    "exposures were in s where ms are told": 1e3,
}
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """What dark and white frames tell."""

    dark: noise.DarkNoise
    transfer: noise.PhotonTransfer
    prnu: Array  # (channel)
    exposure: Array  # (level) s, of the white captures
    defects: defects.Defects

    @property
    def saturation(self) -> float:
        """DN from which a pixel counts as saturated."""
        black = self.dark.black.mean()
        return float(black + noise.SATURATED * (self.transfer.white - black))


@dataclass(frozen=True)
class Charts:
    """Every patch under every light: what was measured and what light came."""

    illuminants: tuple[str, ...]
    values: Array  # (chart, patch, channel) DN, dark signal taken out
    photons: Array  # (chart, patch, wavelength) on a pixel's area, in each node's hat, off-axis loss included


def calibrate(measurements: Measurements, each: Each = map) -> CameraModel:
    """The camera that explains the measurements (docs/method.md#calibration); InputFileError names the unusable capture.

    `each` maps a function over captures: the built-in map, or one that keeps several processes busy.
    """
    body, drift = measurements.body, measurements.lamp_drift
    if measurements.datasheet is not None:
        return from_data_sheet(measurements, measurements.datasheet)
    sensor = measure_sensor(measurements, each)
    figures = describe_noise(sensor, body)
    sweep_fit = None
    if measurements.curve is None:
        sweep, left_out = measure_sweep(measurements.mono, body, sensor, each)
        charts = measure_charts(measurements.charts, sweep.nodes, body, sensor, each)
        curves, sweep_fit = fit_curves(sweep, charts, sensor.dark.black, measurements, left_out)
        if not sweep_fit.odd:
            check_charts(measurements, charts, sweep, sweep_fit.chosen_smoothing, sensor.dark.black)
    else:
        curves = finished.without_fit(measurements.curve, body, drift, measurements.wavelength_uncertainty)
        if measurements.charts:
            curves = curves.to_own_peaks()
            charts = measure_charts(measurements.charts, curves.wavelength, body, sensor, each)
    odd = sweep_fit.odd if sweep_fit else ()
    chart_fit = fit_charts(charts, curves.relative, sensor.dark.black, drift, body, odd) if measurements.charts else None
    fit = Fit(noise=figures, sweep=sweep_fit, chart=chart_fit)
    return assemble(body, summarise(sensor, figures, body), curves, fit)


def from_data_sheet(measurements: Measurements, figures: SensorFigures) -> CameraModel:
    """A camera with a data sheet's sensor and relative curves: of a table, a finished source, a chart behind filters."""
    body, drift, shift = measurements.body, measurements.lamp_drift, measurements.wavelength_uncertainty
    if measurements.curve is not None:
        return assemble(body, figures, finished.without_fit(measurements.curve, body, drift, shift), Fit())
    curves, fit = fit_series(measurements.bands, measurements.darks, body, figures.black, figures.white)
    return assemble(body, figures, curves, Fit(series=fit))


# ------------------------------------------------------------------------------------------------------ measuring


def measure_sensor(measurements: Measurements, each: Each = map) -> Sensor:
    """Noise, black, saturation and defects from dark and white frames (docs/method.md#dark-and-white-frames)."""
    body = measurements.body
    dark = noise.dark_noise(measurements.darks, body, each)
    whites = sorted(measurements.whites, key=lambda capture: capture.exposure)
    levels = list(each(functools.partial(noise.measure_level, body=body, defects=dark.hot), whites))
    signal = np.array([noise.mean_value(level.counts) - dark.black - dark.slope * level.exposure for level in levels])
    agreement.check_whites(whites, np.array([level.lit for level in levels]), signal)
    transfer = noise.photon_transfer(levels, body, dark)
    prnu, dead = noise.prnu(whites, levels, transfer.used, body, dark.hot, each)
    exposure = np.array([level.exposure for level in levels])
    return Sensor(dark, transfer, prnu, exposure, defects.join(dark.hot, dead))


def photons_on_pixel(capture: MonoCapture | ChartCapture, nodes: Array, body: Body) -> Array:
    """(…, wavelength) photons that the area of a pixel on the axis receives during a capture, in each node's hat."""
    photons = responsivity.node_photons(capture.wavelength, capture.radiance, nodes)
    return body.photons_per_radiance * capture.lit * photons


def measure_sweep(
    captures: Sequence[MonoCapture], body: Body, sensor: Sensor, each: Each = map
) -> tuple[responsivity.Sweep, tuple[str, ...]]:
    """Eq. 1's system from the monochromatic captures, each row divided by its photons, and the captures that saturate.

    A channel goes without the captures that saturate it; InputFileError if none, or only dark ones remain, or if a light's
    measured spectrum does not reach its end. The means are over whole frames: what the lens loses off the axis is the same
    for all, and Eq. 2 finds the scale from the charts.
    """
    for capture in captures:
        if max(capture.radiance[0], capture.radiance[-1]) > CUT_OFF * capture.radiance.max():
            raise InputFileError(f"{capture.name}: the measured spectrum does not cover its light; measure a wider range")
    nodes = responsivity.node_grid([(capture.wavelength, capture.radiance) for capture in captures])
    design, values, valid = [], [], []
    histograms = each(functools.partial(noise.count_values, body=body, defects=sensor.defects), captures)
    for capture, counts in zip(captures, histograms, strict=True):
        photons = photons_on_pixel(capture, nodes, body)
        signal = noise.mean_value(counts) - sensor.dark.black - sensor.dark.slope * capture.exposure
        design.append(photons / photons.sum())
        values.append(signal / photons.sum())
        valid.append(noise.share_from(counts, sensor.saturation) < OVEREXPOSED)
    sweep = responsivity.Sweep(nodes, np.array(design), np.array(values), np.array(valid))
    for channel, name in enumerate(body.channels):
        usable = sweep.values[sweep.valid[:, channel], channel]
        if not usable.size:
            raise InputFileError(f"channel {name} is saturated in every monochromatic capture; shorten the exposures")
        if usable.max() <= 0:
            raise InputFileError(f"channel {name} sees nothing in any monochromatic capture; check frames and cfa.pattern")
    left_out = [
        f"{capture.name}: saturated in {' '.join(name for name, ok in zip(body.channels, usable, strict=True) if not ok)}"
        for capture, usable in zip(captures, sweep.valid, strict=True)
        if not usable.all()
    ]
    return sweep, tuple(left_out)


def measure_charts(captures: Sequence[ChartCapture], nodes: Array, body: Body, sensor: Sensor, each: Each = map) -> Charts:
    """Mean DN and incident photons of every patch; InputFileError if the measured radiances do not cover the nodes."""
    for capture in captures:
        first, last = capture.wavelength[[0, -1]]
        if first > nodes[0] + responsivity.NODE_STEP or last < nodes[-1] - responsivity.NODE_STEP:
            raise InputFileError(
                f"{capture.name}: the radiances of {first:g}…{last:g} nm do not cover the responsivity's "
                f"{nodes[0]:g}…{nodes[-1]:g} nm; measure a wider range"
            )
    read = functools.partial(gain.unsaturated_values, body=body, limit=sensor.saturation, defects=sensor.defects)
    dark = [sensor.dark.slope * capture.exposure for capture in captures]
    values = [mean - signal for mean, signal in zip(each(read, captures), dark, strict=True)]
    light = [gain.patch_illumination(capture, body, sensor.defects) for capture in captures]
    photons = [share * photons_on_pixel(capture, nodes, body) for share, capture in zip(light, captures, strict=True)]
    return Charts(tuple(capture.illuminant for capture in captures), np.array(values), np.array(photons))


# -------------------------------------------------------------------------------------------------------- fitting


def fit_curves(
    sweep: responsivity.Sweep, charts: Charts, black: Array, measurements: Measurements, left_out: tuple[str, ...]
) -> tuple[Curves, SweepFit]:
    """Eq. 1 with the smoothing that predicts the charts best, each channel scaled to a peak of 1, and its band."""
    errors = np.array([_validation_error(sweep, charts, delta, black) for delta in DELTAS])
    delta = responsivity.choose_smoothing(DELTAS, errors)
    curves = responsivity.solve_channels(sweep, delta)
    drift, shift = measurements.lamp_drift, measurements.wavelength_uncertainty
    band = responsivity.confidence_bands(sweep, curves, delta, drift, shift)
    odd = agreement.odd_steps(measurements.mono, sweep)
    fit = SweepFit(responsivity.residuals(sweep, curves), left_out, DELTAS, errors, delta, odd)
    return Curves(sweep.nodes, curves, band).to_own_peaks(), fit


def _validation_error(sweep: responsivity.Sweep, charts: Charts, delta: float, black: Array) -> float:
    """Cross-validated relative RMSE over the charts, mean over channels."""
    photons = charts.photons @ responsivity.solve_channels(sweep, delta).T
    channels = range(len(black))
    return float(np.mean([gain.cross_validate(photons[..., c], charts.values[..., c], black[c]) for c in channels]))


def check_charts(
    measurements: Measurements, charts: Charts, sweep: responsivity.Sweep, smoothing: float, black: Array
) -> None:
    """InputFileError if a chart contradicts the others, or all of them the monochromator."""
    curves = responsivity.solve_channels(sweep, smoothing)
    measured = (charts.values - black).sum(axis=1)
    predicted = (charts.photons @ curves.T).sum(axis=1)
    absolute = all(capture.absolute for capture in measurements.mono)
    agreement.check_charts(measurements.charts, measured, predicted, absolute)


def fit_charts(
    charts: Charts, relative: Array, black: Array, drift: float, body: Body, odd: tuple[str, ...] = ()
) -> ChartFit:
    """Eq. 2 for every channel and its validation; InputFileError if the charts contradict the curves, which is blamed on the
    `odd` captures of these if there are any."""
    photons = charts.photons @ relative.T
    fits = []
    for channel, level in enumerate(black):
        seen, values = photons[..., channel], charts.values[..., channel]
        alpha, beta = gain.fit_gain(seen.ravel(), values.ravel(), level)
        fits.append((alpha, beta, gain.gain_error(seen, values, level, alpha, beta, drift)))
    alphas, betas, errors = np.array(fits).T
    predicted = alphas * photons + betas
    r_squared = gain.r_squared(charts.values, predicted)
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
        relative_rmse=gain.relative_rmse(charts.values, predicted, black),
        illuminants=charts.illuminants,
        measured=charts.values,
        predicted=predicted,
    )


# ----------------------------------------------------------------------------------------------------- assembling


def describe_noise(sensor: Sensor, body: Body) -> NoiseFit:
    """Dark and white frames in electrons, by the conversion gain of the whole sensor."""
    dark, transfer = sensor.dark, sensor.transfer
    conversion = float(_shares(body) @ transfer.gain)
    return NoiseFit(
        conversion_gain=transfer.gain,
        conversion_gain_error=transfer.gain_error,
        read_noise=np.sqrt(dark.variance) / conversion,
        dark_current=dark.slope / conversion,
        dsnu=dark.dsnu / conversion,
        prnu=sensor.prnu,
        saturation_capacity=(transfer.white - dark.black) / conversion,
        linearity_error=transfer.linearity_error,
        white_reached=transfer.white_reached,
        defects=sensor.defects,
        exposure=sensor.exposure,
        photon_transfer_mean=transfer.mean,
        photon_transfer_variance=transfer.variance,
    )


def summarise(sensor: Sensor, figures: NoiseFit, body: Body) -> SensorFigures:
    """One figure for all pixels, of those of each channel with its share of the pixels."""
    pixels = _shares(body)
    conversion, black = float(pixels @ sensor.transfer.gain), float(pixels @ sensor.dark.black)

    def quadratic(deviation: Array) -> float:
        return float(np.sqrt(pixels @ deviation**2))

    read_noise, dsnu, prnu = quadratic(figures.read_noise), quadratic(figures.dsnu), quadratic(figures.prnu)
    dark_current = max(float(pixels @ figures.dark_current), 0.0)
    well = (sensor.transfer.white - black) / conversion
    return SensorFigures(conversion, black, sensor.transfer.white, Noise(read_noise, dark_current, dsnu, prnu, well))


def _shares(body: Body) -> Array:
    """(channel) share of the pixels."""
    return np.bincount(body.cfa.ravel(), minlength=len(body.channels)) / body.cfa.size


def efficiency(curves: Curves, fit: Fit, gain: float, body: Body) -> tuple[Array, Array]:
    """Absolute quantum efficiency alpha · r / K (channel, wavelength) and the half width of its 95 % band, in which the
    errors of alpha and K are contained (docs/method.md#quantum-efficiency)."""
    assert fit.chart is not None
    assert fit.noise is not None
    scale = fit.chart.alpha[:, None] / gain
    conversion = np.sqrt(np.sum((_shares(body) * fit.noise.conversion_gain_error) ** 2)) / gain
    relative = np.hypot(fit.chart.alpha_error / fit.chart.alpha, conversion)[:, None]
    band = np.hypot(curves.band, responsivity.COVERAGE * relative * curves.relative)
    return curves.relative * scale, band * scale


def check_efficiency(responsivity: Array, odd: tuple[str, ...] = ()) -> None:
    """InputFileError if a quantum efficiency (channel, wavelength) is above 1, which is blamed on `odd` captures if any."""
    peak = float(responsivity.max())
    if peak > 1.0:
        cure = f"check {odd[0]}" if odd else likely_mistake(peak)
        raise InputFileError(f"the peak quantum efficiency would be {100 * peak:.4g} %, above an electron a photon; {cure}")


def likely_mistake(peak: float) -> str:
    """What a peak quantum efficiency that no camera has is a sign of: the mistakes that would make a usual one of it."""
    likely = [what for what, factor in MISTAKES.items() if USUAL[0] <= peak / factor <= USUAL[1]]
    general = "the units of radiances (photons/s/sr/m²/nm), exposures, pixel_pitch_um and f_number"
    return f"check {general}" + (f", as if {' or '.join(likely)}" if likely else "")


def assemble(body: Body, sensor: SensorFigures, curves: Curves, fit: Fit) -> CameraModel:
    """The camera model, absolute where charts gave the scale; InputFileError if black and white contradict each other."""
    curve, band = curves.relative, curves.band
    if fit.chart is not None:
        curve, band = efficiency(curves, fit, sensor.gain, body)
        check_efficiency(curve, fit.sweep.odd if fit.sweep else ())
    try:
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
            black=sensor.black,
            white=sensor.white,
            fixed_pattern_seed=0,
            noise=sensor.noise,
            optics=body.optics,
            declared=() if fit.noise else ("gain", "black", "white", "noise"),
            fit=fit,
        )
    except ValueError as error:
        raise InputFileError(f"the measurements make no camera: {error}; check dark and white frames") from error
