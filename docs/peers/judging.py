"""Evaluate tables and rival methods: metrics with the best setting of each method, and seconds per megapixel."""

import functools
import hashlib
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rivals import PLAIN, Demosaic, Denoiser, Method, Noise, Rival
from seconds import per_megapixel, tiled_to

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair, TrainingSet, open_training_set
from l3cli.evaluation.basic import develop, develop_bands, develop_stokes, fit_colour, light_of
from l3cli.evaluation.quality import band_figures, band_quality, cropped, judge_stokes, psnr
from l3cli.frames.frame import RawFrame
from l3cli.physics.display import displayed, displayed_delta_e, srgb_curve, white_luminance
from l3cli.physics.stokes import STOKES
from l3cli.rendering.renderer import make_renderer

Array = NDArray[np.floating]
Figures = dict[str, float]
Row = dict[str, Any]  # row of figures.json: name, program, ours, figures, settings, seconds; for some methods by_frame
BORDER = 10  # number of pixels that are ignored at each edge
LOWER = ("delta_e", "angle", "AoLP")  # metrics that are better if they are smaller
OURS = "l3"
DIGITS = 12  # stored digits of a digest


@dataclass(frozen=True)
class Protocol:
    """How a method processes a frame, and which metrics are computed from the result."""

    planes: Callable[[TrainingPair, TrainingSet, Method], Array]  # in the unit of the frame's target
    figures: Callable[[Array, TrainingPair], Figures]


def judged(
    sets: Mapping[str, Path], tables: Mapping[str, TransformTable], rivals: Sequence[Rival], protocol: Protocol
) -> list[Row]:
    """Return the rows of tables and rivals, sorted by the first metric, with the best row first.

    Metrics are means over the frames of a training set in `sets`, and are called "SET METRIC". Rows of tables, and of rivals
    that use the noise model, also contain the metrics of every frame.
    """
    methods: dict[str, tuple[Row, dict[str, Callable[[TrainingPair, TrainingSet], Array]]]] = {}
    given_noise = {f"{rival.program} {rival.name}" for rival in rivals if rival.given_noise}
    for name, table in tables.items():
        methods[name] = ({"name": name, "program": OURS, "ours": True}, {"": functools.partial(rendered, _renderer(table))})
    for rival in rivals:
        runs = {each: _by_rival(protocol, demosaic) for each, demosaic in rival.settings.items()}
        methods[f"{rival.program} {rival.name}"] = ({"name": rival.name, "program": rival.program, "ours": False}, runs)
    rows = []
    for key, (row, runs) in methods.items():
        frames = {setting: _frames(sets, run, protocol) for setting, run in runs.items()}
        means = {setting: {figure: float(np.mean(of)) for figure, of in each.items()} for setting, each in frames.items()}
        row |= best_settings(means)
        if row["ours"] or key in given_noise:
            chosen = {figure: frames[row["settings"].get(figure, PLAIN)][figure] for figure in row["figures"]}
            row["by_frame"] = {figure: [round(value, 4) for value in of] for figure, of in chosen.items()}
        rows.append(row)
        print(f"{key}: {row['figures']} {row['settings']}", file=sys.stderr, flush=True)
    put_seconds(rows, sets, tables, rivals)
    return best_first(rows)


def best_first(rows: Sequence[Row]) -> list[Row]:
    """Sort rows by their first metric."""
    first = next(iter(rows[0]["figures"]))
    return sorted(rows, key=lambda row: row["figures"][first], reverse=not lower_is_better(first))


def lower_is_better(figure: str) -> bool:
    return figure.endswith(LOWER)


def best_settings(means: Mapping[str, Figures]) -> dict[str, Any]:
    """Return the best value of each metric over all settings, and the best setting if it is not the default."""
    figures, settings = {}, {}
    for figure in next(iter(means.values())):
        choose = min if lower_is_better(figure) else max
        setting = choose(means, key=lambda each: means[each][figure])
        figures[figure] = round(means[setting][figure], 4)
        if setting:
            settings[figure] = setting
    return {"figures": figures, "settings": settings}


# ----------------------------------------------------------------------------------------------------- what is measured


def code_protocol() -> Protocol:
    """Return the protocol of published benchmarks: the CPSNR (dB) of the values of all channels."""

    def figures(planes: Array, frame: TrainingPair) -> Figures:
        return {"psnr": band_quality(planes, frame.target, frame.white, BORDER).psnr}

    return Protocol(_bands, figures)


def band_protocol() -> Protocol:
    """Return the protocol for bands: PSNR (dB) and SSIM, averaged over the bands, and the mean spectral angle (degrees)."""

    def figures(planes: Array, frame: TrainingPair) -> Figures:
        given = planes, frame.target, frame.white, BORDER
        by_band = band_figures(*given)
        means = {key: float(np.mean([band[key] for band in by_band])) for key in ("psnr", "ssim")}
        return means | {"angle": band_quality(*given).mean_angle}

    return Protocol(_bands, figures)


def stokes_protocol() -> Protocol:
    """Return the protocol for polarisation: PSNR (dB) of the four intensities, S0 and DoLP, and RMS error of AoLP (degrees).

    The Stokes parameters of rivals are the least-squares solution for the angles and extinction ratios of the camera.
    """

    def figures(planes: Array, frame: TrainingPair) -> Figures:
        quality, _ = judge_stokes(planes, frame.target, frame.white, STOKES, BORDER)
        angle = np.nan if quality.aolp_rmse is None else quality.aolp_rmse
        return {"I": quality.psnr_intensities, "S0": quality.psnr_s0, "DoLP": quality.psnr_dolp, "AoLP": angle}

    def planes(frame: TrainingPair, head: TrainingSet, method: Method) -> Array:
        assert not isinstance(method, Denoiser)
        return develop_stokes(frame, head.camera, method)

    return Protocol(planes, figures)


