"""The measurement file and what lies around it: MEASUREMENTS.toml, frames, CSV spectra (METHOD 1.4).

    MEASUREMENTS.toml   sensor, cfa, optics, and what was measured:
      responsivity      one of: [[mono]] frames of a monochromator; [sweep] a table of means beside a photodiode; [curves]
                        a finished curve; [[band]] a chart behind narrow filters at several exposures
      scale             [[chart]] ColorCheckers under known lights; without them the camera's responsivity is relative
      sensor            [[dark]] and [[white]] frames; without [[white]] a [datasheet] of declared figures
    frames              single-channel 16-bit pictures (TIFF, PNG, PGM) of the whole sensor, raw DN, CFA phase (0, 0)
    spectra             CSV: wavelength in nm, then radiances in photons/s/sr/m²/nm, one column a light or a patch

Names of files are relative to the folder of the measurement file.
"""

import json
import math
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np

from l3cli.artifacts.base import Stage
from l3cli.artifacts.camera import CameraModel, Noise, Optics
from l3cli.artifacts.camera_recipe import CfaRecipe, NoiseRecipe, OpticsRecipe, parse_cfa, read_curves
from l3cli.config import Recipe, load_recipe, read_text
from l3cli.errors import InputFileError, RecipeError
from l3cli.files import sha256, write_whole
from l3cli.io.curves import read_finished, read_sweep
from l3cli.io.frames import FrameFiles
from l3cli.limits import MEGAPIXELS, most_pixels
from l3cli.measurement import (
    PATCHES,
    BandCapture,
    Body,
    Capture,
    ChartCapture,
    FinishedCurves,
    Measurements,
    MonoCapture,
    SensorFigures,
    SweepTable,
)

SITE_PIXELS = 8  # rows and columns of super-pixels from which a local mean can be taken


class BodyRecipe(Recipe):
    rows: int
    cols: int
    pixel_pitch_um: float
    bits: int


class CaptureRecipe(Recipe, kw_only=True):
    """Lens-cap or white frames of one exposure."""

    frames: list[str]
    exposure_s: float
    monitor: float = 1.0  # a reading of the lamp during the capture, over the reading when its spectrum was measured


class MonoRecipe(CaptureRecipe, kw_only=True):
    """An even field lit by one monochromator step."""

    spectrum: str  # CSV of measured radiances, bandwidth and stray light included
    column: int = 1  # which of its columns, counted from 1 after the wavelength


class ChartRecipe(CaptureRecipe, kw_only=True):
    """A ColorChecker under one light; as [[band]] behind one filter, and then the radiances may be relative."""

    illuminant: str
    corners: list[tuple[float, float]]  # col, row in pixels: outer corners of patches 1, 6, 24, 19 (clockwise)
    radiance: str  # CSV of measured radiances, 24 columns, row by row from dark skin to black


class SweepRecipe(Recipe):
    """A monochromator sweep as a table of means."""

    table: str  # CSV: nm, light mean of each channel, dark mean of each channel, photodiode light, photodiode dark
    photodiode: str  # CSV: nm, response of the photodiode per energy


class CurvesRecipe(Recipe):
    """Responsivities that somebody measured."""

    file: str  # CSV: nm, one column a channel; or the JSON of rawtoaces
    per_energy: bool = True  # false: per photon


class DatasheetRecipe(NoiseRecipe, kw_only=True):
    """The sensor as its maker declares it."""

    black_dn: float
    white_dn: float
    gain_dn_per_e: float | None = None  # default: white is where the well is full


class UncertaintyRecipe(Recipe):
    """How well the lights were known, one standard deviation; it widens the confidence band."""

    lamp_drift: float = 0.0  # relative, between a light and its measured spectrum, after the monitor's correction
    wavelength_nm: float = 0.0  # of the spectrometer's scale


