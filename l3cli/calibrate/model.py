"""Measurements → camera model: the steps of METHOD 1.4 in their order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, Fit, Noise
from l3cli.calibrate import gain, noise, responsivity
from l3cli.errors import InputFileError
from l3cli.measurement import Body, ChartCapture, Measurements, MonoCapture

DELTAS = np.geomspace(1e-7, 1e1, 33)  # smoothings tried in Eq. 1
LEAST_R_SQUARED = 0.5  # charts that fit worse were not measured as the measurement file says
OVEREXPOSED = 1e-3  # share of saturated pixels that makes a monochromatic capture useless
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """What dark and white frames tell."""

    dark: noise.DarkNoise
    transfer: noise.PhotonTransfer
    prnu: Array  # (channel)

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


@dataclass(frozen=True)
class Curves:
    """Eq. 1's responsivities, scaled to a peak of 1, and how they were found."""

    wavelength: Array  # (wavelength) nm
    relative: Array  # (channel, wavelength)
    band: Array  # (channel, wavelength) half width of the 95 % band
    errors: Array  # (trial) cross-validated relative RMSE of each of DELTAS
    delta: float


def calibrate(measurements: Measurements) -> CameraModel:
    """The camera that explains the measurements (METHOD 1.4); InputFileError names the capture that cannot be used."""
    body = measurements.body
    sensor = measure_sensor(measurements)
    sweep = measure_sweep(measurements.mono, body, sensor)
    charts = measure_charts(measurements.charts, sweep.nodes, body, sensor)
    curves = fit_curves(sweep, charts, sensor.dark.black, measurements)
    return assemble(body, sensor, charts, curves)


def measure_sensor(measurements: Measurements) -> Sensor:
    """Noise, black and saturation from dark and white frames (METHOD 1.4 (3))."""
    body = measurements.body
    dark = noise.dark_noise(measurements.darks, body)
    whites = sorted(measurements.whites, key=lambda capture: capture.exposure)
    levels = [noise.measure_level(capture, body) for capture in whites]
    transfer = noise.photon_transfer(levels, body, dark)
    return Sensor(dark, transfer, noise.prnu(whites, levels, transfer.used, body))


def photons_on_pixel(capture: MonoCapture | ChartCapture, nodes: Array, body: Body) -> Array:
    """(…, wavelength) photons that the area of a pixel on the axis receives during a capture, in each node's hat."""
    photons = responsivity.node_photons(capture.wavelength, capture.radiance, nodes)
    return body.photons_per_radiance * capture.exposure * photons


def measure_sweep(captures: Sequence[MonoCapture], body: Body, sensor: Sensor) -> responsivity.Sweep:
    """Eq. 1's system from the monochromatic captures, each row divided by its photons.

    A channel goes without the captures that saturate it; InputFileError if none, or only dark ones remain. The means are
    over whole frames: what the lens loses off the axis is the same for all, and Eq. 2 finds the scale from the charts.
    """
    nodes = responsivity.node_grid([(capture.wavelength, capture.radiance) for capture in captures])
    design, values, valid = [], [], []
    for capture in captures:
        photons = photons_on_pixel(capture, nodes, body)
        counts = noise.count_values(capture, body)
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
    return sweep


def measure_charts(captures: Sequence[ChartCapture], nodes: Array, body: Body, sensor: Sensor) -> Charts:
    """Mean DN and incident photons of every patch of every chart capture."""
    values = [
        gain.patch_values(capture, body, sensor.saturation) - sensor.dark.slope * capture.exposure for capture in captures
    ]
    photons = [gain.patch_illumination(capture, body) * photons_on_pixel(capture, nodes, body) for capture in captures]
    return Charts(tuple(capture.illuminant for capture in captures), np.array(values), np.array(photons))


def fit_curves(sweep: responsivity.Sweep, charts: Charts, black: Array, measurements: Measurements) -> Curves:
    """Eq. 1 with the smoothing that predicts the charts best, and its confidence band."""
    errors = np.array([_validation_error(sweep, charts, delta, black) for delta in DELTAS])
    delta = responsivity.choose_smoothing(DELTAS, errors)
    curves = responsivity.solve_channels(sweep, delta)
    drift, shift = measurements.lamp_drift, measurements.wavelength_uncertainty
    band = responsivity.confidence_bands(sweep, curves, delta, drift, shift)
    peak = curves.max(axis=1, keepdims=True)
    return Curves(sweep.nodes, curves / peak, band / peak, errors, delta)


