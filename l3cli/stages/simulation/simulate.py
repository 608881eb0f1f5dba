"""The simulation stage: camera × scenes × lights → training set, and optionally pictures and DNG files of its frames."""

import contextlib
import functools
import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from l3cli.artifacts.camera_recipe import camera_files, columns_left_out, load_camera
from l3cli.artifacts.training_set import (
    TrainingPair,
    TrainingSet,
    frame_name,
    open_training_set,
    whole_part,
    write_training_set,
)
from l3cli.io.file_names import IDEAL, MOTION, RAW
from l3cli.options.commands import SimulateOptions
from l3cli.parallel import workers
from l3cli.recipes.load import load_recipe
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.recipe import SceneRecipe, shots
from l3cli.stages.simulation.preparation import (
    fitting,
    head_of,
    input_files,
    note_unknown_fields,
    prepare,
    unknown_of,
)
from l3cli.stages.simulation.units import StoredFrames, is_of_run, key_of, received, simulate_unit, units_of
from l3cli.system.checkpoint import incomplete_folder, is_finished, mark_finished
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed, files_to_read, refuse_existing
from l3cli.system.outputs import OutputGuard

NEGLIGIBLE_LIGHT = 1e-3  # fraction of a channel's light that scenes may lack without a warning


@dataclass(frozen=True)
class Simulated:
    """Result of a simulation: the number of frames, the number of scenes that were left out, and the files."""

    frames: int
    scenes_left_out: int
    files: FilesUsed


def simulate(scenes: Path, camera: Path, output: Path, options: SimulateOptions) -> Simulated:
    """Simulate the training set of a scene recipe and a camera (model or recipe), and write it.

    Parameters
    ----------
    scenes, camera : Path
        Scene recipe, and camera model or recipe.
    output : Path
        Training set to write.
    options : SimulateOptions
        Options of `l3 simulate`.

    Raises
    ------
    RecipeError, InputFileError
        If recipe, camera or files cannot be used.
    L3Error
        If an output cannot be written.
    """
    # In this order, errors are raised before any work, and no output replaces an input.
    console, resume, force, scheduler = options.console, options.resume, options.force, options.cluster()
    folders = list(dict.fromkeys(filter(None, (options.pictures, options.dng))))
    with OutputGuard(console) as guard:
        guard.protect(scenes, *camera_files(camera), *itertools.chain(*options.inputs().values()))
        guard.hold_file(output)
        refuse_existing(output, force or resume)
        for folder in folders:
            guard.hold_folder(folder, *WRITTEN)
        if scheduler:
            scenes = scenes.absolute()  # because workers elsewhere look for the files that it names
        model, recipe = load_camera(camera), load_recipe(scenes, SceneRecipe)
        _ = model.saturation_exposure  # raises InputFileError for a camera that is blind to the light, before any work
        run, files = prepare(recipe, scenes, model, options.seed)
        files, bad = fitting(run, files, scenes, options.skip_bad, console)
        inputs = {"camera": camera_files(camera), **input_files(run, files)}
        guard.protect(*itertools.chain(*inputs.values()))
        head = head_of(run, model, (scenes, camera), inputs, options.chosen())
        key = key_of(head.history[-1])
        stored = StoredFrames(output, key)
        stands = resume and not force and is_of_run(output, key)
        if not stands:
            refuse_existing(output, force)
        if note := columns_left_out(camera):
            console.info(note)
        for text in unknown_of(run, model, camera):
            console.warn(text)
        note_unknown_fields(run, files, console)
        used = files_to_read({"scene recipe": [scenes], **inputs})
        with contextlib.ExitStack() as unfinished:
            done = [folder for folder in folders if stands and is_finished(folder, key)]
            for folder in folders:
                if folder not in done:
                    unfinished.enter_context(incomplete_folder(folder, key, force))
            if stands:
                stored.remove()  # left by a run that was killed after the output had appeared
                missing = replace(
                    options,
                    pictures=None if options.pictures in done else options.pictures,
                    dng=None if options.dng in done else options.dng,
                )
                with open_training_set(output, unchanged=True) as frames:
                    total = len(frames)
                    pictures = write_pictures(run, files, frames, missing)
            else:
                with stored.held(resume, force, whole_part):
                    total = _simulate_frames(run, files, head, stored, options)
                    pictures = write_pictures(run, files, stored, options)
                    _assemble(stored, head, output, console)  # last, so that a finished set always has its pictures
            for folder in folders:
                mark_finished(folder, key)
        left_out = f"; {bad} scene{'s' if bad > 1 else ''} left out" if bad else ""
        console.info(f"{output}: {total} frame{'s' if total > 1 else ''}{left_out}{'; finished already' if stands else ''}")
        return Simulated(total, bad, used.and_wrote(output, *pictures))


def _simulate_frames(
    run: SimulationRun, files: list[list[Path]], head: TrainingSet, stored: StoredFrames, options: SimulateOptions
) -> int:
    """Simulate and store the frames of a run that are not stored yet. Return the number of all frames."""
    inputs, sums = input_files(run, files), head.history[-1].inputs
    digests = {
        path: digest for role, paths in inputs.items() for path, digest in zip(paths, sums.get(role, ()), strict=True)
    }
    wanted = list(shots(run.recipe, files)) if run.recipe.scene else []
    total = sum(len(each) for _, each in wanted) + len(run.recipe.pair)
    with workers(options.jobs, options.cluster()) as pool:
        work = units_of(run, wanted, stored, pool.size)
        done = total - sum(len(unit.shots) for unit in work)
        function = functools.partial(simulate_unit, stored)
        counts = received(pool, work, stored, digests) if options.scheduler else pool(function, work)
        finished = (index for count in itertools.chain([done], counts) for index in range(count))
        for _ in options.console.progress(finished, total, "frames"):
            pass
    return total


