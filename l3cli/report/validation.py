"""The validation of a camera model in a report: how well it predicts the charts to which it was fitted.

For lab measurements, this includes the choice of the smoothing. For photos, it includes the uncertainty of curves and
colours. A chart is drawn patch by patch: the ideal colour, the actual colour, and the difference.
"""

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
PATCHES_PER_ROW = 6
MAX_CHARTS = 4  # maximum number of charts drawn for a calibration
PATCH_GAP, TEXT_HEIGHT = 10.0, 18.0  # px; gap between patches, and height of the text below each patch


def patches_figure(title: str, names: tuple[str, str], pair: tuple[Array, Array], errors: dict[str, Array]) -> Figure:
    """Draw the patches of a chart in rows, each split into two halves, with the ΔE00 below.

    Parameters
    ----------
    title : str
        Title of the figure.
    names : tuple of str
        Names of the left and the right halves.
    pair : tuple of ndarray, (patch, 3)
        Linear sRGB of the left and the right halves.
    errors : dict of str to ndarray, (patch,)
        ΔE00 between the left half of each patch and this picture. The values of `names[1]` are written below the patches.
        Other entries, such as other pipelines, appear in the finding and the data.

    Returns
    -------
    Figure
        The drawing, with mean and worst ΔE00 in its finding.
    """
    side = (WIDTH - 2 - PATCH_GAP * (PATCHES_PER_ROW - 1)) / PATCHES_PER_ROW
    main, items = errors[names[1]], []
    for patch, error in enumerate(main.tolist()):
        x, y = (
            1 + patch % PATCHES_PER_ROW * (side + PATCH_GAP),
            1 + patch // PATCHES_PER_ROW * (side + TEXT_HEIGHT + PATCH_GAP / 2),
        )
        items.append(box(round(x, 1), round(y, 1), round(side, 1), round(side, 1), hex_colour(pair[0][patch])))
        half = round(x + side / 2, 1), round(y, 1), round(side / 2, 1), round(side, 1)
        items.append(box(*half, hex_colour(pair[1][patch])))
        items.append(f'<path class="axis" d="M{x:.1f},{y:.1f}h{side:.1f}v{side:.1f}h{-side:.1f}z"/>')
        items.append(f'<text x="{x + side / 2:.1f}" y="{y + side + 14:.1f}" text-anchor="middle">{error:.1f}</text>')
    rows = -(-len(main) // PATCHES_PER_ROW)
    worst = int(np.argmax(main))
    means = ", ".join(f"{name} {error.mean():.2f}" for name, error in errors.items())
    finding = (
        f"Left half: {names[0]}. Right half: {names[1]}. Below: ΔE00 between them. "
        f"Mean ΔE00 of {len(main)} patches: {means}; worst of {names[1]}: {PATCH_NAMES[worst]}, {main[worst]:.2f}."
    )
    drawing = sheet(WIDTH, round(rows * (side + TEXT_HEIGHT + PATCH_GAP / 2) + 1), "".join(items), finding)
    data = Data(
        ("patch", f"sRGB, {names[0]}", f"sRGB, {names[1]}", *(f"ΔE00 of {name}" for name in errors)),
        tuple(
            (PATCH_NAMES[patch], *(hex_colour(of[patch]) for of in pair), *(float(of[patch]) for of in errors.values()))
            for patch in range(len(main))
        ),
    )
    return Figure(title, drawing, finding, data=data)


def patches_table(errors: dict[str, Array]) -> Table:
    """Make a table of the ΔE00 of every pipeline for each patch. `errors` is the same as for `patches_figure`."""
    rows = tuple((name, *(f"{float(of[patch]):.2f}" for of in errors.values())) for patch, name in enumerate(PATCH_NAMES))
    return Table("ΔE00 of each patch", ("patch", *errors), rows)


def calibration_figures(camera: CameraModel, fit: ChartFit) -> tuple[Figure, ...]:
    """Draw the charts of a calibration as measured, beside the prediction of the model.

    Channels are converted to colours with one matrix per chart. Charts whose illuminant is not a named standard illuminant
    are omitted, because their ideal colours are unknown.

    Parameters
    ----------
    camera : CameraModel
        Supplies the wavelengths.
    fit : ChartFit
        Measured and predicted values. The first MAX_CHARTS charts are drawn.

    Returns
    -------
    tuple of Figure
        One figure per chart.
    """
    figures = []
    for light, measured, predicted in zip(fit.illuminants[:MAX_CHARTS], fit.measured, fit.predicted, strict=False):
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
    """Fit the matrix (channel, 3) from channels to XYZ.

    The residuals between measurement and prediction act as noise in the least squares fit. They prevent the matrix from
    amplifying the difference between two similar channels.
    """
    noise = np.diag((residual**2).sum(axis=0))
    matrix: Array = np.linalg.pinv(predicted.T @ predicted + noise) @ predicted.T @ ideal
    return matrix


BANDS = {  # key in the document of `l3 calibrate --json` → heading in the report
    "curve ± 95 % (% of peak)": "curve ± 95 % (% of peak)",
    "colours ± 95 % (% of most)": "colours ± 95 % (% of the brightest)",
}


def validation_blocks(camera: CameraModel, fit: Fit, figures: dict[str, Any]) -> tuple[Block, ...]:
    """Build the plots and tables that validate a fitted camera.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    fit : Fit
        Its fit to measurements.
    figures : dict
        The document that `l3 calibrate --json` prints.

    Returns
    -------
    tuple of Block
        Prediction, residuals and smoothing, charts, and tables per chart and per band, as far as the fit has them.
    """
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
    """Make a table from named rows of numbers, as `l3 calibrate --json` prints them."""
    titles = tuple(next(iter(rows.values())))
    body = tuple(
        (name, *(f"{row[title]:.5f}" if title.startswith("R²") else tidy(row[title], 4) for title in titles))
        for name, row in rows.items()
    )
    return Table(caption, (heading, *map(unit, titles)), body)


def _prediction_figures(camera: CameraModel, fit: Fit) -> list[Figure]:
    """Plot measured against predicted values, and the residuals."""
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
    scatter = f"{int(used.sum())} values, one per {what} and channel. R²: {fits}."
    rmse = ", ".join(
        f"{n} {tidy(100 * float(r), 2)} %" for n, r in zip(camera.channels, fit.validation.relative_rmse, strict=True)
    )
    spread = f"RMSE relative to the mean signal: {rmse}; largest residual {tidy(float(np.abs(error[used]).max()))} DN."
    return [one.figure("Measured against predicted", scatter, keys), rest.figure("Residuals", spread, keys)]


def _smoothing_figure(sweep: SweepFit) -> list[Figure]:
    """Plot the cross-validated error against the smoothing δ. There is no plot if fewer than two values were tried."""
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
        f"δ = {tidy(chosen)} was chosen, which is the middle of the plateau. Its cross-validated RMSE is "
        f"{tidy(float(error[nearest]))} %; the lowest RMSE of all δ tried is {tidy(float(error.min()))} %."
    )
    keys = (Key("tried", "var(--one)", "dot"), Key("chosen", "var(--two)", "dot"))
    return [plot.figure("Choice of the smoothing", finding, keys)]


