"""The section of a camera model in a report.

It shows the colour filter array, the responsivities, the noise, and how well the model predicts the charts it was fitted to.
If the noise was measured, a data sheet follows EMVA 1288 release 4.0: operation point, values per channel, and the plots of
the standard (docs/measurement.md#data-sheet).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel, sensitivity_threshold
from l3cli.artifacts.fit import NoiseFit
from l3cli.physics.mosaic import array_rows
from l3cli.report import colours
from l3cli.report.drawing import CHARACTER_WIDTH, Plot, box, escape, sheet, spanning
from l3cli.report.parts import Block, Data, Details, Figure, Figures, Section, Subsection, Table, Text
from l3cli.report.validation import BANDS, photo_lead, photo_subsections, table_of, validation_blocks
from l3cli.system.text import counted, tidy, unit

CELL_HEIGHT, MAX_CELL_WIDTH = 44, 104  # px, height and maximum width of a filter in the drawing of the array
HEADROOM = 1.06  # top of the axis relative to the highest curve, so that there is space for labels
MAX_LABEL_CHARACTERS = 24  # characters; if all channel names together are longer, the curves get no labels
SATURATED_VARIANCE = (
    0.9  # a point with less than this fraction of the variance on the photon transfer line counts as saturated
)
Array = NDArray[np.floating]
LINEAR_RANGE = (0.05, 0.95)  # range of the linear fit, as a fraction of the saturation capacity
SNR_CURVE_START = 1e-3  # lower end of the SNR curve, as a fraction of the saturation capacity
MEANINGS = (
    "η: quantum efficiency including lens and filters, at the channel's peak. SNR max: square root of the saturation "
    "capacity. Threshold: the signal with a signal-to-noise ratio of 1. DR: saturation capacity divided by the threshold. "
    "DSNU and PRNU: standard deviations over pixels. LE: mean relative deviation from a line over 5–95 % of saturation. "
    "Photons are counted at the peak wavelength before the lens, per pixel and exposure. They are not listed if the "
    "responsivities are relative."
)


def camera_section(camera: CameraModel, figures: dict[str, Any], name: str) -> Section:
    """Build the section of a camera model.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    figures : dict
        The document that `l3 calibrate --json` prints for this camera. Its entry "shortfall" says why the model should not
        be trusted, and is empty or None otherwise.
    name : str
        Name of the file that contains the camera.

    Returns
    -------
    Section
        Sensor and array, responsivities, noise, data sheet if the noise was measured, and validation if the camera was
        fitted to charts.
    """
    parts = [
        Subsection("Sensor and colour filter array", (Figures((array_figure(camera),)), _facts(camera))),
        Subsection("Responsivities", (Figures(responsivity_figures(camera)),)),
        Subsection("Noise", _noise_blocks(camera, figures)),
    ]
    if camera.fit is not None and camera.fit.noise is not None:
        parts.append(data_sheet(camera, camera.fit.noise))
    if camera.fit is not None and camera.fit.photo is not None:
        parts[2:2] = photo_subsections(camera, camera.fit.photo, figures)
    if camera.fit is not None and (blocks := validation_blocks(camera, camera.fit, figures)):
        parts.append(Subsection("Validation", blocks))
    doubt = f" It falls short: {figures['shortfall']}." if figures["shortfall"] else ""
    return Section(f"Camera: {camera.name}", f"{_lead(camera, figures)}{doubt} From {name}.", tuple(parts))


def _lead(camera: CameraModel, figures: dict[str, Any]) -> str:
    """Summarize the camera in a few sentences."""
    rows, cols = camera.cfa.shape
    text = (
        f"{len(camera.channels)} channels in a {rows} × {cols} colour filter array on {camera.cols} × {camera.rows} pixels, "
        f"{camera.bits} bits."
    )
    if camera.fit is None:
        return text + " Described by a recipe, not measured."
    if camera.fit.photo is not None:
        return f"{text} {photo_lead(camera.fit.photo, figures)}"
    validation = camera.fit.validation
    if validation is None:
        return text
    worst = int(np.argmax(validation.relative_rmse))
    return (
        f"{text} Its values are predicted with a relative RMSE of {tidy(100 * float(validation.relative_rmse[worst]))} % "
        f"(R² {float(validation.r_squared[worst]):.5f}) in its worst channel, {camera.channels[worst]}.{drift_note(camera)}"
    )


def drift_note(camera: CameraModel) -> str:
    """Return a sentence about lamps that drifted more than declared, with a leading space, or an empty string."""
    if camera.fit is None or camera.fit.drift is None:
        return ""
    return (
        f" The charts disagree as if the lamps had drifted by {tidy(100 * camera.fit.drift.deviation, 2)} %. The confidence "
        "bands include this drift."
    )


# ---------------------------------------------------------------------------------------------------------- array


def array_figure(camera: CameraModel) -> Figure:
    """Draw one period of the colour filter array.

    Each site shows the colour of daylight through its channel, and the channel's name.
    """
    rows, cols = camera.cfa.shape
    light = colours.channel_light(camera)
    wide = float(np.clip(CHARACTER_WIDTH * max(map(len, camera.channels)) + 8, CELL_HEIGHT, MAX_CELL_WIDTH))
    fits = round((wide - 8) / CHARACTER_WIDTH)
    items = []
    for (row, col), channel in np.ndenumerate(camera.cfa):
        fill, ink = colours.hex_colour(light[channel]), colours.ink_on(light[channel])
        x, y = 1 + col * wide, 1 + row * CELL_HEIGHT
        items.append(box(x, y, wide, CELL_HEIGHT, fill, extra=' stroke="currentColor" stroke-width="1"'))
        label = camera.channels[channel]
        shown = label if len(label) <= fits else label[: fits - 1] + "…"
        items.append(
            f'<text x="{x + wide / 2:g}" y="{y + CELL_HEIGHT / 2 + 5:g}" text-anchor="middle" style="fill:{ink}" '
            f'data-on="{fill}">'
            f"{escape(shown)}</text>"
        )
    counts = np.bincount(camera.cfa.ravel(), minlength=len(camera.channels))
    shares = ", ".join(f"{name} on {count}" for name, count in zip(camera.channels, counts, strict=True))
    finding = f"Super-pixel of {rows} × {cols} sites: {shares}. Colours show daylight through each channel."
    svg = sheet(cols * wide + 2, rows * CELL_HEIGHT + 2, "".join(items), finding, fixed_size=True)
    sites = tuple((str(row), str(col), camera.channels[channel]) for (row, col), channel in np.ndenumerate(camera.cfa))
    return Figure("Colour filter array", svg, finding, narrow=True, data=Data(("row", "column", "channel"), sites))


def _facts(camera: CameraModel) -> Table:
    optics = camera.optics
    distance = f"{tidy(optics.object_distance)} m" if optics.object_distance > 0 else "infinity"
    rows = [
        ("Pixels", f"{camera.cols} × {camera.rows}"),
        ("Pixel pitch", f"{tidy(1e6 * camera.pixel_pitch)} µm"),
        ("Converter", f"{camera.bits} bit"),
        ("Black level, white level", f"{tidy(camera.black_level, 5)} DN, {tidy(camera.white_level, 5)} DN"),
        ("Lens", f"{tidy(1e3 * optics.focal_length)} mm f/{tidy(optics.f_number)}, focused at {distance}"),
        ("Responsivity", "absolute, e⁻/photon" if camera.absolute else "relative, largest value 1"),
    ]
    if camera.declared:
        rows.append((_declared_from(camera).capitalize(), ", ".join(camera.declared)))
    return Table("Sensor and lens", ("quantity", "value"), tuple(rows))


def _declared_from(camera: CameraModel) -> str:
    """State the origin of values that were not measured. In a model from photos, dark-frame values are 0."""
    return "not measured, taken as 0" if "dark current" in camera.declared else "taken from the data sheet"


# -------------------------------------------------------------------------------------------------- responsivities


def responsivity_figures(camera: CameraModel) -> tuple[Figure, ...]:
    """Plot the responsivity curves.

    If the curves have confidence bands, these are drawn around the curves, and a second figure shows their half widths.
    """
    label = "quantum efficiency (e⁻/photon)" if camera.absolute else "relative responsivity (1)"
    upper, measured = camera.responsivity + camera.responsivity_band, bool(camera.responsivity_band.any())
    plot = Plot(
        spanning("wavelength (nm)", camera.wavelength), spanning(label, [0.0, HEADROOM * float(upper.max())], zero=True)
    )
    peaks, keys = [], colours.channel_keys(camera)
    for key, curve, half in zip(keys, camera.responsivity, camera.responsivity_band, strict=True):
        peak = int(curve.argmax())
        if measured:
            plot.band(camera.wavelength, np.maximum(curve - half, 0), curve + half, key.colour)
        plot.line(camera.wavelength, curve, key.colour, key.mark, series=key.label)
        if sum(map(len, camera.channels)) <= MAX_LABEL_CHARACTERS:
            plot.label(float(camera.wavelength[peak]), float(curve[peak]), key.label)
        peaks.append(f"{key.label} {tidy(float(curve[peak]))} at {tidy(float(camera.wavelength[peak]), 4)} nm")
    curves = plot.figure("Responsivities", f"Peaks: {', '.join(peaks)}.", keys)
    return (curves, _band_figure(camera)) if measured else (curves,)


def _band_figure(camera: CameraModel) -> Figure:
    """Plot the half widths of the bands. In a good calibration, the bands are too narrow to see beside the curves."""
    shares = 100 * camera.responsivity_band / camera.responsivity.max(axis=1, keepdims=True)
    plot = Plot(spanning("wavelength (nm)", camera.wavelength), spanning("half width (% of peak)", shares, zero=True))
    keys = colours.channel_keys(camera)
    for key, share in zip(keys, shares, strict=True):
        plot.line(camera.wavelength, share, key.colour, key.mark, series=key.label)
    medians = ", ".join(f"{name} {tidy(float(np.median(s)), 2)} %" for name, s in zip(camera.channels, shares, strict=True))
    finding = (
        f"Half width of the 95 % band relative to the channel's peak, median over wavelengths: {medians}. "
        f"The maximum is {tidy(shares.max(), 2)} %."
    )
    return plot.figure("Confidence bands", finding, keys)


# ----------------------------------------------------------------------------------------------------------- noise


def _noise_blocks(camera: CameraModel, figures: dict[str, Any]) -> tuple[Block, ...]:
    rows = tuple(
        (name, f"{tidy(entry['value'], 5)} {unit(entry['unit'])}".strip()) for name, entry in figures["camera"].items()
    )
    declared = f"; {_declared_from(camera)}: {', '.join(camera.declared)}" if camera.declared else ""
    blocks: list[Block] = [Table(f"The camera in EMVA 1288 terms{declared}", ("quantity", "value"), rows)]
    rows_of_channels = figures["channels"].items()
    others = {name: {title: value for title, value in row.items() if title not in BANDS} for name, row in rows_of_channels}
    if any(others.values()):
        blocks.append(table_of("Figures of each channel", "channel", others))
    if figures["saturation reached"] is False:
        blocks.append(Text("No white frame saturates: the white level is assumed to be the largest value of the converter."))
    if figures["defects"]:
        shown = " ".join(f"({row}, {col})" for row, col in figures["defects"][:24])
        more = " …" if len(figures["defects"]) > 24 else ""
        blocks.append(Text(f"{len(figures['defects'])} hot and dead pixels (row, col) are left out: {shown}{more}"))
    if found := figures.get("defect map"):
        blocks.append(Text("Defect map: " + ", ".join(f"{what} {count}" for what, count in found.items())))
    if lost := figures.get("corner fall-off %"):
        shares = ", ".join(f"{name} {share:.3g} %" for name, share in lost.items())
        blocks.append(Text(f"Flat field, loss of light in the darkest corner: {shares}"))
    if figures["left out"] and not figures["photos"]:
        blocks.append(Details(f"{counted(len(figures['left out']), 'capture')} left out", "\n".join(figures["left out"])))
    return tuple(blocks)


def transfer_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Plot the photon transfer: temporal variance against mean signal, with lines whose slope is the system gain K."""
    mean, variance = noise.photon_transfer_mean, noise.photon_transfer_variance
    plot = Plot(
        spanning("mean signal above black (DN)", mean, zero=True), spanning("temporal variance (DN²)", variance, zero=True)
    )
    keys = colours.channel_keys(camera)
    for channel, key in enumerate(keys):
        gain = float(noise.conversion_gain[channel])
        dark = (gain * float(noise.read_noise[channel])) ** 2 + QUANTISATION
        end = float(mean[int(variance[:, channel].argmax()), channel])  # above this signal the channel saturates
        plot.line(np.array([0.0, end]), np.array([dark, dark + gain * end]), key.colour, key.mark, 1.2)
        plot.dots(mean[:, channel], variance[:, channel], key.colour, colours.MARKS[key.mark], series=key.label)
    gains = ", ".join(
        f"{name} {tidy(float(k), 4)} ± {tidy(float(e), 2)}"
        for name, k, e in zip(camera.channels, noise.conversion_gain, noise.conversion_gain_error, strict=True)
    )
    line = noise.conversion_gain * mean + (noise.conversion_gain * noise.read_noise) ** 2
    full = int((variance < SATURATED_VARIANCE * line).sum())
    finding = f"The slope is the system gain K in DN/e⁻: {gains}. Each line is K times the signal plus the dark variance."
    points = f"{counted(full, 'saturated point')} with less variance {'lies' if full == 1 else 'lie'} below the lines."
    return plot.figure("Photon transfer", f"{finding} {points}" if full else finding, keys)


