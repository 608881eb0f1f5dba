"""The section of a report about a transform table: training patches per class, selected transforms, and noise gains."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes import level
from l3cli.classes.windows import Integers, window_channels
from l3cli.report import colours
from l3cli.report.drawing import SERIES, WIDTH, Plot, box, escape, heat, sheet, spanning
from l3cli.report.parts import Block, Data, Figure, Figures, Key, Section, Subsection, Table, Text
from l3cli.system.text import tidy

Array = NDArray[np.floating]
DECADE_OPACITIES = (0.15, 0.3, 0.45, 0.6, 0.8, 1.0)  # opacity of cells with 1–9, 10–99, … patches
MAX_NAME_CHARACTERS = 22  # maximum length of names beside a drawing; longer names are replaced by numbers
MAX_MAPS = 3  # maximum number of outputs with drawn weights


def transform_section(
    table: TransformTable, light: Array | None, insight: dict[str, Any], class_name: Callable[[int], str], name: str
) -> Section:
    """Build the section about a transform table.

    Parameters
    ----------
    table : TransformTable
        The table.
    light : ndarray, (channel, 3), optional
        Display colours of the channels in linear sRGB. None if the report contains no camera. Filters are then drawn without
        colour.
    insight : dict
        Output of `l3 info --json` for the table.
    class_name : callable
        Function that describes a class, given its index.
    name : str
        Name of the file.
    """
    classes = insight["classes"]
    lead = (
        f"The table from {name} is for {table.camera_name}. It has {classes['all']} classes of patches of "
        f"{table.first.rule.patch} × {table.first.rule.patch} pixels. {classes['trained']} classes were trained on patches, "
        f"and {classes['filled']} were filled from neighbouring classes."
    )
    if lights := ", ".join(light["name"] for light in insight.get("lights", ())):
        lead += f" The report shows the transforms for unknown illuminants. The table also has transforms for {lights}."
    parts: tuple[Subsection, ...] = (
        Subsection("Training patches per class", _population_blocks(table, insight)),
        Subsection("Transforms", _transform_blocks(table, light, class_name)),
        Subsection("Noise and uniform areas", (_noise_figures(table), *_gain_tables(table, insight))),
    )
    if insight["later"]:
        parts += (Subsection("Refinement layers", (_refinement_table(insight),)),)
    return Section(f"Table: {name}", lead, parts)


def _refinement_table(insight: dict[str, Any]) -> Table:
    """Tabulate the refinement layers, one per row."""
    gains = tuple(f"median noise gain of {output}" for output in insight["noise_gain"])
    rows = tuple(
        (
            f"layer {number}",
            *(str(layer["classes"][key]) for key in ("all", "trained", "filled")),
            f"{layer['side']} × {layer['side']} × {layer['planes']}",
            str(layer["levels"]),
            _structures(layer),
            *(tidy(gain["median"]) for gain in layer["noise_gain"].values()),
        )
        for number, layer in enumerate(insight["later"], 2)
    )
    headings = ("layer", "classes", "trained", "filled", "taps", "levels", "structures", *gains)
    return Table("Layers that refine the outputs of the previous layer", headings, rows)


def _structures(layer: dict[str, Any]) -> str:
    """Describe a refinement layer's classes for unsaturated pixels: tree leaves, or edge strengths and directions."""
    if "leaves" in layer:
        return f"{layer['leaves']} leaves of a tree of depth {layer['depth']}"
    return (
        f"{layer['structures']}: flat, and {layer['strengths']} edge strengths with {layer['directions']} directions or none"
    )


def level_middles(table: TransformTable) -> Array:
    """Return a positive value inside each level, as a fraction of full scale, for a logarithmic axis."""
    bounds = level.bounds(table)
    lower = np.maximum(bounds[:-1], bounds[1:] / 2)
    return np.sqrt(np.maximum(lower * bounds[1:], 1e-8))


# ------------------------------------------------------------------------------------------------------ population


