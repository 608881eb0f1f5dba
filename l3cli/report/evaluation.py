"""An evaluation as a section: figures, curves over light level, and some frames."""

import itertools
from typing import Any

import numpy as np

from l3cli.classes.names import further_headings, heading
from l3cli.report.colours import SERIES
from l3cli.report.drawing import Plot, spanning
from l3cli.report.parts import (
    Block,
    Figure,
    Figures,
    Key,
    Section,
    Subsection,
    Table,
    Text,
    counted,
    tidy,
)
from l3cli.system.text import figure as number

OURS = "ours"
NAMES = {  # figure → heading; unit and meaning
    "mean_delta_e": "mean ΔE00",
    "median_delta_e": "median ΔE00",
    "p95_delta_e": "95 % ΔE00",
    "scielab": "S-CIELAB ΔE00",
    "psnr": "PSNR (dB)",
    "output_psnr": "linear PSNR (dB)",
    "ssim": "SSIM (1)",
    "mean_angle": "mean spectral angle (°)",
    "median_angle": "median angle (°)",
    "p95_angle": "95 % angle (°)",
}
MEANINGS = (
    "ours is the table; basic is a pipeline that learns nothing (interpolation, white balance, colour matrix). Pictures are "
    "compared as displayed: adapted to D65, the 99th percentile of the target's luminance shown white. ΔE00: CIEDE2000; "
    "S-CIELAB: the same after the eye's blur; PSNR of sRGB, linear PSNR of XYZ."
)
BAND_MEANINGS = (
    "ours is the table; the other pipelines learn nothing. The spectral angle is that between the outputs of a pixel and "
    "its target's; PSNR is of 8-bit codes of which the frame's white is 255, linear PSNR of the outputs as they are, 1 "
    "being the 99th percentile of the target's mean output; SSIM is the mean over the outputs."
)


def evaluation_section(document: dict[str, Any], names: tuple[str, str]) -> Section:
    """Return the section of an evaluation. `document` is that of `l3 evaluate --json`, `names` the files of table and
    frames."""
    figure = next(iter(document["frames"][0][OURS]))
    parts = [
        Subsection("Quality", _quality_blocks(document, figure)),
        Subsection("Over light level", _level_blocks(document, figure)),
    ]
    parts.append(Subsection("By class", _class_blocks(document, figure)))
    title = f"Evaluation: {names[0]} on {names[1]}" if all(names) else f"Evaluation: {names[0] or names[1]}"
    return Section(title, summary(document), tuple(parts))


def luminance_section(
    curves: dict[str, list[tuple[str, tuple[float, ...], tuple[float, ...]]]], sentences: dict[str, list[str]]
) -> Section:
    """Compare cameras over the light on the scene: for each figure the name, luminances (cd/m²) and values of every camera,
    and sentences on where the better one changes."""
    parts = []
    for figure, cameras in curves.items():
        heading = NAMES.get(figure, figure)
        x = spanning("luminance of a perfect white (cd/m²)", cameras[0][1], log=True)
        plot = Plot(x, spanning(heading, [value for _, _, values in cameras for value in values]))
        keys = []
        for colour, (name, luminance, value) in zip(itertools.cycle(SERIES), cameras, strict=False):
            plot.line(np.array(luminance), np.array(value), colour).dots(
                np.array(luminance), np.array(value), colour, series=name
            )
            keys.append(Key(name, colour))
        finding = " ".join(sentences[figure]) or f"{heading} of {cameras[0][0]}."
        rows = tuple(
            (tidy(luminance), *(tidy(values[index]) for _, _, values in cameras))
            for index, luminance in enumerate(cameras[0][1])
        )
        table = Table(heading, ("cd/m²", *(name for name, _, _ in cameras)), rows)
        parts.append(
            Subsection(
                heading, (Figures((Figure(heading, plot.svg(finding), finding, tuple(keys), data=plot.data()),)), table)
            )
        )
    return Section("Over the light on the scene", "Means over all frames of one luminance.", tuple(parts))


def summary(document: dict[str, Any]) -> str:
    """Return the evaluation in a sentence."""
    figure = next(iter(document["frames"][0][OURS]))
    count = len(document["frames"])
    means = ", ".join(f"{name} {main_figure(document['mean'][name], figure)}" for name in document["pipelines"])
    name = NAMES[figure]
    return f"{name[0].upper()}{name[1:]} over {counted(count, 'frame')}: {means}."


def main_figure(figures: dict[str, float], figure: str) -> str:
    """Return the main figure and, of pictures, the PSNR."""
    return figure_text(figure, figures[figure]) + (f" ({number(figures['psnr'], '.1f')} dB)" if "psnr" in figures else "")


