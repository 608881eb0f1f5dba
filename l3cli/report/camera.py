"""A camera model as a section: its array, responsivities, noise, and how well it predicts its charts."""

from typing import Any

import numpy as np

from l3cli.artifacts.camera import QUANTISATION, CameraModel
from l3cli.artifacts.fit import NoiseFit
from l3cli.report import colours
from l3cli.report.drawing import GLYPH, Plot, box, escape, sheet, spanning
from l3cli.report.parts import Block, Data, Details, Figure, Figures, Section, Subsection, Table, Text
from l3cli.report.validation import BANDS, photo_lead, photo_subsections, table_of, validation_blocks
from l3cli.system.text import counted, tidy, unit

CELL, WIDEST = 44, 104  # px, of a filter in the drawing of the array
HEADROOM = 1.06  # above the curves, for their names
LABELLED = 24  # letters of all channels' names that find room above the curves
NEARLY = 0.9  # of the variance that a line of photon transfer has: points below are saturated


def camera_section(camera: CameraModel, figures: dict[str, Any], name: str) -> Section:
    """Return the section of a camera model. `figures` is what `l3 calibrate --json` says of the camera, and under
    "shortfall" why not to trust it, if so; `name` is the file it comes from."""
    parts = [
        Subsection("Sensor and colour filter array", (Figures((array_figure(camera),)), _facts(camera))),
        Subsection("Responsivities", (Figures(responsivity_figures(camera)),)),
        Subsection("Noise", _noise_blocks(camera, figures)),
    ]
    if camera.fit is not None and camera.fit.photo is not None:
        parts[2:2] = photo_subsections(camera, camera.fit.photo, figures)
    if camera.fit is not None and (blocks := validation_blocks(camera, camera.fit, figures)):
        parts.append(Subsection("Validation", blocks))
    doubt = f" It falls short: {figures['shortfall']}." if figures["shortfall"] else ""
    return Section(f"Camera: {camera.name}", f"{_lead(camera, figures)}{doubt} From {name}.", tuple(parts))


def _lead(camera: CameraModel, figures: dict[str, Any]) -> str:
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
        f"(R² {float(validation.r_squared[worst]):.5f}) in its worst channel, {camera.channels[worst]}."
    )


# ---------------------------------------------------------------------------------------------------------- array


def array_figure(camera: colours.Filters) -> Figure:
    """Return one period of the array."""
    rows, cols = camera.cfa.shape
    light = colours.channel_light(camera)
    wide = float(np.clip(GLYPH * max(map(len, camera.channels)) + 8, CELL, WIDEST))
    fits = round((wide - 8) / GLYPH)
    items = []
    for (row, col), channel in np.ndenumerate(camera.cfa):
        fill, ink = colours.hex_colour(light[channel]), colours.ink_on(light[channel])
        x, y = 1 + col * wide, 1 + row * CELL
        items.append(box(x, y, wide, CELL, fill, extra=' stroke="currentColor" stroke-width="1"'))
        label = camera.channels[channel]
        shown = label if len(label) <= fits else label[: fits - 1] + "…"
        items.append(
            f'<text x="{x + wide / 2:g}" y="{y + CELL / 2 + 5:g}" text-anchor="middle" style="fill:{ink}" data-on="{fill}">'
            f"{escape(shown)}</text>"
        )
    counts = np.bincount(camera.cfa.ravel(), minlength=len(camera.channels))
    shares = ", ".join(f"{name} on {count}" for name, count in zip(camera.channels, counts, strict=True))
    finding = f"Super-pixel of {rows} × {cols} sites: {shares}. Colours are those of daylight through each channel."
    svg = sheet(cols * wide + 2, rows * CELL + 2, "".join(items), finding, fixed_size=True)
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
    """Return the origin of the figures that were not measured: photos leave dark frames' figures at 0."""
    return "not measured, taken as 0" if "dark current" in camera.declared else "taken from the data sheet"


# -------------------------------------------------------------------------------------------------- responsivities


def responsivity_figures(camera: colours.Filters) -> tuple[Figure, ...]:
    """Return the curves, and where they were measured their confidence bands."""
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
        if sum(map(len, camera.channels)) <= LABELLED:
            plot.label(float(camera.wavelength[peak]), float(curve[peak]), key.label)
        peaks.append(f"{key.label} {tidy(float(curve[peak]))} at {tidy(float(camera.wavelength[peak]), 4)} nm")
    curves = plot.figure("Responsivities", f"Peaks: {', '.join(peaks)}.", keys)
    return (curves, _band_figure(camera)) if measured else (curves,)


