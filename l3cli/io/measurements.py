"""Measurements that a measurement file names: captures with their frames, spectra and figures
(docs/method.md#calibration)."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.camera import Noise, Optics
from l3cli.artifacts.camera_recipe import MOST_PRNU, check_lengths, check_share, parse_cfa, settings_from
from l3cli.artifacts.schema import Stage
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.measurement import (
    PATCH_NAMES,
    PATCHES,
    BandCapture,
    Body,
    Capture,
    ChartCapture,
    CurveStatistics,
    FinishedCurves,
    Measurements,
    MonoCapture,
    SensorFigures,
    SweepTable,
)
from l3cli.io.correction_recipe import correction_files, correction_measurements, has_base
from l3cli.io.curves import read_finished, read_sweep
from l3cli.io.frames import FrameFiles
from l3cli.io.measurement_recipe import (
    CaptureRecipe,
    ChartRecipe,
    DatasheetRecipe,
    MeasurementRecipe,
    MonoRecipe,
    frame_names,
    key_faults,
    spectrum_names,
)
from l3cli.io.photos import Levels, load_photos, recipe_of_photos
from l3cli.io.priors import prior_files, read_cameras, shipped
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.toml import load_recipe, read_text
from l3cli.spectra.file import read_table
from l3cli.spectra.table import RELATIVE, CurveTable
from l3cli.system.files import sha256, stamp
from l3cli.system.limits import MEGAPIXELS, most_pixels

MOST_MONITOR = 10.0  # and its inverse: a lamp that changes more is another lamp
SITE_PIXELS = 8  # rows and columns of super-pixels from which a local mean can be taken


def load_measurements(path: Path) -> Measurements:
    """Return the measurements that a measurement file names; frames are read later, one by one.

    RecipeError if the file asks for what cannot be, InputFileError if a spectrum or a frame is missing or broken.
    """
    return correction_measurements(path) if has_base(path) else measurements_of(load_recipe(path, MeasurementRecipe), path)


def measurements_of(recipe: MeasurementRecipe, path: Path) -> Measurements:
    """Return the measurements of a measurement file that lies, or would lie, at `path`; errors as of `load_measurements`."""
    body = _body(recipe, path)
    _check_sources(recipe, path)
    for name in frame_names(recipe):
        if not (path.parent / name).is_file():
            raise InputFileError(f"{path.parent / name} does not exist; {path.name} names it as a frame")
    refuse_first(key_faults(recipe), path)
    return Measurements(
        body=body,
        mono=_mono(recipe, body, path),
        charts=tuple(ChartCapture(**_chart(chart, "chart", body, path)) for chart in recipe.chart),
        darks=tuple(Capture(**_common(capture, "dark", body, path)) for capture in recipe.dark),
        whites=tuple(Capture(**_common(capture, "white", body, path)) for capture in recipe.white),
        bands=tuple(BandCapture(**_chart(band, "band", body, path)) for band in recipe.band),
        curve=_curve(recipe, path),
        photos=load_photos(recipe.photos, body, _levels(recipe), path),
        cameras=_cameras(recipe, path),
        datasheet=_datasheet(recipe.datasheet, body, path),
        lamp_drift=math.hypot(recipe.uncertainty.lamp_drift, recipe.uncertainty.photodiode),
        wavelength_uncertainty=recipe.uncertainty.wavelength_nm,
    )


def _check_sources(recipe: MeasurementRecipe, path: Path) -> None:
    """One source of responsivity, one of the sensor's figures, and all that they need; RecipeError otherwise."""
    sources: dict[str, Any] = {"mono": recipe.mono, "sweep": recipe.sweep, "curves": recipe.curves, "band": recipe.band}
    sources |= {"photo": recipe.photos}
    given = [name for name, source in sources.items() if source]
    if len(given) != 1:
        named = " and ".join(given) or "none"
        raise RecipeError(
            f"{path}: give one source of responsivity, [[mono]] [sweep] [curves] [[band]] or [photo]; given: {named}"
        )
    if recipe.prior and not recipe.photos:
        raise RecipeError(f"{path}: prior is for a [photo], and there is none; leave it out")
    if bool(recipe.white) == (recipe.datasheet is not None) and (recipe.white or not recipe.photos):
        raise RecipeError(f"{path}: give either [[white]] frames, and measure the sensor, or its [datasheet]")
    if recipe.white and not recipe.dark:
        raise RecipeError(f"{path}: there is no [[dark]] capture; add some")
    if recipe.mono and recipe.datasheet:
        raise RecipeError(f"{path}: [[mono]] frames need [[white]] and [[dark]] frames, not a [datasheet]")
    if recipe.band and recipe.white:
        raise RecipeError(f"{path}: [[band]] captures need a [datasheet], not [[white]] frames")
    if recipe.chart and not recipe.white:
        raise RecipeError(
            f"{path}: [[chart]] captures need [[white]] and [[dark]] frames; take them or leave the charts out"
        )
    if len(recipe.chart) == 1 or (recipe.mono and not recipe.chart):
        raise RecipeError(f"{path}: one [[chart]] does not separate gain from light; give charts under two illuminants")


