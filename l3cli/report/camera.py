"""The section of a report about a camera model.

The section shows the colour filter array, the responsivities and the noise. If the model was fitted to charts, the section
also shows how accurately it predicts their signals. If the noise was measured, the section contains an EMVA 1288 data sheet,
release 4.0, with the operation point, the values of each channel and the plots (docs/measurement.md#data-sheet).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import QUANTISATION, CameraModel, sensitivity_threshold
from l3cli.artifacts.fit import NoiseFit, PolariserFit
from l3cli.physics.mosaic import array_rows
from l3cli.physics.stokes import malus
from l3cli.report import colours
from l3cli.report.drawing import CHARACTER_WIDTH, Plot, box, escape, sheet, spanning
from l3cli.report.nonuniformity import nonuniformity_figures
from l3cli.report.parts import Block, Data, Details, Figure, Figures, Section, Subsection, Table, Text
from l3cli.report.validation import BANDS, photo_lead, photo_subsections, table_of, validation_blocks
from l3cli.system.text import counted, tidy, unit

CELL_HEIGHT, MAX_CELL_WIDTH = 44, 104  # height and maximum width of a site in the drawing of the CFA, in px
HEADROOM = 1.06  # upper end of an axis, divided by the maximum of the curves, to leave room for labels
MAX_LABEL_CHARACTERS = 24  # curves are labelled if all channel names together are not longer than this
# Fraction of the fitted variance below which a point of the photon transfer curve counts as saturated.
SATURATED_VARIANCE = 0.9
Array = NDArray[np.floating]
LINEAR_RANGE = (0.05, 0.95)  # range of the linear fit, as a fraction of the saturation capacity
SNR_CURVE_START = 1e-3  # lower end of the SNR curve, as a fraction of the saturation capacity
MEANINGS = (
    "η is the quantum efficiency at the peak wavelength of the channel, including lens and filters. SNR max is the square "
    "root of the saturation capacity. The threshold is the signal with a signal-to-noise ratio of 1. DR is the saturation "
    "capacity divided by the threshold. DSNU and PRNU are standard deviations over the pixels. Both consist of a part that "
    "all pixels of a row have in common (.row), a part that all pixels of a column have in common (.col), and the part of "
    "the individual pixels (.pix). The parts of rows and columns apply to the whole sensor. They are 0 if they are not "
    "significant. LE is the mean relative deviation from a line that is fitted between 5 % and 95 % of saturation. Photons "
    "are counted per pixel and exposure, at the peak wavelength, before the lens. Photons are not listed if the "
    "responsivities are relative."
)
MISSING = (
    "EMVA 1288, release 4.0, also defines results that this data sheet does not contain. The dark current as a function of "
    "temperature, and its doubling temperature, would require captures at several sensor temperatures. The spectrograms, "
    "profiles and histograms are computed from the mean dark frame at zero exposure time and from the response of each "
    "pixel, not from frames at one exposure time. They apply to all channels together."
)
MISSING_PATTERNS = " Spectrograms, profiles and histograms of the nonuniformity are not part of this camera model."
MISSING_PHOTONS = (
    " The quantum efficiency, and the threshold and the saturation capacity in photons, would require captures of charts or "
    "of monochromatic light with known radiance."
)


def camera_section(camera: CameraModel, figures: dict[str, Any], name: str) -> Section:
    """Build the section about a camera model.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    figures : dict
        Output of `l3 calibrate --json` for this camera, and the key "shortfall": why the model is unreliable, or "".
    name : str
        File name of the camera model.

    Returns
    -------
    Section
        Subsections about the sensor, the responsivities and the noise, followed by the data sheet, the polarisers and the
        validation if they were measured. Subsections about photos come before the noise.
    """
    parts = [
        Subsection("Sensor and colour filter array", (Figures((array_figure(camera),)), _facts(camera))),
        Subsection("Responsivities", (Figures(responsivity_figures(camera)),)),
        Subsection("Noise", _noise_blocks(camera, figures)),
    ]
    if camera.fit is not None and camera.fit.noise is not None:
        parts.append(data_sheet(camera, camera.fit.noise))
    if camera.fit is not None and camera.fit.polarisers is not None:
        parts.append(Subsection("Polarisers", (Figures((polariser_figure(camera, camera.fit.polarisers),)),)))
    if camera.fit is not None and camera.fit.photo is not None:
        parts[2:2] = photo_subsections(camera, camera.fit.photo, figures)
    if camera.fit is not None and (blocks := validation_blocks(camera, camera.fit, figures)):
        parts.append(Subsection("Validation", blocks))
    doubt = f" The model is not reliable: {figures['shortfall']}." if figures["shortfall"] else ""
    return Section(f"Camera: {camera.name}", f"{_lead(camera, figures)}{doubt} From {name}.", tuple(parts))


def _lead(camera: CameraModel, figures: dict[str, Any]) -> str:
    """Summarise the sensor and the quality of its calibration in a few sentences."""
    rows, cols = camera.cfa.shape
    text = (
        f"{len(camera.channels)} channels in a {rows} × {cols} colour filter array on {camera.cols} × {camera.rows} pixels, "
        f"{camera.bits} bits."
    )
    if camera.fit is None:
        return text + " The camera was not measured. A recipe describes it."
    if camera.fit.photo is not None:
        return f"{text} {photo_lead(camera.fit.photo, figures)}"
    validation = camera.fit.validation
    if validation is None:
        return text
    worst = int(np.argmax(validation.relative_rmse))
    return (
        f"{text} The model predicts the measured values with a relative RMSE of "
        f"{tidy(100 * float(validation.relative_rmse[worst]))} % (R² {float(validation.r_squared[worst]):.5f}) in its worst "
        f"channel, {camera.channels[worst]}.{drift_note(camera)}"
    )


def drift_note(camera: CameraModel) -> str:
    """Return a sentence about unexpected lamp drift, with a leading space, or "" if there was no drift."""
    if camera.fit is None or camera.fit.drift is None:
        return ""
    return (
        f" The measurements of the charts contradict each other. A lamp drift of "
        f"{tidy(100 * camera.fit.drift.deviation, 2)} % would explain this. The confidence bands include the drift."
    )


def polariser_figure(camera: CameraModel, fit: PolariserFit) -> Figure:
    """Plot the signals behind a rotating polariser, with fitted curves of Malus's law.

    Each capture is divided by the brightness of its light, so that one curve per channel fits all captures.
    """
    law = fit.gain, fit.angle, fit.leakage, fit.light_polarisation
    light = np.linspace(0.0, 180.0, 181)
    curves, bright = malus(light, *law), fit.brightness[:, None]
    largest = curves.max()
    # The signal, in DN/s, for which `malus` returns 1.
    unit_signal = (fit.predicted / bright).sum() / malus(fit.light_angle, *law).sum()
    curves, signal = curves / largest, fit.measured / bright / unit_signal / largest
    plot = Plot(
        spanning("angle of the rotating polariser (°)", light),
        spanning("signal relative to the maximum (1)", np.array([0.0, HEADROOM]), zero=True),
    )
    keys = colours.channel_keys(camera)
    for channel, key in enumerate(keys):
        used = fit.used[:, channel]
        plot.line(light, curves[:, channel], key.colour, key.mark, 1.2)
        angle = fit.light_angle[used] % 180.0
        plot.dots(angle, signal[used, channel], key.colour, colours.MARKS[key.mark], series=key.label)
    found = zip(camera.channels, fit.angle, fit.angle_error, fit.leakage, fit.leakage_error, fit.polarised, strict=True)
    results = ", ".join(
        f"{name} {angle:.2f}° ± {error:.2f}°, extinction ratio {tidy(1 / max(leakage, leakage_error), 3)}"
        for name, angle, error, leakage, leakage_error, polarised in found
        if polarised
    )
    residual = float(np.abs(fit.measured - fit.predicted)[fit.used].max() / fit.predicted.max())
    finding = f"Angles with standard deviations: {results}. Largest residual: {tidy(100 * residual, 2)} % of the maximum."
    return plot.figure("Signals behind a rotating polariser", finding, keys)


# ---------------------------------------------------------------------------------------------------------- array


def array_figure(camera: CameraModel) -> Figure:
    """Draw one period of the colour filter array. Sites have the colour of daylight behind their filter."""
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
    sites_of = ", ".join(f"{name} {count}" for name, count in zip(camera.channels, counts, strict=True))
    finding = (
        f"Super-pixel of {rows} × {cols} sites. Sites per channel: {sites_of}. Each colour is that of daylight behind the "
        "filter."
    )
    svg = sheet(cols * wide + 2, rows * CELL_HEIGHT + 2, "".join(items), finding, fixed_size=True)
    sites = tuple((str(row), str(col), camera.channels[channel]) for (row, col), channel in np.ndenumerate(camera.cfa))
    return Figure("Colour filter array", svg, finding, narrow=True, data=Data(("row", "column", "channel"), sites))


def _facts(camera: CameraModel) -> Table:
    optics = camera.optics
    distance = f"{tidy(optics.object_distance)} m" if optics.object_distance > 0 else "infinity"
    rows = [
        ("Pixels", f"{camera.cols} × {camera.rows}"),
        ("Pixel pitch", f"{tidy(1e6 * camera.pixel_pitch)} µm"),
        ("Bit depth of raw values", f"{camera.bits} bit"),
        ("Black level, white level", f"{tidy(camera.black_level, 5)} DN, {tidy(camera.white_level, 5)} DN"),
        ("Lens", f"{tidy(1e3 * optics.focal_length)} mm f/{tidy(optics.f_number)}, focused at {distance}"),
        ("Responsivity", "absolute, e⁻/photon" if camera.absolute else "relative, largest value 1"),
    ]
    if camera.declared:
        rows.append((_declared_from(camera).capitalize(), ", ".join(camera.declared)))
    return Table("Sensor and lens", ("quantity", "value"), tuple(rows))


def _declared_from(camera: CameraModel) -> str:
    """Describe the origin of values that were not measured: the data sheet, or the assumption 0 without dark frames."""
    return "not measured, assumed to be 0" if "dark current" in camera.declared else "from the data sheet"


# -------------------------------------------------------------------------------------------------- responsivities


def responsivity_figures(camera: CameraModel) -> tuple[Figure, ...]:
    """Plot the channels' responsivities. If confidence bands are known, add them, and plot their half widths separately."""
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
    """Plot the half widths of the confidence bands, which can be too narrow to be visible around the curves."""
    shares = 100 * camera.responsivity_band / camera.responsivity.max(axis=1, keepdims=True)
    plot = Plot(spanning("wavelength (nm)", camera.wavelength), spanning("half width (% of peak)", shares, zero=True))
    keys = colours.channel_keys(camera)
    for key, share in zip(keys, shares, strict=True):
        plot.line(camera.wavelength, share, key.colour, key.mark, series=key.label)
    medians = ", ".join(f"{name} {tidy(float(np.median(s)), 2)} %" for name, s in zip(camera.channels, shares, strict=True))
    finding = (
        f"Half width of the 95 % band as a percentage of the channel's peak, median over wavelengths: {medians}. "
        f"The maximum is {tidy(shares.max(), 2)} %."
    )
    return plot.figure("Confidence bands", finding, keys)


