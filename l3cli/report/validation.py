"""Predictions of charts by a camera model, and the choice of its smoothing."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.fit import ChartFit, Fit, SweepFit
from l3cli.report import colours
from l3cli.report.channels import MARKS, mark_of, table_of
from l3cli.report.drawing import Axis, Plot, spanning
from l3cli.report.parts import Block, Figure, Figures, Key, tidy
from l3cli.report.patches import calibration_figures

Array = NDArray[np.floating]


def validation_blocks(camera: CameraModel, fit: Fit, figures: dict[str, Any], light: Array) -> tuple[Block, ...]:
    """Return plots and tables of a camera's `fit`; `figures` as for `camera_section`, `light` (channel, 3) of its
    channels."""
    graphs: list[Figure] = []
    if fit.validation is not None:
        graphs += _prediction_figures(camera, fit, light)
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


def _prediction_figures(camera: CameraModel, fit: Fit, light: Array) -> list[Figure]:
    assert fit.validation is not None
    measured, predicted, used = fit.validation.measured, fit.validation.predicted, _used(fit)
    if not used.any():
        return []
    strokes, keys = colours.strokes(light), []
    what = "chart patch" if isinstance(fit.validation, ChartFit) else "patch and exposure"
    top = max(float(measured[used].max()), float(predicted[used].max()))
    low = min(0.0, float(measured[used].min()), float(predicted[used].min()))
    one = Plot(Axis("predicted (DN)", low, 1.04 * top), Axis("measured (DN)", low, 1.04 * top), square=True)
    one.line(np.array([low, top]), np.array([low, top]), "var(--muted)", "dashed", 1)
    error = measured - predicted
    rest = Plot(Axis("predicted (DN)", low, 1.04 * top), spanning("measured − predicted (DN)", error[used]))
    rest.line(np.array([low, 1.04 * top]), np.zeros(2), "var(--muted)", "dashed", 1)
    for channel, name in enumerate(camera.channels):
        here = used[..., channel]
        mark = MARKS[mark_of(strokes, channel)]
        one.dots(predicted[..., channel][here], measured[..., channel][here], strokes[channel], mark, series=name)
        rest.dots(predicted[..., channel][here], error[..., channel][here], strokes[channel], mark, series=name)
        keys.append(Key(name, strokes[channel], mark))
    fits = ", ".join(f"{n} {float(r):.5f}" for n, r in zip(camera.channels, fit.validation.r_squared, strict=True))
    scatter = f"{int(used.sum())} values, one for each {what} and channel. R²: {fits}."
    rmse = ", ".join(
        f"{n} {tidy(100 * float(r), 2)} %" for n, r in zip(camera.channels, fit.validation.relative_rmse, strict=True)
    )
    spread = f"RMSE relative to the mean signal: {rmse}; largest residual {tidy(float(np.abs(error[used]).max()))} DN."
    return [
        Figure("Measured against predicted", one.svg(scatter), scatter, tuple(keys), data=one.data()),
        Figure("Residuals", rest.svg(spread), spread, tuple(keys), data=rest.data()),
    ]


def _used(fit: Fit) -> NDArray[np.bool_]:
    assert fit.validation is not None
    return fit.series.used if fit.chart is None and fit.series is not None else np.ones(fit.validation.measured.shape, bool)


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
    return [Figure("Choice of the smoothing", plot.svg(finding), finding, keys, data=plot.data())]