def _population_blocks(table: TransformTable, insight: dict[str, Any]) -> tuple[Block, ...]:
    """Draw the number of training patches by level, and by chroma and saturation case or by CFA site."""
    samples = table.first.rule.by_feature(table.first.samples)
    levels = [tidy(value, 1) for value in level.bounds(table)[1:]]
    kinds, sites = (
        kind_names(insight),
        [f"{r},{c} {table.channels[channel]}" for (r, c), channel in np.ndenumerate(table.cfa)],
    )
    by_number = max(map(len, kinds)) > MAX_NAME_CHARACTERS
    kinds = [name.partition(":")[0] for name in kinds] if by_number else kinds
    sites = [name.partition(" ")[0] for name in sites] if max(map(len, sites)) > MAX_NAME_CHARACTERS else sites
    kind = "kind (number in the table below)" if by_number else "kind"
    figures = []
    for contrast in range(table.first.rule.contrasts):
        counts = samples[:, :, contrast].sum(axis=(0, 2)).T
        figures.append(
            _population(counts, kinds, levels, f"Patches at contrast {contrast}{_contrast(table, contrast)}", kind)
        )
    by_site = samples.sum(axis=(2, 3, 4))
    figures.append(_population(by_site, sites, levels, "Patches by site", "site (row, column, channel)"))
    empty = Text("Classes in an empty cell had no training patches. Their transforms were filled from neighbouring classes.")
    return (empty, Figures(tuple(figures)), _kinds_table(insight), *_feature_tables(insight))


def kind_names(insight: dict[str, Any]) -> list[str]:
    """Return the names of the chromas and saturation cases.

    If a name is too long for a drawing, all names are preceded by their numbers, as in "2: chroma 2".
    """
    names = [kind["name"] for kind in insight["kinds"]]
    return (
        [f"{number}: {name}" for number, name in enumerate(names)] if max(map(len, names)) > MAX_NAME_CHARACTERS else names
    )


def _contrast(table: TransformTable, contrast: int) -> str:
    """Return ", the flattest" or ", the most textured" for the lowest or highest of several contrasts, otherwise ""."""
    if table.first.rule.contrasts == 1:
        return ""
    return {0: ", the flattest", table.first.rule.contrasts - 1: ", the most textured"}.get(contrast, "")


def _population(counts: Array, rows: list[str], levels: list[str], title: str, y_label: str) -> Figure:
    """Draw the numbers of patches `counts` (row, level) as a heat map, with one step of opacity per factor of ten."""
    decade = np.clip(np.floor(np.log10(np.maximum(counts, 1))), 0, len(DECADE_OPACITIES) - 1).astype(int)
    shares = np.where(counts > 0, np.array(DECADE_OPACITIES)[decade], 0.0)
    filled = int((counts > 0).sum())
    median = float(np.median(counts[counts > 0])) if filled else 0.0
    finding = f"{filled} of {counts.size} cells contain patches, with a median of {tidy(median)} patches."
    svg = heat(shares, rows, levels, "level, upper end (fraction of full scale)", y_label, finding)
    used = np.unique(decade[counts > 0])
    names = [f"{10**d}–{10 ** (d + 1) - 1}" for d in range(len(DECADE_OPACITIES) - 1)] + [
        f"{10 ** (len(DECADE_OPACITIES) - 1)} or more"
    ]
    keys = tuple(Key(f"{names[d]} patches", "var(--one)", "box", DECADE_OPACITIES[d]) for d in used)
    data = Data((y_label, *levels), tuple((name, *map(float, row)) for name, row in zip(rows, counts, strict=True)))
    return Figure(title, svg, finding, keys, data=data)


def _kinds_table(insight: dict[str, Any]) -> Table:
    patches = (f"{kind['patches']:.0f}" for kind in insight["kinds"])
    rows = tuple(zip(kind_names(insight), patches, strict=True))
    return Table("Patches of each chroma and saturation case", ("kind", "patches"), rows)


def _feature_tables(insight: dict[str, Any]) -> tuple[Table, ...]:
    """Tabulate the number of patches for each value of each additional class feature."""
    return tuple(
        Table(f"Patches by {name}", (name, "patches"), tuple((each["name"], f"{each['patches']:.0f}") for each in values))
        for name, values in insight.get("features", {}).items()
    )


# ------------------------------------------------------------------------------------------------------ transforms


def _transform_blocks(table: TransformTable, light: Array | None, class_name: Callable[[int], str]) -> tuple[Block, ...]:
    chosen = chosen_classes(table)
    if not chosen:
        return (Text("No class was trained on patches."),)
    text = (
        "The drawings show the colour filters of a patch and, for each output, the weight of each pixel of the patch, as in "
        "Figure 3 of the L³ paper. Positive weights are orange, and negative weights are blue. The opacity is the square "
        "root of the weight, relative to the largest weight of the output. The drawn classes have many training patches. "
        "They include one site of each channel, dark and bright levels, and flat and textured areas."
    )
    return (Text(text), Figures(tuple(_maps(table, light, index, class_name(index)) for index in chosen)))


