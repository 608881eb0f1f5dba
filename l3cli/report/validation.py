"""Predictions of charts by a camera model: in the lab with the choice of its smoothing, or in photos with their
reliability; and the patches of a chart side by side: what each should be, what it became, and how far that is."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import ChartFit, Fit, PhotoFit, SweepFit, guessed_light
from l3cli.errors import RecipeError
from l3cli.frames.measurement import PATCH_NAMES
from l3cli.physics import spectra
from l3cli.physics.display import displayed, displayed_delta_e
from l3cli.report.colours import hex_colour, point_keys
from l3cli.report.drawing import WIDTH, Axis, Plot, box, sheet, spanning
from l3cli.report.parts import Block, Data, Details, Figure, Figures, Key, Subsection, Table, Text
from l3cli.system.text import counted, tidy, unit

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
    """Return (channel, 3) that turns `predicted` (patch, channel) into `ideal` (patch, 3) with the least error of what is
    measured, `residual` (patch, channel) apart: channels that are alike are not played off against one another."""
    noise = np.diag((residual**2).sum(axis=0))
    matrix: Array = np.linalg.pinv(predicted.T @ predicted + noise) @ predicted.T @ ideal
    return matrix


BANDS = {  # column of calibration's figures: heading here
    "curve ± 95 % (% of peak)": "curve ± 95 % (% of peak)",
    "colours ± 95 % (% of most)": "colours ± 95 % (% of the brightest)",
}


def validation_blocks(camera: CameraModel, fit: Fit, figures: dict[str, Any]) -> tuple[Block, ...]:
    """Return plots and tables of a camera's `fit`; `figures` as for `camera_section`."""
    graphs: list[Figure] = []
    if fit.validation is not None:
        graphs += _prediction_figures(camera, fit)
    if fit.sweep is not None:
        graphs += _smoothing_figure(fit.sweep)
    blocks: list[Block] = [Figures(tuple(graphs))] if graphs else []
    if fit.chart is not None and (drawn := calibration_figures(camera, fit.chart)):
        blocks.append(Figures(drawn))
    if figures["lights"]:
        blocks.append(table_of("Prediction of each chart", "chart", figures["lights"]))
    if figures["bands"]:
        blocks.append(table_of("Response to each band", "band", figures["bands"]))
    return tuple(blocks)


def table_of(caption: str, heading: str, rows: dict[str, dict[str, float]]) -> Table:
    """Return the rows of numbers by name, as calibration's figures hold them."""
    titles = tuple(next(iter(rows.values())))
    body = tuple(
        (name, *(f"{row[title]:.5f}" if title.startswith("R²") else tidy(row[title], 4) for title in titles))
        for name, row in rows.items()
    )
    return Table(caption, (heading, *map(unit, titles)), body)


def _prediction_figures(camera: CameraModel, fit: Fit) -> list[Figure]:
    assert fit.validation is not None
    measured, predicted = fit.validation.measured, fit.validation.predicted
    used = np.ones(measured.shape, bool) if fit.chart is not None or fit.series is None else fit.series.used
    if not used.any():
        return []
    keys, error = point_keys(camera), measured - predicted
    what = "chart patch" if isinstance(fit.validation, ChartFit) else "patch and exposure"
    top = max(float(measured[used].max()), float(predicted[used].max()))
    low = min(0.0, float(measured[used].min()), float(predicted[used].min()))
    one = Plot(Axis("predicted (DN)", low, 1.04 * top), Axis("measured (DN)", low, 1.04 * top), square=True)
    one.line(np.array([low, top]), np.array([low, top]), "var(--muted)", "dashed", 1)
    one.points(keys, predicted, measured, used)
    rest = Plot(Axis("predicted (DN)", low, 1.04 * top), spanning("measured − predicted (DN)", error[used]))
    rest.line(np.array([low, 1.04 * top]), np.zeros(2), "var(--muted)", "dashed", 1)
    rest.points(keys, predicted, error, used)
    fits = ", ".join(f"{n} {float(r):.5f}" for n, r in zip(camera.channels, fit.validation.r_squared, strict=True))
    scatter = f"{int(used.sum())} values, one for each {what} and channel. R²: {fits}."
    rmse = ", ".join(
        f"{n} {tidy(100 * float(r), 2)} %" for n, r in zip(camera.channels, fit.validation.relative_rmse, strict=True)
    )
    spread = f"RMSE relative to the mean signal: {rmse}; largest residual {tidy(float(np.abs(error[used]).max()))} DN."
    return [one.figure("Measured against predicted", scatter, keys), rest.figure("Residuals", spread, keys)]


