"""Responsivity curves, and those that need no fit: tables, finished curves (docs/method.md#sweeps-and-band-series)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.responsivity import BAND_FLOOR, COVERAGE
from l3cli.errors import InputFileError
from l3cli.measurement import Body, FinishedCurves, SweepTable

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Curves:
    """Relative responsivities per photon, and how well they are known."""

    wavelength: Array  # (wavelength) nm
    relative: Array  # (channel, wavelength)
    band: Array  # (channel, wavelength) half width of the 95 % band

    def to_common_peak(self) -> "Curves":
        """Scaled so that the largest value of the whole set is 1."""
        peak = self.relative.max()
        return replace(self, relative=self.relative / peak, band=self.band / peak)

    def to_channel_peaks(self) -> "Curves":
        """Scaled so that every channel's largest value is 1."""
        peak = self.relative.max(axis=1, keepdims=True)
        return replace(self, relative=self.relative / peak, band=self.band / peak)


def from_sweep(table: SweepTable, body: Body) -> Array:
    """Responsivity (channel, wavelength) per photon of a sweep beside a photodiode; nodes are the sweep's.

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


def without_fit(curve: SweepTable | FinishedCurves, body: Body, drift: float, wavelength_error: float) -> Curves:
    """Curves of a table or of a finished source, in a band of what was declared of the lights."""
    relative = from_sweep(curve, body) if isinstance(curve, SweepTable) else curve.responsivity
    shifted = wavelength_error * np.gradient(relative, curve.wavelength, axis=1)
    band = np.hypot(COVERAGE * np.hypot(drift * relative, shifted), BAND_FLOOR * relative.max())
    return Curves(curve.wavelength, relative, band).to_common_peak()
