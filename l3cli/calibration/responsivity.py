"""Estimate spectral responsivities, and each channel's gain.

Eq. 1 determines the responsivities from monochromatic captures (docs/method.md#responsivity). Eq. 2 determines each
channel's gain and offset from charts under known illuminants (docs/method.md#gain-and-offset). Sweep tables and finished
curves need no fit.
"""

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.fit import Fit
from l3cli.calibration.statistics import Defects, channel_shares
from l3cli.errors import InputFileError
from l3cli.frames import chart
from l3cli.frames.measurement import CHART_COLS, CHART_ROWS, PATCHES, Body, ChartCapture, FinishedCurves, SweepTable
from l3cli.physics import spectra

NODE_STEP = 5.0  # nm; distance between hat functions; 10 nm would double the error (docs/method.md#responsivity)
EDGE = 0.01  # radiances below this fraction of the peak are ignored
PLATEAU = 1.05  # smoothing weights with an error up to 5 % above the minimum count as equally good
PILOT = 10.0  # smoothing weight of the pilot curve for confidence bands, divided by the smoothing weight of the curve itself
BAND_FLOOR = 0.0002  # smallest half width of a confidence band, as a fraction of the peak
COVERAGE = 1.96  # half width of a 95 % confidence band, in standard deviations
Array = NDArray[np.float64]
USUAL = (0.03, 1.0)  # range of plausible peak quantum efficiencies, including lens and filters
PHOTONS_PER_JOULE = 2.5e18  # at 500 nm
# Common mistakes in measurement files, and the factors by which they change the quantum efficiency.
MISTAKES = {
    "exposure times are in ms (use exposure_ms)": 1e-3,
    "exposure times are in µs (use exposure_us)": 1e-6,
    'radiances are in watts (use unit = "W/(sr m² nm)")': PHOTONS_PER_JOULE,
    'radiances are in milliwatts (use unit = "mW/(sr m² nm)")': 1e-3 * PHOTONS_PER_JOULE,
    "radiances are per cm²": 1e4,
    "radiances are per µm": 1e-3,
    "exposure times are in s but declared as ms": 1e3,
}
CORE = 0.25  # half the side of the central square that is averaged in each patch, as a fraction of the patch spacing
# Standard deviation of a patch's mean value: relative, and in DN (docs/method.md#gain-and-offset).
RELATIVE_ERROR, ABSOLUTE_ERROR = 0.005, 0.3


@dataclass(frozen=True)
class Sweep:
    """Linear systems of Eq. 1, one per channel: values = design @ responsivity."""

    nodes: Array  # (wavelength,): centres of the hat functions in nm
    design: Array  # (capture, wavelength): fraction of the capture's photons in each hat function
    values: Array  # (capture, channel): DN/photon
    valid: NDArray[np.bool_]  # (capture, channel): whether the channel is unsaturated


def node_grid(lights: list[tuple[Array, Array]]) -> Array:
    """Return the centres, in nm, of hat functions (triangles) that cover all spectra at a spacing of NODE_STEP.

    Each spectrum in `lights` is a pair (wavelength in nm, radiance).
    """
    lit = [wavelength[radiance >= EDGE * radiance.max()] for wavelength, radiance in lights]
    first = np.floor(min(part[0] for part in lit) / NODE_STEP) * NODE_STEP
    last = np.ceil(max(part[-1] for part in lit) / NODE_STEP) * NODE_STEP
    return np.arange(first, last + NODE_STEP / 2, NODE_STEP)


def light_centre(wavelength: Array, radiance: Array) -> float:
    """Return a narrow spectrum's central wavelength in nm: the centroid of the part above half maximum."""
    inside = np.where(radiance >= radiance.max() / 2, radiance * spectra.bin_widths(wavelength), 0.0)
    return float(inside @ wavelength / inside.sum())


