"""Quantum efficiency of relative curves, and whether a camera can have it (docs/method.md#quantum-efficiency)."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.fit import Fit
from l3cli.calibration.curves import Curves
from l3cli.calibration.responsivity import COVERAGE
from l3cli.calibration.statistics import channel_shares
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body

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
Array = NDArray[np.float64]


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