def data_sheet(camera: CameraModel, noise: NoiseFit) -> Subsection:
    """Build the EMVA 1288 data sheet of a camera whose noise was measured: operation point, values per channel and plots."""
    plots = (transfer_figure, linearity_figure, deviation_figure, snr_figure)
    figures = Figures(tuple(plot(camera, noise) for plot in plots))
    blocks = (operation_point(camera, noise), figures_table(camera, noise), Text(MEANINGS), figures)
    return Subsection("EMVA 1288 data sheet", blocks)


def operation_point(camera: CameraModel, noise: NoiseFit) -> Table:
    """List the settings of the camera and the exposures at which it was measured."""
    first, last = float(noise.exposure.min()), float(noise.exposure.max())
    array = " / ".join(array_rows(camera.channels, camera.cfa))
    rows = (
        ("Camera", camera.name),
        ("Pixels", f"{camera.cols} × {camera.rows}, {tidy(1e6 * camera.pixel_pitch)} µm"),
        ("Colour filter array", array),
        ("Resolution of values", f"{camera.bits} bits"),
        ("Black and white level", f"{tidy(camera.black_level, 5)} and {tidy(camera.white_level, 5)} DN"),
        ("Exposures of white frames", f"{noise.exposure.size}, {tidy(1e3 * first)} to {tidy(1e3 * last)} ms"),
        (
            "Saturation",
            "reached" if noise.white_level_reached else "not reached; the converter's largest value is used",
        ),
        ("Lens", f"{tidy(1e3 * camera.optics.focal_length)} mm, f/{camera.optics.f_number:g}"),
    )
    return Table("Operation point", ("quantity", "value"), rows)


