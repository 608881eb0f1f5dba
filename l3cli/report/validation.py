"""The validation of a camera model in a report: how accurately the model predicts the charts to which it was fitted.

For lab measurements, the report also shows how the smoothing was chosen. For photos, it shows the uncertainty of the
responsivities and the colours. In drawings of charts, each patch shows two colours, such as the predicted and the measured
colour.
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
MAX_CHARTS = 4  # maximum number of drawn charts per calibration
PATCH_GAP, TEXT_HEIGHT = 10.0, 18.0  # distance between patches, and height of the text below each patch, in px


def patches_figure(title: str, names: tuple[str, str], pair: tuple[Array, Array], errors: dict[str, Array]) -> Figure:
    """Draw the patches of a chart. Each patch shows the colours of two pictures side by side, with their ΔE00 below.

    Parameters
    ----------
    title : str
        Title of the figure.
    names : tuple of str
        Names of the left and the right picture.
    pair : tuple of ndarray, (patch, 3)
        Colours of the left and the right picture, in linear sRGB.
    errors : dict of str to ndarray, (patch,)
        ΔE00 between each named picture and the left picture. The right picture, `names[1]`, is required, and its values are
        drawn. All other values appear only in the caption and the data.
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
        f"Left halves: {names[0]}. Right halves: {names[1]}. The numbers are the ΔE00 between the two halves. "
        f"Mean ΔE00 of {len(main)} patches: {means}. Largest ΔE00 of {names[1]}: {PATCH_NAMES[worst]}, "
        f"{main[worst]:.2f}."
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
    """Tabulate the ΔE00 of each patch, with one column per picture. `errors` is as in `patches_figure`."""
    rows = tuple((name, *(f"{float(of[patch]):.2f}" for of in errors.values())) for patch, name in enumerate(PATCH_NAMES))
    return Table("ΔE00 of each patch", ("patch", *errors), rows)


def calibration_figures(camera: CameraModel, fit: ChartFit) -> tuple[Figure, ...]:
    """Draw the measured and predicted colours of the first MAX_CHARTS charts of a calibration.

    One matrix per chart converts channels to colours. It is fitted to the ideal colours of the patches, which are known only
    for a ColorChecker with 24 patches under a named illuminant. Other charts are omitted.
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
    """Fit the matrix (channel, 3) that converts channels to XYZ, by least squares.

    `residual`, the difference between measurement and prediction, is treated as channel noise, so that the matrix does not
    amplify the difference between similar channels.
    """
    noise = np.diag((residual**2).sum(axis=0))
    matrix: Array = np.linalg.pinv(predicted.T @ predicted + noise) @ predicted.T @ ideal
    return matrix


BANDS = {  # headings in the report, by key in the output of `l3 calibrate --json`
    "curve ± 95 % (% of peak)": "curve, 95 % band (± % of its peak)",
    "colours ± 95 % (% of most)": "colours, 95 % band (± % of the brightest patch)",
}


def validation_blocks(camera: CameraModel, fit: Fit, figures: dict[str, Any]) -> tuple[Block, ...]:
    """Build the plots and tables that validate a fitted camera.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    fit : Fit
        Result of fitting the camera to measurements.
    figures : dict
        Output of `l3 calibrate --json`.

    Returns
    -------
    tuple of Block
        Plots of predictions, residuals and smoothing, drawings of charts, and tables of the errors per chart and per
        illumination band. Blocks without data are omitted, so there may be none.
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
        blocks.append(table_of("Response to each illumination band", "band", figures["bands"]))
    return tuple(blocks)


def table_of(caption: str, heading: str, rows: dict[str, dict[str, float]]) -> Table:
    """Tabulate a part of the output of `l3 calibrate --json`: `rows` maps row names to {column title: number}."""
    titles = tuple(next(iter(rows.values())))
    body = tuple(
        (name, *(f"{row[title]:.5f}" if title.startswith("R²") else tidy(row[title], 4) for title in titles))
        for name, row in rows.items()
    )
    return Table(caption, (heading, *map(unit, titles)), body)


def _prediction_figures(camera: CameraModel, fit: Fit) -> list[Figure]:
    """Plot the measured values and their residuals against the predicted values. Without values, the list is empty."""
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
    largest = tidy(float(np.abs(error[used]).max()))
    spread = f"RMSE relative to the mean signal: {rmse}. The largest residual is {largest} DN."
    return [one.figure("Measured against predicted values", scatter, keys), rest.figure("Residuals", spread, keys)]


