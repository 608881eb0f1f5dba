"""A chart behind narrow filters: linearity and relative responses (docs/method.md#sweeps-and-band-series)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.fit import SeriesFit
from l3cli.calibration import agreement, gain, noise
from l3cli.calibration.responsivity import COVERAGE, Curves, light_centre
from l3cli.calibration.statistics import count_values, mean_value, no_defects
from l3cli.errors import InputFileError
from l3cli.frames.measurement import PATCHES, BandCapture, Body, Capture
from l3cli.physics import spectra

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """Patches of every capture, dark value taken out."""

    lights: tuple[str, ...]  # bands by centre
    light: NDArray[np.int64]  # (capture) index of its band
    lit: Array  # (capture) s of light
    values: Array  # (capture, patch, channel) DN
    valid: NDArray[np.bool_]  # (capture, patch, channel) not saturated


def fit_series(
    captures: Sequence[BandCapture], darks: Sequence[Capture], body: Body, black_level: float, white_level: float
) -> tuple[Curves, SeriesFit]:
    """Responses to each band, and how well signals follow exposure; a patch that saturates in a channel is left out there.

    InputFileError if a channel is saturated in all captures of a band, or if a band has a single exposure.
    """
    limit = black_level + noise.SATURATED * (white_level - black_level)
    series = measure_series(captures, darks, body, black_level, limit)
    agreement.check_series(captures, series.light, series.values, series.valid)
    rates, predicted, used = follow_exposure(series)
    for band, name in enumerate(series.lights):
        if not used[series.light == band].any(axis=(0, 1)).all():
            raise InputFileError(f"band {name}: a channel has fewer than two exposures below saturation; give shorter ones")
    centres, photons = band_photons(captures, series)
    response, spread = respond(rates, photons)
    compared = [(series.values[..., c][used[..., c]], predicted[..., c][used[..., c]]) for c in range(len(body.channels))]
    band = COVERAGE * response * spread / np.sqrt(PATCHES)
    fit = SeriesFit(
        lights=series.lights,
        light=series.light,
        exposure=np.array([capture.exposure for capture in captures]),
        response=response / response.max(),
        spread=spread,
        linearity_error=linearity_errors(series, white_level - black_level),
        r_squared=np.array([1.0 - np.mean((m - p) ** 2) / m.var() for m, p in compared]),
        relative_rmse=np.array([np.sqrt(np.mean((m - p) ** 2)) / m.mean() for m, p in compared]),
        left_out=named(captures, series, body),
        used=used,
        measured=series.values,
        predicted=np.where(used, predicted, 0.0),
    )
    return Curves(centres, response.T, band.T).to_common_peak(), fit


def measure_series(
    captures: Sequence[BandCapture], darks: Sequence[Capture], body: Body, black_level: float, limit: float
) -> Series:
    """Return the patches of every capture, bands in the order of their centres."""
    names = list(dict.fromkeys(capture.illuminant for capture in captures))
    names.sort(key=lambda name: next(band_centre(capture) for capture in captures if capture.illuminant == name))
    dark = dark_levels([capture.exposure for capture in captures], darks, body, black_level)
    readings = [gain.patch_values(capture, body, limit, no_defects()) for capture in captures]
    return Series(
        lights=tuple(names),
        light=np.array([names.index(capture.illuminant) for capture in captures]),
        lit=np.array([capture.lit for capture in captures]),
        values=np.array([values for values, _ in readings]) - dark[:, None],
        valid=~np.array([saturated for _, saturated in readings]),
    )


def dark_levels(exposures: Sequence[float], darks: Sequence[Capture], body: Body, black_level: float) -> Array:
    """Return the DN (exposure, channel) in the dark, interpolated between lens-cap frames; without any, `black_level`."""
    if not darks:
        return np.full((len(exposures), len(body.channels)), black_level)
    known = np.array([capture.exposure for capture in darks])
    means = np.array([mean_value(count_values(capture, body, no_defects())) for capture in darks])
    order = np.argsort(known)
    return np.array([np.interp(exposures, known[order], column[order]) for column in means.T]).T


def follow_exposure(series: Series) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the signals as proportional to exposure: rates (light, patch, channel) DN/s from all unsaturated captures of a
    band; of every capture the value (capture, patch, channel) that the others of its band predict; and where there is
    one."""
    weight = series.lit[:, None, None] * series.valid
    products, squares = weight * series.values, weight * series.lit[:, None, None]
    same = series.light == np.arange(len(series.lights))[:, None]
    sums, norms = (np.tensordot(same, terms, 1) for terms in (products, squares))
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = sums / norms
        others = (sums[series.light] - products) / (norms[series.light] - squares)
    used = series.valid & (norms[series.light] - squares > 0)
    return rates, np.where(used, others * series.lit[:, None, None], 0.0), used


def band_centre(capture: BandCapture) -> float:
    """Return the centre of gravity in nm of what a filter lets through at half its peak or more."""
    return light_centre(capture.wavelength, capture.radiance.sum(axis=0))


def band_photons(captures: Sequence[BandCapture], series: Series) -> tuple[Array, Array]:
    """Return the centres (light) nm of the bands and the light of every patch (light, patch) in them, in the unit of the
    radiances."""
    first = [captures[int(np.argmax(series.light == band))] for band in range(len(series.lights))]
    photons = [capture.radiance @ spectra.bin_widths(capture.wavelength) for capture in first]
    return np.array([band_centre(capture) for capture in first]), np.array(photons)


def respond(rates: Array, photons: Array) -> tuple[Array, Array]:
    """(light, channel) mean over patches of rates (light, patch, channel) over photons (light, patch), and its relative
    spread over patches. What a patch gets more or less of all bands, each in its brightest channel, is uneven light, and
    taken out."""
    each = rates / photons[..., None]
    response = np.nanmean(each, axis=1)  # a patch may be saturated in every capture
    relative = each / response[:, None]
    brightest = np.take_along_axis(relative, response.argmax(axis=1)[:, None, None], axis=2)[..., 0]
    spread = np.nanstd(relative / np.nanmedian(brightest, axis=0)[:, None], axis=1, ddof=1)
    return response, spread


def linearity_errors(series: Series, span: float) -> Array:
    """(channel) mean over bands and patches of the deviation from a line, where three captures or more lie in 5–95 %."""
    low, high = (share * span for share in noise.LINEAR)
    errors: list[list[float]] = [[] for _ in range(series.values.shape[2])]
    chosen = series.valid & (series.values >= low) & (series.values <= high)
    for band in range(len(series.lights)):
        for patch, channel in np.ndindex(series.values.shape[1:]):
            usable = chosen[:, patch, channel] & (series.light == band)
            if usable.sum() > 2:
                errors[channel].append(noise.linearity_error(series.lit[usable], series.values[usable, patch, channel]))
    return np.array([np.mean(deviations) if deviations else 0.0 for deviations in errors])


def named(captures: Sequence[BandCapture], series: Series, body: Body) -> tuple[str, ...]:
    """Return the captures with saturated patches, and how many in which channel."""
    lines = []
    for capture, valid in zip(captures, series.valid, strict=True):
        counts = zip(body.channels, (~valid).sum(axis=0), strict=True)
        saturated = ", ".join(f"{count} in {channel}" for channel, count in counts if count)
        if saturated:
            lines.append(f"{capture.name}: patches saturated: {saturated}")
    return tuple(lines)
