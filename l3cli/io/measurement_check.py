"""Check a measurement file and the files that it lists, and summarise its contents."""

import functools
from collections.abc import Iterator
from typing import Any

from l3cli.artifacts.recipe_source import RecipeSource
from l3cli.frames.measurement import Measurements
from l3cli.io.measurement_recipe import CaptureRecipe, CorrectionRecipe, MeasurementRecipe, captures_of, key_faults
from l3cli.io.measurements import read_contents
from l3cli.physics.mosaic import array_rows
from l3cli.recipes.faults import Fault
from l3cli.system.text import array_lines, counted, seconds_text


def measurement_faults(recipe: MeasurementRecipe | CorrectionRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield the faults in a measurement file and in all files that it lists. Raw frames are not decoded."""
    yield from key_faults(recipe)
    faults: list[Fault] = []
    read_contents(recipe, source.path, functools.partial(source.noting, faults))
    yield from faults


def measurement_summary(recipe: MeasurementRecipe | CorrectionRecipe, measured: Measurements) -> dict[str, Any]:
    """Summarise a measurement file as a dictionary of JSON types.

    The dictionary contains the CFA, the channels and a summary of each section. Sections that list captures are summarised
    by their number of captures, number of frames and range of exposure times in s.
    """
    body, sections = measured.body, _captures(recipe)
    array = [row.split() for row in array_rows(body.channels, body.cfa)]
    document = {"name": body.name, "array": array, "channels": list(body.channels), "sections": sections}
    if isinstance(recipe, CorrectionRecipe):
        return document
    if measured.mono:
        peaks = [float(step.wavelength[step.radiance.argmax()]) for step in measured.mono]
        sections["mono"]["wavelength_nm"] = [min(peaks), max(peaks)]
    for section in ("band", "chart"):
        if section in sections:
            sections[section]["illuminants"] = [each.illuminant for each in getattr(recipe, section)]
    if recipe.photos:
        frames = sum(len(photo.frames) for photo in recipe.photos)
        lights = [photo.light or "illuminant to be estimated" for photo in recipe.photos]
        sections["photo"] = {"captures": len(recipe.photos), "frames": frames, "illuminants": lights}
    named = {"sweep": recipe.sweep and recipe.sweep.table, "curves": recipe.curves and recipe.curves.file}
    sections |= {section: {"file": name} for section, name in named.items() if name}
    if recipe.datasheet is not None:
        sections["datasheet"] = {"well_capacity_e": recipe.datasheet.well_capacity_e}
    return document


def _captures(recipe: MeasurementRecipe | CorrectionRecipe) -> dict[str, Any]:
    """Return each section's number of captures, number of frames and range of exposure times in s."""
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
    """Format the result of `measurement_summary` as lines of text. `width` has no effect."""
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
        texts += [f"full-well capacity {section['well_capacity_e']:g} e-"] if "well_capacity_e" in section else []
        lines.append(f"[{name}] {', '.join(texts)}")
    return lines
