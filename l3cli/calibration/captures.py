"""Results of captures: the sensor from dark and white frames, responsivity from monochromatic ones, gain from charts
(docs/method.md#calibration)."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration import agreement, defects, gain, noise, responsivity
from l3cli.calibration.statistics import Each, count_values, mean_value, measure_level, share_from
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, ChartCapture, Measurements, MonoCapture

OVEREXPOSED = 1e-3  # share of saturated pixels that makes a monochromatic capture useless
CUT_OFF = 0.05  # share of a light's peak that may be left where its measured spectrum ends
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """Results of dark and white frames."""

    dark: noise.DarkNoise
    transfer: noise.PhotonTransfer
    prnu: Array  # (channel)
    exposure: Array  # (level) s, of the white captures
    defects: defects.Defects
    response: Array  # (row, col) DN/s of the white light, defects patched

    @property
    def saturation(self) -> float:
        """DN from which a pixel counts as saturated."""
        black_level = self.dark.black_level.mean()
        return float(black_level + noise.SATURATED * (self.transfer.white_level - black_level))


@dataclass(frozen=True)
class Charts:
    """Every patch under every light: what was measured and what light came."""

    illuminants: tuple[str, ...]
    values: Array  # (chart, patch, channel) DN, dark signal taken out
    photons: Array  # (chart, patch, wavelength) on a pixel's area, in each node's hat, off-axis loss included


def measure_sensor(measurements: Measurements, each: Each = map) -> Sensor:
    """Measure noise, black level, saturation and defects from dark and white frames
    (docs/method.md#dark-and-white-frames)."""
    body = measurements.body
    dark = noise.dark_noise(measurements.darks, body, each)
    whites = sorted(measurements.whites, key=lambda capture: capture.exposure)
    levels = list(each(functools.partial(measure_level, body=body, defects=dark.hot), whites))
    signal = np.array([mean_value(level.counts) - dark.black_level - dark.slope * level.exposure for level in levels])
    agreement.check_whites(whites, np.array([level.lit for level in levels]), signal)
    transfer = noise.photon_transfer(levels, body, dark)
    prnu, dead, response = noise.prnu(whites, levels, transfer.used, body, dark.hot, each)
    exposure = np.array([level.exposure for level in levels])
    return Sensor(dark, transfer, prnu, exposure, defects.join(dark.hot, dead), response)


def photons_on_pixel(capture: MonoCapture | ChartCapture, nodes: Array, body: Body) -> Array:
    """Return the photons (…, wavelength) that the area of a pixel on the axis receives during a capture, in each node's
    hat."""
    photons = responsivity.node_photons(capture.wavelength, capture.radiance, nodes)
    return body.photons_per_radiance * capture.lit * photons


def measure_sweep(
    captures: Sequence[MonoCapture], body: Body, sensor: Sensor, each: Each = map
) -> tuple[responsivity.Sweep, tuple[str, ...]]:
    """Return Eq. 1's system from the monochromatic captures, each row divided by its photons, and the captures that
    saturate.

    A channel goes without the captures that saturate it; InputFileError if none, or only dark ones remain, or if a light's
    measured spectrum does not reach its end. The means are over whole frames: what the lens loses off the axis is the same
    for all, and Eq. 2 finds the scale from the charts.
    """
    for capture in captures:
        if max(capture.radiance[0], capture.radiance[-1]) > CUT_OFF * capture.radiance.max():
            raise InputFileError(f"{capture.name}: the measured spectrum does not cover its light; measure a wider range")
    nodes = responsivity.node_grid([(capture.wavelength, capture.radiance) for capture in captures])
    design, values, valid = [], [], []
    histograms = each(functools.partial(count_values, body=body, defects=sensor.defects), captures)
    for capture, counts in zip(captures, histograms, strict=True):
        photons = photons_on_pixel(capture, nodes, body)
        signal = mean_value(counts) - sensor.dark.black_level - sensor.dark.slope * capture.exposure
        design.append(photons / photons.sum())
        values.append(signal / photons.sum())
        valid.append(share_from(counts, sensor.saturation) < OVEREXPOSED)
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
    """Return the mean DN and incident photons of every patch; InputFileError if the measured radiances do not cover the
    nodes."""
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
