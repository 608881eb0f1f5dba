"""The section of a report about a CFA design: the conclusion, the best CFAs, their filters and the predicted errors.

The section shows the errors by exposure and by group of patches. If tables were trained for some of the CFAs, the section
also contains their measured errors and crops of their pictures.
"""

import base64
import itertools

import numpy as np

from l3cli.artifacts.design import KINDS, Design, Truth
from l3cli.report.camera import array_figure, responsivity_figures
from l3cli.report.drawing import Plot, spanning
from l3cli.report.parts import Figure, Figures, Gallery, Jpeg, Picture, Section, Subsection, Table, Text

TABLE_ROWS, DRAWN_ARRAYS = 20, 5  # maximum number of CFAs in the table, and maximum number of drawn CFAs
ENLARGEMENT = 4  # magnification of the crops
MARKS = ("line", "dashed", "dotted", "line")  # line styles of successive CFAs in plots


def design_section(design: Design, name: str, jpeg: Jpeg) -> Section:
    """Build the section about a design.

    Parameters
    ----------
    design : Design
        The ranked CFAs.
    name : str
        File name of the design.
    jpeg : callable
        JPEG encoder, see `parts.Jpeg`.

    Returns
    -------
    Section
        Section with an introduction that names the best CFA.
    """
    drawn = tuple(_figure(design, place) for place in design.best(DRAWN_ARRAYS))
    library = design.camera(" ".join(design.filters), design.efficiency)
    parts = [
        Subsection("Arrays", (Table(design.caption, *design.table(TABLE_ROWS)), Figures(drawn))),
        Subsection("Filters", (Figures(responsivity_figures(library)), _sensitivity(design))),
        Subsection("Error by exposure", (Figures((_over_light(design),)),)),
        Subsection("Error by group of patches", (_groups(design),)),
    ]
    if tuned := design.tuned:
        parts.append(Subsection("Optimized filters", (Text(" ".join(tuned.words(design.levels))),)))
    if truth := design.truth:
        table = Table(" ".join(truth.agreement(design.levels)), *truth.table(design.levels))
        shown = (_pictures(design, truth, level, jpeg) for level in _two_levels(truth))
        parts.append(Subsection("Arrays that were trained and evaluated", (table, *shown)))
    return Section(f"Design: {design.name}", f"{' '.join(design.verdict)} From {name}.", tuple(parts))


def _figure(design: Design, place: int) -> Figure:
    """Draw a CFA, with its rank as the title and its predicted errors as the caption."""
    drawn = array_figure(design.camera(design.patterns[place], design.efficiency))
    errors = ", ".join(f"{level} {error:.2f}" for level, error in zip(design.levels, design.predicted[place], strict=True))
    title = f"{place + 1}{' (Bayer)' if place == design.bayer else ''}"
    return Figure(title, drawn.svg, f"Predicted error: {errors}.", narrow=True, data=drawn.data)


def _sensitivity(design: Design) -> Table:
    """Tabulate how much the best CFA's error changes if one of its filters is shifted by 5 nm."""
    used = design.patterns[0].split()
    changes = zip(design.filters, design.sensitivity, strict=True)
    rows = tuple((name, f"{100 * change:+.2f}") for name, change in changes if name in used)
    return Table("Change in the error of the best array if a filter is shifted by 5 nm", ("filter", "change (%)"), rows)


def _over_light(design: Design) -> Figure:
    """Plot the CFAs' predicted errors against exposure, the luminance of white times the exposure time."""
    plot = Plot(
        spanning("luminance of white × exposure time (cd s/m²)", design.dose, log=True),
        spanning(f"predicted error ({design.unit})", design.map_error, log=True),
    )
    series = {name: (design.dose, errors) for name, errors in zip(design.mapped, design.map_error, strict=True)}
    keys = plot.curves(series, MARKS, size=0)
    return plot.figure("Error by exposure", " ".join(design.crossings) or "One array is the best at every exposure.", keys)


def _groups(design: Design) -> Table:
    """Tabulate the predicted errors of the best CFA and the Bayer CFA by contrast, brightness and hue."""
    places, rows = design.best(1), []
    for kind in itertools.chain(*KINDS):
        shares = design.share * [kind in group.split() for group in design.groups]
        if (share := shares.sum(axis=1)).any():  # (level)
            errors = (design.error[places] * shares).sum(axis=2) / np.where(share > 0, share, np.nan)  # (CFA, level)
            rows.append((kind, *(f"{each:.2f}" if np.isfinite(each) else "–" for each in errors.T.ravel())))
    headings = ("patches", *(f"{level}, {design.patterns[place]}" for level in design.levels for place in places))
    return Table(f"Predicted error ({design.unit}) by contrast, brightness and hue", headings, tuple(rows))


def _two_levels(truth: Truth) -> list[int]:
    """Return the light levels with the smallest and the largest measured error, without duplicates."""
    errors = truth.measured[..., 0].mean(axis=0)
    return list(dict.fromkeys([int(errors.argmin()), int(errors.argmax())]))


def _pictures(design: Design, truth: Truth, level: int, jpeg: Jpeg) -> Gallery:
    """Show crops at one light level: the ideal, the CFAs with the lowest measured errors, and the Bayer CFA."""
    errors = truth.measured[:, level, 0]
    bayer = [truth.trained.index(design.patterns[design.bayer])] if design.bayer >= 0 else []
    crops = {"ideal": truth.ideals[level]}
    for place in (*errors.argsort(kind="stable").tolist()[:DRAWN_ARRAYS], *bayer):
        crops[f"{truth.trained[place]}, ΔE00 {errors[place]:.2f}"] = truth.crops[place, level]
    pictures = []
    for name, crop in crops.items():
        large = np.ascontiguousarray(crop.repeat(ENLARGEMENT, axis=0).repeat(ENLARGEMENT, axis=1))
        coded, caption = base64.b64encode(jpeg(large, 90)).decode(), f"{design.levels[level]}: {name}"
        rows, cols = large.shape[:2]
        pictures.append(Picture(f"data:image/jpeg;base64,{coded}", rows, cols, caption, f"{caption}, at {ENLARGEMENT}×"))
    return Gallery(tuple(pictures), wide=True)
