"""Two sections of a report about an evaluation: the section at the top of the page, and the section with all metrics.

The top section shows pictures of a few frames, a summary and the mean metrics. The other section lists the metrics by
illuminant, level, gain and class. In both sections, the pipeline "ours" is the evaluated table.
"""

from typing import Any

import numpy as np

from l3cli.classes.names import feature_headings, heading
from l3cli.physics.figures import FIGURES, figure_text
from l3cli.report.drawing import Axis, Plot, spanning
from l3cli.report.parts import (
    Block,
    Comparison,
    Figure,
    Figures,
    Front,
    Jpeg,
    Key,
    Picture,
    Pixels,
    Section,
    Subsection,
    Table,
    Text,
    fitted,
)
from l3cli.system.text import counted, tidy
from l3cli.system.text import figure as number

DIRECTIONS = {"rows": "along rows", "columns": "along columns"}
NYQUIST = 0.5  # cycles/pixel


def standard_blocks(standards: dict[str, Any], height: int) -> tuple[Block, ...]:
    """Build the blocks with the metrics that standards define on test charts: plots of MTF and SNR, a table, an explanation.

    Parameters
    ----------
    standards : dict
        Value of the key "standards" in the output of `l3 evaluate --json`.
    height : int
        Picture height in pixels, to convert MTF50 to line widths per picture height.
    """
    edges, grey = standards["edge"], standards["grey"]
    figures = [_edge_figure(edges[across], DIRECTIONS[across]) for across in edges]
    if grey:
        figures.append(_grey_figure(grey))
    heads, rows = ["pipeline"], []
    names = list(next(iter(standards["figures"].values())))
    for name in names:
        heads.append(FIGURES[name].heading)
        heads += ["in line widths per picture height"] if name.startswith("mtf50") else []
    for owner, values in standards["figures"].items():
        row = [owner]
        for name in names:
            row.append(figure_text(name, values[name]))
            value = values[name]
            row += [("–" if value is None else f"{2 * height * value:.0f}")] if name.startswith("mtf50") else []
        rows.append(tuple(row))
    table = Table("Metrics from standards", tuple(heads), tuple(rows))
    return (Figures(tuple(figures)), table, Text(_meaning(standards, height)))


def _meaning(standards: dict[str, Any], height: int) -> str:
    """Explain the metrics from standards and the measurement conditions."""
    grey, chart = standards["grey"], standards["chart"]
    text = (
        "MTF50 is the lowest frequency at which the MTF of a noise-free slanted edge with a contrast of 4:1 is 0.5 (ISO "
        f"12233). The picture height is {height} rows."
    )
    if chart:
        text += (
            f" ΔE00 by the camera's uncertainty is the mean colour error on a chart for {chart['cameras']} random cameras "
            "whose curves vary within the confidence bands."
        )
    if grey is None:
        return f"{text} The camera's responsivities are relative, so its noise at a given illuminance is unknown."
    raw = "; ".join(
        f"{name} {figure_text('snr10', grey['snr10']['closed_form'][name])} in closed form, "
        f"{figure_text('snr10', grey['snr10']['raw'][name])} measured"
        for name in grey["closed_form"]
    )
    return (
        f"{text} SNR10 is the lowest illuminance at which the luminance of a {100 * grey['reflectance']:.0f} % grey patch "
        f"under {grey['light']} has a signal-to-noise ratio of 10, at f/{grey['f_number']:g}, an exposure time of "
        f"{1000 * grey['exposure']:.0f} ms and a pixel pitch of {tidy(1e6 * grey['pixel_pitch'])} µm. SNR10 of raw values, "
        f"in lux: {raw}."
    )


