"""The patches of a colour chart side by side: what each should be, what it became, and how far that is."""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import ChartFit
from l3cli.errors import RecipeError
from l3cli.frames.measurement import PATCH_NAMES
from l3cli.physics import spectra
from l3cli.physics.display import displayed, displayed_delta_e
from l3cli.report.colours import hex_colour
from l3cli.report.drawing import WIDTH, box, sheet
from l3cli.report.parts import Data, Figure, Table

Array = NDArray[np.floating]
COLUMNS = 6
CHARTS = 4  # of a calibration that are drawn
GAP, LINE = 10.0, 18.0  # between patches, and below them for their ΔE00


def patches_figure(title: str, names: tuple[str, str], pair: tuple[Array, Array], errors: dict[str, Array]) -> Figure:
    """Return the patches of a chart, row by row, each in two halves: `pair` are linear sRGB (patch, 3) of what `names` call
    them, the first on the left; `errors` (patch) are ΔE00 of the second from the first, and below it of others."""
    side = (WIDTH - 2 - GAP * (COLUMNS - 1)) / COLUMNS
    main, items = errors[names[1]], []
    for patch, error in enumerate(main.tolist()):
        x, y = 1 + patch % COLUMNS * (side + GAP), 1 + patch // COLUMNS * (side + LINE + GAP / 2)
        items.append(box(round(x, 1), round(y, 1), round(side, 1), round(side, 1), hex_colour(pair[0][patch])))
        half = round(x + side / 2, 1), round(y, 1), round(side / 2, 1), round(side, 1)
        items.append(box(*half, hex_colour(pair[1][patch])))
        items.append(f'<path class="axis" d="M{x:.1f},{y:.1f}h{side:.1f}v{side:.1f}h{-side:.1f}z"/>')
        items.append(f'<text x="{x + side / 2:.1f}" y="{y + side + 14:.1f}" text-anchor="middle">{error:.1f}</text>')
    rows = -(-len(main) // COLUMNS)
    worst = int(np.argmax(main))
    means = ", ".join(f"{name} {error.mean():.2f}" for name, error in errors.items())
    finding = (
        f"Left half: {names[0]}; right half: {names[1]}; below: ΔE00 between them. "
        f"Mean ΔE00 of {len(main)} patches: {means}; worst of {names[1]}: {PATCH_NAMES[worst]}, {main[worst]:.2f}."
    )
    drawing = sheet(WIDTH, round(rows * (side + LINE + GAP / 2) + 1), "".join(items), finding)
    data = Data(
        ("patch", f"sRGB, {names[0]}", f"sRGB, {names[1]}", *(f"ΔE00 of {name}" for name in errors)),
        tuple(
            (PATCH_NAMES[patch], *(hex_colour(of[patch]) for of in pair), *(float(of[patch]) for of in errors.values()))
            for patch in range(len(main))
        ),
    )
    return Figure(title, drawing, finding, data=data)


def patches_table(errors: dict[str, Array]) -> Table:
    """Return ΔE00 (patch) of every pipeline, patch by patch."""
    rows = tuple((name, *(f"{float(of[patch]):.2f}" for of in errors.values())) for patch, name in enumerate(PATCH_NAMES))
    return Table("ΔE00 of each patch", ("patch", *errors), rows)


def calibration_figures(camera: CameraModel, fit: ChartFit) -> tuple[Figure, ...]:
    """Return the patches of the first of a calibration's charts as measured beside as the model predicts them, in the
    colours into which one matrix turns the channels; none of charts under lights without a standard's name."""
    figures = []
    for light, measured, predicted in zip(fit.illuminants[:CHARTS], fit.measured, fit.predicted, strict=False):
        try:
            radiance = spectra.illuminant(light, camera.wavelength)
        except RecipeError:
            continue
        weights = spectra.xyz_weights(camera.wavelength) * radiance
        ideal = spectra.colorchecker(camera.wavelength)[1] @ weights.T / weights[1].sum()
        if len(ideal) != len(measured):
            continue
        matrix = _matrix(predicted - fit.beta, measured - predicted, ideal)
        white = weights.sum(axis=1) / weights[1].sum()
        one, other = (displayed(((values - fit.beta) @ matrix).T[:, None], white, 1.0) for values in (predicted, measured))
        names, errors = ("predicted", "measured"), {"measured": displayed_delta_e(other, one)[0]}
        figures.append(patches_figure(f"Chart under {light}", names, (one[0], other[0]), errors))
    return tuple(figures)


def _matrix(predicted: Array, residual: Array, ideal: Array) -> Array:
    """(channel, 3) that turns `predicted` (patch, channel) into `ideal` (patch, 3) with the least error of what is measured,
    `residual` (patch, channel) apart: channels that are alike are not played off against one another."""
    noise = np.diag((residual**2).sum(axis=0))
    matrix: Array = np.linalg.pinv(predicted.T @ predicted + noise) @ predicted.T @ ideal
    return matrix
