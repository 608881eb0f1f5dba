"""A design as a section: a verdict, arrays with their curves, error over light and by group, what training measured."""

import base64
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import Design, Truth
from l3cli.report.camera import array_figure, responsivity_figures
from l3cli.report.drawing import SERIES, Plot, spanning
from l3cli.report.parts import Figure, Figures, Gallery, Jpeg, Key, Picture, Section, Subsection, Table

ROWS, DRAWN = 20, 5  # arrays in the table, and drawn
ENLARGED = 4  # times, crops of what training gives

MARKS = ("line", "dashed", "dotted", "line")


@dataclass(frozen=True)
class _Drawn:
    """An array of a design as drawings of cameras take it."""

    channels: tuple[str, ...]
    cfa: NDArray[np.uint8]
    wavelength: NDArray[np.float64]
    responsivity: NDArray[np.float64]
    responsivity_band: NDArray[np.float64]
    absolute: bool = True


def design_section(design: Design, name: str, jpeg: Jpeg) -> Section:
    """Return the section of a design from the file `name`."""
    parts = [
        Subsection("Arrays", (_arrays(design), Figures(tuple(_figure(design, place) for place in _drawn(design))))),
        Subsection("Filters", (Figures(responsivity_figures(_library(design))), _sensitivity(design))),
        Subsection("Error over light", (Figures((_over_light(design),)),)),
        Subsection("Error by group", (_groups(design),)),
    ]
    if design.truth is not None:
        shown = [_pictures(design, design.truth, level, jpeg) for level in _two_levels(design.truth)]
        parts.append(Subsection("Trained and judged on the same unseen scenes", (_truth(design), *shown)))
    return Section(f"Design: {design.name}", f"{' '.join(design.verdict)} From {name}.", tuple(parts))


def _drawn(design: Design) -> list[int]:
    return list(dict.fromkeys([*range(min(DRAWN, len(design.patterns))), *([design.bayer] if design.bayer >= 0 else [])]))


def _library(design: Design) -> _Drawn:
    count = len(design.filters)
    return _Drawn(
        design.filters, np.arange(count, dtype=np.uint8)[None], design.wavelength, design.efficiency, 0 * design.efficiency
    )


def _figure(design: Design, place: int) -> Figure:
    rows = [row.split() for row in design.patterns[place].split(" / ")]
    used = [index for index, name in enumerate(design.filters) if any(name in row for row in rows)]
    names = tuple(design.filters[index] for index in used)
    cfa = np.array([[names.index(name) for name in row] for row in rows], np.uint8)
    curves = design.efficiency[used]
    drawn = array_figure(_Drawn(names, cfa, design.wavelength, curves, 0 * curves))
    errors = ", ".join(f"{level} {error:.2f}" for level, error in zip(design.levels, design.predicted[place], strict=True))
    title = f"{place + 1}{' (Bayer)' if place == design.bayer else ''}"
    return Figure(title, drawn.svg, f"Predicted error: {errors}.", narrow=True, data=drawn.data)


def _arrays(design: Design) -> Table:
    rows = [
        (
            f"{place + 1}{'=' if design.ties[place] else ''}",
            design.patterns[place],
            *(f"{error:.3f}" for error in design.predicted[place]),
            *(f"{error:.3f}" if error else "–" for error in design.dyes[place]),
        )
        for place in list(dict.fromkeys([*range(min(ROWS, len(design.patterns))), *_drawn(design)]))
    ]
    headings = ("", "array", *design.levels, *(f"{level}, Bayer of its filters" for level in design.levels))
    caption = f"Predicted error ({design.unit}) of {design.tried} arrays, best first; =: a tie with the best"
    return Table(caption, headings, tuple(rows))


def _sensitivity(design: Design) -> Table:
    rows = [
        (name, f"{100 * change:+.2f}")
        for name, change in zip(design.filters, design.sensitivity, strict=True)
        if name in design.patterns[0].split()
    ]
    return Table("Change of the best array's error, %, if a filter lies 5 nm off", ("filter", "%"), tuple(rows))


def _over_light(design: Design) -> Figure:
    plot = Plot(
        spanning("luminance of white × time (cd s/m²)", design.dose, log=True),
        spanning(f"predicted error ({design.unit})", design.map_error, log=True),
    )
    keys = []
    for number, (name, errors) in enumerate(zip(design.mapped, design.map_error, strict=True)):
        colour, mark = SERIES[number % len(SERIES)], MARKS[number % len(MARKS)]
        plot.line(design.dose, errors, colour, mark, series=name)
        keys.append(Key(name, colour, mark))
    return plot.figure("Error over light", " ".join(design.crossings) or "One array leads at every light.", tuple(keys))


def _groups(design: Design) -> Table:
    shown = [0] if design.bayer in (-1, 0) else [0, design.bayer]
    headings = ["group", *(f"{level}, {design.patterns[place]}" for level in design.levels for place in shown)]
    rows = [
        (group, *(f"{design.error[place, level, n]:.2f}" for level in range(len(design.levels)) for place in shown))
        for n, group in enumerate(design.groups)
        if design.share[0, n] > 0
    ]
    caption = f"Predicted error ({design.unit}) by brightness and contrast of the neighbourhood"
    return Table(caption, tuple(headings), tuple(rows))


def _truth(design: Design) -> Table:
    truth = design.truth
    assert truth is not None
    rows = [
        (
            name.replace(" ", "\N{NO-BREAK SPACE}"),
            *(f"{value:.2f}" for pair in zip(expected, measured[:, 0], strict=True) for value in pair),
        )
        for name, expected, measured in zip(truth.trained, truth.expected, truth.measured, strict=True)
    ]
    ranks = "; ".join(f"{level} {truth.in_words(place)}" for place, level in enumerate(design.levels))
    headings = ("array", *(f"{level}, {what}" for level in design.levels for what in ("predicted", "ΔE00")))
    return Table(f"Predicted and measured error; rank correlation {ranks}", headings, tuple(rows))


def _two_levels(truth: Truth) -> list[int]:
    """Return the levels with the least and the largest measured error."""
    errors = truth.measured[..., 0].mean(axis=0)
    return list(dict.fromkeys([int(errors.argmin()), int(errors.argmax())]))


def _pictures(design: Design, truth: Truth, level: int, jpeg: Jpeg) -> Gallery:
    """Return the crops of a level, enlarged: the ideal, the best arrays by what was measured, and Bayer's."""
    order = truth.measured[:, level, 0].argsort(kind="stable").tolist()
    bayer = [truth.trained.index(design.patterns[design.bayer])] if design.bayer >= 0 else []
    best = list(dict.fromkeys([*order[:DRAWN], *bayer]))
    crops = {"ideal": truth.ideals[level]}
    crops |= {
        f"{truth.trained[place]}, ΔE00 {truth.measured[place, level, 0]:.2f}": truth.crops[place, level] for place in best
    }
    pictures = []
    for name, crop in crops.items():
        large = crop.repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)
        coded = base64.b64encode(jpeg(np.ascontiguousarray(large), 90)).decode()
        caption = f"{design.levels[level]}: {name}"
        rows, cols = large.shape[:2]
        pictures.append(Picture("data:image/jpeg;base64," + coded, rows, cols, caption, f"{caption}, at {ENLARGED}×"))
    return Gallery(tuple(pictures), wide=True)