def figures_table(camera: CameraModel, noise: NoiseFit) -> Table:
    """List the quantities of EMVA 1288 in a table with one column per channel."""
    gain, capacity = noise.conversion_gain, noise.saturation_capacity
    least = sensitivity_threshold(noise.read_noise, gain)
    peak = camera.responsivity.argmax(axis=1)
    efficiency = camera.responsivity.max(axis=1)
    lines: list[tuple[str, Array]] = [("peak wavelength (nm)", camera.wavelength[peak])]
    if camera.absolute:
        lines += [("quantum efficiency η (%)", 100 * efficiency)]
    lines += [
        ("overall system gain K (DN/e⁻)", gain),
        ("± of K (DN/e⁻)", noise.conversion_gain_error),
        ("inverse gain 1/K (e⁻/DN)", 1 / gain),
        ("temporal dark noise (e⁻)", noise.read_noise),
        ("temporal dark noise (DN)", np.hypot(gain * noise.read_noise, np.sqrt(QUANTISATION))),
        ("SNR max (dB)", 10 * np.log10(capacity)),
        ("SNR max (bit)", np.log2(capacity) / 2),
        ("threshold (e⁻)", least),
        ("saturation capacity (e⁻)", capacity),
    ]
    if camera.absolute:
        lines += [("threshold (photons)", least / efficiency), ("saturation capacity (photons)", capacity / efficiency)]
    lines += [
        ("dynamic range DR (dB)", 20 * np.log10(capacity / least)),
        ("dynamic range DR (bit)", np.log2(capacity / least)),
        ("DSNU1288 (e⁻)", noise.dsnu),
        ("DSNU1288 (DN)", gain * noise.dsnu),
        ("PRNU1288 (%)", 100 * noise.prnu),
        ("linearity error LE (%)", 100 * noise.linearity_error),
        ("dark current (e⁻/s)", noise.dark_current),
    ]
    rows = tuple((name, *(tidy(float(value), 4) for value in values)) for name, values in lines)
    return Table("EMVA 1288 figures of each channel", ("quantity", *camera.channels), rows)


