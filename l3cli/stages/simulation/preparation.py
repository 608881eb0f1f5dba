"""Checks and resolutions before any frame is simulated."""

import dataclasses
from pathlib import Path
from typing import Any

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import recipe_text
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import InputFileError, RecipeError, listed
from l3cli.io.file_names import find_scenes
from l3cli.io.scenes.registry import is_folder
from l3cli.recipes.toml import read_text
from l3cli.simulation import recipe as asked
from l3cli.simulation.light import SCENE_LIGHT, column_names, make_light, make_target, read_curve, recorded_under
from l3cli.simulation.recipe import SceneRecipe
from l3cli.simulation.run import SimulationRun
from l3cli.simulation.sensor import noise_plugin
from l3cli.simulation.sources import FileSource, name_of
from l3cli.stages.simulation.scenes import files_of, refusals
from l3cli.system.console import Console
from l3cli.system.files import sha256
from l3cli.system.plugins import package


def prepare(recipe: SceneRecipe, path: Path, camera: CameraModel, seed: int) -> tuple[SimulationRun, list[list[Path]]]:
    """Everything checked and resolved before any work: the run, and the files of each source."""
    try:
        asked.check(recipe, camera)
        named = asked.curve_files(recipe)
        curves = {name: read_curve(path.parent / name, role) for name, role in named.items()}
        fitted = asked.set_up(camera, recipe, curves)
        other = recipe.target.illuminant
        wanted = {*recipe.illuminants, *filter(None, [other])} - {SCENE_LIGHT}
        lights = {name: make_light(name, curves, fitted.wavelength) for name in sorted(wanted)}
        recorded = {name: recorded_under(name, curves, fitted.wavelength) for name in asked.recorded_lights(recipe)}
    except RecipeError as error:
        raise RecipeError(f"{path}: {error}") from error
    outputs = recipe.target.outputs
    names = column_names(path.parent / outputs) if outputs in curves else ()
    target = make_target(outputs, curves.get(outputs), names, lights[other] if other else None, fitted)
    patterns = zip(recipe.scene, asked.patterns(recipe), strict=True)
    files = [
        find_scenes(text, path.parent, is_folder(name_of(source))) if text is not None else [] for source, text in patterns
    ]
    return SimulationRun(recipe, fitted, target, lights, recorded, seed, path.parent), files


def fitting(
    run: SimulationRun, files: list[list[Path]], path: Path, skip_bad: bool, console: Console
) -> tuple[list[list[Path]], int]:
    """The files of each source that can be read and fit on the sensor, and how many do not: with `skip_bad` each is said
    and left out, else InputFileError names them all."""
    refused = refusals(run, files)
    bad = [error for errors in refused for error in errors.values()]
    if not bad:
        return files, 0
    if not skip_bad:
        count = sum(map(len, files))
        total = f"{len(bad)} of {count} scenes cannot be taken: " if len(bad) > 1 else ""
        why = [str(error).partition("; ")[0] for error in bad]
        cure = "give scale, crop or (rgb) shrink, mend the files, or leave them out with ‹skip_bad›"
        raise InputFileError(f"{total}{listed(why)}; {cure}")
    readable = [[path for path in paths if path not in errors] for paths, errors in zip(files, refused, strict=True)]
    synthetic = any(not isinstance(source, FileSource) for source in run.recipe.scene)
    if not (any(readable) or synthetic or run.recipe.pair):
        raise InputFileError(f"{path}: no scene is left of {len(bad)}: {listed(map(str, bad))}")
    for error in bad:
        console.report(f"l3: {error}")
    return readable, len(bad)


def input_files(run: SimulationRun, files: list[list[Path]]) -> dict[str, list[Path]]:
    """All files of a run by their role; `files` are those of each source."""
    return {
        "scene": [
            file
            for source, paths in zip(run.recipe.scene, files, strict=True)
            for path in paths
            for file in files_of(source, path)
        ],
        "spectrum": [run.base / name for name in asked.curve_files(run.recipe)],
        "pair": [run.base / name for pair in run.recipe.pair for name in (pair.raw, pair.picture)],
    }


def head_of(
    run: SimulationRun,
    camera: CameraModel,
    recipes: tuple[Path, Path],
    inputs: dict[str, list[Path]],
    chosen: dict[str, Any],
) -> TrainingSet:
    """The training set's head, with this stage as the last of the camera's history."""
    texts = [read_text(recipes[0]), recipe_text(recipes[1])]
    sums = {role: [sha256(path) for path in paths] for role, paths in inputs.items() if paths}
    recipe = "\n".join(text for text in texts if text)
    if model := run.recipe.sensor.noise_model:
        recipe += f"\n# noise_model of {package(noise_plugin(model))}\n"
    stage = Stage("simulate", chosen, recipe, sums)
    return TrainingSet(
        camera=dataclasses.replace(run.camera, history=()),
        outputs=run.target.outputs,
        target_description=run.target.description,
        target_light=run.target.light.spectrum if run.target.light else None,
        history=(*camera.history, stage),
    )