def chosen_classes(table: TransformTable) -> list[int]:
    """Choose the classes of the first layer for which transforms are drawn.

    They cover these combinations, at the first site of each channel:

    * the most frequent channel at a dark and at a bright level, each with the lowest and the highest contrast
    * up to seven other channels at a medium level with the highest contrast

    Each combination is represented by its unsaturated class with the most training patches. Combinations without training
    patches are omitted.

    Returns
    -------
    list of int
        Indices of the classes, without duplicates.
    """
    rule = table.first.rule
    sites = table.cfa.ravel()
    common = int(np.bincount(sites).argmax())
    middles = level_middles(table)
    dark, mid, bright = (int(np.argmin(np.abs(np.log(middles / share)))) for share in (0.02, 0.2, 0.4))
    first = int(np.argmax(sites == common))
    wanted = [(first, at, contrast) for at in (dark, bright) for contrast in sorted({0, rule.contrasts - 1})]
    others = [channel for channel in np.unique(sites).tolist() if channel != common][:7]
    wanted += [(int(np.argmax(sites == channel)), mid, rule.contrasts - 1) for channel in others]
    chosen = []
    for site, at, contrast in wanted:
        combinations = np.arange(rule.combinations)[:, None]
        classes = rule.join(at, contrast, np.arange(rule.chromas), site, combinations).ravel()
        most = int(classes[table.first.samples[classes].argmax()])
        if table.first.samples[most] > 0:
            chosen.append(most)
    return list(dict.fromkeys(chosen))


def _maps(table: TransformTable, light: Array | None, index: int, name: str) -> Figure:
    """Draw the colour filters of a patch, and a class's weights for the first MAX_MAPS outputs."""
    patch, outputs = table.first.rule.patch, min(MAX_MAPS, len(table.outputs))
    gap, top = 8.0, 18.0
    side = (WIDTH - gap * outputs) / (outputs + 1)
    cell = side / patch
    weights = table.first.weights[index].astype(np.float64)
    items = [f'<text x="{side / 2:.1f}" y="13" text-anchor="middle">filters</text>']
    for tap, channel in enumerate(taps(table, index)):
        x, y = tap % patch * cell, top + tap // patch * cell
        fill = colours.hex_colour(light[channel]) if light is not None else "var(--paper)"
        items.append(box(round(x, 1), round(y, 1), round(cell, 2), round(cell, 2), fill))
    for output in range(outputs):
        left = (side + gap) * (output + 1)
        items.append(f'<text x="{left + side / 2:.1f}" y="13" text-anchor="middle">{escape(table.outputs[output])}</text>')
        items += _weight_map(weights[output].reshape(patch, patch), left, top, cell)
    for panel in range(outputs + 1):
        left, middle = (side + gap) * panel, top + patch // 2 * cell
        frame = f"M{left:.1f},{top}h{side:.1f}v{side:.1f}h{-side:.1f}z"
        centre = f"M{left + patch // 2 * cell:.1f},{middle:.1f}h{cell:.1f}v{cell:.1f}h{-cell:.1f}z"
        items.append(f'<path class="axis" d="{frame}"/><path class="centre" d="{centre}"/>')
    gains = np.sqrt((weights**2).sum(axis=1))
    figures = ", ".join(
        f"{table.outputs[o]} {tidy(gains[o])} (sum {tidy(weights[o].sum())}, largest {tidy(np.abs(weights[o]).max())})"
        for o in range(outputs)
    )
    finding = f"Trained on {table.first.samples[index]:.0f} patches. Noise gain √Σw² of each output: {figures}."
    drawing = sheet(WIDTH, round(top + side + 2), "".join(items), f"{name}. {finding}")
    return Figure(name, drawing, finding, data=_weights_data(table, index))