def _lit(camera: CameraModel, noise: NoiseFit, channel: int) -> tuple[Array, Array, Array]:
    """Fit the linear range of a channel.

    Returns
    -------
    exposure : ndarray, (exposure,)
        Exposure times in seconds, ascending.
    signal : ndarray, (exposure,)
        Mean signal above the dark signal, in DN.
    line : ndarray, (exposure,)
        Line fitted over LINEAR_RANGE with relative weights, in DN; NaN if fewer than two exposures are in that range.
    """
    gain = noise.conversion_gain[channel]
    order = np.argsort(noise.exposure, kind="stable")
    exposure, mean = noise.exposure[order], noise.photon_transfer_mean[order, channel]
    signal = mean - gain * noise.dark_current[channel] * exposure
    share = mean / (gain * noise.saturation_capacity[channel])
    chosen = (share >= LINEAR_RANGE[0]) & (share <= LINEAR_RANGE[1]) & (signal > 0)
    if chosen.sum() < 2:
        return exposure, signal, np.full(exposure.size, np.nan)
    return exposure, signal, np.polyval(np.polyfit(exposure[chosen], signal[chosen], 1, w=1 / signal[chosen]), exposure)


def linearity_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Plot the mean signal against the exposure time, with the fitted line."""
    every = [_lit(camera, noise, channel) for channel in range(len(camera.channels))]
    plot = Plot(
        spanning("exposure time (s)", noise.exposure, zero=True),
        spanning("mean signal above the dark (DN)", np.array([signal for _, signal, _ in every]), zero=True),
    )
    keys = colours.channel_keys(camera)
    for key, (exposure, signal, line) in zip(keys, every, strict=True):
        inside = np.isfinite(line) & (line <= 1.1 * signal.max())
        plot.line(exposure[inside], line[inside], key.colour, key.mark, 1.2)
        plot.dots(exposure, signal, key.colour, colours.MARKS[key.mark], series=key.label)
    return plot.figure("Linearity", "The lines minimize relative deviations over 5–95 % of saturation.", keys)


def deviation_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Plot the relative deviation of the signal from the fitted line against the signal."""
    keys, drawn = colours.channel_keys(camera), []
    for channel in range(len(keys)):
        _, signal, line = _lit(camera, noise, channel)
        share = signal / (noise.conversion_gain[channel] * noise.saturation_capacity[channel])
        inside = np.isfinite(line) & (share >= LINEAR_RANGE[0]) & (share <= LINEAR_RANGE[1])
        drawn.append((100 * share[inside], 100 * (signal[inside] / line[inside] - 1)))
    plot = Plot(
        spanning("mean signal (% of saturation)", np.concatenate([share for share, _ in drawn]), zero=True),
        spanning("deviation from the line (%)", np.concatenate([deviation for _, deviation in drawn])),
    )
    for key, (share, deviation) in zip(keys, drawn, strict=True):
        if share.size:
            plot.line(share, deviation, key.colour, key.mark, 1.2)
            plot.dots(share, deviation, key.colour, colours.MARKS[key.mark], series=key.label)
    errors = ", ".join(
        f"{name} {tidy(100 * float(error), 3)} %" for name, error in zip(camera.channels, noise.linearity_error, strict=True)
    )
    return plot.figure(
        "Deviation from linearity",
        f"LE: {errors}. LE is corrected for lamp drift if a monitor recorded it; the plot is not.",
        keys,
    )