def _common(capture: CaptureRecipe, table: str, body: Body, path: Path) -> dict[str, Any]:
    """Return the keywords that every capture has."""
    if capture.seconds is None:
        raise RecipeError(f"{path}: a [[{table}]] capture needs one of exposure_s, exposure_ms and exposure_us")
    if not capture.frames or not 0 < capture.seconds < math.inf or not 0 < capture.monitor < math.inf:
        raise RecipeError(f"{path}: a [[{table}]] capture needs frames, and exposure_s and monitor above 0")
    if not 1 / MOST_MONITOR <= capture.monitor <= MOST_MONITOR:
        raise RecipeError(
            f"{path}: monitor of {capture.frames[0]} is {capture.monitor:g}; give the lamp's reading over the one when its "
            f"spectrum was measured, 1 where it is the same"
        )
    files = FrameFiles(tuple(path.parent / name for name in capture.frames), (body.rows, body.cols), body.bits, body)
    return {"name": capture.frames[0], "exposure": capture.seconds, "frames": files, "monitor": capture.monitor}


def _mono(recipe: MeasurementRecipe, body: Body, path: Path) -> tuple[MonoCapture, ...]:
    tables = {name: read_table(path.parent / name) for name in {step.spectrum for step in recipe.mono}}
    mono = []
    for step in recipe.mono:
        light = _light(tables[step.spectrum], step, path)
        radiance = light.photons(step.unit)
        if radiance.max() <= 0:
            raise InputFileError(f"{path.parent / step.spectrum}: column {step.column} is dark; measure the light again")
        common = _common(step, "mono", body, path)
        absolute = not {step.unit, *light.units} & set(RELATIVE)
        mono.append(MonoCapture(**common, wavelength=light.wavelength, radiance=radiance[0], absolute=absolute))
    return tuple(mono)


def _light(table: CurveTable, step: MonoRecipe, path: Path) -> CurveTable:
    """Return the column that a step names."""
    if isinstance(step.column, int) and not 1 <= step.column <= len(table.values):
        raise RecipeError(f"{path}: column {step.column} of {step.spectrum} is none of its 1…{len(table.values)}")
    return table.column(step.column)


def _chart(chart: ChartRecipe, table: str, body: Body, path: Path) -> dict[str, Any]:
    """Return a chart capture as keywords."""
    if len(chart.corners) != 4 or not np.isfinite(chart.corners).all():
        raise RecipeError(f"{path}: a [[{table}]] has {len(chart.corners)} corners; give col, row of patches 1, 6, 24, 19")
    measured = read_table(path.parent / chart.radiance).ordered(PATCH_NAMES, patch_name)
    if table == "chart" and {chart.unit, *measured.units} & set(RELATIVE):
        raise InputFileError(
            f"{path.parent / chart.radiance}: radiances of a [[chart]] give the scale and cannot be relative; measure them"
        )
    radiance = measured.photons(chart.unit, absolute=table == "chart")
    if radiance.max(axis=1).min() <= 0:
        raise InputFileError(f"{path.parent / chart.radiance}: a patch without light; measure the chart again")
    return {
        **_common(chart, table, body, path),
        "illuminant": chart.illuminant,
        "corners": np.array(chart.corners, dtype=np.float64),
        "wavelength": measured.wavelength,
        "radiance": radiance,
    }


def patch_name(heading: str) -> str:
    """Return the patch that a heading means: "patch 13", "13", "blue", "white 9.5 (.05 D)"; other headings as they are."""
    number = re.fullmatch(r"(?:patch|p|no|#)?[ ._-]*0*(\d{1,2})", heading.strip(), re.IGNORECASE)
    if number and 1 <= int(number[1]) <= PATCHES:
        return PATCH_NAMES[int(number[1]) - 1]
    return re.sub(r"\s*\(.*\)$", "", heading).strip().lower()


def _curve(recipe: MeasurementRecipe, path: Path) -> SweepTable | FinishedCurves | None:
    if recipe.sweep is not None:
        sweep = recipe.sweep
        response = sweep.response
        paths = path.parent / sweep.table, path.parent / response.file
        return read_sweep(*paths, recipe.cfa.channels, response.column)
    if recipe.curves is not None:
        curves = recipe.curves
        return read_finished(path.parent / curves.file, recipe.cfa.channels, curves.per_energy, curves.columns)
    return None