# --------------------------------------------------------------------------------------------------------- photos


def photo_subsections(camera: CameraModel, fit: PhotoFit, figures: dict[str, Any]) -> tuple[Subsection, ...]:
    """Build the subsections of a camera fitted to photos of a chart.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    fit : PhotoFit
        Measured and predicted patches of each photo.
    figures : dict
        The document that `l3 calibrate --json` prints.

    Returns
    -------
    tuple of Subsection
        The photos, the uncertainty of curves and colours, and the patches of each photo.
    """
    keys = point_keys(camera)
    return (
        Subsection("Photos of a chart", (_photos(figures), _lights(figures), *_left_out(figures))),
        Subsection("What to rely on", (_bands(camera, figures), *_reading(figures))),
        Subsection("Patches", tuple(Figures(_patches(fit, index, keys)) for index in range(len(fit.names)))),
    )


def photo_lead(fit: PhotoFit, figures: dict[str, Any]) -> str:
    """Summarize the uncertainty of curves and colours in a sentence."""
    curve, colours = (max(row[title] for row in figures["channels"].values()) for title in BANDS)
    many = "a photo" if len(fit.names) == 1 else f"{len(fit.names)} photos"
    return (
        f"Estimated from {many} of a chart: its curves stay uncertain (95 % within ± {tidy(curve, 2)} % of their peak), but "
        f"its colours do not (± {tidy(colours, 2)} % of the brightest)."
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
    return Table("Photos, with glare and residual of the worst channel", ("photo", "chart", "light", *units), tuple(rows))


def _lights(figures: dict[str, Any]) -> Text:
    """Say for each photo whether the given illuminant fits its patches."""
    words = []
    for name, photo in figures["photos"].items():
        if photo["guessed"]:
            words.append(
                f"{name}: the illuminant was not given; it is {guessed_light(photo['probable lights'])}. The bands "
                "include the uncertainty of the illuminant."
            )
        elif photo["deficit"] > 0:
            words.append(
                f"{name}: {photo['nearest']} explains its patches best among the common illuminants; "
                f"{photo['light']} was given."
            )
        else:
            words.append(f"{name}: no common illuminant explains its patches better than {photo['light']}, which was given.")
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
    """Explain how to read the bands, and which additional photo would help most."""
    further = figures["next light"]
    source = "smoothness alone" if figures["prior"] == "smooth" else "the curves of measured cameras"
    return (
        Text(
            "Curves stay uncertain, colours do not. The patches determine the responses to other surfaces under other "
            "illuminants well, and these make the colours of pictures. They determine the details of a curve only roughly; "
            f"these are filled in from {source}. The first column is the band drawn around the curves above."
        ),
        Text(
            f"Another photo of the chart would help most under {further['light']}. It would reduce the error of the colours "
            f"to {tidy(further['remaining %'], 2)} % of its present value."
        ),
    )


def _patches(fit: PhotoFit, index: int, keys: tuple[Key, ...]) -> tuple[Figure, Figure]:
    """Plot measured against predicted patches of one photo, and the residual of each patch."""
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
    fits = (
        f"{int(used.sum())} values of {len(used)} patches. The prediction includes uneven light and glare. "
        f"Residual RMS: {rms}."
    )
    largest = f"Largest: patch {patch + 1} in {keys[worst].label}, {tidy(float(rest[patch, worst]), 2)} %."
    return one.figure(f"Patches of {fit.names[index]}", fits, keys), left.figure("Residuals", largest, keys)