def _quality_blocks(document: dict[str, Any], figure: str) -> tuple[Block, ...]:
    figures = tuple(document["frames"][0][OURS])
    headings = ("pipeline", *(NAMES[name] for name in figures))
    means = tuple((name, *(figure_text(f, document["mean"][name][f]) for f in figures)) for name in document["pipelines"])
    blocks: list[Block] = [Table("Means over the frames", headings, means)]
    blocks.append(Text(MEANINGS if figure == "mean_delta_e" else BAND_MEANINGS))
    baselines = document["pipelines"][1:]
    about = ("frame", "scene", "light", "level (share of full scale)")
    rows = tuple(
        (str(index + 1), f["scene"], f["illuminant"], f"{f['level']:.3f}", *(figure_text(n, f[OURS][n]) for n in figures))
        + tuple(figure_text(figure, f[baseline][figure]) for baseline in baselines)
        for index, f in enumerate(document["frames"])
    )
    heads = (*about, *(NAMES[name] for name in figures), *(f"{baseline}: {NAMES[figure]}" for baseline in baselines))
    blocks.append(Table("Frames", heads, rows))
    if document["by_band"]:
        blocks.append(_band_table(document))
    if len(document["by_illuminant"]) > 1:
        blocks.append(
            _grouped(
                document,
                "By illuminant",
                "illuminant",
                [g["illuminant"] for g in document["by_illuminant"]],
                "by_illuminant",
            )
        )
    return tuple(blocks)


def _band_table(document: dict[str, Any]) -> Table:
    shown = [(owner, figure) for figure in ("psnr", "output_psnr", "ssim") for owner in document["pipelines"]]
    rows = tuple(
        (entry["band"], *(figure_text(figure, entry[owner][figure]) for owner, figure in shown))
        for entry in document["by_band"]
    )
    return Table("By band", ("band", *(f"{owner}: {NAMES[figure]}" for owner, figure in shown)), rows)


def _grouped(document: dict[str, Any], caption: str, heading: str, names: list[str], group: str) -> Table:
    figure = next(iter(document["frames"][0][OURS]))
    heads = (heading, "frames", *(f"{owner}: {NAMES[figure]}" for owner in document["pipelines"]))
    rows = tuple(
        (name, str(g["frames"]), *(figure_text(figure, g[owner][figure]) for owner in document["pipelines"]))
        for name, g in zip(names, document[group], strict=True)
    )
    return Table(caption, heads, rows)


def _level_blocks(document: dict[str, Any], figure: str) -> tuple[Block, ...]:
    figures: list[Figure] = []
    blocks: list[Block] = []
    classes = document["by_class"].get("level", [])
    if len(classes) > 1:
        at = level_middles(classes)
        figures.append(
            _curves(document, figure, classes, at, "Error over the class's level", "level of the pixel's neighbourhood")
        )
    groups = document["by_level"]
    if len(groups) > 1:
        at = np.array([np.sqrt(group["from"] * group["to"]) for group in groups])
        figures.append(_curves(document, figure, groups, at, "Error over the frame's level", "mean level of the frame"))
    if figures:
        blocks.append(Figures(tuple(figures)))
    names = [f"{g['from']:.3f}–{g['to']:.3f}" for g in groups]
    blocks.append(_grouped(document, "By the frame's level (share of full scale)", "level", names, "by_level"))
    return tuple(blocks)


def level_middles(entries: list[dict[str, Any]]) -> np.ndarray:
    """Return a level within the bounds of each entry, fit for a logarithmic axis."""
    return np.array([np.sqrt(max(entry["from"], entry["to"] / 2) * entry["to"]) for entry in entries])


def _curves(document: dict[str, Any], figure: str, entries: list, at: np.ndarray, title: str, label: str) -> Figure:
    values = {name: np.array([entry[name][figure] for entry in entries]) for name in document["pipelines"]}
    everything = np.concatenate(list(values.values()))
    plot = Plot(spanning(f"{label} (share of full scale)", at, log=True), spanning(NAMES[figure], everything, zero=True))
    keys = []
    for index, (name, curve) in enumerate(values.items()):
        colour, mark = SERIES[index % len(SERIES)], ("line", "dashed", "dotted", "dashed")[index % 4]
        plot.line(at, curve, colour, mark).dots(at, curve, colour, size=6, series=name)
        keys.append(Key(name, colour, mark))
    values_text = "; ".join(
        f"{name} {figure_text(figure, curve[0])} at level {tidy(at[0], 2)}, "
        f"{figure_text(figure, curve[-1])} at {tidy(at[-1], 2)}, at most {figure_text(figure, curve.max())}"
        for name, curve in values.items()
    )
    finding = f"{NAMES[figure]}: {values_text}."
    return Figure(title, plot.svg(finding), finding, tuple(keys), data=plot.data())


def _class_blocks(document: dict[str, Any], figure: str) -> tuple[Block, ...]:
    heads = ("pixels", *(f"{owner}: {NAMES[figure]}" for owner in document["pipelines"]))

    def cells(entry: dict[str, Any]) -> tuple[str, ...]:
        return (str(entry["pixels"]), *(figure_text(figure, entry[owner][figure]) for owner in document["pipelines"]))

    tables = []
    for axis, entries in document["by_class"].items():
        if axis != "level" and len(entries) > 1:
            tables.append(Table(f"By {axis}", (axis, *heads), tuple((heading(axis, e), *cells(e)) for e in entries)))
    worst = tuple(
        (
            ", ".join([f"level {e['from']:.3g}–{e['to']:.3g}, contrast {e['contrast']}", *further_headings(e), _kind(e)]),
            *cells(e),
        )
        for e in document["worst_classes"]
    )
    return (*tables, Table("Worst classes", ("class", *heads), worst))


def _kind(entry: dict[str, Any]) -> str:
    return f"saturation case {entry['case']}" if entry["chroma"] is None else f"chroma {entry['chroma']}"


def figure_text(figure: str, value: float) -> str:
    """Return a figure of quality as text, without its unit."""
    return number(value, ".4f" if figure == "ssim" else ".2f")