class MeasurementRecipe(Recipe):
    """MEASUREMENTS.toml."""

    title: ClassVar[str] = "a measurement file"

    name: str
    sensor: BodyRecipe
    cfa: CfaRecipe
    optics: OpticsRecipe
    mono: list[MonoRecipe] = msgspec.field(default_factory=list)
    sweep: SweepRecipe | None = None
    curves: CurvesRecipe | None = None
    band: list[ChartRecipe] = msgspec.field(default_factory=list)
    chart: list[ChartRecipe] = msgspec.field(default_factory=list)
    white: list[CaptureRecipe] = msgspec.field(default_factory=list)
    dark: list[CaptureRecipe] = msgspec.field(default_factory=list)
    datasheet: DatasheetRecipe | None = None
    uncertainty: UncertaintyRecipe = msgspec.field(default_factory=UncertaintyRecipe)


# ------------------------------------------------------------------------------------------------------- reading


def load_measurements(path: Path) -> Measurements:
    """The measurements that a measurement file names; frames are read later, one by one.

    RecipeError if the file asks for what cannot be, InputFileError if a spectrum or a frame is missing or broken.
    """
    recipe = load_recipe(path, MeasurementRecipe)
    body = _body(recipe, path)
    _check_sources(recipe, path)
    for name in frame_names(recipe):
        if not (path.parent / name).is_file():
            raise InputFileError(f"{path.parent / name} does not exist; {path.name} names it as a frame")
    uncertainty = recipe.uncertainty
    if not (0 <= uncertainty.lamp_drift < 1 and 0 <= uncertainty.wavelength_nm < 100):
        raise RecipeError(f"{path}: uncertainty is a standard deviation: lamp_drift in 0…1, wavelength_nm in 0…100")
    return Measurements(
        body=body,
        mono=_mono(recipe, body, path),
        charts=tuple(ChartCapture(**_chart(chart, "chart", body, path)) for chart in recipe.chart),
        darks=tuple(Capture(**_common(capture, "dark", body, path)) for capture in recipe.dark),
        whites=tuple(Capture(**_common(capture, "white", body, path)) for capture in recipe.white),
        bands=tuple(BandCapture(**_chart(band, "band", body, path)) for band in recipe.band),
        curve=_curve(recipe, path),
        datasheet=_datasheet(recipe.datasheet, body, path),
        lamp_drift=uncertainty.lamp_drift,
        wavelength_uncertainty=uncertainty.wavelength_nm,
    )


def _check_sources(recipe: MeasurementRecipe, path: Path) -> None:
    """One source of responsivity, one of the sensor's figures, and all that they need; RecipeError otherwise."""
    sources = {"mono": recipe.mono, "sweep": recipe.sweep, "curves": recipe.curves, "band": recipe.band}
    given = [name for name, source in sources.items() if source]
    if len(given) != 1:
        found = " and ".join(given) or "none"
        raise RecipeError(f"{path}: give one source of responsivity, [[mono]] [sweep] [curves] or [[band]]; found {found}")
    if bool(recipe.white) == (recipe.datasheet is not None):
        raise RecipeError(f"{path}: give either [[white]] frames, and measure the sensor, or its [datasheet]")
    if recipe.white and not recipe.dark:
        raise RecipeError(f"{path}: there is no [[dark]] capture; add some")
    if recipe.mono and recipe.datasheet:
        raise RecipeError(f"{path}: [[mono]] frames need [[white]] and [[dark]] ones beside them, not a [datasheet]")
    if recipe.band and recipe.white:
        raise RecipeError(f"{path}: [[band]] captures need a [datasheet], not [[white]] frames")
    if recipe.chart and not recipe.white:
        raise RecipeError(
            f"{path}: [[chart]] captures need [[white]] and [[dark]] frames; take them or leave the charts out"
        )
    if len(recipe.chart) == 1 or (recipe.mono and not recipe.chart):
        raise RecipeError(f"{path}: one [[chart]] cannot tell gain from light; give charts under two illuminants or more")


def _common(capture: CaptureRecipe, table: str, body: Body, path: Path) -> dict[str, Any]:
    """What every capture has, as keywords."""
    if not capture.frames or not 0 < capture.exposure_s < math.inf or not 0 < capture.monitor < math.inf:
        raise RecipeError(f"{path}: a [[{table}]] capture needs frames, and exposure_s and monitor above 0")
    files = FrameFiles(tuple(path.parent / name for name in capture.frames), (body.rows, body.cols), body.bits)
    return {"name": capture.frames[0], "exposure": capture.exposure_s, "frames": files, "monitor": capture.monitor}


