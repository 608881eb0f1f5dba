"""Responsivity curves of fits, tables and finished sources; quantum efficiency (docs/method.md#calibration)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.fit import Fit
from l3cli.calibration.responsivity import BAND_FLOOR, COVERAGE
from l3cli.calibration.statistics import channel_shares
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, FinishedCurves, SweepTable

Array = NDArray[np.float64]
USUAL = (0.03, 1.0)  # peak quantum efficiencies of cameras, lens and filters included
PHOTONS_PER_JOULE = 2.5e18  # at 500 nm
MISTAKES = {  # and by what each multiplies a quantum efficiency
    "exposures were in ms (exposure_ms)": 1e-3,
    "exposures were in µs (exposure_us)": 1e-6,
    'radiances were in watts (unit = "W/(sr m² nm)")': PHOTONS_PER_JOULE,
    'radiances were in milliwatts (unit = "mW/(sr m² nm)")': 1e-3 * PHOTONS_PER_JOULE,
    "radiances were per cm²": 1e4,
    "radiances were per µm": 1e-3,
    "exposures were in s where ms are stated": 1e3,
}


@dataclass(frozen=True)
class Curves:
    """Relative responsivities per photon, and how well they are known."""

    wavelength: Array  # (wavelength) nm
    relative: Array  # (channel, wavelength)
    band: Array  # (channel, wavelength) half width of the 95 % band; 0 everywhere: not known

    def to_common_peak(self) -> "Curves":
        """Return the curves scaled so that the largest value of the whole set is 1."""
        peak = self.relative.max()
        return replace(self, relative=self.relative / peak, band=self.band / peak)

    def to_channel_peaks(self) -> "Curves":
        """Return the curves scaled so that every channel's largest value is 1."""
        peak = self.relative.max(axis=1, keepdims=True)
        return replace(self, relative=self.relative / peak, band=self.band / peak)

    def widened(self, light_error: float, wavelength_error: float) -> "Curves":
        """Return the curves with a band that holds a relative error of the light and one of its wavelength in nm, too,
        standard deviations."""
        slope = np.gradient(self.relative, self.wavelength, axis=1) if self.wavelength.size > 1 else 0.0
        stated = COVERAGE * np.hypot(light_error * self.relative, wavelength_error * slope)
        return replace(self, band=np.hypot(self.band, stated))


def from_sweep(table: SweepTable, body: Body) -> Array:
    """Return the responsivity (channel, wavelength) per photon of a sweep beside a photodiode; nodes are the sweep's.

    Camera and photodiode each lose the dark reading of the same step; what lies below zero is zero. InputFileError if the
    photodiode or a channel sees no light.
    """
    energy = (table.diode_light - table.diode_dark) / table.diode_response
    dark = np.flatnonzero(~(energy > 0))
    if dark.size:
        raise InputFileError(
            f"the photodiode sees no light at {table.wavelength[dark[0]]:g} nm; leave that row of the sweep's table out"
        )
    per_energy = np.maximum(table.light - table.dark, 0.0) / energy
    blind = np.flatnonzero(per_energy.max(axis=1) <= 0)
    if blind.size:
        raise InputFileError(f"channel {body.channels[blind[0]]} sees nothing in the sweep's table; check its columns")
    return np.asarray(per_energy / table.wavelength, dtype=np.float64)


def without_fit(curve: SweepTable | FinishedCurves, body: Body, light_error: float, wavelength_error: float) -> Curves:
    """Return the curves of a table or of a finished source, in a band of what was stated of light and wavelength: without
    either, their error is not known, and there is no band."""
    relative = from_sweep(curve, body) if isinstance(curve, SweepTable) else curve.responsivity
    curves = Curves(curve.wavelength, relative, np.zeros_like(relative))
    if light_error and wavelength_error:
        floor = np.full_like(relative, BAND_FLOOR * relative.max())
        curves = replace(curves, band=floor).widened(light_error, wavelength_error)
    return curves.to_common_peak()


def efficiency(curves: Curves, fit: Fit, gain: float, body: Body) -> tuple[Array, Array]:
    """Return the absolute quantum efficiency alpha · r / K (channel, wavelength) and the half width of its 95 % band, in
    which the errors of alpha and K are contained (docs/method.md#quantum-efficiency)."""
    assert fit.chart is not None
    assert fit.noise is not None
    scale = (fit.chart.alpha / (gain * body.channel_gains * body.channel_exposures))[:, None]
    conversion = np.sqrt(np.sum((channel_shares(body) * fit.noise.conversion_gain_error) ** 2)) / gain
    relative = np.hypot(fit.chart.alpha_error / fit.chart.alpha, conversion)[:, None]
    band = np.hypot(curves.band, COVERAGE * relative * curves.relative)
    return curves.relative * scale, band * scale


def check_efficiency(responsivity: Array, odd: tuple[str, ...] = ()) -> None:
    """Raise InputFileError if a quantum efficiency (channel, wavelength) is above 1, which is blamed on `odd` captures if
    any."""
    peak = float(responsivity.max())
    if peak > 1.0:
        cure = f"check {odd[0]}" if odd else likely_mistake(peak)
        raise InputFileError(f"the peak quantum efficiency would be {100 * peak:.4g} %, above an electron a photon; {cure}")


def likely_mistake(peak: float) -> str:
    """Return the mistakes that would turn a usual peak quantum efficiency into one that no camera has, in words."""
    likely = [what for what, factor in MISTAKES.items() if USUAL[0] <= peak / factor <= USUAL[1]]
    general = "the units of radiances (photons/s/sr/m²/nm), exposures, pixel_pitch_um and f_number"
    return f"check {general}" + (f", as if {' or '.join(likely)}" if likely else "")
