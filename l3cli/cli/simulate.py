"""l3 simulate: camera × scenes × lights → training set."""

import dataclasses
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options

if TYPE_CHECKING:
    from l3cli.artifacts.camera import CameraModel
    from l3cli.artifacts.training_set import TrainingSet
    from l3cli.cli.frames import Run
    from l3cli.parallel.cluster import Scheduler
    from l3cli.simulate.light import Curve
    from l3cli.simulate.recipe import SceneRecipe

NEGLIGIBLE = 1e-3  # share of a channel's light that may go unseen without a word


@click.command()
@click.argument("scenes", type=options.FILE, metavar="SCENES.toml")
@click.option("--camera", type=options.FILE, required=True, metavar="FILE", help="Camera model or camera recipe (.toml).")
@options.output("Training set to write")
@click.option(
    "--pictures", type=options.FILE, metavar="DIR", help="Also write each raw frame (TIFF) and ideal picture (PNG)."
)
@click.option("--dng", type=options.FILE, metavar="DIR", help="Also write each raw frame as DNG, for other raw developers.")
@click.option("--resume", is_flag=True, help="Go on with the frames that a run that was stopped left in OUTPUT.parts.")
@options.seed
@options.scheduler
@options.jobs
@options.trust
@options.force
@options.quiet
def simulate(
    scenes: Path, camera: Path, output: Path, pictures: Path | None, dng: Path | None, resume: bool, seed: int, jobs: int,
    scheduler: "Scheduler | None", force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Simulate what a camera sees of many scenes, and the pictures it should make of them.

    \b
    Example: l3 simulate scenes.toml --camera camera.h5 -o training.h5
    """
    from l3cli.artifacts.camera_recipe import load_camera
    from l3cli.cli.frames import close_folder, jobs_of, key_of, open_folder, remove_finished, stored, work_off
    from l3cli.config import load_recipe
    from l3cli.files import refuse_existing
    from l3cli.parallel import workers
    from l3cli.simulate.recipe import SceneRecipe, shots

    options.hold_file(output, scenes, camera)
    remove_finished(output)
    refuse_existing(output, force)
    for folder in dict.fromkeys(filter(None, (pictures, dng))):
        options.claim_folder(folder, force)
    if scheduler:
        scenes = scenes.absolute()  # its files are looked for by workers elsewhere
    model, recipe = load_camera(camera), load_recipe(scenes, SceneRecipe)
    run, files, inputs = _prepare(recipe, scenes, model, seed)
    head = _head(run, model, (scenes, camera), inputs, seed)
    sums = head.history[-1].inputs
    digests = {path: own for role, paths in inputs.items() for path, own in zip(paths, sums.get(role, ()), strict=True)}
    key = key_of(head.history[-1])
    run = dataclasses.replace(run, key=key, folder=open_folder(output, key, resume))
    wanted = list(shots(recipe, files)) if recipe.scene else []
    total = sum(len(own) for _, own in wanted) + len(recipe.pair)
    with close_folder(run.folder):
        with workers(jobs, scheduler) as crew:
            work = jobs_of(run, wanted, crew.size)
            counts = stored(crew, work, digests) if scheduler else crew(work_off, work)
            finished = (index for count in counts for index in range(count))
            for _ in options.progress(finished, total, "frames", quiet):
                pass
        _assemble(run, head, output, total, quiet)
    if pictures:
        _write_pictures(output, pictures)
    if dng:
        _write_dng(run, output, dng)
    options.say(f"{output}: {total} frame{'s' if total > 1 else ''}", quiet)


def _prepare(
    recipe: "SceneRecipe", path: Path, camera: "CameraModel", seed: int
) -> tuple["Run", list[list[Path]], dict[str, list[Path]]]:
    """Everything checked and looked up before any work: the run, the files of each source, all files by their role."""
    from l3cli.cli.frames import Run
    from l3cli.errors import RecipeError
    from l3cli.io.cubes import band_pictures
    from l3cli.io.scene_files import find
    from l3cli.simulate import recipe as asked
    from l3cli.simulate.light import OWN, make_light
    from l3cli.simulate.sources import BandFolder
    from l3cli.simulate.targets import make_target

    try:
        asked.check(recipe, camera)
        named = asked.curve_files(recipe)
        curves = {name: _curve(path.parent / name, role) for name, role in named.items()}
        fitted = asked.set_up(camera, recipe, curves)
        other = recipe.target.illuminant
        wanted = {*recipe.illuminants, *asked.scene_lights(recipe), *filter(None, [other])} - {OWN}
        lights = {name: make_light(name, curves, fitted.wavelength) for name in sorted(wanted)}
    except RecipeError as error:
        raise RecipeError(f"{path}: {error}") from error
    outputs = recipe.target.outputs
    names = _column_names(path.parent / outputs) if outputs in curves else ()
    target = make_target(outputs, curves.get(outputs), names, lights[other] if other else None, fitted)
    patterns = zip(recipe.scene, asked.patterns(recipe), strict=True)
    files = [find(text, path.parent, isinstance(source, BandFolder)) if text else [] for source, text in patterns]
    roles = {
        "scene": [file for found in files for each in found for file in (band_pictures(each) if each.is_dir() else [each])],
        "spectrum": [path.parent / name for name in named],
        "pair": [path.parent / name for pair in recipe.pair for name in (pair.raw, pair.picture)],
    }
    return Run(recipe, fitted, target, lights, seed, path.parent, "", Path()), files, roles


def _curve(path: Path, role: str) -> "Curve":
    from l3cli.curve_table import read_table
    from l3cli.simulate.light import check_measured

    table = read_table(path)
    if role == "transmittance":
        return table.wavelength, table.counted(1).shares()
    if role == "functions":
        return table.wavelength, table.values
    curve = table.wavelength, table.powers()
    check_measured(curve, str(path))
    return curve


def _column_names(path: Path) -> tuple[str, ...]:
    """The heading of a CSV file of matching functions, or numbers where it has none."""
    from l3cli.curve_table import read_table

    table = read_table(path)
    unnamed = tuple(f"output {number}" for number in range(1, len(table.values) + 1))
    names = table.names or ()
    named = len(set(names)) == len(names) and not any(re.fullmatch(r"[-+.\deE]*", name) for name in names)
    return names if names and named else unnamed


def _head(
    run: "Run", camera: "CameraModel", recipes: tuple[Path, Path], inputs: dict[str, list[Path]], seed: int
) -> "TrainingSet":
    """The training set's head, with this stage as the last of the camera's history."""
    from l3cli.artifacts.base import Stage
    from l3cli.artifacts.camera_recipe import recipe_text
    from l3cli.artifacts.training_set import TrainingSet
    from l3cli.config import read_text
    from l3cli.files import sha256

    texts = [read_text(recipes[0]), recipe_text(recipes[1])]
    sums = {role: [sha256(path) for path in paths] for role, paths in inputs.items() if paths}
    recipe = "\n".join(text for text in texts if text)
    stage = Stage("simulate", {"seed": seed}, recipe, {"camera": [sha256(recipes[1])], **sums})
    return TrainingSet(
        camera=dataclasses.replace(run.camera, history=()),
        outputs=run.target.outputs,
        target_description=run.target.description,
        history=(*camera.history, stage),
    )


def _assemble(run: "Run", head: "TrainingSet", output: Path, total: int, quiet: bool) -> None:
    """The training set from its stored frames; what the scene that covers least of the light lacks is said."""
    from l3cli.artifacts.training_set import write_training_set

    with write_training_set(output, head) as writer:
        worst = max(
            (writer.append_part(run.part(index), run.key) for index in range(total)), key=lambda part: part.uncovered
        )
    if worst.uncovered > NEGLIGIBLE:
        share = f"{worst.uncovered:.1%} of the light that a channel collects from white"
        options.say(f"warning: {worst.scene} holds no data for {share}; give scenes of more wavelengths", quiet)


def _write_pictures(training: Path, folder: Path) -> None:
    """Each frame of a training set as raw mosaic and as the picture it should become, white at display white."""
    import numpy as np

    from l3cli.artifacts.training_set import open_training_set
    from l3cli.io.images import write_linear, write_mosaic, write_picture
    from l3cli.render.display import encode, make_display

    with open_training_set(training, unchanged=True) as frames:
        for index, frame in enumerate(frames):
            name = options.frame_name(index, frame.scene)
            write_mosaic(folder / f"{name}_raw.tif", frame.raw)
            if frames.head.outputs != ("X", "Y", "Z"):
                planes = np.moveaxis(frame.target / np.float32(frame.white.max()), 0, -1)
                write_linear(folder / f"{name}_ideal.exr", planes, frames.head.outputs)
                continue
            display = make_display(frame.white, 1.0 / frame.white[1], bits=8)
            write_picture(folder / f"{name}_ideal.png", encode(frame.target, display))


def _write_dng(run: "Run", training: Path, folder: Path) -> None:
    """Each raw frame of a training set as DNG, with the white balance of its light where that is known."""
    from l3cli.artifacts.training_set import open_training_set
    from l3cli.io.dng_writer import LIGHT_CODES, RawColour, write_dng
    from l3cli.simulate.light import make_light
    from l3cli.simulate.raw_colour import colour_matrix, neutral

    with open_training_set(training) as frames:
        camera = frames.head.camera
        lights = {name: make_light(name, {}, camera.wavelength) for name in LIGHT_CODES}
        colour = RawColour({name: colour_matrix(camera, light) for name, light in lights.items()})
        for index, frame in enumerate(frames):
            light = run.lights.get(frame.illuminant)
            grey = None if light is None else neutral(camera, light)
            path = folder / f"{options.frame_name(index, frame.scene)}.dng"
            write_dng(path, frame.raw, camera, colour, grey, frame.exposure)
