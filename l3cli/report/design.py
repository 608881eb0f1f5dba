"""A design as a section: a verdict, arrays with their curves, error over light and by group, what training measured."""

import base64
import itertools

import numpy as np

from l3cli.artifacts.design import KINDS, Design, Truth
from l3cli.report.camera import array_figure, responsivity_figures
from l3cli.report.drawing import Plot, spanning
from l3cli.report.parts import Figure, Figures, Gallery, Jpeg, Picture, Section, Subsection, Table, Text

ROWS, DRAWN = 20, 5  # arrays in the table, and drawn
ENLARGED = 4  # times, crops of what training gives
MARKS = ("line", "dashed", "dotted", "line")


def design_section(design: Design, name: str, jpeg: Jpeg) -> Section:
    """Return the section of a design from the file `name`."""
    drawn = tuple(_figure(design, place) for place in design.best(DRAWN))
    library = design.camera(" ".join(design.filters), design.efficiency)
    parts = [
        Subsection("Arrays", (Table(design.caption, *design.table(ROWS)), Figures(drawn))),
        Subsection("Filters", (Figures(responsivity_figures(library)), _sensitivity(design))),
        Subsection("Error over light", (Figures((_over_light(design),)),)),
        Subsection("Error by group", (_groups(design),)),
    ]
    if tuned := design.tuned:
        parts.append(Subsection("Tuned filters", (Text(" ".join(tuned.words(design.levels))),)))
    if truth := design.truth:
        table = Table(" ".join(truth.agreement(design.levels)), *truth.table(design.levels))
        shown = (_pictures(design, truth, level, jpeg) for level in _two_levels(truth))
        parts.append(Subsection("Trained and judged on the same unseen scenes", (table, *shown)))
    return Section(f"Design: {design.name}", f"{' '.join(design.verdict)} From {name}.", tuple(parts))


def _figure(design: Design, place: int) -> Figure:
    drawn = array_figure(design.camera(design.patterns[place], design.efficiency))
    errors = ", ".join(f"{level} {error:.2f}" for level, error in zip(design.levels, design.predicted[place], strict=True))
    title = f"{place + 1}{' (Bayer)' if place == design.bayer else ''}"
    return Figure(title, drawn.svg, f"Predicted error: {errors}.", narrow=True, data=drawn.data)


def _sensitivity(design: Design) -> Table:
    used = design.patterns[0].split()
    changes = zip(design.filters, design.sensitivity, strict=True)
    rows = tuple((name, f"{100 * change:+.2f}") for name, change in changes if name in used)
    return Table("Change of the best array's error, %, if a filter lies 5 nm off", ("filter", "%"), rows)


def _over_light(design: Design) -> Figure:
    plot = Plot(
        spanning("luminance of white × time (cd s/m²)", design.dose, log=True),
        spanning(f"predicted error ({design.unit})", design.map_error, log=True),
    )
    series = {name: (design.dose, errors) for name, errors in zip(design.mapped, design.map_error, strict=True)}
    keys = plot.curves(series, MARKS, size=0)
    return plot.figure("Error over light", " ".join(design.crossings) or "One array leads at every light.", keys)


def _groups(design: Design) -> Table:
    """Return the errors of the best array and Bayer's in the groups of each kind."""
    places, rows = design.best(1), []
    for kind in itertools.chain(*KINDS):
        shares = design.share * [kind in group.split() for group in design.groups]
        if (share := shares.sum(axis=1)).any():  # (level)
            errors = (design.error[places] * shares).sum(axis=2) / np.where(share > 0, share, np.nan)  # (array, level)
            rows.append((kind, *(f"{each:.2f}" if np.isfinite(each) else "–" for each in errors.T.ravel())))
    headings = ("patches", *(f"{level}, {design.patterns[place]}" for level in design.levels for place in places))
    return Table(f"Predicted error ({design.unit}) by contrast, brightness and hue", headings, tuple(rows))


def _two_levels(truth: Truth) -> list[int]:
    """Return the levels with the least and the largest measured error."""
    errors = truth.measured[..., 0].mean(axis=0)
    return list(dict.fromkeys([int(errors.argmin()), int(errors.argmax())]))


def _pictures(design: Design, truth: Truth, level: int, jpeg: Jpeg) -> Gallery:
    """Return the crops of a level, enlarged: the ideal, the best arrays by what was measured, and Bayer's."""
    errors = truth.measured[:, level, 0]
    bayer = [truth.trained.index(design.patterns[design.bayer])] if design.bayer >= 0 else []
    crops = {"ideal": truth.ideals[level]}
    for place in (*errors.argsort(kind="stable").tolist()[:DRAWN], *bayer):
        crops[f"{truth.trained[place]}, ΔE00 {errors[place]:.2f}"] = truth.crops[place, level]
    pictures = []
    for name, crop in crops.items():
        large = np.ascontiguousarray(crop.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1))
        coded, caption = base64.b64encode(jpeg(large, 90)).decode(), f"{design.levels[level]}: {name}"
        rows, cols = large.shape[:2]
        pictures.append(Picture(f"data:image/jpeg;base64,{coded}", rows, cols, caption, f"{caption}, at {ENLARGED}×"))
    return Gallery(tuple(pictures), wide=True)