def node_photons(wavelength: Array, radiance: Array, nodes: Array) -> Array:
    """Integrate a radiance over wavelength, weighted by each hat function.

    Parameters
    ----------
    wavelength : ndarray, (wavelength,)
        Wavelengths of the radiance in nm.
    radiance : ndarray, (…, wavelength)
        Radiance in photons/s/sr/m²/nm.
    nodes : ndarray, (node,)
        Centres of the hat functions in nm.

    Returns
    -------
    ndarray, (…, node)
        Integrals in photons/s/sr/m².
    """
    return np.asarray(spectra.resample(radiance, wavelength, nodes) * spectra.bin_widths(nodes), dtype=np.float64)


def roughness(nodes: int) -> Array:
    """Return the matrix (nodes − 2, nodes) that computes the second differences of a curve."""
    return np.diff(np.eye(nodes), n=2, axis=0)


def solve(design: Array, values: Array, delta: float) -> Array:
    """Minimise ‖values − design r‖² + delta ‖second differences of r‖² over r ≥ 0.

    Parameters
    ----------
    design : ndarray, (capture, node)
        System matrix.
    values : ndarray, (capture,)
        Right-hand side. It is scaled to a peak of 1 during the fit, so that the effect of `delta` does not depend on the
        channel or the unit.
    delta : float
        Smoothing weight.

    Returns
    -------
    ndarray, (node,)
        Responsivity r in the unit of `values`.
    """
    from scipy.optimize import nnls

    peak = values.max()
    stacked = np.vstack([design, np.sqrt(delta) * roughness(design.shape[1])])
    right_side = np.concatenate([values / peak, np.zeros(len(stacked) - len(design))])
    return nnls(stacked, right_side)[0] * peak


def solve_channels(sweep: Sweep, delta: float) -> Array:
    """Solve Eq. 1 for each channel, excluding captures in which the channel is saturated.

    Returns
    -------
    ndarray, (channel, wavelength)
        Responsivities in DN/photon.
    """
    columns = zip(sweep.values.T, sweep.valid.T, strict=True)
    return np.array([solve(sweep.design[valid], values[valid], delta) for values, valid in columns])


def residuals(sweep: Sweep, responsivity: Array) -> Array:
    """Return each channel's RMS residual of Eq. 1, relative to the channel's largest value."""
    relative = []
    for values, valid, curve in zip(sweep.values.T, sweep.valid.T, responsivity, strict=True):
        rest = values[valid] - sweep.design[valid] @ curve
        relative.append(np.sqrt(np.mean(rest**2)) / values[valid].max())
    return np.array(relative)


def choose_smoothing(deltas: Array, errors: Array) -> float:
    """Choose a smoothing weight by its validation error (docs/method.md#responsivity).

    The weights next to the best one have nearly the same error, so the exact minimum depends on chance. The result is
    therefore the geometric centre of a range: the weights around the minimum with errors of at most PLATEAU times the
    minimum.

    Parameters
    ----------
    deltas : ndarray, (weight,)
        Smoothing weights in increasing order.
    errors : ndarray, (weight,)
        Validation error of each smoothing weight.
    """
    best = int(errors.argmin())
    good = errors <= PLATEAU * errors[best]
    first, last = best, best
    while first > 0 and good[first - 1]:
        first -= 1
    while last < len(errors) - 1 and good[last + 1]:
        last += 1
    return float(np.sqrt(deltas[first] * deltas[last]))