# ----------------------------------------------------------------------------------------------------------- noise


def _noise_blocks(camera: CameraModel, figures: dict[str, Any]) -> tuple[Block, ...]:
    rows = tuple(
        (name, f"{tidy(entry['value'], 5)} {unit(entry['unit'])}".strip()) for name, entry in figures["camera"].items()
    )
    declared = f"; {_declared_from(camera)}: {', '.join(camera.declared)}" if camera.declared else ""
    blocks: list[Block] = [Table(f"Camera parameters as defined in EMVA 1288{declared}", ("quantity", "value"), rows)]
    rows_of_channels = figures["channels"].items()
    others = {name: {title: value for title, value in row.items() if title not in BANDS} for name, row in rows_of_channels}
    if any(others.values()):
        blocks.append(table_of("Values per channel", "channel", others))
    if figures["saturation reached"] is False:
        blocks.append(Text("No white frame saturates. The white level is assumed to be the largest possible raw value."))
    if figures["defects"]:
        shown = " ".join(f"({row}, {col})" for row, col in figures["defects"][:24])
        more = " …" if len(figures["defects"]) > 24 else ""
        blocks.append(Text(f"Hot and dead pixels (row, col) that were ignored: {len(figures['defects'])}. {shown}{more}"))
    if found := figures.get("defect map"):
        blocks.append(Text("Pixels in the defect map: " + ", ".join(f"{what} {count}" for what, count in found.items())))
    if lost := figures.get("corner fall-off %"):
        shares = ", ".join(f"{name} {share:.3g} %" for name, share in lost.items())
        blocks.append(Text(f"Loss of light in the darkest corner of the flat field: {shares}"))
    if figures["left out"] and not figures["photos"]:
        unused = counted(len(figures["left out"]), "capture")
        blocks.append(Details(f"{unused} not used for the calibration", "\n".join(figures["left out"])))
    return tuple(blocks)