def _edge_figure(edge: dict[str, Any], direction: str) -> Figure:
    """Plot the MTF of each pipeline along rows or along columns."""
    frequency = np.array(edge["frequency"])
    curves = {name: np.array(values) for name, values in edge["mtf"].items() if values}
    most = max(1.0, *(float(values.max()) for values in curves.values()))
    plot = Plot(Axis("frequency (cycles/pixel)", 0.0, float(frequency[-1])), Axis("MTF (1)", 0.0, 1.04 * most))
    plot.line(np.array([NYQUIST, NYQUIST]), np.array([0.0, most]), "currentColor", "dotted", 1.0)
    keys = plot.curves(
        {name: (frequency, values) for name, values in curves.items()}, ("dashed", "line", "dotted", "line"), size=0
    )
    halves = ", ".join(f"{name} {figure_text('mtf50_rows', value)}" for name, value in edge["mtf50"].items())
    finding = f"MTF50 in cycles/pixel: {halves}. The dotted line is the Nyquist frequency."
    return plot.figure(f"Sharpness {direction}", finding, keys)


def _grey_figure(grey: dict[str, Any]) -> Figure:
    """Plot the signal-to-noise ratio of a grey patch against the illuminance, for each pipeline and for raw values."""
    lux = np.array(grey["lux"])
    best = max(grey["closed_form"], key=lambda name: grey["closed_form"][name][-1])
    curves = {name: np.array(values) for name, values in grey["pipelines"].items()}
    raw, closed = np.array(grey["raw"][best]), np.array(grey["closed_form"][best])
    everything = np.concatenate([raw, closed, *curves.values()])
    plot = Plot(spanning("illuminance (lux)", lux, log=True), spanning("signal-to-noise ratio (1)", everything, log=True))
    plot.line(lux[[0, -1]], np.array([10.0, 10.0]), "currentColor", "dotted", 1.0)
    keys = plot.curves({name: (lux, values) for name, values in curves.items()}, ("line", "dashed", "dotted"))
    keys += plot.curves({f"raw {best}, closed form": (lux, closed)}, ("dashed",), size=0, width=1.2)
    plot.dots(lux, raw, "currentColor", "plus", series=f"raw {best}, measured")
    least = ", ".join(f"{name} {figure_text('snr10', grey['snr10'][name])}" for name in curves)
    finding = f"SNR10 in lux: {least}. Plus signs are measured raw values of channel {best}."
    return plot.figure("Signal-to-noise ratio of a grey", finding, keys)


OURS = "ours"
MEANINGS = (
    "“ours” is the table. “basic” is a conventional pipeline without training: interpolation, white balance and a colour "
    "matrix. Pictures are compared as displayed. They are adapted to D65, and the 99th percentile of the target's luminance "
    "is displayed as white. ΔE00 is CIEDE2000. S-CIELAB is ΔE00 after the blur of the eye. Mottle is the C*ab of blotches "
    "in uniform patches after a Gaussian blur of 4 pixels. Visual noise is the sum of the standard deviations of L*, a* and "
    "b* in uniform patches after the blur of the eye, with weights 1, 0.852 and 0.323. PSNR is computed from sRGB, and "
    "linear PSNR from XYZ."
)
BAND_MEANINGS = (
    "“ours” is the table. The other pipelines are not trained, with two exceptions: “wiener” (Wiener estimate) and “pinv” "
    "(pseudo-inverse) are linear estimates of reflectances or radiances from demosaicked bands. The spectral angle of a "
    "pixel is the angle between its outputs and the target. GFC is the mean cosine of the spectral angle. RMSE is computed "
    "over all outputs, as a fraction of a perfect white. PSNR is computed from 8-bit values in which a perfect white is "
    "255. Linear PSNR is computed from the outputs themselves, and its peak is the 99th percentile of the target's mean "
    "output. SSIM is the mean over the outputs."
)
SINGLE_MEANINGS = (
    "“ours” is the table. The mean error is the mean absolute difference from the target. Mean error and RMSE are fractions "
    "of a perfect white. PSNR is computed from 8-bit values in which a perfect white is 255. Linear PSNR is computed from "
    "the output itself, and its peak is the 99th percentile of the target. SSIM is computed from values clipped at white."
)
STOKES_MEANINGS = (
    "“ours” is the table. “bilinear” interpolates each channel and solves for the Stokes parameters by least squares. DoLP "
    "is the degree of linear polarisation, and AoLP its angle. The error of the angle is computed where the DoLP of the "
    "target exceeds 0.05, and the bias of DoLP where it is below 0.005. PSNR is computed from linear values in which a "
    "perfect white is 1: of DoLP, of the intensities behind ideal polarisers at four angles, of S0 / 2, S1 and S2."
)
MEANINGS_OF = {  # main metric → explanation of all metrics
    "mean_delta_e": MEANINGS,
    "mean_angle": BAND_MEANINGS,
    "mean_error": SINGLE_MEANINGS,
    "mean_dolp_error": STOKES_MEANINGS,
}
GAIN_MEANING = (
    "The camera model contains the noise at these analog gains. For each gain, a few frames under each illuminant are "
    "simulated again with this noise. The exposure time is shortened in proportion to the gain."
)

