"""Draw the figures of docs/how-l3-works.md.

python docs/figures/figures.py                        # pipeline.svg
python docs/figures/figures.py table.h5 frame.tif     # pipeline.svg, neighbourhood.svg and filters.svg

The table is trained on `l3 simulate default --camera bayer` with the class recipe `default`. The frame is the raw frame
that `l3 simulate docs/gallery/scene.toml --camera bayer --pictures` writes.
"""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import l3cli as l3
from l3cli.artifacts.table import TransformTable
from l3cli.classes.names import class_words
from l3cli.frames.frame import RawFrame
from l3cli.report.colours import channel_light, hex_colour
from l3cli.system.files import write_whole

FOLDER = Path(__file__).parent
INK, PALE, LINE, PAPER = "#1b1f24", "#57606a", "#8c959f", "#ffffff"
STYLE = (
    "text{font:13px system-ui,'Segoe UI',Roboto,'DejaVu Sans',sans-serif;fill:#1b1f24}.small{font-size:11.5px;fill:#57606a}"
    ".head{font-weight:600}.code{font-family:ui-monospace,'DejaVu Sans Mono',monospace;font-size:12px;fill:#0969da}"
)
CENTRE = (60, 250)  # row and column of the pixel whose neighbourhood is drawn, at the edge of a bright bar
FILTER_LEVELS = (1, 4, 8)  # levels whose filters are drawn: dark, middle, bright
CELL = 24  # px, side of a pixel of the neighbourhood


class Box(NamedTuple):
    """A box for a file of the pipeline: position, title, and lines that describe the content."""

    x: float
    y: float
    title: str
    lines: tuple[str, ...]


BOX_WIDTH, BOX_HEIGHT = 176, 74  # px


def text(x: float, y: float, content: str, kind: str = "", anchor: str = "start") -> str:
    style = f' class="{kind}"' if kind else ""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}"{style}>{content}</text>'


