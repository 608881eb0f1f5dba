"""l3 simulate: camera × scenes × lights → training set."""

import contextlib
import dataclasses
import itertools
import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options
from l3cli.cli.terminal import tell

if TYPE_CHECKING:
    from l3cli.artifacts.camera import CameraModel
    from l3cli.artifacts.training_set import TrainingPair, TrainingSet
    from l3cli.cli.frames import Run
    from l3cli.parallel.cluster import Scheduler
    from l3cli.simulate.light import Curve
    from l3cli.simulate.recipe import SceneRecipe

WRITTEN = ("*_raw.tif", "*_ideal.png", "*_ideal.exr", "*.dng")  # into the folders of pictures
NEGLIGIBLE = 1e-3  # share of a channel's light that may go unseen without a word


@click.command()
@click.argument("scenes", type=options.RecipeFile("scenes"), metavar="SCENES.toml")
@click.option(
    "--camera", type=options.CAMERA, required=True, metavar="CAMERA", help="Camera model, camera recipe (.toml) or its name."
)
@options.output("Training set to write")
@click.option(
    "--pictures", type=options.FILE, metavar="DIR", help="Also write each raw frame (TIFF) and ideal picture (PNG)."
)
@click.option("--dng", type=options.FILE, metavar="DIR", help="Also write each raw frame as DNG, for other raw developers.")
@click.option("--resume", is_flag=True, help="Go on with the frames in OUTPUT.parts, or make the pictures of a whole set.")
@click.option(
    "--skip-bad", is_flag=True,
    help="Leave out scenes whose files have no readable header or do not fit the sensor; exit code 1 if there were any.",
)  # fmt: skip
@options.seed
@options.scheduler
@options.jobs
@options.trust
@options.force
@options.quiet
def simulate(
    scenes: Path, camera: Path, output: Path, pictures: Path | None, dng: Path | None, resume: bool, skip_bad: bool,
    seed: int, jobs: int, scheduler: "Scheduler | None", force: bool, quiet: bool,
) -> int:  # fmt: skip
    """Simulate what a camera sees of many scenes, and the pictures it should make of them.

    SCENES.toml is a recipe, or the name of one that comes with l3, such as default or small.

    \b
    Example: l3 simulate scenes.toml --camera camera.h5 -o training.h5
    """
    from l3cli.artifacts.camera_recipe import camera_files, load_camera
    from l3cli.artifacts.training_set import open_training_set
    from l3cli.cli.frames import StoredFrames, close_folder, is_of_run, key_of, open_folder, remove_finished
    from l3cli.config import load_recipe
    from l3cli.files import finished_together, refuse_existing
    from l3cli.simulate.recipe import SceneRecipe

    options.spare(scenes, *camera_files(camera))
    options.hold_file(output)
    remove_finished(output)
    refuse_existing(output, force or resume)
    folders = list(dict.fromkeys(filter(None, (pictures, dng))))
    for folder in folders:
        options.hold_folder(folder, *WRITTEN)
    if scheduler:
        scenes = scenes.absolute()  # its files are looked for by workers elsewhere
    model, recipe = load_camera(camera), load_recipe(scenes, SceneRecipe)
    run, files = _prepare(recipe, scenes, model, seed)
    files, bad = _fitting(run, files, scenes, skip_bad)
    inputs = {"camera": camera_files(camera), **_inputs(run, files)}
    options.spare(*itertools.chain(*inputs.values()))
    head = _head(run, model, (scenes, camera), inputs, seed)
    run = dataclasses.replace(run, key=key_of(head.history[-1]))
    stands = resume and not force and is_of_run(output, run.key)
    if not stands:
        refuse_existing(output, force)
    with contextlib.ExitStack() as unfinished:
        for folder in folders:
            unfinished.enter_context(finished_together(folder, run.key, force))
        if stands:
            with open_training_set(output, unchanged=True) as frames:
                total = len(frames)
                _write_beside(run, frames, pictures, dng)
        else:
            run = dataclasses.replace(run, folder=open_folder(output, run.key, resume, force))
            with close_folder(run.folder):
                total = _simulate_frames(run, files, head, jobs, scheduler, quiet)
                _write_beside(run, StoredFrames(run, total), pictures, dng)
                _assemble(run, head, output, total, quiet)  # last: whoever finds the set finds its pictures, too
    left_out = f"; {bad} scene{'s' if bad > 1 else ''} left out" if bad else ""
    options.say(f"{output}: {total} frame{'s' if total > 1 else ''}{left_out}", quiet)
    return 1 if bad else 0