ERROR_KEY = (  # legend of the error maps from l3cli.evaluation.pictures
    Key("ΔE00 in the error map: 0", "#000000", "box"),
    Key("2.5", "#460a6e", "box"),
    Key("5", "#be285a", "box"),
    Key("7.5", "#f58c1e", "box"),
    Key("10 or more", "#ffffff", "box"),
)
SAME_LUMINANCE = 0.01  # relative tolerance when luminances are compared, because users round values in lux
FRAMES_SHOWN = 3  # number of frames in the top section: the median, worst and best frame
Pictures = dict[
    int, dict[str, Pixels]
]  # pictures by frame index and by name: the name of a pipeline, "ideal" or "error" (error map)


def evaluation_section(document: dict[str, Any], names: tuple[str, str], height: int) -> Section:
    """Build the section with all metrics of an evaluation.

    Parameters
    ----------
    document : dict
        Output of `l3 evaluate --json`.
    names : tuple of str
        File names of the table and of the training set.
    height : int
        Picture height in pixels.

    Returns
    -------
    Section
        Metrics over all frames, by level, by class, and from standards. If the camera model contains the noise at several
        analog gains, also metrics by gain.
    """
    parts = [
        Subsection("Quality", _quality_blocks(document)),
        Subsection("By light level", _level_blocks(document)),
        Subsection("By class", _class_blocks(document)),
        Subsection("Metrics from standards", standard_blocks(document["standards"], height)),
    ]
    if document["by_gain"]:
        parts.insert(2, Subsection("By gain and illuminant", _gain_blocks(document)))
    return Section(f"Evaluation: {names[0]} on {names[1]}", summary(document), tuple(parts))


def luminance_section(
    curves: dict[str, list[tuple[str, tuple[float, ...], tuple[float, ...]]]], sentences: dict[str, list[str]]
) -> Section:
    """Build the section that compares cameras as a function of scene luminance.

    Parameters
    ----------
    curves : dict of str to list of (name, luminances, values)
        By metric: for each camera, its name, luminances in cd/m², and the metric at these luminances.
    sentences : dict of str to list of str
        By metric: which camera is better in which luminance range.

    Returns
    -------
    Section
        One subsection per metric, with a plot and a table.
    """
    parts = []
    for figure, cameras in curves.items():
        heading = FIGURES[figure].heading if figure in FIGURES else figure
        x = spanning("luminance of a perfect white (cd/m²)", cameras[0][1], log=True)
        plot = Plot(x, spanning(heading, [value for _, _, values in cameras for value in values]))
        series = {name: (np.array(luminance), np.array(value)) for name, luminance, value in cameras}
        keys = plot.curves(series, marks=("line",), size=5)
        finding = " ".join(sentences[figure]) or f"{heading} of {cameras[0][0]}."
        rows = tuple(
            (tidy(luminance), *(tidy(values[index]) for _, _, values in cameras))
            for index, luminance in enumerate(cameras[0][1])
        )
        table = Table(heading, ("cd/m²", *(name for name, _, _ in cameras)), rows)
        parts.append(Subsection(heading, (Figures((plot.figure(heading, finding, keys),)), table)))
    return Section(
        "By luminance of the scene", "Each value is the mean over all frames of the same luminance.", tuple(parts)
    )


