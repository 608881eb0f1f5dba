"""Measurement files: what they and the files that they name refuse, and what each section holds."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.camera_recipe import MOST_PRNU, cfa_faults, length_faults, load_camera, share_faults
from l3cli.errors import InputFileError
from l3cli.frames.measurement import PATCH_NAMES
from l3cli.io.correction_recipe import CorrectionRecipe
from l3cli.io.curves import read_finished, read_sweep
from l3cli.io.measurement_recipe import (
    CaptureRecipe,
    ChartRecipe,
    MeasurementRecipe,
    MonoRecipe,
    PhotoRecipe,
    is_table,
    key_faults,
)
from l3cli.io.measurements import MOST_MONITOR, load_measurements, patch_name
from l3cli.io.priors import prior_files
from l3cli.physics import charts
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml_lines import KeyPath
from l3cli.spectra.file import read_table
from l3cli.spectra.table import RELATIVE
from l3cli.stages.checking.scenes import GRID, named_light
from l3cli.stages.checking.source import Source

CAPTURES = ("mono", "band", "chart", "white", "dark")  # lists of tables that name frames


def faults(recipe: MeasurementRecipe | CorrectionRecipe, source: Source) -> Iterator[Fault]:
    """Yield the faults of the numbers of the sensor and of captures, and of every file that is named; the rest, such as
    sections that do not go together, `meaning` finds one by one."""
    if isinstance(recipe, CorrectionRecipe):
        yield from _correction_faults(recipe, source)
        return
    sensor = recipe.sensor
    for key in ("rows", "cols", "pixel_pitch_um", "bits"):
        if not getattr(sensor, key) > 0 or (key == "bits" and sensor.bits > 16):
            yield fault("sensor needs rows, cols and pixel_pitch_um above 0 and 1 to 16 bits", f"sensor.{key}")
    for key in ("focal_length_mm", "f_number"):
        if not getattr(recipe.optics, key) > 0:
            yield fault("optics needs focal_length_mm and f_number above 0", f"optics.{key}")
    yield from length_faults(sensor.pixel_pitch_um, recipe.optics)
    yield from cfa_faults(recipe.cfa)
    if recipe.datasheet is not None:
        yield from share_faults(recipe.datasheet.prnu, "datasheet.prnu", MOST_PRNU)
    yield from key_faults(recipe)
    for section in CAPTURES:
        for number, capture in enumerate(getattr(recipe, section)):
            yield from _capture_faults(capture, (section, number), source)
    yield from _curve_faults(recipe, source)
    for number, photo in enumerate(recipe.photos):
        yield from _photo_faults(photo, ("photo", number) if isinstance(recipe.photo, list) else ("photo",), source)


def _correction_faults(recipe: CorrectionRecipe, source: Source) -> Iterator[Fault]:
    """Yield the faults of the camera that is taken from another file, and of the captures."""
    yield from source.attempt(("base",), load_camera, source.file(recipe.base))
    for section in ("dark", "white"):
        captures = getattr(recipe, section)
        if not captures:
            yield fault(f"there is no [[{section}]] capture; add some", section)
        for number, capture in enumerate(captures):
            yield from _capture_faults(capture, (section, number), source)


def _photo_faults(photo: PhotoRecipe, key: KeyPath, source: Source) -> Iterator[Fault]:
    """Yield the faults of the files, the light and the chart of a photo."""
    for field in ("frames", "dark", "white"):
        yield from _missing(getattr(photo, field), (*key, field), source)
    for field, name, named in (("light", photo.light, named_light), ("chart", photo.chart, _named_chart)):
        if name is not None:
            work = (read_table, source.file(name)) if is_table(name) else (named, name)
            yield from source.attempt((*key, field), *work)


def _named_chart(name: str) -> None:
    """Raise RecipeError unless a chart has that name."""
    charts.chart(name, GRID)


def _capture_faults(capture: CaptureRecipe, key: KeyPath, source: Source) -> Iterator[Fault]:
    """Yield the faults of the frames, the exposure and the spectra of a capture."""
    table = key[0]
    if capture.seconds is None or not 0 < capture.seconds < float("inf"):
        message = f"a [[{table}]] capture needs one of exposure_s, exposure_ms and exposure_us, above 0"
        yield fault(message, *((*key, f"exposure_{unit}") for unit in ("s", "ms", "us")))
    if not 1 / MOST_MONITOR <= capture.monitor <= MOST_MONITOR:
        message = f"monitor is {capture.monitor:g}; give the lamp's reading over the one when its spectrum was measured"
        yield fault(f"{message}, 1 where it is the same", (*key, "monitor"))
    if not capture.frames:
        yield fault(f"a [[{table}]] capture needs frames", (*key, "frames"))
    yield from _missing(capture.frames, (*key, "frames"), source)
    if isinstance(capture, MonoRecipe):
        yield from source.attempt((*key, "spectrum"), _check_light, source.file(capture.spectrum), capture)
    if isinstance(capture, ChartRecipe):
        if len(capture.corners) != 4 or not np.isfinite(capture.corners).all():
            message = f"a [[{table}]] has {len(capture.corners)} corners; give col, row of patches 1, 6, 24, 19"
            yield fault(message, (*key, "corners"))
        yield from source.attempt((*key, "radiance"), _check_chart, source.file(capture.radiance), capture, table)


def _missing(names: Sequence[str], key: KeyPath, source: Source) -> Iterator[Fault]:
    """Yield the faults of frames that do not exist."""
    for number, name in enumerate(names):
        if not os.path.isfile(source.file(name)):
            yield fault(f"{source.file(name)} does not exist; it is named as a frame", (*key, number))


def _check_light(path: Path, step: MonoRecipe) -> None:
    if read_table(path).column(step.column).photons(step.unit).max() <= 0:
        raise InputFileError(f"{path}: column {step.column} is dark; measure the light again")


def _check_chart(path: Path, chart: ChartRecipe, table: str) -> None:
    measured = read_table(path).ordered(PATCH_NAMES, patch_name)
    if table == "chart" and {chart.unit, *measured.units} & set(RELATIVE):
        raise InputFileError(f"{path}: radiances of a [[chart]] give the scale and cannot be relative; measure them")
    if measured.photons(chart.unit, absolute=table == "chart").max(axis=1).min() <= 0:
        raise InputFileError(f"{path}: a patch without light; measure the chart again")


def _curve_faults(recipe: MeasurementRecipe, source: Source) -> Iterator[Fault]:
    channels, sweep, curves = recipe.cfa.channels, recipe.sweep, recipe.curves
    if sweep is not None:
        paths = source.file(sweep.table), source.file(sweep.response.file)
        yield from source.attempt(("sweep", "table"), read_sweep, *paths, channels, sweep.response.column)
    if curves is not None:
        asked = channels, curves.per_energy, curves.columns
        yield from source.attempt(("curves", "file"), read_finished, source.file(curves.file), *asked)
    if recipe.prior is not None:
        yield from source.attempt(("prior",), prior_files, source.file(recipe.prior))


def meaning(recipe: MeasurementRecipe | CorrectionRecipe, source: Source) -> tuple[dict[str, Any], list[Fault]]:
    """Return the sections with their captures, frames and exposures."""
    body = load_measurements(source.path).body
    sections = _captures(recipe)
    if isinstance(recipe, CorrectionRecipe):
        names = [[body.channels[site] for site in row] for row in body.cfa]
        return {"name": body.name, "array": names, "channels": list(body.channels), "sections": sections}, []
    if recipe.mono:
        steps = [read_table(source.file(step.spectrum)).column(step.column) for step in recipe.mono]
        peaks = [float(step.wavelength[step.values[0].argmax()]) for step in steps]
        sections["mono"]["wavelength_nm"] = [min(peaks), max(peaks)]
    for section in ("band", "chart"):
        if section in sections:
            sections[section]["illuminants"] = [each.illuminant for each in getattr(recipe, section)]
    if recipe.photos:
        frames = sum(len(photo.frames) for photo in recipe.photos)
        lights = [photo.light or "to be guessed" for photo in recipe.photos]
        sections["photo"] = {"captures": len(recipe.photos), "frames": frames, "illuminants": lights}
    named = {"sweep": recipe.sweep and recipe.sweep.table, "curves": recipe.curves and recipe.curves.file}
    sections |= {section: {"file": name} for section, name in named.items() if name}
    if recipe.datasheet is not None:
        sections["datasheet"] = {"well_capacity_e": recipe.datasheet.well_capacity_e}
    rows = [row.split() for row in recipe.cfa.pattern]
    return {"name": recipe.name, "array": rows, "channels": recipe.cfa.channels, "sections": sections}, []


def _captures(recipe: MeasurementRecipe | CorrectionRecipe) -> dict[str, Any]:
    """Return the numbers of captures and frames of each section, and their exposures."""
    sections: dict[str, Any] = {}
    for section in CAPTURES:
        captures: list[CaptureRecipe] = getattr(recipe, section, [])
        if captures:
            exposures = [capture.seconds or 0.0 for capture in captures]
            sections[section] = {
                "captures": len(captures),
                "frames": sum(len(capture.frames) for capture in captures),
                "exposure_s": [min(exposures), max(exposures)],
            }
    return sections