def _smoothing_figure(sweep: SweepFit) -> list[Figure]:
    tried = sweep.smoothing > 0
    if tried.sum() < 2:
        return []
    delta, error = sweep.smoothing[tried], 100 * sweep.smoothing_error[tried]
    order = np.argsort(delta)
    plot = Plot(spanning("smoothing δ (1)", delta, log=True), spanning("cross-validated RMSE (%)", error, log=True))
    plot.line(delta[order], error[order], "var(--one)").dots(delta, error, "var(--one)", series="tried")
    chosen = float(sweep.chosen_smoothing)
    nearest = int(np.argmin(np.abs(np.log(delta / chosen)))) if chosen > 0 else int(np.argmin(error))
    plot.dots(delta[nearest : nearest + 1], error[nearest : nearest + 1], "var(--two)", size=10, opacity=1, series="chosen")
    finding = (
        f"δ = {tidy(chosen)} was chosen, the middle of the plateau; its cross-validated RMSE is "
        f"{tidy(float(error[nearest]))} %, the least of all tried {tidy(float(error.min()))} %."
    )
    keys = (Key("tried", "var(--one)", "dot"), Key("chosen", "var(--two)", "dot"))
    return [plot.figure("Choice of the smoothing", finding, keys)]


# --------------------------------------------------------------------------------------------------------- photos


def photo_subsections(camera: CameraModel, fit: PhotoFit, figures: dict[str, Any]) -> tuple[Subsection, ...]:
    """Return the parts of a camera made from photos; `figures` as for `camera_section`."""
    keys = point_keys(camera)
    return (
        Subsection("Photos of a chart", (_photos(figures), _lights(figures), *_left_out(figures))),
        Subsection("What to rely on", (_bands(camera, figures), *_reading(figures))),
        Subsection("Patches", tuple(Figures(_patches(fit, index, keys)) for index in range(len(fit.names)))),
    )


def photo_lead(fit: PhotoFit, figures: dict[str, Any]) -> str:
    """Return the uncertainties in a sentence."""
    curve, colours = (max(row[title] for row in figures["channels"].values()) for title in BANDS)
    many = "a photo" if len(fit.names) == 1 else f"{len(fit.names)} photos"
    return (
        f"Estimated from {many} of a chart: its curves stay uncertain (95 % within ± {tidy(curve, 2)} % of their peak), its "
        f"colours do not (± {tidy(colours, 2)} % of the brightest)."
    )


def _photos(figures: dict[str, Any]) -> Table:
    rows = [
        (
            name,
            photo["chart"],
            guessed_light(photo["probable lights"]) if photo["guessed"] else photo["light"],
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
                f"{name}: its light was not named, and is {guessed_light(photo['probable lights'])}; the bands include what "
                "these lights allow."
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
    source = "smoothness alone" if figures["prior"] == "smooth" else "the curves of measured cameras"
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


def _patches(fit: PhotoFit, index: int, keys: tuple[Key, ...]) -> tuple[Figure, Figure]:
    """Draw measured against predicted patches of one photo, and the difference of each."""
    used = fit.used[index]
    brightest = np.where(used, fit.measured[index], 0.0).max(axis=0)
    brightest = np.where(brightest > 0, brightest, 1.0)
    measured, predicted = (100.0 * values[index] / brightest for values in (fit.measured, fit.predicted))
    rest = np.where(used, measured - predicted, 0.0)
    one = Plot(Axis("predicted (% of the brightest)", 0, 106), Axis("measured (% of the brightest)", 0, 106), square=True)
    one.line(np.array([0.0, 106.0]), np.array([0.0, 106.0]), "var(--muted)", "dashed", 1)
    one.points(keys, predicted, measured, used)
    left = Plot(
        Axis("patch, row by row", 0.0, len(used) + 1.0),
        spanning("measured − predicted (% of the brightest)", np.append(rest, (-0.1, 0.1))),
    )
    left.line(np.array([0.0, len(used) + 1.0]), np.zeros(2), "var(--muted)", "dashed", 1)
    left.points(keys, np.indices(used.shape)[0] + 1.0, rest, used)
    patch, worst = map(int, np.unravel_index(int(np.abs(rest).argmax()), rest.shape))
    rms = ", ".join(f"{key.label} {tidy(100 * float(m), 2)} %" for key, m in zip(keys, fit.misfit[index], strict=True))
    fits = f"{int(used.sum())} values of {len(used)} patches, uneven light and glare in the prediction. Residual RMS: {rms}."
    largest = f"Largest: patch {patch + 1} in {keys[worst].label}, {tidy(float(rest[patch, worst]), 2)} %."
    return one.figure(f"Patches of {fit.names[index]}", fits, keys), left.figure("Residuals", largest, keys)