def _validation_error(sweep: responsivity.Sweep, charts: Charts, delta: float, black: Array) -> float:
    """Cross-validated relative RMSE over the charts, mean over channels."""
    photons = charts.photons @ responsivity.solve_channels(sweep, delta).T
    channels = range(len(black))
    return float(np.mean([gain.cross_validate(photons[..., c], charts.values[..., c], black[c]) for c in channels]))


def fit_charts(charts: Charts, relative: Array, black: Array) -> tuple[Array, Array, Array]:
    """Eq. 2 for every channel: alpha (channel) DN/photon, beta (channel) DN, predicted DN (chart, patch, channel)."""
    photons = charts.photons @ relative.T
    fits = [gain.fit_gain(photons[..., c].ravel(), charts.values[..., c].ravel(), black[c]) for c in range(len(relative))]
    alpha, beta = np.array(fits).T
    return alpha, beta, alpha * photons + beta


def assemble(body: Body, sensor: Sensor, charts: Charts, curves: Curves) -> CameraModel:
    """The camera model: quantum efficiency is alpha · r / K (METHOD 1.4 (4)).

    InputFileError if the charts contradict the curves, or black and white each other.
    """
    pixels = np.bincount(body.cfa.ravel()) / body.cfa.size
    conversion, black = float(pixels @ sensor.transfer.gain), float(pixels @ sensor.dark.black)
    fit = describe_fit(sensor, charts, curves, conversion)
    worst = int(fit.r_squared.argmin())
    if fit.r_squared[worst] < LEAST_R_SQUARED:
        raise InputFileError(
            f"channel {body.channels[worst]}: the charts do not fit the responsivity (R² {fit.r_squared[worst]:.2f}); "
            "check the order of corners and radiances, exposures and cfa.pattern"
        )
    scale = fit.alpha[:, None] / conversion
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
            responsivity=curves.relative * scale,
            responsivity_band=curves.band * scale,
            absolute=True,
            gain=conversion,
            black=black,
            white=sensor.transfer.white,
            fixed_pattern_seed=0,
            noise=Noise(
                read_noise=_quadratic_mean(fit.read_noise, pixels),
                dark_current=max(float(pixels @ fit.dark_current), 0.0),
                dsnu=_quadratic_mean(fit.dsnu, pixels),
                prnu=_quadratic_mean(fit.prnu, pixels),
                well_capacity=(sensor.transfer.white - black) / conversion,
            ),
            optics=body.optics,
            fit=fit,
        )
    except ValueError as error:
        raise InputFileError(f"the measurements make no camera: {error}; check dark and white frames") from error


def describe_fit(sensor: Sensor, charts: Charts, curves: Curves, conversion: float) -> Fit:
    """Eq. 2 and all that tells how well the measurements are explained; conversion is K in DN/e-."""
    dark, transfer = sensor.dark, sensor.transfer
    alpha, beta, predicted = fit_charts(charts, curves.relative, dark.black)
    return Fit(
        conversion_gain=transfer.gain,
        read_noise=np.sqrt(dark.variance) / conversion,
        dark_current=dark.slope / conversion,
        dsnu=dark.dsnu / conversion,
        prnu=sensor.prnu,
        white_reached=transfer.white_reached,
        alpha=alpha,
        beta=beta,
        r_squared=gain.r_squared(charts.values, predicted),
        relative_rmse=gain.relative_rmse(charts.values, predicted, dark.black),
        smoothing=DELTAS,
        smoothing_error=curves.errors,
        chosen_smoothing=curves.delta,
        illuminants=charts.illuminants,
        measured=charts.values,
        predicted=predicted,
        photon_transfer_mean=transfer.mean,
        photon_transfer_variance=transfer.variance,
    )


def _quadratic_mean(deviation: Array, share: Array) -> float:
    """One standard deviation for all pixels, of those of each channel with its share of the pixels (channel)."""
    return float(np.sqrt(share @ deviation**2))