def _mono(recipe: MeasurementRecipe, body: Body, path: Path) -> tuple[MonoCapture, ...]:
    curves = {name: read_curves(path.parent / name) for name in {step.spectrum for step in recipe.mono}}
    mono = []
    for step in recipe.mono:
        wavelength, columns = curves[step.spectrum]
        if not 1 <= step.column <= len(columns):
            raise RecipeError(f"{path}: column {step.column} of {step.spectrum} is none of its 1…{len(columns)}")
        if columns[step.column - 1].max() <= 0:
            raise InputFileError(f"{path.parent / step.spectrum}: column {step.column} is dark; measure the light again")
        common = _common(step, "mono", body, path)
        mono.append(MonoCapture(**common, wavelength=wavelength, radiance=columns[step.column - 1]))
    return tuple(mono)


def _chart(chart: ChartRecipe, table: str, body: Body, path: Path) -> dict[str, Any]:
    """A chart capture as keywords."""
    if len(chart.corners) != 4 or not np.isfinite(chart.corners).all():
        raise RecipeError(f"{path}: a [[{table}]] has {len(chart.corners)} corners; give col, row of patches 1, 6, 24, 19")
    wavelength, radiance = read_curves(path.parent / chart.radiance, PATCHES)
    if radiance.max(axis=1).min() <= 0:
        raise InputFileError(f"{path.parent / chart.radiance}: a patch without light; measure the chart again")
    return {
        **_common(chart, table, body, path),
        "illuminant": chart.illuminant,
        "corners": np.array(chart.corners, dtype=np.float64),
        "wavelength": wavelength,
        "radiance": radiance,
    }


def _curve(recipe: MeasurementRecipe, path: Path) -> SweepTable | FinishedCurves | None:
    if recipe.sweep is not None:
        sweep = recipe.sweep
        return read_sweep(path.parent / sweep.table, path.parent / sweep.photodiode, recipe.cfa.channels)
    if recipe.curves is not None:
        return read_finished(path.parent / recipe.curves.file, recipe.cfa.channels, recipe.curves.per_energy)
    return None


def _datasheet(declared: DatasheetRecipe | None, body: Body, path: Path) -> SensorFigures | None:
    if declared is None:
        return None
    black, white, well = declared.black_dn, declared.white_dn, declared.well_capacity_e
    spreads = (declared.read_noise_e, declared.dark_current_e_per_s, declared.dsnu_e, declared.prnu)
    if not (0 <= black < white <= 2**body.bits - 1 and 0 < well < math.inf and min(spreads) >= 0):
        raise RecipeError(
            f"{path}: datasheet needs 0 ≤ black_dn < white_dn ≤ {2**body.bits - 1}, a well, and no negative figure"
        )
    gain = (white - black) / well if declared.gain_dn_per_e is None else declared.gain_dn_per_e
    if not 0 < gain < math.inf:
        raise RecipeError(f"{path}: datasheet.gain_dn_per_e must be above 0")
    return SensorFigures(gain, black, white, Noise(*spreads, well))