def _smoothing_figure(sweep: SweepFit) -> list[Figure]:
    """Plot the cross-validated error against the smoothing δ. The list is empty if fewer than two values were tried."""
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
        f"The chosen value, δ = {tidy(chosen)}, is the middle of the plateau. Its cross-validated RMSE is "
        f"{tidy(float(error[nearest]))} %, and the lowest RMSE of all tried values is {tidy(float(error.min()))} %."
    )
    keys = (Key("tried", "var(--one)", "dot"), Key("chosen", "var(--two)", "dot"))
    return [plot.figure("Choice of the smoothing δ", finding, keys)]


# --------------------------------------------------------------------------------------------------------- photos


def photo_subsections(camera: CameraModel, fit: PhotoFit, figures: dict[str, Any]) -> tuple[Subsection, ...]:
    """Build the subsections of a camera that was fitted to photos of a chart.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    fit : PhotoFit
        Measured and predicted signals of the patches in each photo.
    figures : dict
        Output of `l3 calibrate --json`.

    Returns
    -------
    tuple of Subsection
        Subsections about the photos, the uncertainty of responsivities and colours, and the patches of each photo.
    """
    keys = point_keys(camera)
    return (
        Subsection("Photos of a chart", (_photos(figures), _lights(figures), *_left_out(figures))),
        Subsection("Uncertainty of curves and colours", (_bands(camera, figures), *_reading(figures))),
        Subsection("Patches of each photo", tuple(Figures(_patches(fit, index, keys)) for index in range(len(fit.names)))),
    )


def photo_lead(fit: PhotoFit, figures: dict[str, Any]) -> str:
    """Summarise the fit to photos, with the uncertainty of responsivities and colours."""
    curve, colours = (max(row[title] for row in figures["channels"].values()) for title in BANDS)
    many = "one photo" if len(fit.names) == 1 else f"{len(fit.names)} photos"
    return (
        f"The camera was estimated from {many} of a chart. The 95 % bands are ± {tidy(curve, 2)} % of the peak for the "
        f"responsivity curves, and ± {tidy(colours, 2)} % of the brightest patch for colours."
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
    units = ("uneven light (%)", "glare (% of the brightest patch)", "residual RMS (% of the brightest patch)")
    headings = ("photo", "chart", "illuminant", *units)
    return Table("Photos. Glare and residual are values of the worst channel", headings, tuple(rows))


def _lights(figures: dict[str, Any]) -> Text:
    """Explain for each photo whether the illuminant that the user specified fits the patches."""
    words = []
    for name, photo in figures["photos"].items():
        if photo["guessed"]:
            words.append(
                f"{name}: no illuminant was specified. The estimate is {guessed_light(photo['probable lights'])}. The bands "
                "include the uncertainty of the illuminant."
            )
        elif photo["deficit"] > 0:
            words.append(
                f"{name}: {photo['light']} was specified, but the common illuminant that fits the patches best is "
                f"{photo['nearest']}."
            )
        else:
            words.append(f"{name}: {photo['light']} was specified, and no common illuminant fits the patches better.")
    return Text(" ".join(words))


def _left_out(figures: dict[str, Any]) -> list[Block]:
    lines = figures["left out"]
    return [Details(f"{counted(len(lines), 'patch value')} not used", "\n".join(lines))] if lines else []


def _bands(camera: CameraModel, figures: dict[str, Any]) -> Table:
    rows = [(name, *(tidy(figures["channels"][name][title], 3) for title in BANDS)) for name in camera.channels]
    return Table(
        "95 % bands, RMS over wavelengths (curve) and over surfaces (colours)", ("channel", *BANDS.values()), tuple(rows)
    )


def _reading(figures: dict[str, Any]) -> tuple[Text, Text]:
    """Explain the confidence bands, and recommend the photo that would reduce the uncertainty most."""
    further = figures["next light"]
    source = "smoothness alone" if figures["prior"] == "smooth" else "the curves of measured cameras"
    return (
        Text(
            "A photo of a chart determines the colours of pictures accurately, because the patches determine how the camera "
            "responds to most surfaces and illuminants. The photo determines the details of the responsivity curves only "
            f"roughly. These details come from {source}. The first column of the table is the band around the curves in the "
            "plot above."
        ),
        Text(
            f"Another photo of the chart would reduce the uncertainty most under {further['light']}. The colour error would "
            f"decrease to {tidy(further['remaining %'], 2)} % of its present value."
        ),
    )


def _patches(fit: PhotoFit, index: int, keys: tuple[Key, ...]) -> tuple[Figure, Figure]:
    """Plot the measured against the predicted patch signals of one photo, and the residual of each patch."""
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
        f"RMS of the residuals: {rms}."
    )
    value = tidy(float(rest[patch, worst]), 2)
    largest = f"The largest residual is {value} %, for patch {patch + 1} in channel {keys[worst].label}."
    return one.figure(f"Patches of {fit.names[index]}", fits, keys), left.figure("Residuals", largest, keys)
