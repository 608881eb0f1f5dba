"""The section of a report with maps of the degree and angle of polarisation."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.physics.display import codes, srgb_curve
from l3cli.physics.figures import FIGURES, figure_text
from l3cli.physics.polarisation_colours import angle_colours, degree_colours
from l3cli.physics.stokes import dolp, stokes_of
from l3cli.report.evaluation import OURS, brightness, verdict
from l3cli.report.parts import Comparison, Front, Jpeg, Key, Picture, Pixels, Section, Subsection, Table, fitted
from l3cli.system.text import counted, tidy

Array = NDArray[np.floating]

FIGURE_OF = {"DoLP": "mean_dolp_error", "AoLP": "aolp_rmse", "S0": "psnr_s0"}  # metric in the captions of each map
TITLES = {"DoLP": "Degree of linear polarisation", "AoLP": "Angle of linear polarisation", "S0": "Intensity"}
SCALES = (0.1, 0.2, 0.5, 1.0)  # possible upper ends of the DoLP scale
BRIGHT_QUANTILE = 0.99  # quantile of the ideal picture's values that a scale must cover
KEY_STEPS = 4  # number of intervals in a colour key
Maps = dict[str, dict[str, Pixels]]  # name of the map → name of the pipeline, or "ideal" → picture


def polarisation_maps(target: Array, planes: dict[str, Array], outputs: tuple[str, ...]) -> tuple[Maps, float]:
    """Render maps of DoLP, AoLP and S0 for all pipelines.

    Parameters
    ----------
    target : ndarray, (output, row, col)
        Target of the frame.
    planes : dict of str to ndarray, (output, row, col)
        Outputs of each pipeline, in the unit of the target.
    outputs : tuple of str
        Names of the outputs.

    Returns
    -------
    dict
        8-bit sRGB pictures (row, col, 3) by map, then by pipeline or "ideal".
    float
        Upper end of the DoLP scale, at which the colours of the AoLP map are brightest.
    """
    stokes = {name: stokes_of(of, outputs).astype(np.float64) for name, of in {**planes, "ideal": target}.items()}
    ideal = stokes["ideal"]
    usual = float(np.quantile(dolp(ideal), BRIGHT_QUANTILE))
    scale = next((each for each in SCALES if usual <= each), SCALES[-1])
    white = max(float(np.quantile(ideal[0], BRIGHT_QUANTILE)), 1e-9)
    pictures: dict[str, Callable[[Array], Array]] = {
        "DoLP": lambda of: degree_colours(of, scale),
        "AoLP": lambda of: angle_colours(of, scale),
        "S0": lambda of: np.repeat(srgb_curve(np.clip(of[0] / white, 0, 1))[..., None], 3, axis=2),
    }
    maps = {kind: {name: codes(make(of), 8) for name, of in stokes.items()} for kind, make in pictures.items()}
    return maps, scale


def polarisation_section(
    document: dict[str, Any], maps: dict[int, tuple[Maps, float]], title: str, anchor: str, limit: int, jpeg: Jpeg
) -> Section:  # fmt: skip
    """Build the section at the top of a page about a table with Stokes parameters.

    The section shows all maps of the median frame with the mean metrics, and the DoLP maps of the other frames.

    Parameters
    ----------
    document : dict
        Output of `l3 evaluate --json`.
    maps : dict
        Results of `polarisation_maps` by frame index, for the frames from `shown_frames`, in the same order.
    title : str
        Title of the section.
    anchor : str
        Prefix of the HTML anchors of the comparisons.
    limit : int
        Maximum total size of all pictures in bytes.
    jpeg : callable
        JPEG encoder, see `parts.Jpeg`.
    """
    first, *others = maps
    shown = [(first, kind) for kind in FIGURE_OF] + [(index, "DoLP") for index in others]
    each = limit // sum(len(maps[index][0][kind]) for index, kind in shown)
    made = {(index, kind): _comparison(document, index, kind, maps[index], anchor, each, jpeg) for index, kind in shown}
    count, pipelines, figure = len(document["frames"]), document["pipelines"], FIGURE_OF["DoLP"]
    rows = tuple(
        (FIGURES[name].heading, *(figure_text(name, document["mean"][owner][name]) for owner in pipelines))
        for name in document["frames"][0][OURS]
    )
    over = "" if count == 1 else f", mean over {counted(count, 'frame')}"
    table = Table("Metrics" if count == 1 else "Means over the frames", ("metric", *pipelines), rows)
    score = figure_text(figure, document["mean"][OURS][figure])
    meaning = f"{FIGURES[figure].heading} of ours{over}."
    front = Front(made[first, "DoLP"], score, meaning, verdict(document), table)
    parts = [Subsection(TITLES["DoLP"], (front,))]
    parts += [Subsection(TITLES[kind], (made[first, kind],)) for kind in FIGURE_OF if kind != "DoLP"]
    if others:
        parts.append(Subsection("Other frames", tuple(made[index, "DoLP"] for index in others)))
    which = "" if count == 1 else f"The first frame is the frame with the median {FIGURES[figure].heading}."
    return Section(title, which, tuple(parts))


def _comparison(
    document: dict[str, Any], index: int, kind: str, maps: tuple[Maps, float], anchor: str, limit: int, jpeg: Jpeg
) -> Comparison:
    """Build the comparison of one map of a frame: the table ("ours"), the ideal, and the other pipelines."""
    frame, (pictures, scale) = document["frames"][index], maps
    title = f"{kind}, frame {index + 1}: {frame['scene']}, {frame['illuminant']}{brightness(frame)}"
    figure, made = FIGURE_OF[kind], []
    for name in sorted(pictures[kind], key=lambda name: (name != OURS, name != "ideal")):
        pixels = pictures[kind][name]
        uri, (rows, cols) = fitted(pixels, limit, jpeg)
        shows = "the target" if name == "ideal" else f"{FIGURES[figure].heading} {figure_text(figure, frame[name][figure])}"
        caption = f"{kind} of {name}: {shows}"
        made.append(Picture(uri, rows, cols, caption, f"{frame['scene']}, {caption}"))
    size = pictures[kind][OURS].shape[:2]
    return Comparison(f"{anchor}-{index}-{kind}", title, tuple(made), _key(kind, scale), (size[0], size[1]))


def _key(kind: str, scale: float) -> tuple[Key, ...]:
    """Return the colour key of a map. AoLP colours are shown for the DoLP at the upper end of the scale."""
    if kind == "S0":
        return ()
    steps = np.arange(KEY_STEPS + (kind == "DoLP")) / KEY_STEPS
    turn = 2 * np.pi * steps
    stokes = np.stack([np.ones_like(steps), scale * steps, 0 * steps])
    if kind == "AoLP":
        stokes = np.stack([np.ones_like(steps), scale * np.cos(turn), scale * np.sin(turn)])
    colours = codes(degree_colours(stokes, scale) if kind == "DoLP" else angle_colours(stokes, scale), 8)
    labels = [f"{tidy(scale * step)}" if kind == "DoLP" else f"{180 * step:g}°" for step in steps]
    if kind == "DoLP" and scale < 1:
        labels[-1] += " or more"
    labels[0] = f"{kind} {labels[0]}"
    return tuple(
        Key(label, "#{:02x}{:02x}{:02x}".format(*colour), "box") for label, colour in zip(labels, colours, strict=True)
    )