def _simulate_frames(
    run: "Run", files: list[list[Path]], head: "TrainingSet", jobs: int, scheduler: "Scheduler | None", quiet: bool
) -> int:
    """Simulate and store those frames of a run that are not stored yet; how many it has."""
    from l3cli.cli.frames import jobs_of, stored, work_off
    from l3cli.parallel import workers
    from l3cli.simulate.recipe import shots

    inputs, sums = _inputs(run, files), head.history[-1].inputs
    digests = {path: own for role, paths in inputs.items() for path, own in zip(paths, sums.get(role, ()), strict=True)}
    wanted = list(shots(run.recipe, files)) if run.recipe.scene else []
    total = sum(len(own) for _, own in wanted) + len(run.recipe.pair)
    with workers(jobs, scheduler) as crew:
        work = jobs_of(run, wanted, crew.size)
        counts = stored(crew, work, digests) if scheduler else crew(work_off, work)
        finished = (index for count in counts for index in range(count))
        for _ in options.progress(finished, total, "frames", quiet):
            pass
    return total


def _prepare(recipe: "SceneRecipe", path: Path, camera: "CameraModel", seed: int) -> tuple["Run", list[list[Path]]]:
    """Everything checked and looked up before any work: the run, and the files of each source."""
    from l3cli.cli.frames import Run
    from l3cli.errors import RecipeError
    from l3cli.io.scene_files import find
    from l3cli.simulate import recipe as asked
    from l3cli.simulate.light import OWN, make_light, recorded_under
    from l3cli.simulate.sources import BandFolder
    from l3cli.simulate.targets import make_target

    try:
        asked.check(recipe, camera)
        named = asked.curve_files(recipe)
        curves = {name: _curve(path.parent / name, role) for name, role in named.items()}
        fitted = asked.set_up(camera, recipe, curves)
        other = recipe.target.illuminant
        wanted = {*recipe.illuminants, *filter(None, [other])} - {OWN}
        lights = {name: make_light(name, curves, fitted.wavelength) for name in sorted(wanted)}
        recorded = {name: recorded_under(name, curves, fitted.wavelength) for name in asked.scene_lights(recipe)}
    except RecipeError as error:
        raise RecipeError(f"{path}: {error}") from error
    outputs = recipe.target.outputs
    names = _column_names(path.parent / outputs) if outputs in curves else ()
    target = make_target(outputs, curves.get(outputs), names, lights[other] if other else None, fitted)
    patterns = zip(recipe.scene, asked.patterns(recipe), strict=True)
    files = [find(text, path.parent, isinstance(source, BandFolder)) if text else [] for source, text in patterns]
    return Run(recipe, fitted, target, lights, recorded, seed, path.parent, "", Path()), files


def _fitting(run: "Run", files: list[list[Path]], path: Path, skip_bad: bool) -> tuple[list[list[Path]], int]:
    """The files of each source that can be read and fit on the sensor, and how many do not: with `skip_bad` each is said
    and left out, else InputFileError names them all."""
    from l3cli.cli.frames import refusals
    from l3cli.errors import InputFileError, listed
    from l3cli.simulate.sources import FileSource

    refused = refusals(run, files)
    bad = [error for own in refused for error in own.values()]
    if not bad:
        return files, 0
    if not skip_bad:
        count = sum(map(len, files))
        told = f"{len(bad)} of {count} scenes cannot be taken: " if len(bad) > 1 else ""
        why = [str(error).partition("; ")[0] for error in bad]
        cure = "give scale, crop or (rgb) shrink, mend the files, or leave them out with --skip-bad"
        raise InputFileError(f"{told}{listed(why)}; {cure}")
    kept = [[each for each in found if each not in own] for found, own in zip(files, refused, strict=True)]
    drawn = any(not isinstance(source, FileSource) for source in run.recipe.scene)
    if not (any(kept) or drawn or run.recipe.pair):
        raise InputFileError(f"{path}: no scene is left of {len(bad)}: {listed(map(str, bad))}")
    for error in bad:
        tell(f"l3: {error}")
    return kept, len(bad)