def _band_figure(camera: colours.Filters) -> Figure:
    """Return the half widths alone, since a good calibration's bands are thinner than its lines."""
    shares = 100 * camera.responsivity_band / camera.responsivity.max(axis=1, keepdims=True)
    plot = Plot(spanning("wavelength (nm)", camera.wavelength), spanning("half width (% of peak)", shares, zero=True))
    keys = colours.channel_keys(camera)
    for key, share in zip(keys, shares, strict=True):
        plot.line(camera.wavelength, share, key.colour, key.mark, series=key.label)
    medians = ", ".join(f"{name} {tidy(float(np.median(s)), 2)} %" for name, s in zip(camera.channels, shares, strict=True))
    finding = (
        f"Half width of the 95 % band as a share of the channel's peak, median over wavelengths: {medians}; "
        f"at most {tidy(shares.max(), 2)} %."
    )
    return plot.figure("Confidence bands", finding, keys)


# ----------------------------------------------------------------------------------------------------------- noise


def _noise_blocks(camera: CameraModel, figures: dict[str, Any]) -> tuple[Block, ...]:
    rows = tuple(
        (name, f"{tidy(entry['value'], 5)} {unit(entry['unit'])}".strip()) for name, entry in figures["camera"].items()
    )
    blocks: list[Block] = []
    if camera.fit is not None and camera.fit.noise is not None:
        blocks.append(Figures((transfer_figure(camera, camera.fit.noise),)))
    sheet = f"; {_declared_from(camera)}: {', '.join(camera.declared)}" if camera.declared else ""
    blocks.append(Table(f"The camera in EMVA 1288 terms{sheet}", ("quantity", "value"), rows))
    rows_of_channels = figures["channels"].items()
    others = {name: {title: value for title, value in row.items() if title not in BANDS} for name, row in rows_of_channels}
    if any(others.values()):
        blocks.append(table_of("Figures of each channel", "channel", others))
    if figures["saturation reached"] is False:
        blocks.append(Text("No white frame saturates: the white level is taken to be the converter's last value."))
    if figures["defects"]:
        shown = " ".join(f"({row}, {col})" for row, col in figures["defects"][:24])
        more = " …" if len(figures["defects"]) > 24 else ""
        blocks.append(Text(f"{len(figures['defects'])} hot and dead pixels (row, col) are left out: {shown}{more}"))
    if found := figures.get("defect map"):
        blocks.append(Text("Defect map: " + ", ".join(f"{what} {count}" for what, count in found.items())))
    if lost := figures.get("corner fall-off %"):
        shares = ", ".join(f"{name} {share:.3g} %" for name, share in lost.items())
        blocks.append(Text(f"Flat field: light lost in the darkest corner: {shares}"))
    if figures["left out"] and not figures["photos"]:
        blocks.append(Details(f"{counted(len(figures['left out']), 'capture')} left out", "\n".join(figures["left out"])))
    return tuple(blocks)


def transfer_figure(camera: CameraModel, noise: NoiseFit) -> Figure:
    """Return the temporal variance over the mean signal, with the line that the system gain is the slope of."""
    mean, variance = noise.photon_transfer_mean, noise.photon_transfer_variance
    plot = Plot(
        spanning("mean signal above black (DN)", mean, zero=True), spanning("temporal variance (DN²)", variance, zero=True)
    )
    keys = colours.channel_keys(camera)
    for channel, key in enumerate(keys):
        gain = float(noise.conversion_gain[channel])
        dark = (gain * float(noise.read_noise[channel])) ** 2 + QUANTISATION
        end = float(mean[int(variance[:, channel].argmax()), channel])  # beyond it the channel saturates
        plot.line(np.array([0.0, end]), np.array([dark, dark + gain * end]), key.colour, key.mark, 1.2)
        plot.dots(mean[:, channel], variance[:, channel], key.colour, colours.MARKS[key.mark], series=key.label)
    gains = ", ".join(
        f"{name} {tidy(float(k), 4)} ± {tidy(float(e), 2)}"
        for name, k, e in zip(camera.channels, noise.conversion_gain, noise.conversion_gain_error, strict=True)
    )
    line = noise.conversion_gain * mean + (noise.conversion_gain * noise.read_noise) ** 2
    full = int((variance < NEARLY * line).sum())
    finding = f"The slope is the system gain K in DN/e⁻: {gains}. Lines are K times signal plus dark variance."
    points = f"{counted(full, 'saturated point')}, of less variance, {'lies' if full == 1 else 'lie'} below them."
    return plot.figure("Photon transfer", f"{finding} {points}" if full else finding, keys)
