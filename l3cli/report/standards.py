"""Figures of standards as part of an evaluation's section: sharpness across edges, signal over noise over lux."""

from typing import Any

import numpy as np

from l3cli.physics.figures import FIGURES, figure_text
from l3cli.report.drawing import Axis, Plot, spanning
from l3cli.report.parts import Block, Figure, Figures, Table, Text
from l3cli.system.text import tidy

DIRECTIONS = {"rows": "along rows", "columns": "along columns"}
NYQUIST = 0.5


def standard_blocks(standards: dict[str, Any], height: int) -> tuple[Block, ...]:
    """Return plots and a table of the part "standards" of an evaluation; `height`: rows of the camera's pictures."""
    edges, grey = standards["edge"], standards["grey"]
    figures = [_edge_figure(edges[across], DIRECTIONS[across]) for across in edges]
    if grey:
        figures.append(_grey_figure(grey))
    heads, rows = ["pipeline"], []
    names = list(next(iter(standards["figures"].values())))
    for name in names:
        heads.append(FIGURES[name].heading)
        heads += ["… line widths a picture height"] if name.startswith("mtf50") else []
    for owner, values in standards["figures"].items():
        row = [owner]
        for name in names:
            row.append(figure_text(name, values[name]))
            value = values[name]
            row += [("–" if value is None else f"{2 * height * value:.0f}")] if name.startswith("mtf50") else []
        rows.append(tuple(row))
    return (Figures(tuple(figures)), Table("By standards", tuple(heads), tuple(rows)), Text(_meaning(standards, height)))


def _meaning(standards: dict[str, Any], height: int) -> str:
    grey, chart = standards["grey"], standards["chart"]
    text = (
        "MTF50: frequency at which the contrast of a slanted edge of 4:1, without noise, is halved (ISO 12233); a picture "
        f"height is {height} rows."
    )
    if chart:
        text += f" ΔE00 by the camera's uncertainty: mean of a chart by {chart['cameras']} cameras that its bands allow."
    if grey is None:
        return f"{text} Curves of the camera are relative: nothing is known over lux."
    raw = "; ".join(
        f"{name} {figure_text('snr10', grey['snr10']['closed_form'][name])} in closed form, "
        f"{figure_text('snr10', grey['snr10']['raw'][name])} measured"
        for name in grey["closed_form"]
    )
    return (
        f"{text} SNR10: least illuminance at which the brightness of a grey of {100 * grey['reflectance']:.0f} % under "
        f"{grey['light']} has a signal-to-noise ratio of 10 at f/{grey['f_number']:g}, {1000 * grey['exposure']:.0f} ms, "
        f"pixels of {tidy(1e6 * grey['pixel_pitch'])} µm. Of raw values, in lux: {raw}."
    )


def _edge_figure(edge: dict[str, Any], direction: str) -> Figure:
    frequency = np.array(edge["frequency"])
    curves = {name: np.array(values) for name, values in edge["mtf"].items() if values}
    most = max(1.0, *(float(values.max()) for values in curves.values()))
    plot = Plot(Axis("frequency (cycles/pixel)", 0.0, float(frequency[-1])), Axis("contrast left (1)", 0.0, 1.04 * most))
    plot.line(np.array([NYQUIST, NYQUIST]), np.array([0.0, most]), "currentColor", "dotted", 1.0)
    keys = plot.curves(
        {name: (frequency, values) for name, values in curves.items()}, ("dashed", "line", "dotted", "line"), size=0
    )
    halves = ", ".join(f"{name} {figure_text('mtf50_rows', value)}" for name, value in edge["mtf50"].items())
    return plot.figure(f"Sharpness {direction}", f"MTF50 in cycles/pixel: {halves}. Dotted: what pixels can resolve.", keys)


def _grey_figure(grey: dict[str, Any]) -> Figure:
    lux = np.array(grey["lux"])
    best = max(grey["closed_form"], key=lambda name: grey["closed_form"][name][-1])
    curves = {name: np.array(values) for name, values in grey["pipelines"].items()}
    raw, closed = np.array(grey["raw"][best]), np.array(grey["closed_form"][best])
    everything = np.concatenate([raw, closed, *curves.values()])
    plot = Plot(spanning("illuminance (lux)", lux, log=True), spanning("signal over noise (1)", everything, log=True))
    plot.line(lux[[0, -1]], np.array([10.0, 10.0]), "currentColor", "dotted", 1.0)
    keys = plot.curves({name: (lux, values) for name, values in curves.items()}, ("line", "dashed", "dotted"))
    keys += plot.curves({f"raw {best}, closed form": (lux, closed)}, ("dashed",), size=0, width=1.2)
    plot.dots(lux, raw, "currentColor", "plus", series=f"raw {best}, measured")
    least = ", ".join(f"{name} {figure_text('snr10', grey['snr10'][name])}" for name in curves)
    return plot.figure("Signal over noise of a grey", f"SNR10 in lux: {least}. Plus signs: raw {best}, measured.", keys)
