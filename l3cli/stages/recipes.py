"""Faults and meaning of recipes that no single room knows: of designs, and of scenes with their files."""

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.artifacts.recipe_source import Meaning, RecipeSource, keys_of
from l3cli.design.pixel import pixel_of
from l3cli.design.recipe import DesignRecipe, design_faults, filter_curves, level_name
from l3cli.errors import InputFileError
from l3cli.io.file_names import find_scenes
from l3cli.recipes.faults import Fault, fault
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.recipe import SceneRecipe, curve_faults, scene_faults, shots
from l3cli.simulation.sources import wanted_scenes
from l3cli.stages.simulation.preparation import prepare, refusals, scene_files, size_of


def files_named(path: Path, content: Mapping[str, Any]) -> tuple[Path, ...]:
    """Return every file that a recipe at `path` names, whatever for: by its name, a pattern, or in a mixture of lights."""
    found: list[Path] = []
    for _, value in keys_of(content):
        for name in dict.fromkeys([value, *value.split()]) if isinstance(value, str) else []:
            single = path.parent / name
            found += [single] if os.path.isfile(single) else []
            if any(letter in name for letter in "*?["):
                with contextlib.suppress(InputFileError):
                    found += find_scenes(name, path.parent)
    return tuple(dict.fromkeys(found))


def design_recipe_faults(recipe: DesignRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, and with the files that it names."""
    wrong = list(design_faults(recipe))
    yield from wrong
    if not wrong:
        yield from source.attempt(None, _design_curves, recipe, source)


def _design_curves(recipe: DesignRecipe, source: RecipeSource) -> Any:
    camera = pixel_of(recipe.pixel, source.path.parent)
    return filter_curves(recipe, camera, camera.wavelength, source.path.parent)


def design_meaning(recipe: DesignRecipe, source: RecipeSource) -> Meaning:
    """Return the peak efficiency of each filter, and the lights and exposures."""
    peaks = _design_curves(recipe, source).max(axis=1).tolist()
    return {"filters": dict(zip(recipe.filters, peaks, strict=True)), "levels": list(map(level_name, recipe.level))}, []


def design_lines(figures: dict[str, Any], width: int | None) -> list[str]:
    """Return the figures of a design recipe as lines."""
    filters = ", ".join(f"{name} {100 * peak:.0f} %" for name, peak in figures["filters"].items())
    return [f"filters, peak quantum efficiency: {filters}", f"levels: {'; '.join(figures['levels'])}"]


def scene_recipe_faults(recipe: SceneRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield all that is wrong with a recipe, for its camera if one is given, and with the files that it names."""
    yield from scene_faults(recipe, source.camera)
    yield from curve_faults(recipe, source)
    for number, scene in enumerate(recipe.scene):
        yield from source.attempt(("scene", number, "file"), scene_files, scene, source.path)
    for number, pair in enumerate(recipe.pair):
        for side, name in (("raw", pair.raw), ("picture", pair.picture)):
            if not os.path.isfile(source.file(name)):
                message = f"{source.file(name)} does not exist; name a file relative to the recipe"
                yield fault(message, f"pair.{number}.{side}")


def scene_meaning(recipe: SceneRecipe, source: RecipeSource) -> Meaning:
    """Return the frames, and their size where a camera is given; the files that do not fit on its sensor."""
    run = None
    if source.camera is None:
        files = [scene_files(scene, source.path) for scene in recipe.scene]
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
