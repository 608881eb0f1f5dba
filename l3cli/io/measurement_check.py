"""Check a measurement file and the files that it names, and summarise its contents."""

import functools
import os
from collections.abc import Iterator, Sequence
from typing import Any

from l3cli.artifacts.camera_recipe import load_camera
from l3cli.artifacts.recipe_source import Meaning, RecipeSource
from l3cli.io.curves import prior_files
from l3cli.io.measurement_recipe import (
    CaptureRecipe,
    ChartRecipe,
    CorrectionRecipe,
    MeasurementRecipe,
    MonitorRecipe,
    MonoRecipe,
    PhotoRecipe,
    captures_of,
    key_faults,
)
from l3cli.io.measurements import chart_radiance, curve_of, load_measurements, monitor_at, step_radiance
from l3cli.physics import charts, spectra
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import KeyPath
from l3cli.spectra.file import names_file, read_table
from l3cli.system.text import array_lines, counted, seconds_text


def measurement_faults(recipe: MeasurementRecipe | CorrectionRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield the faults of the keys and of every named file. `measurement_meaning` finds the remaining faults one by one."""
    yield from key_faults(recipe)
    for section, number, capture in captures_of(recipe):
        yield from _capture_faults(capture, (section, number), source)
    if isinstance(recipe, CorrectionRecipe):
        yield from source.attempt(("base",), load_camera, source.file(recipe.base))
        return
    key = ("sweep", "table") if recipe.sweep is not None else ("curves", "file")
    yield from source.attempt(key, curve_of, recipe, source.path)
    if recipe.prior is not None:
        yield from source.attempt(("prior",), prior_files, source.file(recipe.prior))
    for number, photo in enumerate(recipe.photos):
        yield from _photo_faults(photo, ("photo", number) if isinstance(recipe.photo, list) else ("photo",), source)


def _photo_faults(photo: PhotoRecipe, key: KeyPath, source: RecipeSource) -> Iterator[Fault]:
    """Yield the faults of the files, light and chart of a photo."""
    for field in ("frames", "dark", "white"):
        yield from _missing(getattr(photo, field), (*key, field), source)
    named_chart = functools.partial(charts.chart, wavelength=spectra.SAMPLED)
    for field, name, named in (("light", photo.light, spectra.require_illuminant), ("chart", photo.chart, named_chart)):
        if name is not None:
            work = (read_table, source.file(name)) if names_file(name) else (named, name)
            yield from source.attempt((*key, field), *work)


def _capture_faults(capture: CaptureRecipe, key: KeyPath, source: RecipeSource) -> Iterator[Fault]:
    """Yield the faults of the frames and spectra of a capture."""
    yield from _missing(capture.frames, (*key, "frames"), source)
    if isinstance(capture, MonoRecipe):
        wrong = list(source.attempt((*key, "spectrum"), _light, capture, source))
        yield from wrong
        if isinstance(capture.monitor, MonitorRecipe) and not wrong:
            yield from source.attempt((*key, "monitor"), _monitor, capture, source)
    if isinstance(capture, ChartRecipe):
        yield from source.attempt((*key, "radiance"), chart_radiance, source.file(capture.radiance), capture, key[0])


def _light(step: MonoRecipe, source: RecipeSource) -> None:
    """Raise InputFileError or RecipeError unless the table contains the light of a step."""
    step_radiance(read_table(source.file(step.spectrum)), step, source.path)


def _monitor(step: MonoRecipe, source: RecipeSource) -> None:
    """Raise InputFileError unless the table contains the reading for a step."""
    light, radiance = step_radiance(read_table(source.file(step.spectrum)), step, source.path)
    assert isinstance(step.monitor, MonitorRecipe)
    monitor_at(step.monitor, float(light.wavelength[radiance.argmax()]), source.path)


def _missing(names: Sequence[str], key: KeyPath, source: RecipeSource) -> Iterator[Fault]:
    """Yield a fault for each frame that does not exist."""
    for number, name in enumerate(names):
        if not os.path.isfile(source.file(name)):
            yield fault(f"{source.file(name)} does not exist; it is named as a frame", (*key, number))


def measurement_meaning(recipe: MeasurementRecipe | CorrectionRecipe, source: RecipeSource) -> Meaning:
    """Return the sections of a measurement file with their captures, frames and exposures."""
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
    """Return the numbers of captures and frames of each section, and the range of exposures."""
    sections: dict[str, list[CaptureRecipe]] = {}
    for section, _, capture in captures_of(recipe):
        sections.setdefault(section, []).append(capture)
    return {
        section: {
            "captures": len(captures),
            "frames": sum(len(capture.frames) for capture in captures),
            "exposure_s": [least(capture.seconds or 0.0 for capture in captures) for least in (min, max)],
        }
        for section, captures in sections.items()
    }


def measurement_lines(measured: dict[str, Any], width: int | None) -> list[str]:
    """Format the sections as lines."""
    lines = [f"{measured['name']}: channels {', '.join(measured['channels'])}", "", *array_lines(measured["array"]), ""]
    for name, section in measured["sections"].items():
        texts = (
            [counted(section["captures"], "capture"), counted(section["frames"], "frame")] if "captures" in section else []
        )
        if "exposure_s" in section:
            texts.append(" … ".join(dict.fromkeys(map(seconds_text, section["exposure_s"]))))
        if "wavelength_nm" in section:
            texts.append("{:g}…{:g} nm".format(*section["wavelength_nm"]))
        texts += [", ".join(section["illuminants"])] if "illuminants" in section else []
        texts += [section["file"]] if "file" in section else []
        texts += [f"well of {section['well_capacity_e']:g} e-"] if "well_capacity_e" in section else []
        lines.append(f"[{name}] {', '.join(texts)}")
    return lines