def _inputs(run: "Run", files: list[list[Path]]) -> dict[str, list[Path]]:
    """All files of a run by their role; `files` are those of each source."""
    from l3cli.cli.frames import files_of
    from l3cli.simulate.recipe import curve_files

    return {
        "scene": [
            file
            for source, found in zip(run.recipe.scene, files, strict=True)
            for each in found
            for file in files_of(source, each)
        ],
        "spectrum": [run.base / name for name in curve_files(run.recipe)],
        "pair": [run.base / name for pair in run.recipe.pair for name in (pair.raw, pair.picture)],
    }


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
    from l3cli.artifacts.camera_recipe import recipe_text
    from l3cli.artifacts.schema import Stage
    from l3cli.artifacts.training_set import TrainingSet
    from l3cli.config import read_text
    from l3cli.files import sha256

    texts = [read_text(recipes[0]), recipe_text(recipes[1])]
    sums = {role: [sha256(path) for path in paths] for role, paths in inputs.items() if paths}
    recipe = "\n".join(text for text in texts if text)
    stage = Stage("simulate", {"seed": seed}, recipe, sums)
    return TrainingSet(
        camera=dataclasses.replace(run.camera, history=()),
        outputs=run.target.outputs,
        target_description=run.target.description,
        target_light=run.target.light.spectrum if run.target.light else None,
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


def _write_beside(run: "Run", frames: "Iterable[TrainingPair]", pictures: Path | None, dng: Path | None) -> None:
    """The pictures and DNGs of all `frames`, as far as they are asked for."""
    if pictures:
        _write_pictures(run, frames, pictures)
    if dng:
        _write_dng(run, frames, dng)


def _write_pictures(run: "Run", frames: "Iterable[TrainingPair]", folder: Path) -> None:
    """Each frame as raw mosaic and as the picture it should become, white at display white."""
    import numpy as np

    from l3cli.io.images import write_linear, write_mosaic, write_picture
    from l3cli.render.display import encode, make_display

    for index, frame in enumerate(frames):
        name = options.frame_name(index, frame.scene)
        write_mosaic(folder / f"{name}_raw.tif", frame.raw, frame.dark_time)
        if run.target.outputs != ("X", "Y", "Z"):
            planes = np.moveaxis(frame.target / np.float32(frame.white.max()), 0, -1)
            write_linear(folder / f"{name}_ideal.exr", planes, run.target.outputs)
            continue
        display = make_display(frame.white, 1.0 / frame.white[1], bits=8)
        write_picture(folder / f"{name}_ideal.png", encode(frame.target, display))


def _write_dng(run: "Run", frames: "Iterable[TrainingPair]", folder: Path) -> None:
    """Each raw frame as DNG, with the white balance of its light where that is known."""
    from l3cli.io.dng_writer import LIGHT_CODES, RawColour, write_dng
    from l3cli.simulate.light import make_light
    from l3cli.simulate.raw_colour import colour_matrix, neutral

    camera = run.camera
    lights = {name: make_light(name, {}, camera.wavelength) for name in LIGHT_CODES}
    colour = RawColour({name: colour_matrix(camera, light) for name, light in lights.items()})
    for index, frame in enumerate(frames):
        light = run.lights.get(frame.illuminant)
        grey = None if light is None else neutral(camera, light)
        path = folder / f"{options.frame_name(index, frame.scene)}.dng"
        write_dng(path, frame.raw, camera, colour, grey, frame.exposure)