def confidence_bands(sweep: Sweep, responsivity: Array, delta: float, drift: float, wavelength_error: float) -> Array:
    """Compute the half widths of the responsivities' 95 % confidence bands (docs/method.md#confidence-bands).

    Parameters
    ----------
    sweep : Sweep
        Monochromatic captures.
    responsivity : ndarray, (channel, wavelength)
        Responsivities from `sweep` with the smoothing weight `delta`.
    delta : float
        Smoothing weight in Eq. 1.
    drift : float
        Relative standard deviation of the lamp drift.
    wavelength_error : float
        Standard deviation of the wavelengths in nm.

    Returns
    -------
    ndarray, (channel, wavelength)
        Half width of the bands.

    Notes
    -----
    The half width is the root sum of squares of five contributions:

    1. The standard deviation of the curve for residuals with random signs (wild bootstrap). The residuals come from a
       smoother pilot curve and are divided by 1 − leverage. Because the estimate is linear where r > 0, this contribution
       has a closed form.
    2. The bias of the pilot curve.
    3. The effect of the lamp drift.
    4. The effect of the wavelength error.
    5. A minimum, BAND_FLOOR.
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
    """Return the matrix (node, capture) that converts capture values to a responsivity, ignoring the constraint r ≥ 0."""
    penalty = roughness(design.shape[1])
    return np.asarray(np.linalg.solve(design.T @ design + delta * penalty.T @ penalty, design.T), dtype=np.float64)


def smoothers(sweep: Sweep, delta: float) -> list[Array]:
    """Return, for each channel, the matrix (node, capture) that converts capture values to a responsivity.

    If the channel is saturated in a capture, the capture's column contains zeros.
    """
    matrices = []
    for valid in sweep.valid.T:
        matrix = np.zeros((sweep.nodes.size, valid.size))
        matrix[:, valid] = _smoother(sweep.design[valid], delta)
        matrices.append(matrix)
    return matrices


@dataclass(frozen=True)
class Curves:
    """Relative responsivities per photon, with confidence bands."""

    wavelength: Array  # (wavelength,): nm
    relative: Array  # (channel, wavelength): responsivity
    band: Array  # (channel, wavelength): half width of the 95 % confidence band; 0 everywhere if it is unknown

    def to_common_peak(self) -> "Curves":
        """Scale all curves by the same factor, so that the highest peak is 1."""
        peak = self.relative.max()
        return replace(self, relative=self.relative / peak, band=self.band / peak)

    def to_channel_peaks(self) -> "Curves":
        """Scale each curve to a peak of 1."""
        peak = self.relative.max(axis=1, keepdims=True)
        return replace(self, relative=self.relative / peak, band=self.band / peak)

    def widened(self, light_error: float, wavelength_error: float) -> "Curves":
        """Widen the confidence bands to include errors in the brightness and wavelength of the measurement light.

        Parameters
        ----------
        light_error : float
            Relative standard deviation of the brightness.
        wavelength_error : float
            Standard deviation of the wavelength in nm.
        """
        slope = np.gradient(self.relative, self.wavelength, axis=1) if self.wavelength.size > 1 else 0.0
        stated = COVERAGE * np.hypot(light_error * self.relative, wavelength_error * slope)
        return replace(self, band=np.hypot(self.band, stated))


def from_sweep(table: SweepTable, body: Body) -> Array:
    """Compute the responsivities per photon from a wavelength sweep with a photodiode as reference.

    The dark readings of camera and photodiode are subtracted. Negative responsivities become zero.

    Returns
    -------
    ndarray, (channel, wavelength)
        Relative responsivities.

    Raises
    ------
    InputFileError
        If the photodiode receives no light at a wavelength, or if a channel has no signal at all.
    """
    energy = (table.diode_light - table.diode_dark) / table.diode_response
    dark = np.flatnonzero(~(energy > 0))
    if dark.size:
        raise InputFileError(
            f"the photodiode receives no light at {table.wavelength[dark[0]]:g} nm; remove this row from the sweep table"
        )
    per_energy = np.maximum(table.light - table.dark, 0.0) / energy
    blind = np.flatnonzero(per_energy.max(axis=1) <= 0)
    if blind.size:
        raise InputFileError(
            f"channel {body.channels[blind[0]]} has no signal in the sweep table; check the columns of this channel"
        )
    return np.asarray(per_energy / table.wavelength, dtype=np.float64)


def without_fit(curve: SweepTable | FinishedCurves, body: Body, light_error: float, wavelength_error: float) -> Curves:
    """Convert a sweep table or finished curves to relative responsivities with a highest peak of 1.

    The confidence bands follow from the declared errors of brightness and wavelength. If one of these errors is 0, the bands
    are 0 (unknown).
    """
    relative = from_sweep(curve, body) if isinstance(curve, SweepTable) else curve.responsivity
    curves = Curves(curve.wavelength, relative, np.zeros_like(relative))
    if light_error and wavelength_error:
        floor = np.full_like(relative, BAND_FLOOR * relative.max())
        curves = replace(curves, band=floor).widened(light_error, wavelength_error)
    return curves.to_common_peak()


def efficiency(curves: Curves, fit: Fit, gain: float, body: Body) -> tuple[Array, Array]:
    """Convert relative responsivities r to quantum efficiencies alpha · r / K (docs/method.md#gain-and-offset).

    Parameters
    ----------
    curves : Curves
        Relative responsivities. Each channel has a peak of 1.
    fit : Fit
        Results of the calibration, with `chart` (alpha) and `noise` (K of each channel).
    gain : float
        Conversion gain K of the sensor in DN/e-.
    body : Body
        Gains and exposures of the channels.

    Returns
    -------
    efficiency, band : ndarray, (channel, wavelength)
        Quantum efficiency, and half width of its 95 % confidence band, including the errors of alpha and K.
    """
    assert fit.chart is not None
    assert fit.noise is not None
    scale = (fit.chart.alpha / (gain * body.channel_gains * body.channel_exposures))[:, None]
    conversion = np.sqrt(np.sum((channel_shares(body) * fit.noise.conversion_gain_error) ** 2)) / gain
    relative = np.hypot(fit.chart.alpha_error / fit.chart.alpha, conversion)[:, None]
    band = np.hypot(curves.band, COVERAGE * relative * curves.relative)
    return curves.relative * scale, band * scale


def check_efficiency(responsivity: Array, odd: tuple[str, ...] = ()) -> None:
    """Raise InputFileError if a quantum efficiency exceeds 1.

    `odd` contains descriptions of implausible captures. The message recommends checking the first one or, if there is none,
    the units.
    """
    peak = float(responsivity.max())
    if peak > 1.0:
        cure = f"check {odd[0]}" if odd else likely_mistake(peak)
        raise InputFileError(
            f"the peak quantum efficiency would be {100 * peak:.4g} %, which is more than one electron per photon; {cure}"
        )


def likely_mistake(peak: float) -> str:
    """Recommend checking the units, and list mistakes that would explain an implausible peak quantum efficiency."""
    likely = [mistake for mistake, factor in MISTAKES.items() if USUAL[0] <= peak / factor <= USUAL[1]]
    general = "the units of radiances (photons/s/sr/m²/nm), exposure times, pixel_pitch_um and f_number"
    return f"check {general}" + (f"; perhaps {' or '.join(likely)}" if likely else "")


def patch_map(corners: Array, rows: int, cols: int) -> NDArray[np.int64]:
    """Return the index of the ColorChecker patch at each pixel: (row, col).

    The index is assigned only in the central square of a patch. All other pixels have the value 24. The chart may be rotated
    and seen in perspective.

    Parameters
    ----------
    corners : ndarray, (4, 2)
        Column and row of the outer corners of patches 1, 6, 24 and 19.
    rows, cols : int
        Size of the frame.
    """
    cells = chart.corner_cells(CHART_ROWS, CHART_COLS)
    return chart.patch_map(chart.homography(cells, corners), (CHART_ROWS, CHART_COLS), (rows, cols), CORE)


@functools.lru_cache(maxsize=1)  # usually, a series of captures shows the chart at one place
def _cached_patches(corners: tuple[float, ...], rows: int, cols: int) -> NDArray[np.uint8]:
    """Return the result of `patch_map`. `corners` contains the column and row of each corner in turn."""
    return patch_map(np.reshape(corners, (4, 2)), rows, cols).astype(np.uint8)


def patch_values(capture: ChartCapture, body: Body, limit: float, defects: Defects) -> tuple[Array, NDArray[np.bool_]]:
    """Measure a chart's patches, averaged over all frames of a capture.

    A patch is saturated in a channel if, in any frame, more than 0.1 % of the pixels in its central square reach `limit` DN.
    Defective pixels are ignored.

    Returns
    -------
    values : ndarray, (patch, channel)
        Mean value in DN.
    saturated : ndarray of bool, (patch, channel)
        Whether the patch is saturated.

    Raises
    ------
    InputFileError
        If the corners of the chart are outside the frame or on a line, or if a central square contains no pixel of a
        channel.
    """
    channels = len(body.channels)
    pixels, label, count = _cores(capture, body, defects)
    total, frames = np.zeros((PATCHES, channels)), 0
    saturated = np.zeros((PATCHES, channels), dtype=bool)
    for frame in capture.frames:
        values = frame.ravel()[pixels].astype(np.float64)
        saturated |= _per_label(label, values >= limit, channels) > count / 1000
        total += _per_label(label, values, channels)
        frames += 1
    return total / count / frames, saturated


def unsaturated_values(capture: ChartCapture, body: Body, limit: float, defects: Defects) -> Array:
    """Measure a chart's patches like `patch_values`, but raise InputFileError if a patch is saturated: (patch, channel)."""
    values, saturated = patch_values(capture, body, limit, defects)
    if saturated.any():
        patch, channel = np.argwhere(saturated)[0]
        raise InputFileError(
            f"{capture.name}: patch {patch + 1} is saturated in channel {body.channels[channel]}; use a shorter exposure"
        )
    return values


def patch_illumination(capture: ChartCapture, body: Body, defects: Defects) -> Array:
    """Return the illumination at each patch in the frame, relative to the optical axis (cos⁴ falloff): (patch, 1)."""
    pixels, label, count = _cores(capture, body, defects)
    channels = len(body.channels)
    light = _per_label(label, body.relative_illumination.ravel()[pixels], channels)
    return light.sum(axis=1, keepdims=True) / count.sum(axis=1, keepdims=True)


def _cores(capture: ChartCapture, body: Body, defects: Defects) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Find the pixels in the central squares of the patches, except defective pixels.

    Returns
    -------
    pixels : ndarray, (pixel,)
        Indices of the pixels in the flattened frame.
    label : ndarray, (pixel,)
        Label of each pixel: patch · (number of channels) + channel.
    count : ndarray, (patch, channel)
        Number of pixels with each label.

    Raises
    ------
    InputFileError
        If the corners of the chart are outside the frame or on a line, or if a patch contains no pixel of a channel.
    """
    rows, cols, channels = body.rows, body.cols, len(body.channels)
    if (capture.corners < 0).any() or (capture.corners > (cols, rows)).any():
        raise InputFileError(
            f"{capture.name}: a corner of the chart is outside the frame, which has {cols} columns and {rows} rows; "
            'correct "corners", the column and row of each corner'
        )
    try:
        patches = _cached_patches(tuple(capture.corners.ravel().tolist()), rows, cols).copy()
    except np.linalg.LinAlgError:
        raise InputFileError(
            f'{capture.name}: the corners of the chart are on a line; correct "corners" (begin at patch 1 and continue '
            "clockwise)"
        ) from None
    patches[defects[:, 0], defects[:, 1]] = PATCHES
    patch = patches.ravel()
    pixels = np.flatnonzero(patch < PATCHES)
    channel = body.cfa[(pixels // cols) % body.cfa.shape[0], (pixels % cols) % body.cfa.shape[1]]
    label = patch[pixels].astype(np.int64) * channels + channel
    count = _per_label(label, np.ones(label.size), channels)
    if not count.all():
        raise InputFileError(
            f'{capture.name}: a patch contains too few pixels; check "corners", which must begin at patch 1 and continue '
            "clockwise"
        )
    return pixels, label, count


def _per_label(label: NDArray[np.int64], weights: NDArray, channels: int) -> Array:
    """Sum `weights` over all pixels with the same label: (patch, channel)."""
    sums = np.bincount(label, weights=weights, minlength=PATCHES * channels)
    return sums.astype(np.float64).reshape(PATCHES, channels)


def fit_gain(photons: Array, values: Array, black_level: float) -> tuple[float, float]:
    """Fit values ≈ alpha · photons + beta, with alpha ≥ 0, for one channel (Eq. 2).

    Parameters
    ----------
    photons : ndarray, (sample,)
        Photons from each patch, weighted by the relative responsivity.
    values : ndarray, (sample,)
        Mean value of each patch in DN.
    black_level : float
        Black level in DN, which affects only the weights of the samples (docs/method.md#gain-and-offset).

    Returns
    -------
    alpha, beta : float
        Slope in DN/photon, and offset in DN.
    """
    from scipy.optimize import lsq_linear

    weight = 1.0 / np.hypot(RELATIVE_ERROR * (values - black_level), ABSOLUTE_ERROR)
    scale = photons.max()
    system = np.stack([photons / scale, np.ones_like(photons)], axis=1) * weight[:, None]
    alpha, beta = lsq_linear(system, values * weight, bounds=([0.0, -np.inf], [np.inf, np.inf])).x
    return float(alpha / scale), float(beta)


def gain_error(photons: Array, values: Array, black_level: float, alpha: float, beta: float, drift: float) -> float:
    """Return the standard error of `alpha`, the slope in Eq. 2.

    The slopes of the charts differ, because the lamps drift. Their standard deviation is taken from separate fits to each
    chart, or from the declared lamp drift if that is larger. The standard error is this standard deviation divided by the
    square root of the number of charts.

    Parameters
    ----------
    photons : ndarray, (chart, patch)
        Photons from each patch, weighted by the relative responsivity.
    values : ndarray, (chart, patch)
        Mean value of each patch in DN.
    black_level : float
        Black level in DN.
    alpha, beta : float
        Slope in DN/photon and offset in DN, from `fit_gain`.
    drift : float
        Declared relative standard deviation of the lamp drift.
    """
    single, _ = chart_factors(photons, values, black_level, beta)
    charts = len(single)
    return float(max(single.std(ddof=1), drift * alpha) / np.sqrt(charts))


def chart_factors(photons: Array, values: Array, black_level: float, beta: float) -> tuple[Array, Array]:
    """Fit the slope in Eq. 2 to each chart separately, with the same offset `beta`.

    Returns
    -------
    slopes : ndarray, (chart,)
        Slope of each chart.
    weights : ndarray, (chart, patch)
        Weights of the patches in the fit.
    """
    weight = 1.0 / np.hypot(RELATIVE_ERROR * (values - black_level), ABSOLUTE_ERROR) ** 2
    return (weight * photons * (values - beta)).sum(axis=1) / (weight * photons**2).sum(axis=1), weight


def relative_rmse(measured: Array, predicted: Array, black_level: Array | float) -> Array:
    """Return the RMSE over charts and patches, divided by the mean signal above black.

    The arrays have the shape (chart, patch, …), and the result has the shape (…).
    """
    return np.sqrt(np.mean((measured - predicted) ** 2, axis=(0, 1))) / np.mean(measured - black_level, axis=(0, 1))


def r_squared(measured: Array, predicted: Array) -> Array:
    """Return R², the fraction of the variance over charts and patches that the prediction explains.

    The arrays have the shape (chart, patch, …), and the result has the shape (…).
    """
    residual = np.sum((measured - predicted) ** 2, axis=(0, 1))
    return 1.0 - residual / np.sum((measured - measured.mean(axis=(0, 1))) ** 2, axis=(0, 1))


def cross_validate(photons: Array, values: Array, black_level: float) -> float:
    """Return the relative RMSE of a leave-one-out cross-validation over the charts.

    Each chart is predicted with alpha and beta fitted to the other charts. `photons` and `values` have the shape (chart,
    patch).
    """
    predicted = np.empty_like(values)
    for left_out in range(len(values)):
        others = np.arange(len(values)) != left_out
        alpha, beta = fit_gain(photons[others].ravel(), values[others].ravel(), black_level)
        predicted[left_out] = alpha * photons[left_out] + beta
    return float(relative_rmse(values, predicted, black_level))