def snr_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Plot the signal-to-noise ratio against the signal in electrons.

    Points are measured. Lines are computed from the read noise and gain of each channel. The dotted line is an ideal sensor
    with photon noise only.
    """
    most = float(noise.saturation_capacity.max())
    electrons = np.geomspace(most * SNR_CURVE_START, most, 60)
    plot = Plot(
        spanning("signal (e⁻)", electrons, log=True),
        spanning("signal over noise (1)", np.sqrt(electrons[[0, -1]]) * (0.3, 1.0), log=True),
    )
    plot.line(electrons, np.sqrt(electrons), "currentColor", "dotted", 1.2)
    keys = colours.channel_keys(camera)
    for channel, key in enumerate(keys):
        gain, dark = noise.conversion_gain[channel], noise.read_noise[channel]
        variance = electrons + dark**2 + QUANTISATION / gain**2
        plot.line(electrons, electrons / np.sqrt(variance), key.colour, key.mark, 1.2)
        mean, measured = noise.photon_transfer_mean[:, channel], noise.photon_transfer_variance[:, channel]
        inside = (mean > 0) & (measured > 0) & (mean < LINEAR_RANGE[1] * gain * noise.saturation_capacity[channel])
        snr = mean[inside] / np.sqrt(measured[inside])
        plot.dots(mean[inside] / gain, snr, key.colour, colours.MARKS[key.mark], series=key.label)
    best = ", ".join(
        f"{name} {tidy(10 * np.log10(float(capacity)), 3)} dB"
        for name, capacity in zip(camera.channels, noise.saturation_capacity, strict=True)
    )
    finding = f"SNR max: {best}. Temporal noise only. Dotted: an ideal sensor with photon noise only."
    return plot.figure("Signal over noise", finding, keys)