def transfer_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Plot the temporal variance against the mean signal (photon transfer). The slope of each line is the system gain."""
    mean, variance = noise.photon_transfer_mean, noise.photon_transfer_variance
    plot = Plot(
        spanning("mean signal above black (DN)", mean, zero=True), spanning("temporal variance (DN²)", variance, zero=True)
    )
    keys = colours.channel_keys(camera)
    for channel, key in enumerate(keys):
        gain = float(noise.conversion_gain[channel])
        dark = (gain * float(noise.read_noise[channel])) ** 2 + QUANTISATION
        end = float(mean[int(variance[:, channel].argmax()), channel])  # signal at which the channel starts to saturate
        plot.line(np.array([0.0, end]), np.array([dark, dark + gain * end]), key.colour, key.mark, 1.2)
        plot.dots(mean[:, channel], variance[:, channel], key.colour, colours.MARKS[key.mark], series=key.label)
    gains = ", ".join(
        f"{name} {tidy(float(k), 4)} ± {tidy(float(e), 2)}"
        for name, k, e in zip(camera.channels, noise.conversion_gain, noise.conversion_gain_error, strict=True)
    )
    line = noise.conversion_gain * mean + (noise.conversion_gain * noise.read_noise) ** 2
    full = int((variance < SATURATED_VARIANCE * line).sum())
    finding = f"System gain K in DN/e⁻: {gains}. Each line is K times the signal plus the dark variance."
    points = f"Below the lines: {counted(full, 'saturated point')}."
    return plot.figure("Photon transfer", f"{finding} {points}" if full else finding, keys)


def data_sheet(camera: CameraModel, noise: NoiseFit) -> Subsection:
    """Build the EMVA 1288 data sheet: the operation point, the values of each channel, and the plots."""
    plots = (transfer_figure, linearity_figure, deviation_figure, snr_figure)
    figures = Figures((*(plot(camera, noise) for plot in plots), *nonuniformity_figures(noise)))
    patterns = "" if noise.dark_pattern and noise.response_pattern else MISSING_PATTERNS
    missing = Text(MISSING + patterns + ("" if camera.absolute else MISSING_PHOTONS))
    blocks = (operation_point(camera, noise), figures_table(camera, noise), Text(MEANINGS), missing, figures)
    return Subsection("EMVA 1288 data sheet", blocks)


def operation_point(camera: CameraModel, noise: NoiseFit) -> Table:
    """List the camera settings and the exposure times of the white frames."""
    first, last = float(noise.exposure.min()), float(noise.exposure.max())
    array = " / ".join(array_rows(camera.channels, camera.cfa))
    rows = (
        ("Camera", camera.name),
        ("Pixels", f"{camera.cols} × {camera.rows}, {tidy(1e6 * camera.pixel_pitch)} µm"),
        ("Colour filter array", array),
        ("Bit depth of raw values", f"{camera.bits} bits"),
        ("Black and white level", f"{tidy(camera.black_level, 5)} and {tidy(camera.white_level, 5)} DN"),
        ("Exposure times of white frames", f"{noise.exposure.size}, from {tidy(1e3 * first)} to {tidy(1e3 * last)} ms"),
        (
            "Saturation",
            "reached" if noise.white_level_reached else "not reached; the largest possible raw value is assumed",
        ),
        ("Lens", f"{tidy(1e3 * camera.optics.focal_length)} mm, f/{camera.optics.f_number:g}"),
        *_blinking_rows(camera, noise),
    )
    return Table("Operation point", ("quantity", "value"), rows)


def _blinking_rows(camera: CameraModel, noise: NoiseFit) -> list[tuple[str, str]]:
    """Return a table row with the number of blinking pixels, if it was measured."""
    if not noise.blinking_frames:
        return []
    count = 0 if noise.blinking is None else len(noise.blinking)
    text = f"{count} ({tidy(1e6 * count / (camera.rows * camera.cols))} per million) in {noise.blinking_frames} dark frames"
    if noise.blinking_step is not None:
        text += f", median step {tidy(float(np.median(noise.blinking_step)))} e⁻"
    return [("Blinking pixels", text)]


def figures_table(camera: CameraModel, noise: NoiseFit) -> Table:
    """Tabulate the EMVA 1288 quantities, with one column per channel."""
    gain, capacity = noise.conversion_gain, noise.saturation_capacity
    least = sensitivity_threshold(noise.read_noise, gain)
    peak = camera.responsivity.argmax(axis=1)
    efficiency = camera.responsivity.max(axis=1)
    lines: list[tuple[str, Array]] = [("peak wavelength (nm)", camera.wavelength[peak])]
    if camera.absolute:
        lines += [("quantum efficiency η (%)", 100 * efficiency)]
    lines += [
        ("overall system gain K (DN/e⁻)", gain),
        ("standard error of K (DN/e⁻)", noise.conversion_gain_error),
        ("inverse gain 1/K (e⁻/DN)", 1 / gain),
        ("temporal dark noise (e⁻)", noise.read_noise),
        ("temporal dark noise (DN)", np.hypot(gain * noise.read_noise, np.sqrt(QUANTISATION))),
        *_line_noise_rows(noise),
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
        *_nonuniformity_rows(noise),
        ("linearity error LE (%)", 100 * noise.linearity_error),
        ("dark current from the mean (e⁻/s)", noise.dark_current),
    ]
    if noise.dark_current_variance is not None and noise.dark_current_variance_error is not None:
        lines += [
            ("dark current from the variance (e⁻/s)", noise.dark_current_variance),
            ("standard error of the dark current from the variance (e⁻/s)", noise.dark_current_variance_error),
        ]
    rows = tuple((name, *(tidy(float(value), 4) for value in values)) for name, values in lines)
    return Table("EMVA 1288 values per channel", ("quantity", *camera.channels), rows)


def _line_noise_rows(noise: NoiseFit) -> list[tuple[str, Array]]:
    """Return table rows for significant temporal row and column noise, with the same value in the column of each channel."""
    found = {
        "row": (noise.row_temporal_noise, noise.row_temporal_noise_error),
        "column": (noise.column_temporal_noise, noise.column_temporal_noise_error),
    }
    every = np.ones_like(noise.read_noise)
    return [
        (f"{line} temporal noise{what} (e⁻)", every * value)
        for line, (deviation, error) in found.items()
        if deviation
        for what, value in (("", deviation), (", standard error", error))
    ]


def _nonuniformity_rows(noise: NoiseFit) -> list[tuple[str, Array]]:
    """Return table rows for the total DSNU and PRNU, and for their row, column and pixel parts.

    If a standard error is known, it follows in a separate row. The row and column parts are the same for all channels.
    """
    every = np.ones_like(noise.dsnu)
    unknown = np.zeros_like(noise.dsnu)
    dsnu_error = unknown if noise.dsnu_error is None else noise.dsnu_error
    prnu_error = unknown if noise.prnu_error is None else noise.prnu_error
    dsnu_lines = ((every * noise.row_noise, noise.row_noise_error), (every * noise.column_noise, noise.column_noise_error))
    prnu_lines = ((every * noise.row_prnu, noise.row_prnu_error), (every * noise.column_prnu, noise.column_prnu_error))
    dsnu: tuple[tuple[Array, Any], ...] = (
        total_dsnu(noise),
        *dsnu_lines,
        (noise.dsnu, dsnu_error),
    )
    prnu: tuple[tuple[Array, Any], ...] = (
        (noise.prnu, prnu_error),
        *prnu_lines,
        noise.pixel_prnu,
    )
    rows: list[tuple[str, Array]] = []
    for name, in_unit, scale, values in (("DSNU1288", "e⁻", 1.0, dsnu), ("PRNU1288", "%", 100.0, prnu)):
        for part, (deviation, error) in zip(("", ".row", ".col", ".pix"), values, strict=True):
            rows.append((f"{name}{part} ({in_unit})", scale * deviation))
            if np.any(error):
                rows.append((f"standard error of {name}{part} ({in_unit})", scale * error * every))
        if in_unit == "e⁻":
            rows.append((f"{name} (DN)", noise.conversion_gain * values[0][0]))
    return rows


def total_dsnu(noise: NoiseFit) -> tuple[Array, Array]:
    """Return DSNU1288 of each channel in e-, including row and column deviations, and its standard error."""
    error = np.zeros_like(noise.dsnu) if noise.dsnu_error is None else noise.dsnu_error
    variance, square = noise.dsnu**2, (noise.dsnu * error) ** 2
    for line, uncertainty in ((noise.row_noise, noise.row_noise_error), (noise.column_noise, noise.column_noise_error)):
        variance, square = variance + line**2, square + (line * uncertainty) ** 2
    deviation = np.sqrt(variance)
    return deviation, np.sqrt(square) / np.where(deviation > 0, deviation, 1.0)


def _lit(camera: CameraModel, noise: NoiseFit, channel: int) -> tuple[Array, Array, Array]:
    """Fit a straight line to a channel's signal as a function of exposure time.

    Returns
    -------
    exposure : ndarray, (exposure,)
        Exposure times in s, in increasing order.
    signal : ndarray, (exposure,)
        Mean signal above the dark signal, in DN.
    line : ndarray, (exposure,)
        Fitted line in DN. The fit minimises relative deviations within LINEAR_RANGE. NaN if fewer than two signals are
        within this range.
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
        spanning("mean signal above dark signal (DN)", np.array([signal for _, signal, _ in every]), zero=True),
    )
    keys = colours.channel_keys(camera)
    for key, (exposure, signal, line) in zip(keys, every, strict=True):
        inside = np.isfinite(line) & (line <= 1.1 * signal.max())
        plot.line(exposure[inside], line[inside], key.colour, key.mark, 1.2)
        plot.dots(exposure, signal, key.colour, colours.MARKS[key.mark], series=key.label)
    finding = "The lines minimise the relative deviations between 5 % and 95 % of saturation."
    return plot.figure("Linearity", finding, keys)