def sheet(width: float, height: float, parts: Iterable[str], description: str) -> str:
    """Return the parts as an SVG file with styles and a white background."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}" '
        f'role="img"><title>{description}</title><style>{STYLE}</style><defs><marker id="tip" viewBox="0 0 8 8" refX="7" '
        f'refY="4" markerWidth="7" markerHeight="7" orient="auto"><path d="M0,0L8,4L0,8z" fill="{PALE}"/></marker></defs>'
        f'<rect width="{width:g}" height="{height:g}" rx="6" fill="{PAPER}"/>{"".join(parts)}</svg>\n'
    )


def arrow(x: float, y: float, to_x: float, to_y: float) -> str:
    return (
        f'<path d="M{x:g},{y:g}L{to_x:g},{to_y:g}" stroke="{PALE}" stroke-width="1.5" fill="none" marker-end="url(#tip)"/>'
    )


def file_box(box: Box, fill: str = "#f6f8fa") -> str:
    frame = (
        f'<rect x="{box.x:g}" y="{box.y:g}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="6" fill="{fill}" stroke="{LINE}"/>'
    )
    lines = "".join(text(box.x + 12, box.y + 43 + 17 * at, line, "small") for at, line in enumerate(box.lines))
    return frame + text(box.x + 12, box.y + 23, box.title, "head") + lines


def pipeline() -> str:
    """Return the drawing of the four stages and the files that they exchange."""
    left, middle, right = 20, 292, 564
    upper, lower = 24, 168
    boxes = (
        Box(left, upper, "what you have", ("lab data, chart photo,", "raw file or data sheet")),
        Box(middle, upper, "camera model", ("filters, responsivities,", "noise, optics")),
        Box(right, upper, "training set", ("raw frames, each with", "the ideal output")),
        Box(right, lower, "transform table", ("class rules and one linear", "filter per class")),
        Box(middle, lower, "output", ("picture, DNG, video", "or measurements")),
        Box(left, lower, "raw frame", ("from the real camera", "")),
    )
    x_gap, half = BOX_WIDTH + 4, BOX_HEIGHT / 2
    arrows = (
        arrow(left + x_gap, upper + half, middle - 4, upper + half),
        arrow(middle + x_gap, upper + half, right - 4, upper + half),
        arrow(right + BOX_WIDTH / 2, upper + BOX_HEIGHT + 4, right + BOX_WIDTH / 2, lower - 4),
        arrow(right - 4, lower + half, middle + x_gap, lower + half),
        f'<path d="M{left + BOX_WIDTH / 2:g},{lower + BOX_HEIGHT + 4:g}v24'
        f'H{(middle + x_gap + right) / 2:g}V{lower + half + 5:g}" '
        f'stroke="{PALE}" stroke-width="1.5" fill="none" marker-end="url(#tip)"/>',
    )
    between = BOX_WIDTH + (middle - left - BOX_WIDTH) / 2
    labels = (
        text(left + between, upper + half - 9, "l3 calibrate", "code", "middle"),
        text(middle + between, upper + half - 9, "l3 simulate", "code", "middle"),
        text(middle + between, upper + half + 20, "scenes, lights", "small", "middle"),
        text(right + BOX_WIDTH / 2 + 10, (upper + BOX_HEIGHT + lower) / 2 + 4, "l3 train", "code"),
        text(right + BOX_WIDTH / 2 - 10, (upper + BOX_HEIGHT + lower) / 2 + 4, "class recipe", "small", "end"),
        text(middle + between, lower + half - 9, "l3 render", "code", "middle"),
    )
    about = (
        "The pipeline: calibrate gives a camera model, simulate a training set, train a transform table, render a picture."
    )
    return sheet(760, 290, (*map(file_box, boxes), *arrows, *labels), about)


def filter_colours(table: TransformTable) -> list[str]:
    """Return a background colour for each channel, pale enough for numbers to be legible."""
    assert table.camera is not None
    light = channel_light(table.camera)
    return [hex_colour(0.55 + 0.45 * each / each.max()) for each in light]


def channel_at(table: TransformTable, row: int, col: int) -> int:
    rows, cols = table.cfa.shape
    return int(table.cfa[row % rows, col % cols])


def neighbourhood(table: TransformTable, frame: RawFrame, renderer: l3.Renderer) -> str:
    """Return the drawing of the raw values around a pixel, and of the features that determine the class of the pixel."""
    colours, (row, col), radius = filter_colours(table), CENTRE, table.first.rule.radius
    side = 2 * radius + 1
    parts = []
    for i in range(side):
        for j in range(side):
            at_row, at_col = row + i - radius, col + j - radius
            x, y = 20 + j * CELL * 1.5, 44 + i * CELL * 1.25
            fill = colours[channel_at(table, at_row, at_col)]
            parts.append(
                f'<rect x="{x:g}" y="{y:g}" width="{CELL * 1.5:g}" height="{CELL * 1.25:g}" fill="{fill}" stroke="{PAPER}"/>'
            )
            parts.append(text(x + CELL * 0.75, y + CELL * 0.8, str(int(frame.values[at_row, at_col])), "small", "middle"))
    x, y = 20 + radius * CELL * 1.5, 44 + radius * CELL * 1.25
    parts.append(
        f'<rect x="{x:g}" y="{y:g}" width="{CELL * 1.5:g}" height="{CELL * 1.25:g}" fill="none" stroke="{INK}" '
        'stroke-width="2.5"/>'
    )
    index = int(renderer.labels(frame)[row, col])
    site_row, site_col = row % table.cfa.shape[0], col % table.cfa.shape[1]
    words = class_words(table, index)
    features = [("site", f"({site_row}, {site_col}), a {table.channels[channel_at(table, row, col)]} filter")]
    features += [(name, value) for name, value in words.items() if value != "not distinguished"]
    features = [(name, f"values change {value}" if name == "direction" else value) for name, value in features]
    left = 20 + side * CELL * 1.5 + 34
    parts.append(text(20, 28, f"x: {side}×{side} raw values (DN)", "head"))
    parts.append(text(left, 28, "features", "head"))
    for at, (name, value) in enumerate(features):
        parts.append(text(left, 66 + 44 * at, name, "head"))
        parts.append(text(left, 84 + 44 * at, value, "small"))
    below = 66 + 44 * len(features) + 8
    parts.append(text(left, below, f"k: class {index} of {len(table.first.weights)}", "head"))
    parts.append(text(left, below + 22, "o = T_k x + b_k", "code"))
    width, height = left + 320, max(44 + side * CELL * 1.25 + 20, below + 44)
    return sheet(width, height, parts, "A neighbourhood of 9×9 raw values, and the features that decide its class.")


def filter_of(table: TransformTable, level: int, output: str) -> NDArray[np.float32]:
    """Return the filter (row, col) of an output at the first site, for the class of uniform white areas at a level."""
    rule = table.first.rule
    index = rule.join(level, 0, rule.chromas - 1)
    return table.first.weights[index, table.outputs.index(output)].reshape(rule.patch, rule.patch)


def diverging(value: float) -> str:
    """Return a colour: red for -1, white for 0, blue for 1."""
    end = np.array([33, 102, 172]) if value > 0 else np.array([178, 24, 43])
    red, green, blue = np.rint(255 + (end - 255) * min(abs(value), 1.0)).astype(int)
    return f"#{red:02x}{green:02x}{blue:02x}"


def filters(table: TransformTable) -> str:
    """Return the drawing of the filters of a table, with one row per class and one column per output."""
    side, cell, gap = table.first.rule.patch, 15, 28
    size = side * cell
    left, top = 130, 62
    parts = [text(left, 24, "T_k: weights of each class, output by output", "head")]
    parts += [
        text(left + at * (size + gap) + size / 2, 50, output, "head", "middle") for at, output in enumerate(table.outputs)
    ]
    bounds = ("dark", "middle", "bright")
    for at, (level, name) in enumerate(zip(FILTER_LEVELS, bounds, strict=True)):
        y = top + at * (size + gap)
        parts.append(text(20, y + size / 2 - 4, f"level {level}", "head"))
        parts.append(text(20, y + size / 2 + 14, f"{name}, uniform", "small"))
        for number, output in enumerate(table.outputs):
            weights = filter_of(table, level, output)
            shares = weights / np.abs(weights).max()
            x = left + number * (size + gap)
            for i, j in np.ndindex(weights.shape):
                fill = diverging(float(shares[i, j]))
                parts.append(
                    f'<rect x="{x + j * cell:g}" y="{y + i * cell:g}" width="{cell}" height="{cell}" fill="{fill}" '
                    'stroke="#eaeef2"/>'
                )
            middle = (side // 2) * cell
            parts.append(
                f'<rect x="{x + middle:g}" y="{y + middle:g}" width="{cell}" height="{cell}" fill="none" stroke="{INK}" '
                'stroke-width="2"/>'
            )
    foot = top + len(FILTER_LEVELS) * (size + gap)
    count = len(table.first.weights)
    parts.append(
        text(20, foot + 8, f"… {count} classes in all. Blue adds, red subtracts. Each square has its own scale.", "small")
    )
    width = left + len(table.outputs) * (size + gap)
    return sheet(width, foot + 26, parts, "The filters of three classes for the outputs X, Y and Z.")


def main(arguments: list[str]) -> None:
    write_whole(FOLDER / "pipeline.svg", pipeline().encode())
    if not arguments:
        return
    table_file, frame_file = arguments
    table = l3.load_table(table_file)
    frame = l3.read_raw(frame_file, table)
    renderer = l3.Renderer(table, backend="reference")
    write_whole(FOLDER / "neighbourhood.svg", neighbourhood(table, frame, renderer).encode())
    write_whole(FOLDER / "filters.svg", filters(table).encode())


if __name__ == "__main__":
    main(sys.argv[1:])
