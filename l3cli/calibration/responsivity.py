"""Eq. 1: the spectral responsivity of each channel from monochromatic lights (docs/method.md#responsivity)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.physics import spectra

NODE_STEP = 5.0  # nm between hats: 10 nm doubles the error (docs/method.md#responsivity)
EDGE = 0.01  # share of a light's peak below which it does not reach a node
PLATEAU = 1.05  # a smoothing whose error is within 5 % of the best is as good
PILOT = 10.0  # the band's residuals are taken about a curve this much smoother
BAND_FLOOR = 0.0002  # of the peak
COVERAGE = 1.96  # standard deviations of a 95 % band
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sweep:
    """Eq. 1's linear system: values = design @ responsivity, for all channels."""

    nodes: Array  # (wavelength) nm
    design: Array  # (capture, wavelength) share of the capture's photons that a node's hat takes
    values: Array  # (capture, channel) DN/photon
    valid: NDArray[np.bool_]  # (capture, channel) not saturated


def node_grid(lights: list[tuple[Array, Array]]) -> Array:
    """Nodes (wavelength) nm every 5 nm over what the lights, (wavelength, radiance) each, reach."""
    lit = [wavelength[radiance >= EDGE * radiance.max()] for wavelength, radiance in lights]
    first = np.floor(min(part[0] for part in lit) / NODE_STEP) * NODE_STEP
    last = np.ceil(max(part[-1] for part in lit) / NODE_STEP) * NODE_STEP
    return np.arange(first, last + NODE_STEP / 2, NODE_STEP)


def light_centre(wavelength: Array, radiance: Array) -> float:
    """Return the centre of gravity in nm of a light (wavelength) at half its peak or more."""
    inside = np.where(radiance >= radiance.max() / 2, radiance * spectra.bin_widths(wavelength), 0.0)
    return float(inside @ wavelength / inside.sum())


def node_photons(wavelength: Array, radiance: Array, nodes: Array) -> Array:
    """(…, node): integral of radiance (…, wavelength) × each node's hat, photons/s/sr/m²."""
    return np.asarray(spectra.resample(radiance, wavelength, nodes) * spectra.bin_widths(nodes), dtype=np.float64)


def roughness(nodes: int) -> Array:
    """Second differences (nodes − 2, nodes)."""
    return np.diff(np.eye(nodes), n=2, axis=0)


def solve(design: Array, values: Array, delta: float) -> Array:
    """Return the responsivity r ≥ 0 (node) that minimises ‖values − design r‖² + delta ‖second differences of r‖².

    values (capture) are scaled to their peak meanwhile, so that delta means the same for every channel and unit.
    """
    from scipy.optimize import nnls

    peak = values.max()
    stacked = np.vstack([design, np.sqrt(delta) * roughness(design.shape[1])])
    right_side = np.concatenate([values / peak, np.zeros(len(stacked) - len(design))])
    return nnls(stacked, right_side)[0] * peak


def solve_channels(sweep: Sweep, delta: float) -> Array:
    """Responsivities (channel, wavelength) DN/photon, each from its unsaturated captures."""
    columns = zip(sweep.values.T, sweep.valid.T, strict=True)
    return np.array([solve(sweep.design[valid], values[valid], delta) for values, valid in columns])


def residuals(sweep: Sweep, responsivity: Array) -> Array:
    """Return the RMS (channel) of what Eq. 1 leaves unexplained, over the channel's largest value."""
    relative = []
    for values, valid, curve in zip(sweep.values.T, sweep.valid.T, responsivity, strict=True):
        rest = values[valid] - sweep.design[valid] @ curve
        relative.append(np.sqrt(np.mean(rest**2)) / values[valid].max())
    return np.array(relative)


def choose_smoothing(deltas: Array, errors: Array) -> float:
    """Return the logarithmic middle of the plateau about the least error, which alone is chance
    (docs/method.md#responsivity)."""
    best = int(errors.argmin())
    good = errors <= PLATEAU * errors[best]
    first, last = best, best
    while first > 0 and good[first - 1]:
        first -= 1
    while last < len(errors) - 1 and good[last + 1]:
        last += 1
    return float(np.sqrt(deltas[first] * deltas[last]))


def confidence_bands(sweep: Sweep, responsivity: Array, delta: float, drift: float, wavelength_error: float) -> Array:
    """Return the half width (channel, wavelength) of a 95 % band about `responsivity` (docs/method.md#confidence-bands).

    Leverage-corrected residuals of random sign about a smoother pilot, whose spread is known in closed form because the
    estimate is linear where r > 0; in quadrature with the pilot's bias, lamp drift, wavelength error and a floor.
    """
    bands = []
    for channel, curve in enumerate(responsivity):
        valid = sweep.valid[:, channel]
        design, values = sweep.design[valid], sweep.values[valid, channel]
        smoother = _smoother(design, delta)
        pilot_of = _smoother(design, PILOT * delta)
        pilot = pilot_of @ values
        leverage = np.clip(np.diag(design @ pilot_of), 0.0, 0.9)
        residual = (values - design @ pilot) / (1.0 - leverage)
        spread = np.sqrt(smoother**2 @ residual**2)
        drifted = drift * np.sqrt(smoother**2 @ values**2)
        shifted = wavelength_error * np.gradient(curve, sweep.nodes)
        bias = smoother @ (design @ pilot) - pilot
        parts = [
            COVERAGE * spread,
            COVERAGE * drifted,
            COVERAGE * shifted,
            bias,
            np.full_like(curve, BAND_FLOOR * curve.max()),
        ]
        bands.append(np.sqrt(np.sum(np.square(parts), axis=0)))
    return np.array(bands, dtype=np.float64)


def _smoother(design: Array, delta: float) -> Array:
    """(node, capture): the matrix that turns values into the responsivity while no r is held at zero."""
    penalty = roughness(design.shape[1])
    return np.asarray(np.linalg.solve(design.T @ design + delta * penalty.T @ penalty, design.T), dtype=np.float64)