def picture_protocol() -> Protocol:
    """Return the protocol for pictures: PSNR (dB) of sRGB and mean CIEDE2000. Rivals use a fitted colour matrix."""

    def figures(planes: Array, frame: TrainingPair) -> Figures:
        scale = white_luminance(frame.target[1])
        made, ideal = (displayed(cropped(of, BORDER), frame.white, scale) for of in (planes, frame.target))
        return {"psnr": psnr(srgb_curve(made), srgb_curve(ideal)), "delta_e": float(displayed_delta_e(made, ideal).mean())}

    def planes(frame: TrainingPair, head: TrainingSet, demosaic: Method) -> Array:
        colour = fit_colour(head.camera, light_of(frame, head.camera), head.target_light)
        balance = colour.balance / (frame.luminance * frame.exposure)
        return develop(frame, head.camera, colour, _given_noise(demosaic, frame, head.camera, balance))

    return Protocol(planes, figures)


def _given_noise(method: Method, frame: TrainingPair, camera: CameraModel, balance: Array) -> Demosaic:
    """Return the method with the noise of the frame. `balance` is the mosaic value of a photo-electron in each channel."""
    if not isinstance(method, Denoiser):
        return method
    constant, _, _ = camera.noise_terms(camera.dark_signal(frame.dark_time))
    return method.given(Noise(balance, constant / camera.gain**2))


def _bands(frame: TrainingPair, head: TrainingSet, demosaic: Method) -> Array:
    assert not isinstance(demosaic, Denoiser)
    return develop_bands(frame, head.camera, head.target_light is not None, demosaic)


# -------------------------------------------------------------------------------------------------------------- runs


def _renderer(table: TransformTable) -> tuple[TransformTable, Any]:
    return table, make_renderer("opencl", table)


def rendered(ours: tuple[TransformTable, Any], frame: TrainingPair, head: TrainingSet) -> Array:
    """Render a frame with a table, in the unit of the target."""
    table, renderer = ours
    outputs: Array = renderer.outputs(raw_frame(frame.raw, frame, head.camera)) * (table.output_unit / frame.exposure)
    return outputs


def raw_frame(values: NDArray[np.uint16], frame: TrainingPair, camera: CameraModel) -> RawFrame:
    dark = camera.dark_signal(frame.dark_time)
    return RawFrame(frame.scene, values, camera.black_level, camera.white_level, dark=dark)


def _by_rival(protocol: Protocol, demosaic: Method) -> Callable[[TrainingPair, TrainingSet], Array]:
    return lambda frame, head: protocol.planes(frame, head, demosaic)


def _frames(
    sets: Mapping[str, Path], run: Callable[[TrainingPair, TrainingSet], Array], protocol: Protocol
) -> dict[str, list[float]]:
    """Return the metrics of all frames, by set and metric."""
    figures: dict[str, list[float]] = {}
    for name, path in sets.items():
        with open_training_set(path) as reader:
            frames = [protocol.figures(run(frame, reader.head), frame) for frame in reader]
        figures |= {f"{name} {figure}": [each[figure] for each in frames] for figure in frames[0]}
    return figures


def described(sets: Mapping[str, Path]) -> dict[str, Any]:
    """Return the scene of each frame of the first set, and a digest of all frames."""
    whole, frames = hashlib.sha256(), []
    for path in sets.values():
        with open_training_set(path) as reader:
            for frame in reader:
                whole.update(frame.raw.tobytes() + frame.target.tobytes())
                frames.append(frame.scene)
    return {"frames": frames[: len(frames) // len(sets)], "digest": whole.hexdigest()[:DIGITS]}


def put_seconds(
    rows: Iterable[Row], sets: Mapping[str, Path], tables: Mapping[str, TransformTable], rivals: Iterable[Rival]
) -> None:
    """Add the seconds per megapixel to every row, for the slowest of the settings with the best metrics."""
    with open_training_set(next(iter(sets.values()))) as reader:
        frame, head = reader.frame(0), reader.head
    cfa = head.camera.cfa
    span = head.camera.white_level - head.camera.black_level
    share = (frame.raw - head.camera.black_level) / span
    electron = np.full(len(head.camera.channels), head.camera.gain / span)

    def table_figures(table: TransformTable) -> Callable[[int], Callable[[], object]]:
        _, renderer = _renderer(table)
        return lambda side: lambda: renderer.outputs(raw_frame(tiled_to(frame.raw, side, cfa.shape), frame, head.camera))

    def rival_figures(method: Method) -> Callable[[int], Callable[[], object]]:
        demosaic = _given_noise(method, frame, head.camera, electron)
        return lambda side: lambda: demosaic(tiled_to(share, side, cfa.shape), cfa)

    by_name = {(rival.name, rival.program): rival for rival in rivals}
    methods, row_figures = {}, []
    for row in rows:
        rival = by_name.get((row["name"], row["program"]))
        chosen = {row["settings"].get(figure, "") for figure in row["figures"]}
        for setting in chosen:
            key = f"{row['program']} {row['name']} {setting}"
            methods[key] = table_figures(tables[row["name"]]) if rival is None else rival_figures(rival.settings[setting])
            row_figures.append((row, key))
    taken = per_megapixel(methods)
    for row, key in row_figures:
        row["seconds"] = max(row.get("seconds", 0.0), float(f"{taken[key]:.3g}"))
