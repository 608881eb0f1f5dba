"""Figures of EMVA 1288, release 4.0, about nonuniformity: spectrograms, profiles and logarithmic histograms."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.fit import NoiseFit, Nonuniformity
from l3cli.report.drawing import DASHES, Plot, spanning
from l3cli.report.parts import Figure, Key
from l3cli.system.text import counted, tidy

STATISTICS = ("mean", "minimum", "maximum", "middle line")  # order of the profiles in Nonuniformity
LOWEST_COUNT = 0.5  # lower end of the axes for numbers of pixels; bins without pixels are below the axis
LEAST_EXPECTED = 0.05  # smallest expected number of pixels per bin for which the normal distribution is drawn
Array = NDArray[np.floating]


def nonuniformity_figures(noise: NoiseFit) -> tuple[Figure, ...]:
    """Draw the DSNU and PRNU figures for which data were measured."""
    parts = (("DSNU", "e⁻", 1.0, noise.dark_pattern), ("PRNU", "%", 100.0, noise.response_pattern))
    return tuple(
        figure
        for name, unit, scale, found in parts
        if found is not None
        for figure in (
            spectrogram(name, unit, scale, found),
            *profiles(name, unit, scale, found),
            histogram(name, unit, scale, found),
            accumulated(name, unit, scale, found),
        )
    )


def rounded(values: Array) -> Array:
    """Round values to four significant digits, so that the data of the figures are not many times larger than the page."""
    return np.array([float(f"{value:.4g}") for value in values])


def spectrogram(name: str, unit: str, scale: float, found: Nonuniformity) -> Figure:
    """Plot the square root of the power spectra along rows and along columns."""
    spectra = {"horizontal": scale * found.horizontal_spectrum, "vertical": scale * found.vertical_spectrum}
    highest = max(float(each.max()) for each in spectra.values()) or 1.0
    lowest = min((float(each[each > 0].min()) for each in spectra.values() if each.any()), default=highest / 10)
    plot = Plot(
        spanning("spatial frequency (cycles/pixel)", [0.0, 0.5], zero=True),
        spanning(f"{name} per frequency ({unit})", [min(lowest, highest / 2), highest], log=True),
    )
    series = {kind: (rounded(found.frequency), rounded(each)) for kind, each in spectra.items()}
    keys = plot.curves(series, size=0)
    peaks = ", ".join(
        f"{kind} {tidy(float(each.max()), 3)} {unit} at {tidy(float(found.frequency[each.argmax()]), 3)} cycles/pixel"
        for kind, each in spectra.items()
    )
    finding = (
        f"Largest values: {peaks}. White noise has its standard deviation at every frequency. Temporal noise is subtracted."
    )
    return plot.figure(f"{name} spectrograms", finding, keys)


def profiles(name: str, unit: str, scale: float, found: Nonuniformity) -> tuple[Figure, Figure]:
    """Plot the horizontal and the vertical profile: mean, minimum, maximum and middle line of the columns and rows."""
    return tuple(  # type: ignore[return-value]
        _profile(f"{name} {kind} profile", label, f"{name} ({unit})", position, scale * values)
        for kind, label, position, values in (
            ("horizontal", "column (pixel)", found.column, found.horizontal_profile),
            ("vertical", "row (pixel)", found.row, found.vertical_profile),
        )
    )


def _profile(title: str, position_label: str, label: str, position: Array, values: Array) -> Figure:
    plot = Plot(spanning(position_label, position, zero=True), spanning(label, values))
    series = {name: (position, rounded(each)) for name, each in zip(STATISTICS, values, strict=True)}
    keys = plot.curves(series, size=0, width=1.2)
    finding = (
        f"Range of the means: {tidy(float(values[0].min()), 3)} to {tidy(float(values[0].max()), 3)}. The minima and maxima "
        "include temporal noise that remains in the mean frame, and defects."
    )
    return plot.figure(title[0].upper() + title[1:], finding, keys)


def histogram(name: str, unit: str, scale: float, found: Nonuniformity) -> Figure:
    """Plot the logarithmic histogram, and the normal distribution with the same standard deviation."""
    filled = np.flatnonzero(found.histogram_count)
    edges = scale * found.histogram_edge[filled[0] : filled[-1] + 2]
    counts = found.histogram_count[filled[0] : filled[-1] + 1].astype(np.float64)
    spread, width = scale * found.spread, edges[1] - edges[0]
    middle = (edges[1:] + edges[:-1]) / 2
    expected = counts.sum() * width / (spread * np.sqrt(2 * np.pi)) * np.exp(-0.5 * (middle / spread) ** 2)
    plot = Plot(
        spanning(f"{name} deviation ({unit})", edges), spanning("pixels per bin", [LOWEST_COUNT, counts.max()], log=True)
    )
    plot.steps(rounded(edges), counts, "var(--one)", series="measured")
    drawn = expected >= LEAST_EXPECTED
    plot.line(rounded(middle[drawn]), rounded(expected[drawn]), "var(--two)", "dashed", 1.2, series="normal distribution")
    keys = (Key("measured", "var(--one)", "line"), Key("normal distribution", "var(--two)", "dashed"))
    return plot.figure(f"{name} logarithmic histogram", _spread_text(spread, unit), keys)


def accumulated(name: str, unit: str, scale: float, found: Nonuniformity) -> Figure:
    """Plot the percentage of pixels with an absolute deviation above a threshold, against the threshold."""
    threshold, pixels = scale * found.threshold, float(found.histogram_count.sum())
    share = 100 * found.exceeding / pixels
    plot = Plot(
        spanning(f"absolute {name} deviation ({unit})", threshold, log=True),
        spanning("pixels with at least this deviation (%)", [100 * LOWEST_COUNT / pixels, 100.0], log=True),
    )
    plot.line(rounded(threshold), rounded(share), "var(--one)", next(iter(DASHES)), series="measured")
    far = counted(int(np.interp(6 * found.spread, found.threshold, found.exceeding, right=0)), "pixel")
    finding = f"About {far} beyond 6 standard deviations ({tidy(6 * scale * found.spread, 3)} {unit})."
    return plot.figure(f"{name} accumulated logarithmic histogram", finding)


def _spread_text(spread: float, unit: str) -> str:
    return (
        f"Standard deviation without hot and dead pixels, including temporal noise that remains in the mean frame: "
        f"{tidy(spread, 3)} {unit}."
    )
