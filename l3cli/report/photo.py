"""Sections on a camera model made from photos of a chart: the photos, their reliability, and how the patches are
explained."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import PhotoFit
from l3cli.report.channels import MARKS
from l3cli.report.drawing import Axis, Plot, spanning
from l3cli.report.parts import Block, Details, Figure, Figures, Key, Subsection, Table, Text, counted, tidy

BANDS = {  # column of calibration's figures: heading here
    "curve ± 95 % (% of peak)": "curve ± 95 % (% of peak)",
    "colours ± 95 % (% of most)": "colours ± 95 % (% of the brightest)",
}
Array = NDArray[np.floating]


def photo_subsections(
    camera: CameraModel, fit: PhotoFit, figures: dict[str, Any], strokes: Sequence[str], keys: tuple[Key, ...]
) -> tuple[Subsection, ...]:
    """Return the parts of a camera made from photos. `figures` is what `l3 calibrate --json` says of the camera; `strokes`
    and `keys` are the channels' in all figures."""
    return (
        Subsection("Photos of a chart", (_photos(figures), _lights(figures), *_left_out(figures))),
        Subsection("What to rely on", (_bands(camera, figures), *_reading(figures))),
        Subsection("Patches", tuple(Figures(_patches(fit, index, strokes, keys)) for index in range(len(fit.names)))),
    )


def photo_lead(fit: PhotoFit, figures: dict[str, Any]) -> str:
    """Return the uncertainties in a sentence."""
    curve, colours = (max(row[title] for row in figures["channels"].values()) for title in BANDS)
    many = "a photo" if len(fit.names) == 1 else f"{len(fit.names)} photos"
    return (
        f"Estimated from {many} of a chart: its curves stay uncertain (95 % within ± {tidy(curve, 2)} % of their peak), its "
        f"colours do not (± {tidy(colours, 2)} % of the brightest)."
    )


def declared_from(camera: CameraModel) -> str:
    """Return the origin of the figures that were not measured: photos leave dark frames' figures at 0."""
    return "not measured, taken as 0" if "dark current" in camera.declared else "taken from the data sheet"


def without_bands(rows: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Return the figures of each channel that the bands are not among; none where there are no others."""
    others = {name: {title: value for title, value in row.items() if title not in BANDS} for name, row in rows.items()}
    return others if any(others.values()) else {}


def _photos(figures: dict[str, Any]) -> Table:
    rows = [
        (
            name,
            photo["chart"],
            f"{photo['light']}{' (guessed)' if photo['guessed'] else ''}",
            tidy(photo["uneven %"], 2),
            tidy(max(photo["glare %"]), 2),
            tidy(max(photo["misfit %"]), 2),
        )
        for name, photo in figures["photos"].items()
    ]
    units = ("uneven light (%)", "glare (% of the brightest)", "residual RMS (% of the brightest)")
    return Table(
        "Photos; glare and residual are those of the worst channel", ("photo", "chart", "light", *units), tuple(rows)
    )


def _lights(figures: dict[str, Any]) -> Text:
    """Return whether the stated lights are those that the patches look like, in words."""
    words = []
    for name, photo in figures["photos"].items():
        if photo["guessed"]:
            words.append(
                f"{name}: its light was guessed, of the usual ones the most probable; the bands include what others allow."
            )
        elif photo["deficit"] > 0:
            words.append(
                f"{name}: of the usual lights, {photo['nearest']} explains its patches best; {photo['light']} was named."
            )
        else:
            words.append(f"{name}: no usual light explains its patches better than {photo['light']}, which was named.")
    return Text(" ".join(words))


def _left_out(figures: dict[str, Any]) -> list[Block]:
    lines = figures["left out"]
    return [Details(f"{counted(len(lines), 'value')} of patches left out", "\n".join(lines))] if lines else []


def _bands(camera: CameraModel, figures: dict[str, Any]) -> Table:
    rows = [(name, *(tidy(figures["channels"][name][title], 3) for title in BANDS)) for name in camera.channels]
    return Table(
        "Half widths of the 95 % bands, RMS over wavelengths and surfaces", ("channel", *BANDS.values()), tuple(rows)
    )


def _reading(figures: dict[str, Any]) -> tuple[Text, Text]:
    further = figures["next light"]
    source = "the curves of measured cameras" if figures["prior"] == "measured cameras" else "smoothness alone"
    return (
        Text(
            "Curves stay uncertain, colours do not: the patches say little of a curve's details, which are filled in from "
            f"{source}, but much of the responses to other surfaces under other lights, of which pictures are made. The "
            "first column is the band drawn about the curves above."
        ),
        Text(
            f"One more photo of the chart would help most under {further['light']}: it would leave "
            f"{tidy(further['remaining %'], 2)} % of the error of the colours."
        ),
    )


def _patches(fit: PhotoFit, index: int, strokes: Sequence[str], keys: tuple[Key, ...]) -> tuple[Figure, Figure]:
    """Draw measured against predicted patches of one photo, and the difference of each."""
    used = fit.used[index]
    brightest = np.where(used, fit.measured[index], 0.0).max(axis=0)
    brightest = np.where(brightest > 0, brightest, 1.0)
    measured, predicted = (100.0 * values[index] / brightest for values in (fit.measured, fit.predicted))
    rest = np.where(used, measured - predicted, 0.0)
    one = Plot(Axis("predicted (% of the brightest)", 0, 106), Axis("measured (% of the brightest)", 0, 106), square=True)
    one.line(np.array([0.0, 106.0]), np.array([0.0, 106.0]), "var(--muted)", "dashed", 1)
    left = Plot(
        Axis("patch, row by row", 0.0, len(used) + 1.0),
        spanning("measured − predicted (% of the brightest)", np.append(rest, (-0.1, 0.1))),
    )
    left.line(np.array([0.0, len(used) + 1.0]), np.zeros(2), "var(--muted)", "dashed", 1)
    points = tuple(replace(key, mark=MARKS[key.mark]) for key in keys)
    for channel, (stroke, key) in enumerate(zip(strokes, points, strict=True)):
        here = np.flatnonzero(used[:, channel])
        one.dots(predicted[here, channel], measured[here, channel], stroke, key.mark, series=key.label)
        left.dots(here + 1.0, rest[here, channel], stroke, key.mark, series=key.label)
    patch, worst = map(int, np.unravel_index(int(np.abs(rest).argmax()), rest.shape))
    rms = ", ".join(f"{key.label} {tidy(100 * float(m), 2)} %" for key, m in zip(keys, fit.misfit[index], strict=True))
    fits = f"{int(used.sum())} values of {len(used)} patches, uneven light and glare in the prediction. Residual RMS: {rms}."
    largest = f"Largest: patch {patch + 1} in {keys[worst].label}, {tidy(float(rest[patch, worst]), 2)} %."
    return (
        Figure(f"Patches of {fit.names[index]}", one.svg(fits), fits, points, data=one.data()),
        Figure("Residuals", left.svg(largest), largest, points, data=left.data()),
    )