def deviation_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Plot the relative deviation of the mean signal from the fitted line, against the signal."""
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
        f"LE: {errors}. If a monitor recorded the lamp, LE is corrected for its drift. The plot is not corrected.",
        keys,
    )


def snr_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Plot the temporal and the total signal-to-noise ratio against the signal in electrons.

    The points are measured. The thick lines are computed from the read noise and the gain of each channel. The thin lines
    also contain DSNU and PRNU. The dotted line shows an ideal sensor with photon noise only.
    """
    most = float(noise.saturation_capacity.max())
    electrons = np.geomspace(most * SNR_CURVE_START, most, 60)
    plot = Plot(
        spanning("signal (e⁻)", electrons, log=True),
        spanning("signal-to-noise ratio (1)", np.sqrt(electrons[[0, -1]]) * (0.3, 1.0), log=True),
    )
    plot.line(electrons, np.sqrt(electrons), "currentColor", "dotted", 1.2)
    keys, dsnu = colours.channel_keys(camera), total_dsnu(noise)[0]
    for channel, key in enumerate(keys):
        gain, dark = noise.conversion_gain[channel], noise.read_noise[channel]
        variance = electrons + dark**2 + QUANTISATION / gain**2
        plot.line(electrons, electrons / np.sqrt(variance), key.colour, key.mark, 1.6)
        fixed = dsnu[channel] ** 2 + (noise.prnu[channel] * electrons) ** 2
        total = electrons / np.sqrt(variance + fixed)
        plot.line(electrons, total, key.colour, key.mark, 0.7, series=f"{key.label}, total")
        mean, measured = noise.photon_transfer_mean[:, channel], noise.photon_transfer_variance[:, channel]
        inside = (mean > 0) & (measured > 0) & (mean < LINEAR_RANGE[1] * gain * noise.saturation_capacity[channel])
        snr = mean[inside] / np.sqrt(measured[inside])
        plot.dots(mean[inside] / gain, snr, key.colour, colours.MARKS[key.mark], series=key.label)
    best = ", ".join(
        f"{name} {tidy(10 * np.log10(float(capacity)), 3)} dB"
        for name, capacity in zip(camera.channels, noise.saturation_capacity, strict=True)
    )
    finding = (
        f"SNR max: {best}. Points and thick lines contain temporal noise. Thin lines also contain DSNU and PRNU (total "
        "SNR). The dotted line shows an ideal sensor with photon noise only."
    )
    return plot.figure("Signal-to-noise ratio", finding, keys)
