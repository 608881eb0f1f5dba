"""Faults and meaning of recipes and measurement files, and of the files that they name."""

import contextlib
import functools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_curves import responsivity
from l3cli.artifacts.camera_recipe import CameraRecipe, PhaseRecipe, camera_faults, columns_left_out, load_camera
from l3cli.artifacts.class_rule import MAX_PATCH
from l3cli.classes import contrast, level
from l3cli.design.pixel import pixel_of
from l3cli.design.recipe import DesignRecipe, design_faults, filter_curves, level_name
from l3cli.errors import InputFileError, L3Error, shortened
from l3cli.io.curves import prior_files
from l3cli.io.file_names import find_scenes
from l3cli.io.measurement_recipe import (
    CaptureRecipe,
    ChartRecipe,
    CorrectionRecipe,
    MeasurementRecipe,
    MonoRecipe,
    PhotoRecipe,
    captures_of,
    is_table,
    key_faults,
)
from l3cli.io.measurements import chart_radiance, curve_of, load_measurements, step_radiance
from l3cli.io.scenes.registry import is_folder
from l3cli.physics import charts, spectra
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import KeyPath
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.lab import LabRecipe, lab_faults
from l3cli.simulation.light import MEASURED, SCENE_LIGHT, mixture, read_curve
from l3cli.simulation.recipe import SceneRecipe, scene_faults, shots
from l3cli.simulation.sources import FileSource, name_of, wanted_scenes
from l3cli.simulation.sources import Source as SceneSource
from l3cli.simulation.summary import array_lines, camera_figures, lab_figures, seconds_text
from l3cli.spectra.file import read_table
from l3cli.stages.simulation.preparation import prepare, refusals, size_of
from l3cli.system.text import counted
from l3cli.training.recipe import TrainingRecipe, layer_faults, learning_faults
from l3cli.training.summary import class_figures

SUFFIX = re.compile("_(dn|e|s|nm|um|mm|m)$")  # of a key with a unit
SHORTEST = 4  # letters of a text that an error is known by
GRID = np.arange(400.0, 701.0, 10.0)  # nm, on which a light's name is tried
Meaning = tuple[dict[str, Any], list[Fault]]


@dataclass(frozen=True)
class Source:
    """A recipe that is checked, and what it is checked with."""

    path: Path
    content: Mapping[str, Any]
    camera: CameraModel | None  # that the recipe is for, if one is given

    def file(self, name: str) -> Path:
        """Return a file that the recipe names."""
        return self.path.parent / name

    def attempt(self, key: KeyPath | None, work: Callable[..., object], *arguments: object) -> Iterator[Fault]:
        """Yield the fault, if there is one, with which `work` fails: at `key`, or where its message belongs."""
        try:
            work(*arguments)
        except (L3Error, OSError) as error:  # a name that is too long, a folder that must not be read
            message = self.plain(error)
            yield Fault(message, (key_in(message, self.content) if key is None else key,))

    def plain(self, error: L3Error | OSError) -> str:
        """Return an error's message without the name of this file."""
        if isinstance(error, OSError):
            return f"{shortened(str(error.filename))}: {error.strerror}; name another file"
        return re.sub(rf"^{re.escape(str(self.path))}(:\d+)?: ", "", str(error))


def files_named(path: Path, content: Mapping[str, Any]) -> tuple[Path, ...]:
    """Return every file that a recipe at `path` names, whatever for: by its name, a pattern, or in a mixture of lights."""
    found: list[Path] = []
    for _, value in _keys(content, ()):
        for name in dict.fromkeys([value, *value.split()]) if isinstance(value, str) else []:
            single = path.parent / name
            found += [single] if os.path.isfile(single) else []
            if any(letter in name for letter in "*?["):
                with contextlib.suppress(InputFileError):
                    found += find_scenes(name, path.parent)
    return tuple(dict.fromkeys(found))


def key_in(message: str, content: Mapping[str, Any]) -> KeyPath:
    """Return the key that a message is about: whose name, or else whose text (that of a file, say) it holds; () where there
    is none."""
    found: list[tuple[int, KeyPath]] = []
    for path, value in _keys(content, ()):
        names = [part for part in path if isinstance(part, str)]
        last = names[-1] if isinstance(path[-1], str) else ""
        if len(names) > 1 and ".".join(names) in message:
            found.append((200 + len(names), path))
        elif isinstance(value, str) and len(value) >= SHORTEST and value in message:
            found.append((100, path))
        elif last and re.search(rf"\b({re.escape(last)}|{re.escape(SUFFIX.sub('', last).replace('_', ' '))})\b", message):
            found.append((len(last), path))
    return max(found, key=lambda each: each[0])[1] if found else ()