def _weights_data(table: TransformTable, index: int) -> Data:
    """Tabulate all weights of a class, with output, position in the patch and channel."""
    patch, channel = table.first.rule.patch, taps(table, index)
    rows = tuple(
        (table.outputs[output], str(tap // patch), str(tap % patch), table.channels[channel[tap]], float(weight))
        for (output, tap), weight in np.ndenumerate(table.first.weights[index])
    )
    return Data(("output", "row of the patch", "column of the patch", "channel", "weight (1)"), rows)


def _weight_map(weights: Array, left: float, top: float, cell: float) -> list[str]:
    """Draw the weights of one output as cells: positive weights in orange, negative weights in blue."""
    largest = float(np.abs(weights).max()) or 1.0
    items = []
    for (row, col), weight in np.ndenumerate(weights):
        share = round(float(np.sqrt(abs(weight) / largest)), 2)
        if share >= 0.05:
            colour = "var(--two)" if weight > 0 else "var(--one)"
            items.append(
                box(round(left + col * cell, 1), round(top + row * cell, 1), round(cell, 2), round(cell, 2), colour, share)
            )
    return items


def taps(table: TransformTable, index: int) -> Integers:
    """Return the channel of each tap (tap,) for a class of the first layer."""
    return window_channels(table.cfa, table.first.rule.patch)[table.first.rule.split(index).site]


# ----------------------------------------------------------------------------------------------------------- noise


def _noise_figures(table: TransformTable) -> Figures:
    """Plot the median noise gain of trained unsaturated classes, if any, against the level."""
    rule, gains = table.first.rule, np.sqrt((table.first.weights.astype(np.float64) ** 2).sum(axis=2))
    gain = rule.by_feature(gains)[..., rule.kinds_of(0), :]
    trained = rule.by_feature(table.first.samples)[..., rule.kinds_of(0)] > 0
    middles, curves = level_middles(table), []
    for output in range(min(MAX_MAPS, len(table.outputs))):
        for contrast in sorted({0, table.first.rule.contrasts - 1}):
            curves.append((output, contrast, _medians(gain[:, :, contrast, ..., output], trained[:, :, contrast])))
    known = np.concatenate([values[np.isfinite(values)] for _, _, values in curves])
    if not known.size:
        return Figures(())
    plot = Plot(
        spanning("level (fraction of full scale)", middles, log=True), spanning("noise gain √Σw² (1)", known, log=True)
    )
    keys, ranges = [], []
    for output, contrast, values in curves:
        at = np.isfinite(values)
        if not at.any():
            continue
        textured = contrast > 0
        name = table.outputs[output]
        if table.first.rule.contrasts > 1:
            name += ", textured" if textured else ", flat"
        mark = "dashed" if textured else "line"
        plot.line(middles[at], values[at], SERIES[output], mark, series=name)
        keys.append(Key(name, SERIES[output], mark))
        ranges.append(f"{name} {tidy(values[at][0], 2)} to {tidy(values[at][-1], 2)}")
    finding = (
        f"Median over trained unsaturated classes, from the darkest to the brightest level: {'; '.join(ranges)}. "
        "With a gain of 1, the output is as noisy as a single pixel."
    )
    return Figures((plot.figure("Noise gain", finding, tuple(keys)),))


def _medians(values: Array, chosen: NDArray[np.bool_]) -> Array:
    """Return the median of the `chosen` values (site, level, …) at each level, or NaN if there are none."""
    return np.array(
        [np.median(values[:, at][chosen[:, at]]) if chosen[:, at].any() else np.nan for at in range(values.shape[1])]
    )


def _gain_tables(table: TransformTable, insight: dict[str, Any]) -> tuple[Table, ...]:
    """Tabulate the noise gain, the gain in uniform areas, and the classes with the highest noise gain."""
    flat = tuple(
        (output, *(tidy(gains[channel]) for channel in table.channels)) for output, gains in insight["dc_gain"].items()
    )
    noise = tuple((output, tidy(gain["median"]), tidy(gain["worst"])) for output, gain in insight["noise_gain"].items())
    worst = tuple(
        (entry["class"], tidy(entry["noise_gain"]), f"{entry['patches']:.0f}", tidy(entry["condition"]))
        for entry in insight["worst"]
    )
    return (
        Table("Noise gain √Σw² of trained classes", ("output", "median", "maximum"), noise),
        Table("Gain for a uniform signal in one channel, median of unsaturated classes", ("output", *table.channels), flat),
        Table("Classes with the highest noise gain", ("class", "noise gain", "patches", "condition number"), worst),
    )