def main_of(document: dict[str, Any]) -> str:
    """Return the main metric of an evaluation, such as "mean_delta_e", which is the first metric of the first frame."""
    return str(next(iter(document["frames"][0][OURS])))


def summary(document: dict[str, Any]) -> str:
    """Return a sentence with each pipeline's main metric, averaged over all frames."""
    figure = main_of(document)
    means = ", ".join(f"{name} {main_figure(document['mean'][name], figure)}" for name in document["pipelines"])
    name = FIGURES[figure].heading
    return f"{name[0].upper()}{name[1:]} over {counted(len(document['frames']), 'frame')}: {means}."


def main_figure(figures: dict[str, float], figure: str) -> str:
    """Format the main metric, followed by the PSNR in parentheses if it is known."""
    return figure_text(figure, figures[figure]) + (f" ({number(figures['psnr'], '.1f')} dB)" if "psnr" in figures else "")


def _quality_blocks(document: dict[str, Any]) -> tuple[Block, ...]:
    figure, figures = main_of(document), tuple(document["frames"][0][OURS])
    headings = ("pipeline", *(FIGURES[name].heading for name in figures))
    means = tuple((name, *_texts(document["mean"][name], figures)) for name in document["pipelines"])
    baselines = document["pipelines"][1:]
    about = ("frame", "scene", "illuminant", "level (fraction of full scale)")
    rows = tuple(
        (str(index + 1), f["scene"], f["illuminant"], f"{f['level']:.3f}", *_texts(f[OURS], figures))
        + tuple(figure_text(figure, f[baseline][figure]) for baseline in baselines)
        for index, f in enumerate(document["frames"])
    )
    heads = (
        *about,
        *(FIGURES[name].heading for name in figures),
        *(f"{baseline}: {FIGURES[figure].heading}" for baseline in baselines),
    )
    blocks: list[Block] = [
        Table("Means over the frames", headings, means),
        Text(MEANINGS_OF[figure]),
        Table("Frames", heads, rows),
    ]
    if document["by_patch"]:
        patches = tuple(
            (f"{e['from']:.3f}–{e['to']:.3f}", e["kind"], str(e["patches"]))
            + tuple(figure_text("mottle", e[owner]["mottle"]) for owner in document["pipelines"])
            for e in document["by_patch"]
        )
        owners = (f"{owner}: mottle" for owner in document["pipelines"])
        heads = ("level (fraction of full scale)", "colour", "patches", *owners)
        blocks.append(Table("Mottle of uniform patches (C*ab)", heads, patches))
    if document["by_band"]:
        shown = [(owner, name) for name in ("psnr", "output_psnr", "ssim") for owner in document["pipelines"]]
        bands = tuple(
            (each["band"], *(figure_text(name, each[owner][name]) for owner, name in shown)) for each in document["by_band"]
        )
        blocks.append(Table("By band", ("band", *(f"{owner}: {FIGURES[name].heading}" for owner, name in shown)), bands))
    if len(groups := document["by_illuminant"]) > 1:
        blocks.append(_grouped(document, "By illuminant", "illuminant", "frames", [(g["illuminant"], g) for g in groups]))
    return tuple(blocks)