def _keys(value: Any, path: KeyPath) -> Iterator[tuple[KeyPath, Any]]:
    inner = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        yield (*path, key), item
        yield from _keys(item, (*path, key))


def camera_recipe_faults(recipe: CameraRecipe | PhaseRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with the numbers of a recipe, or with its file of curves."""
    if source.path.suffix != ".toml":
        yield fault("commands know a camera recipe by its suffix; call the file NAME.toml", "name")
    if isinstance(recipe, PhaseRecipe):
        return
    wrong = list(camera_faults(recipe))
    yield from wrong
    declared = recipe.responsivity
    if declared.file is not None:
        work = (responsivity, declared, recipe.cfa.channels, source.path.parent)
        if not any(each.keys[0][0] in ("responsivity", "cfa") for each in wrong):
            yield from source.attempt(("responsivity", "file"), *work)


def camera_meaning(recipe: CameraRecipe | PhaseRecipe, source: Source) -> Meaning:
    """Return the camera in figures, and a note on columns of its file of curves."""
    return camera_figures(load_camera(source.path)) | {"note": columns_left_out(source.path)}, []


def lab_recipe_faults(recipe: LabRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, for its camera if one is given."""
    yield from lab_faults(recipe, source.camera)
    yield from source.attempt(("white", "illuminant"), named_light, recipe.white.illuminant)
    for number, name in enumerate(recipe.chart.illuminants):
        yield from source.attempt(("chart", "illuminants", number), named_light, name)


def lab_meaning(recipe: LabRecipe, source: Source) -> Meaning:
    """Return captures and frames of each kind."""
    return ({} if source.camera is None else lab_figures(recipe, source.camera)), []


def class_recipe_faults(recipe: TrainingRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, for its camera if one is given."""
    yield from learning_faults(recipe.learning)
    yield from layer_faults(recipe.layer)
    classes = recipe.classes
    if classes.patch % 2 == 0 or not 1 <= classes.patch <= MAX_PATCH:
        yield fault(f"classes.patch is {classes.patch}, not an odd number up to {MAX_PATCH}", "classes.patch")
    yield from source.attempt(None, contrast.check_edges, classes)
    yield from source.attempt(None, level.edge_shares, classes)


def class_meaning(recipe: TrainingRecipe, source: Source) -> Meaning:
    """Return the classes of each layer, and the bytes of the table for a camera."""
    return class_figures(recipe, source.camera), []


def design_recipe_faults(recipe: DesignRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, and with the files that it names."""
    wrong = list(design_faults(recipe))
    yield from wrong
    if not wrong:
        yield from source.attempt(None, _design_curves, recipe, source)


def _design_curves(recipe: DesignRecipe, source: Source) -> Any:
    camera = pixel_of(recipe.pixel, source.path.parent)
    return filter_curves(recipe, camera, camera.wavelength, source.path.parent)


def design_meaning(recipe: DesignRecipe, source: Source) -> Meaning:
    """Return the peak efficiency of each filter, and the lights and exposures."""
    peaks = _design_curves(recipe, source).max(axis=1).tolist()
    return {"filters": dict(zip(recipe.filters, peaks, strict=True)), "levels": list(map(level_name, recipe.level))}, []


def design_lines(figures: dict[str, Any], width: int | None) -> list[str]:
    """Return the figures of a design recipe as lines."""
    filters = ", ".join(f"{name} {100 * peak:.0f} %" for name, peak in figures["filters"].items())
    return [f"filters, peak quantum efficiency: {filters}", f"levels: {'; '.join(figures['levels'])}"]


def scene_recipe_faults(recipe: SceneRecipe, source: Source) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, for its camera if one is given, and with the files that it names."""
    yield from scene_faults(recipe, source.camera)
    lens, target = recipe.lens, recipe.target
    for text, key in _lights(recipe):
        yield from _light_faults(text, key, source)
    if isinstance(lens.transmittance, str):
        yield from source.attempt(("lens", "transmittance"), read_curve, source.file(lens.transmittance), "transmittance")
    if target.outputs.endswith(MEASURED):
        yield from source.attempt(("target", "outputs"), read_curve, source.file(target.outputs), "functions")
    for number, scene in enumerate(recipe.scene):
        yield from source.attempt(("scene", number, "file"), _files, scene, source.path)
    for number, pair in enumerate(recipe.pair):
        for side, name in (("raw", pair.raw), ("picture", pair.picture)):
            if not os.path.isfile(source.file(name)):
                message = f"{source.file(name)} does not exist; name a file relative to the recipe"
                yield fault(message, f"pair.{number}.{side}")


def _lights(recipe: SceneRecipe) -> Iterator[tuple[str, KeyPath]]:
    """Yield the lights that a recipe names, and where."""
    yield from ((text, ("illuminants", number)) for number, text in enumerate(recipe.illuminants))
    if recipe.target.illuminant is not None:
        yield recipe.target.illuminant, ("target", "illuminant")
    for number, scene in enumerate(recipe.scene):
        if text := getattr(scene, "light", None):
            yield text, ("scene", number, "light")


def _light_faults(text: str, key: KeyPath, source: Source) -> Iterator[Fault]:
    if text == SCENE_LIGHT:
        return
    wrong = list(source.attempt(key, mixture, text))
    yield from wrong
    for _, name in [] if wrong else mixture(text):
        if name.endswith(MEASURED):
            yield from source.attempt(key, read_curve, source.file(name), "light")
        else:
            yield from source.attempt(key, named_light, name)


@functools.lru_cache(1000)
def named_light(name: str) -> None:
    """Raise RecipeError unless a light has that name."""
    spectra.illuminant(name, GRID)


def _files(scene: SceneSource, recipe: Path) -> list[Path]:
    """Return the files of a source; InputFileError if it is to have some and there are none."""
    return find_scenes(scene.file, recipe.parent, is_folder(name_of(scene))) if isinstance(scene, FileSource) else []


def scene_meaning(recipe: SceneRecipe, source: Source) -> Meaning:
    """Return the frames, and their size where a camera is given; the files that do not fit on its sensor."""
    run = None
    if source.camera is None:
        files = [_files(scene, source.path) for scene in recipe.scene]
    else:
        run, files = prepare(recipe, source.path, source.camera, 0)
    wanted = list(shots(recipe, files)) if recipe.scene else []
    document: dict[str, Any] = {
        "scenes": len(wanted),
        "clips": sum(scene.source.motion is not None for scene, _ in wanted),
        "illuminants": recipe.illuminants,
        "luminances_cd_m2": recipe.luminances_cd_m2,
        "exposures": dict([recipe.exposures()]) if recipe.scene else {},
        "pairs": len(recipe.pair),
        "frames": sum(len(each) for _, each in wanted) + len(recipe.pair),
    }
    if run is None:
        return document, []
    bad = [
        Fault(str(error), (("scene", number, "file"),))
        for number, errors in enumerate(refusals(run, files))
        for error in errors.values()
    ]
    return (document, bad) if bad else (document | _sizes(recipe, run, files), [])


def _sizes(recipe: SceneRecipe, run: SimulationRun, files: list[list[Path]]) -> dict[str, Any]:
    """Return the pixels and bytes of the simulated frames of a camera."""
    sizes = []
    for scene, paths in zip(recipe.scene, files, strict=True):
        each = len(recipe.illuminants) * len(recipe.luminances_cd_m2) * len(recipe.exposures()[1])
        each *= scene.motion.frames if scene.motion else 1
        sizes += [(size_of(wanted, run), each) for wanted in wanted_scenes(scene, paths)]
    if not sizes:
        return {"camera": run.camera.name}
    a_pixel = run.frame_bytes / (run.camera.rows * run.camera.cols)
    pixels = [rows * cols for (rows, cols), _ in sizes]
    return {
        "camera": run.camera.name,
        "largest": list(sizes[int(np.argmax(pixels))][0]),
        "largest_bytes": int(max(pixels) * a_pixel),
        "bytes": int(sum(number * each for number, (_, each) in zip(pixels, sizes, strict=True)) * a_pixel),
    }


def measurement_faults(recipe: MeasurementRecipe | CorrectionRecipe, source: Source) -> Iterator[Fault]:
    """Yield the faults of the keys and of every file that is named; the rest `meaning` finds one by one."""
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
    """Yield the faults of the frames and the spectra of a capture."""
    yield from _missing(capture.frames, (*key, "frames"), source)
    if isinstance(capture, MonoRecipe):
        yield from source.attempt((*key, "spectrum"), _light, capture, source)
    if isinstance(capture, ChartRecipe):
        yield from source.attempt((*key, "radiance"), chart_radiance, source.file(capture.radiance), capture, key[0])


def _light(step: MonoRecipe, source: Source) -> None:
    """Raise InputFileError or RecipeError unless a table holds the light of a step."""
    step_radiance(read_table(source.file(step.spectrum)), step, source.path)


def _missing(names: Sequence[str], key: KeyPath, source: Source) -> Iterator[Fault]:
    """Yield the faults of frames that do not exist."""
    for number, name in enumerate(names):
        if not os.path.isfile(source.file(name)):
            yield fault(f"{source.file(name)} does not exist; it is named as a frame", (*key, number))


def measurement_meaning(recipe: MeasurementRecipe | CorrectionRecipe, source: Source) -> Meaning:
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
    """Return the sections as lines."""
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