def _body(recipe: MeasurementRecipe, path: Path) -> Body:
    sensor, optics = recipe.sensor, recipe.optics
    if not (sensor.rows > 0 and sensor.cols > 0 and sensor.pixel_pitch_um > 0 and 1 <= sensor.bits <= 16):
        raise RecipeError(f"{path}: sensor needs rows, cols and pixel_pitch_um above 0 and 1 to 16 bits")
    if sensor.rows * sensor.cols > most_pixels():
        raise RecipeError(f"{path}: {sensor.rows}×{sensor.cols} pixels are more than inputs may have; raise {MEGAPIXELS}")
    if not (optics.focal_length_mm > 0 and optics.f_number > 0):
        raise RecipeError(f"{path}: optics needs focal_length_mm and f_number above 0")
    if 0 < optics.object_distance_m <= optics.focal_length_mm * 1e-3:
        raise RecipeError(f"{path}: optics.object_distance_m is nearer than the focal length; give 0 for infinity")
    cfa = parse_cfa(recipe.cfa, str(path))
    if sensor.rows < SITE_PIXELS * cfa.shape[0] or sensor.cols < SITE_PIXELS * cfa.shape[1]:
        raise RecipeError(f"{path}: {sensor.rows}×{sensor.cols} pixels are too few to measure noise; check sensor")
    return Body(
        name=recipe.name,
        rows=sensor.rows,
        cols=sensor.cols,
        pixel_pitch=sensor.pixel_pitch_um * 1e-6,
        bits=sensor.bits,
        channels=tuple(recipe.cfa.channels),
        cfa=cfa,
        optics=Optics(optics.focal_length_mm * 1e-3, optics.f_number, optics.object_distance_m),
    )


def frame_names(recipe: MeasurementRecipe) -> list[str]:
    """Every frame a measurement file names, in order."""
    captures: list[CaptureRecipe] = [*recipe.mono, *recipe.band, *recipe.chart, *recipe.white, *recipe.dark]
    return [name for capture in captures for name in capture.frames]


def spectrum_names(recipe: MeasurementRecipe) -> list[str]:
    """Every file of spectra, tables and curves a measurement file names, each once, in order."""
    names = [step.spectrum for step in recipe.mono] + [chart.radiance for chart in [*recipe.band, *recipe.chart]]
    names += [recipe.sweep.table, recipe.sweep.photodiode] if recipe.sweep else []
    names += [recipe.curves.file] if recipe.curves else []
    return list(dict.fromkeys(names))


def measurement_files(path: Path) -> list[Path]:
    """Every file that calibration reads."""
    recipe = load_recipe(path, MeasurementRecipe)
    return [path, *(path.parent / name for name in frame_names(recipe) + spectrum_names(recipe))]


def history(path: Path, options: dict[str, Any]) -> Stage:
    """What calibration leaves in the history: options, the measurement file and the SHA-256 of all that it names."""
    recipe = load_recipe(path, MeasurementRecipe)
    inputs = {
        "measurements": [sha256(path)],
        "frames": [sha256(path.parent / name) for name in frame_names(recipe)],
        "spectra": [sha256(path.parent / name) for name in spectrum_names(recipe)],
    }
    return Stage("calibrate", options, read_text(path), inputs)


# ------------------------------------------------------------------------------------------------------- writing


def describe(camera: CameraModel, uncertainty: UncertaintyRecipe, **captures: Any) -> MeasurementRecipe:
    """The measurement file of captures of a known camera; `captures` are the lists mono, chart, white and dark."""
    optics = camera.optics
    return MeasurementRecipe(
        name=camera.name,
        sensor=BodyRecipe(camera.rows, camera.cols, round(camera.pixel_pitch * 1e6, 9), camera.bits),
        cfa=CfaRecipe(list(camera.channels), [" ".join(camera.channels[site] for site in row) for row in camera.cfa]),
        optics=OpticsRecipe(round(optics.focal_length * 1e3, 9), optics.f_number, optics.object_distance),
        uncertainty=uncertainty,
        **captures,
    )


def write_measurements(recipe: MeasurementRecipe, path: Path) -> None:
    """Write a measurement file."""
    write_whole(path, _toml(msgspec.to_builtins(recipe)))


def _toml(table: dict[str, Any], prefix: str = "") -> str:
    """A table of numbers, texts, lists, tables and lists of tables as TOML; JSON writes the plain values alike."""

    def is_table(value: Any) -> bool:
        return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))

    table = {key: value for key, value in table.items() if value is not None and value != []}
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items() if not is_table(value)]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += ["", f"[{prefix}{key}]", _toml(value, f"{prefix}{key}.").rstrip()]
        elif is_table(value):
            for item in value:
                lines += ["", f"[[{prefix}{key}]]", _toml(item, f"{prefix}{key}.").rstrip()]
    return "\n".join(lines) + "\n"