def _assemble(stored: StoredFrames, head: TrainingSet, output: Path, console: Console) -> None:
    """Write the training set from its stored frames. Warn if a scene lacks data for more than a negligible part of the
    light.
    """
    with write_training_set(output, head) as writer:
        worst = max(stored.append_to(writer), key=lambda scene: scene.uncovered)
    if worst.uncovered > NEGLIGIBLE_LIGHT:
        share = f"{worst.uncovered:.1%} of the light that a channel collects from white"
        console.warn(f"{worst.scene} has no data for {share}; give scenes with more wavelengths")


CHANNELS = ("down", "right", "seen")  # channels of a file of motion
WRITTEN = (f"*{RAW}", f"*{IDEAL}", "*_ideal.exr", f"*{MOTION}", "*.dng")  # files in the folders of pictures


def write_pictures(
    run: SimulationRun, files: list[list[Path]], frames: Iterable[TrainingPair], options: SimulateOptions
) -> list[Path]:
    """Write the pictures and DNGs of all frames that the options ask for, and return their files.

    `files` are the files of each source. A message names the exposure with which a clip is rendered as bright as its ideal
    pictures.
    """
    written: list[Path] = []
    if options.pictures:
        lengths = _write_motion(run, files, options.pictures, written)
        first_of = {index: first for first, count in lengths.items() for index in range(first, first + count)}
        for index, scale in _write_pictures(run, frames, options.pictures, first_of, written).items():
            if index in lengths:
                last = index + lengths[index] - 1
                options.console.info(
                    f"frames {index}–{last}: ‹exposure› {scale:.6g} renders them as bright as their ideal pictures"
                )
    if options.dng:
        _write_dng(run, frames, options.dng, written)
    return written


def _write_pictures(
    run: SimulationRun, frames: Iterable[TrainingPair], folder: Path, first_of: dict[int, int], written: list[Path]
) -> dict[int, float]:
    """Write the raw mosaic and the ideal picture of each frame.

    Ideal pictures are exposed like those of `l3 render`: the 99th percentile of Y is shown as white.

    Parameters
    ----------
    run : SimulationRun
        The camera and the outputs of the frames.
    frames : iterable of TrainingPair
        The frames in their order.
    folder : Path
        Where the pictures are written.
    first_of : dict
        Number of each frame of a clip → number of the clip's first frame, whose exposure applies to the whole clip.
    written : list of Path
        The files are appended to this list.

    Returns
    -------
    dict
        Number of each frame with an sRGB ideal picture → the exposure with which `l3 render` makes it equally bright.
    """
    import numpy as np

    from l3cli.io.pictures.openimageio import write_mosaic
    from l3cli.io.pictures.registry import write_picture
    from l3cli.physics.display import exposure_scale
    from l3cli.rendering.display import encode, make_display

    scales, exposures = {}, {}
    for index, frame in enumerate(frames):
        name = frame_name(index, frame.scene)
        write_mosaic(folder / f"{name}{RAW}", frame.raw, frame.dark_time)
        if run.target.outputs != ("X", "Y", "Z"):
            planes = np.moveaxis(frame.target / np.float32(frame.white.max()), 0, -1)
            write_picture(folder / f"{name}_ideal.exr", planes, run.target.outputs)
            written += [folder / f"{name}{RAW}", folder / f"{name}_ideal.exr"]
            continue
        first = first_of.get(index, index)
        if first not in exposures:
            exposures[first] = exposure_scale(frame.target[1])
        display = make_display(frame.white, exposures[first], bits=8)
        write_picture(folder / f"{name}{IDEAL}", encode(frame.target, display))
        written += [folder / f"{name}{RAW}", folder / f"{name}{IDEAL}"]
        scales[index] = run.camera.output_unit * exposures[first] / frame.exposure
    return scales


def _write_motion(run: SimulationRun, files: list[list[Path]], folder: Path, written: list[Path]) -> dict[int, int]:
    """Write the motion of each frame of a clip since the previous frame, and append the files to `written`.

    Returns
    -------
    dict
        Number of the first frame of each clip → number of frames.
    """
    import numpy as np

    from l3cli.io.pictures.registry import write_picture
    from l3cli.simulation.clip import known_motion

    lengths = {}
    for wanted, clip in shots(run.recipe, files) if run.recipe.scene else ():
        if wanted.source.motion is None:
            continue
        moved = known_motion(wanted, run)
        for shot in clip:
            name = frame_name(shot.index, wanted.name)
            write_picture(folder / f"{name}{MOTION}", np.moveaxis(moved(shot.moment), 0, -1), CHANNELS)
            written.append(folder / f"{name}{MOTION}")
            if shot.moment == 0:
                lengths[shot.index] = wanted.source.motion.frames
    return lengths


def _write_dng(run: SimulationRun, frames: Iterable[TrainingPair], folder: Path, written: list[Path]) -> None:
    """Write each raw frame as DNG, with the white balance of its illuminant if known, and append the files to `written`."""
    from l3cli.io.pictures.dng import LIGHT_CODES, write_dng
    from l3cli.simulation.light import colour_matrix, make_light, neutral

    camera = run.camera
    lights = {name: make_light(name, {}, camera.wavelength) for name in LIGHT_CODES}
    matrices = {name: colour_matrix(camera, light) for name, light in lights.items()}
    for index, frame in enumerate(frames):
        light = run.lights.get(frame.illuminant)
        grey = None if light is None else neutral(camera, light)
        path = folder / f"{frame_name(index, frame.scene)}.dng"
        write_dng(path, frame.raw, camera, matrices, grey, frame.exposure)
        written.append(path)
