"""The `l3 simulate` stage, which writes a training set and, optionally, pictures and DNG files of the frames."""

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
    polarisation_notes,
    prepare,
    unknown_of,
)
from l3cli.stages.simulation.units import StoredFrames, is_of_run, key_of, received, simulate_unit, units_of
from l3cli.system.checkpoint import incomplete_folder, is_finished, mark_finished
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed, files_to_read, refuse_existing
from l3cli.system.outputs import OutputGuard
from l3cli.system.text import counted

# l3 warns if a channel collects more than this fraction of its light at wavelengths without scene data
NEGLIGIBLE_LIGHT = 1e-3


@dataclass(frozen=True)
class Simulated:
    """Result of a simulation."""

    frames: int  # number of frames
    scenes_left_out: int  # number of skipped scenes
    files: FilesUsed  # files that were read and written


def simulate(scenes: Path, camera: Path, output: Path, options: SimulateOptions) -> Simulated:
    """Simulate the frames of a scene recipe with a camera, and write them to a training set.

    With `resume`, frames that an interrupted run has stored are reused. If the training set is already finished, only
    missing pictures are written.

    Parameters
    ----------
    scenes : Path
        Scene recipe.
    camera : Path
        Camera model or camera recipe.
    output : Path
        Training set to write.
    options : SimulateOptions
        Options of `l3 simulate`.

    Raises
    ------
    RecipeError, InputFileError
        If the recipe, the camera or a scene file is unsuitable.
    L3Error
        If an output cannot be written.
    """
    # In this order of checks, errors are raised before any work, and no output replaces an input.
    console, resume, force, scheduler = options.console, options.resume, options.force, options.cluster()
    folders = list(dict.fromkeys(filter(None, (options.pictures, options.dng))))
    with OutputGuard(console) as guard:
        guard.protect(scenes, *camera_files(camera), *itertools.chain(*options.inputs().values()))
        guard.hold_file(output)
        refuse_existing(output, force or resume)
        for folder in folders:
            guard.hold_folder(folder, *PICTURE_FILES)
        if scheduler:
            scenes = scenes.absolute()  # workers on other machines may have another working directory
        model, recipe = load_camera(camera), load_recipe(scenes, SceneRecipe)
        _ = model.saturation_exposure  # raises InputFileError, before any work, if a pixel saturates only in extreme light
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
        contradictions, impossible = polarisation_notes(run, files)
        for text in contradictions:
            console.warn(text)
        for text in impossible:
            console.info(text)
        used = files_to_read({"scene recipe": [scenes], **inputs})
        with contextlib.ExitStack() as unfinished:
            done = [folder for folder in folders if stands and is_finished(folder, key)]
            for folder in folders:
                if folder not in done:
                    unfinished.enter_context(incomplete_folder(folder, key, force))
            if stands:
                stored.remove()  # stored frames remain if a run was killed just after writing the output
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
                    _assemble(stored, head, output, console)  # last: a training set implies finished pictures
            for folder in folders:
                mark_finished(folder, key)
        left_out = f"; {bad} scene{'s' if bad > 1 else ''} skipped" if bad else ""
        console.info(f"{output}: {counted(total, 'frame')}{left_out}{'; already finished' if stands else ''}")
        return Simulated(total, bad, used.and_wrote(output, *pictures))


def _simulate_frames(
    run: SimulationRun, files: list[list[Path]], head: TrainingSet, stored: StoredFrames, options: SimulateOptions
) -> int:
    """Simulate and store the missing frames of a run, and return the total number of frames."""
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
    """Write the training set from its stored frames.

    l3 warns if a channel collects more than NEGLIGIBLE_LIGHT of its light at wavelengths without scene data.
    """
    with write_training_set(output, head) as writer:
        worst = max(stored.append_to(writer), key=lambda scene: scene.uncovered)
    if worst.uncovered > NEGLIGIBLE_LIGHT:
        share = f"{worst.uncovered:.1%} of the light that a channel collects from white"
        console.warn(f"the scene {worst.scene} has no data for {share}; use scenes with a wider range of wavelengths")


# channels of EXR files with motion: displacement down and right in pixels, and validity (1 or 0)
MOTION_CHANNELS = ("down", "right", "seen")
PICTURE_FILES = (f"*{RAW}", f"*{IDEAL}", "*_ideal.exr", f"*{MOTION}", "*.dng")  # names of the pictures that l3 writes


def write_pictures(
    run: SimulationRun, files: list[list[Path]], frames: Iterable[TrainingPair], options: SimulateOptions
) -> list[Path]:
    """Write pictures and DNG files into the folders that the options specify.

    For each clip, l3 also prints the value of ‹exposure› at which pictures from `l3 render` are as bright as the ideal
    pictures.

    Parameters
    ----------
    run : SimulationRun
        The run.
    files : list of list of Path
        The scene files of each source.
    frames : iterable of TrainingPair
        All frames of the run.
    options : SimulateOptions
        Options of `l3 simulate`.

    Returns
    -------
    list of Path
        The files that were written.
    """
    written: list[Path] = []
    if options.pictures:
        lengths = _write_motion(run, files, options.pictures, written)
        first_of = {index: first for first, count in lengths.items() for index in range(first, first + count)}
        for index, scale in _write_pictures(run, frames, options.pictures, first_of, written).items():
            if index in lengths:
                last = index + lengths[index] - 1
                options.console.info(
                    f"frames {index}–{last}: to render pictures that are as bright as the ideal pictures, use "
                    f"‹exposure› {scale:.6g}"
                )
    if options.dng:
        _write_dng(run, frames, options.dng, written)
    return written


def _write_pictures(
    run: SimulationRun, frames: Iterable[TrainingPair], folder: Path, first_of: dict[int, int], written: list[Path]
) -> dict[int, float]:
    """Write the raw mosaic and the ideal picture of each frame.

    For the outputs X, Y, Z, the ideal picture is an sRGB file with automatic exposure as in `l3 render`: the 99th percentile
    of Y becomes white. For other outputs, it is an EXR file with the linear outputs.

    Parameters
    ----------
    run : SimulationRun
        The run.
    frames : iterable of TrainingPair
        All frames of the run.
    folder : Path
        Folder of the pictures.
    first_of : dict
        Index of each clip frame → index of the first frame in its clip, which determines the exposure of the clip.
    written : list of Path
        List to which the files are appended.

    Returns
    -------
    dict
        Index of each frame with an sRGB ideal picture → value of ‹exposure› at which `l3 render` produces an equally bright
        picture.
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
    """Write the motion since the previous frame as a file for each clip frame, and append the files to `written`.

    Returns
    -------
    dict
        Index of the first frame of each clip → number of frames in the clip.
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
            write_picture(folder / f"{name}{MOTION}", np.moveaxis(moved(shot.moment), 0, -1), MOTION_CHANNELS)
            written.append(folder / f"{name}{MOTION}")
            if shot.moment == 0:
                lengths[shot.index] = wanted.source.motion.frames
    return lengths


def _write_dng(run: SimulationRun, frames: Iterable[TrainingPair], folder: Path, written: list[Path]) -> None:
    """Write each raw frame as a DNG file, with its white balance if it is known, and append the files to `written`."""
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