def _texts(values: dict[str, float], figures: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(figure_text(figure, values[figure]) for figure in figures)


def _grouped(
    document: dict[str, Any], caption: str, heading: str, counts: str, entries: list[tuple[str, dict[str, Any]]]
) -> Table:
    """Tabulate the main metric, with one row per group of frames or pixels and one column per pipeline.

    Parameters
    ----------
    document : dict
        Output of `l3 evaluate --json`.
    caption, heading : str
        Caption of the table, and heading of the column with the group names.
    counts : str
        Key of the group size in the metrics, "frames" or "pixels".
    entries : list of (str, dict)
        Name and metrics of each group.
    """
    figure, owners = main_of(document), document["pipelines"]
    rows = tuple(
        (name, str(of[counts]), *(figure_text(figure, of[owner][figure]) for owner in owners)) for name, of in entries
    )
    return Table(caption, (heading, counts, *(f"{owner}: {FIGURES[figure].heading}" for owner in owners)), rows)


def _level_blocks(document: dict[str, Any]) -> tuple[Block, ...]:
    figures: list[Figure] = []
    classes, groups = document["by_class"].get("level", []), document["by_level"]
    if len(classes) > 1:
        title, label = "Error by level of the class", "level of the pixel's neighbourhood"
        figures.append(_curves(document, classes, level_middles(classes), title, label))
    if len(groups) > 1:
        at = np.array([np.sqrt(group["from"] * group["to"]) for group in groups])
        figures.append(_curves(document, groups, at, "Error by level of the frame", "mean level of the frame"))
    entries = [(f"{g['from']:.3f}–{g['to']:.3f}", g) for g in groups]
    table = _grouped(document, "By level of the frame (fraction of full scale)", "level", "frames", entries)
    return (Figures(tuple(figures)), table) if figures else (table,)


def _gain_blocks(document: dict[str, Any]) -> tuple[Block, ...]:
    """Plot the main metric against the analog gain, with a table and an explanation.

    If there are several illuminants, the plot shows only the table, with one curve per illuminant. Otherwise, it shows one
    curve per pipeline.
    """
    groups, figure = document["by_gain"], main_of(document)
    lights = tuple(dict.fromkeys(group["illuminant"] for group in groups))
    gains = np.array(list(dict.fromkeys(group["gain"] for group in groups)))

    def errors(light: str, owner: str) -> np.ndarray:
        return np.array([group[owner][figure] for group in groups if group["illuminant"] == light])

    if len(lights) > 1:
        curves = {light: errors(light, OURS) for light in lights}
    else:
        curves = {name: errors(lights[0], name) for name in document["pipelines"]}
    heading = FIGURES[figure].heading
    y = spanning(heading, np.concatenate(list(curves.values())), zero=True)
    plot = Plot(spanning("analog gain, relative to the gain of the camera model", gains, log=True), y)
    keys = plot.curves({name: (gains, curve) for name, curve in curves.items()})
    ends = "; ".join(
        f"{name} {figure_text(figure, curve[0])} at gain {gains[0]:g}, {figure_text(figure, curve[-1])} at {gains[-1]:g}"
        for name, curve in curves.items()
    )
    title = "Error of ours by analog gain" if len(lights) > 1 else "Error by analog gain"
    entries = [(f"{group['gain']:g}, {group['illuminant']}", group) for group in groups]
    table = _grouped(document, "By analog gain and illuminant", "gain, illuminant", "frames", entries)
    return Figures((plot.figure(title, f"{heading}: {ends}.", keys),)), Text(GAIN_MEANING), table


def level_middles(entries: list[dict[str, Any]]) -> np.ndarray:
    """Return the geometric mean of each entry's bounds "from" and "to", for a logarithmic axis.

    Lower bounds, which can be 0, are first raised to at least half of the upper bound.
    """
    return np.array([np.sqrt(max(entry["from"], entry["to"] / 2) * entry["to"]) for entry in entries])


def _curves(document: dict[str, Any], entries: list[dict[str, Any]], at: np.ndarray, title: str, label: str) -> Figure:
    """Plot each pipeline's main metric against the levels `at` of the given entries."""
    figure = main_of(document)
    values = {name: np.array([entry[name][figure] for entry in entries]) for name in document["pipelines"]}
    everything = np.concatenate(list(values.values()))
    plot = Plot(
        spanning(f"{label} (fraction of full scale)", at, log=True), spanning(FIGURES[figure].heading, everything, zero=True)
    )
    keys = plot.curves({name: (at, curve) for name, curve in values.items()}, ("line", "dashed", "dotted", "dashed"))
    values_text = "; ".join(
        f"{name} {figure_text(figure, curve[0])} at level {tidy(at[0], 2)}, "
        f"{figure_text(figure, curve[-1])} at {tidy(at[-1], 2)}, at most {figure_text(figure, curve.max())}"
        for name, curve in values.items()
    )
    return plot.figure(title, f"{FIGURES[figure].heading}: {values_text}.", keys)


def _class_blocks(document: dict[str, Any]) -> tuple[Block, ...]:
    tables = [
        _grouped(document, f"By {axis}", axis, "pixels", [(heading(axis, entry), entry) for entry in entries])
        for axis, entries in document["by_class"].items()
        if axis != "level" and len(entries) > 1
    ]
    worst = [
        (", ".join([f"level {e['from']:.3g}–{e['to']:.3g}, contrast {e['contrast']}", *feature_headings(e), kind]), e)
        for e in document["worst_classes"]
        for kind in [f"saturation case {e['case']}" if e["chroma"] is None else f"chroma {e['chroma']}"]
    ]
    return (*tables, _grouped(document, "Worst classes", "class", "pixels", worst))


# ------------------------------------------------------------------------------------------------ beginning of a page


def lit_as(luminance: float, at: float | None) -> bool:
    """Whether a frame's luminance in cd/m² equals `at`, with a tolerance of SAME_LUMINANCE. None matches every frame."""
    return at is None or abs(luminance / at - 1) < SAME_LUMINANCE


def brightness(frame: dict[str, Any]) -> str:
    """Format a frame's luminance for a caption, with a leading comma, or return "" without a scene fingerprint."""
    if frame["shown"] is None:
        return ""
    return f", {tidy(frame['luminance'])} cd/m² ({tidy(np.pi * frame['luminance'])} lux)"


def shown_frames(document: dict[str, Any], at: float | None = None) -> list[int]:
    """Choose the frames for the top section of a report.

    Parameters
    ----------
    document : dict
        Output of `l3 evaluate --json`.
    at : float, optional
        Luminance in cd/m², to which the choice is restricted. At least one frame must have this luminance.
        [default: choose from all frames]

    Returns
    -------
    list of int
        Indices of the frame with the median of the table's main metric, of the worst frame, and of the best frame. If fewer
        frames are available, all are returned, starting with the median frame.
    """
    figure = main_of(document)
    among = [number for number, frame in enumerate(document["frames"]) if lit_as(frame["luminance"], at)]
    order = sorted(among, key=lambda number: -document["frames"][number][OURS][figure])
    middle = order.pop(len(order) // 2)
    return [middle, *(order if len(order) < FRAMES_SHOWN else (order[0], order[-1]))]


def front_section(
    document: dict[str, Any], pictures: Pictures, title: str, anchor: str, limit: int, jpeg: Jpeg,
    below: tuple[Subsection, ...], at: float | None = None,
) -> Section:  # fmt: skip
    """Build the section at the top of a page.

    It shows the first frame with the mean metrics, then the subsections `below`, and then the other frames.

    Parameters
    ----------
    document : dict
        Output of `l3 evaluate --json`.
    pictures : dict
        Pictures of the frames from `shown_frames`, in the same order.
    title : str
        Title of the section.
    anchor : str
        Prefix of the HTML anchors of the comparisons.
    limit : int
        Maximum total size of all pictures in bytes.
    jpeg : callable
        JPEG encoder, see `parts.Jpeg`.
    below : tuple of Subsection
        Subsections that follow the first frame.
    at : float, optional
        Luminance in cd/m², as in `shown_frames`.
    """
    count, figure = len(document["frames"]), main_of(document)
    among = sum(lit_as(frame["luminance"], at) for frame in document["frames"])
    each = limit // sum(len(frame) for frame in pictures.values())
    comparisons = [_comparison(document, index, names, anchor, each, jpeg) for index, names in pictures.items()]
    over = "" if count == 1 else f", mean over {counted(count, 'frame')}"
    meaning = f"{FIGURES[figure].heading} of ours{over}. A ΔE00 of 1 is just visible."
    pipelines = document["pipelines"]
    rows = tuple(
        (FIGURES[name].heading, *(figure_text(name, document["mean"][owner][name]) for owner in pipelines))
        for name in document["frames"][0][OURS]
    )
    table = Table("Metrics" if count == 1 else "Means over the frames", ("metric", *pipelines), rows)
    score = figure_text(figure, document["mean"][OURS][figure])
    parts = [Subsection("Ours and the ideal", (Front(comparisons[0], score, meaning, verdict(document), table),)), *below]
    if comparisons[1:]:
        title_of_others = "The worst and the best frame" if among > FRAMES_SHOWN else "Other frames"
        parts.append(Subsection(title_of_others, tuple(comparisons[1:])))
    of = f"{count} frames" if at is None else f"{counted(among, 'frame')} at {tidy(at)} cd/m² ({tidy(np.pi * at)} lux)"
    which = "" if count == 1 else f"The first picture is the frame with the median {FIGURES[figure].heading} of {of}."
    return Section(title, which, tuple(parts))


def verdict(document: dict[str, Any]) -> str:
    """Return one sentence per baseline, on the metrics and frames in which the table is closer to the ideal."""
    count, figure = len(document["frames"]), main_of(document)
    sentences = []
    for baseline, wins in document["better"].items():
        lost = [FIGURES[name].heading for name, won in wins.items() if 2 * won <= count]
        if all(won == count for won in wins.values()):
            often = ", in every frame" if count > 1 else ""
            sentences.append(f"Ours is closer to the ideal than {baseline} in every metric{often}.")
        elif 2 * wins[figure] > count:
            but = f", but not in {', '.join(lost)}" if lost else ""
            by = _in_frames(figure, wins[figure], count)
            sentences.append(f"Ours is closer to the ideal than {baseline} in {by}{but}.")
        else:
            worse = count - wins[figure]
            sentences.append(f"Ours is not closer to the ideal than {baseline} in {_in_frames(figure, worse, count)}.")
    return " ".join(sentences)


def _in_frames(figure: str, won: int, count: int) -> str:
    return FIGURES[figure].heading + (f" ({won} of {count} frames)" if count > 1 else "")


def _comparison(
    document: dict[str, Any], index: int, pictures: dict[str, Pixels], anchor: str, limit: int, jpeg: Jpeg
) -> Comparison:
    """Build the comparison of one frame: the table's picture, the ideal, the baselines, and the error map."""
    frame = document["frames"][index]
    light = f"{frame['illuminant']}{brightness(frame)}"
    title = f"Frame {index + 1}: {frame['scene']}, {light}, level {frame['level']:.3f}"
    ordered = sorted(pictures, key=lambda name: (name != OURS, name != "ideal", name == "error"))
    made = tuple(_picture(frame, name, pictures[name], main_of(document), limit, jpeg) for name in ordered)
    size = next(iter(pictures.values())).shape[:2]
    return Comparison(f"{anchor}-{index}", title, made, ERROR_KEY, (size[0], size[1]))


def _picture(frame: dict[str, Any], name: str, pixels: Pixels, figure: str, limit: int, jpeg: Jpeg) -> Picture:
    """Encode one picture of a frame in at most `limit` bytes, and write its caption."""
    uri, (rows, cols) = fitted(pixels, limit, jpeg)
    scale = pixels.shape[0] // rows
    reduced = f", shown at 1/{scale} of its size" if scale > 1 else ""
    if name == "ideal":
        shows = "the target"
    elif name == "error":
        shows = f"ΔE00 of ours at each pixel, mean {figure_text(figure, frame[OURS][figure])}"
    else:
        shows = f"{FIGURES[figure].heading} {main_figure(frame[name], figure)}"
    caption = f"{name}: {shows}{reduced}"
    return Picture(uri, rows, cols, caption, f"{frame['scene']}, {caption}")