def _levels(recipe: MeasurementRecipe) -> Levels:
    """Return the black and white level of raw files that state none."""
    declared = recipe.datasheet
    return Levels(None, None) if declared is None else Levels(declared.black_level_dn, declared.white_level_dn)


def _cameras(recipe: MeasurementRecipe, path: Path) -> CurveStatistics | tuple[FinishedCurves, ...] | None:
    """Return the prior knowledge of curves, before a photo is taken."""
    if not recipe.photos:
        return None
    return shipped() if recipe.prior is None else read_cameras(prior_files(path.parent / recipe.prior))


def _datasheet(declared: DatasheetRecipe | None, body: Body, path: Path) -> SensorFigures | None:
    if declared is None:
        return None
    black_level, white_level, well = declared.black_level_dn, declared.white_level_dn, declared.well_capacity_e
    spreads = (declared.read_noise_e, declared.dark_current_e_per_s, declared.dsnu_e, declared.prnu)
    if not (0 <= black_level < white_level <= 2**body.bits - 1 and 0 < well < math.inf and min(spreads) >= 0):
        raise RecipeError(
            f"{path}: datasheet needs 0 ≤ black_level_dn < white_level_dn ≤ {2**body.bits - 1}, a well, "
            "and no negative figure"
        )
    check_share(declared.prnu, "datasheet.prnu", MOST_PRNU, path)
    gain = (white_level - black_level) / well if declared.gain_dn_per_e is None else declared.gain_dn_per_e
    if not 0 < gain < math.inf:
        raise RecipeError(f"{path}: datasheet.gain_dn_per_e must be above 0")
    return SensorFigures(gain, black_level, white_level, Noise(*spreads, well))


def _body(recipe: MeasurementRecipe, path: Path) -> Body:
    sensor, optics = recipe.sensor, recipe.optics
    if not (sensor.rows > 0 and sensor.cols > 0 and sensor.pixel_pitch_um > 0 and 1 <= sensor.bits <= 16):
        raise RecipeError(f"{path}: sensor needs rows, cols and pixel_pitch_um above 0 and 1 to 16 bits")
    if sensor.rows * sensor.cols > most_pixels():
        raise RecipeError(f"{path}: {sensor.rows}×{sensor.cols} pixels are more than inputs may have; raise {MEGAPIXELS}")
    if not (optics.focal_length_mm > 0 and optics.f_number > 0):
        raise RecipeError(f"{path}: optics needs focal_length_mm and f_number above 0")
    check_lengths(sensor.pixel_pitch_um, optics, path)
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
        readout=settings_from(recipe.channel, recipe.cfa.channels, path),
    )


@dataclass(frozen=True)
class Inputs:
    """The files of a calibration, as they were before any was read."""

    recipe: str  # text of the measurement file
    files: dict[str, list[Path]]  # role → its files
    stamps: dict[Path, tuple[int, ...]]

    def history(self, options: dict[str, Any]) -> Stage:
        """Return the history stage of a calibration: options, the measurement file and the SHA-256 of all that it names.

        InputFileError if one is not the file that it was before, so that what was read and what is named are the same.
        """
        digests = {role: [sha256(file) for file in files] for role, files in self.files.items()}
        for file, before in self.stamps.items():
            if stamp(file) != before:
                raise InputFileError(f"{file} has changed while it was read; run again when nothing writes to it")
        return Stage("calibrate", options, self.recipe, digests)


def inputs_of(path: Path) -> Inputs:
    """Return the measurement file and all files that it names, to be called before they are read."""
    first = stamp(path)
    if has_base(path):
        files = correction_files(path)
        return Inputs(
            read_text(path), files, {file: stamp(file) for each in files.values() for file in each} | {path: first}
        )
    recipe = load_recipe(path, MeasurementRecipe)
    files = {
        "measurements": [path],
        "frames": [path.parent / name for name in frame_names(recipe)],
        "spectra": [path.parent / name for name in spectrum_names(recipe)],
    }
    if recipe.prior is not None:
        files["spectra"] += prior_files(path.parent / recipe.prior)
    stamps = {file: stamp(file) for named in files.values() for file in named} | {path: first}
    return Inputs(read_text(path), files, stamps)


def inputs_of_photos(photos: Sequence[Path]) -> Inputs:
    """Return the raw files of a calibration that has no measurement file, to be called before they are read."""
    return Inputs("", {"frames": list(photos)}, {file: stamp(file) for file in photos})


def photo_measurements(photos: Sequence[Path], light: str | None) -> Measurements:
    """Return the measurements of raw files of a chart under one light (None: to be estimated) without a measurement file;
    InputFileError if they do not state all that is needed."""
    return measurements_of(recipe_of_photos(photos, light), photos[0])
