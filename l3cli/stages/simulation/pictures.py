"""The pictures and DNGs that a simulation lays beside its training set."""

from collections.abc import Iterable
from pathlib import Path

from l3cli.artifacts.training_set import TrainingPair, frame_name
from l3cli.io.file_names import IDEAL, MOTION, RAW
from l3cli.options.pipeline import SimulateOptions
from l3cli.simulation.recipe import shots as asked
from l3cli.simulation.run import SimulationRun

CHANNELS = ("down", "right", "seen")  # of a file of motion
WRITTEN = (f"*{RAW}", f"*{IDEAL}", "*_ideal.exr", f"*{MOTION}", "*.dng")  # into the folders of pictures


def write_pictures(
    run: SimulationRun, files: list[list[Path]], frames: Iterable[TrainingPair], options: SimulateOptions
) -> None:
    """The pictures and DNGs of all `frames`, as far as they are asked for; `files` are those of each source. Of clips it is
    said how they are rendered as bright as the ideal pictures."""
    if options.pictures:
        lengths = _write_motion(run, files, options.pictures)
        for index, scale in _write_pictures(run, frames, options.pictures).items():
            if index in lengths:
                last = index + lengths[index] - 1
                options.console.info(
                    f"frames {index}–{last}: ‹exposure› {scale:.6g} renders them as bright as their ideal pictures"
                )
    if options.dng:
        _write_dng(run, frames, options.dng)


def _write_pictures(run: SimulationRun, frames: Iterable[TrainingPair], folder: Path) -> dict[int, float]:
    """Each frame as raw mosaic and as the picture it should become, white at display white; of those that are sRGB the
    factor of Y at which a table shows the same."""
    import numpy as np

    from l3cli.io.pictures.openimageio import write_mosaic
    from l3cli.io.pictures.registry import write_picture
    from l3cli.rendering.display import encode, make_display

    scales = {}
    for index, frame in enumerate(frames):
        name = frame_name(index, frame.scene)
        write_mosaic(folder / f"{name}{RAW}", frame.raw, frame.dark_time)
        if run.target.outputs != ("X", "Y", "Z"):
            planes = np.moveaxis(frame.target / np.float32(frame.white.max()), 0, -1)
            write_picture(folder / f"{name}_ideal.exr", planes, run.target.outputs)
            continue
        display = make_display(frame.white, 1.0 / frame.white[1], bits=8)
        write_picture(folder / f"{name}{IDEAL}", encode(frame.target, display))
        scales[index] = run.camera.output_unit / (frame.white[1] * frame.exposure)
    return scales


def _write_motion(run: SimulationRun, files: list[list[Path]], folder: Path) -> dict[int, int]:
    """Write the motion of each frame of a clip since the one before; return the number of frames of each clip by the
    number of its first."""
    import numpy as np

    from l3cli.io.pictures.registry import write_picture
    from l3cli.simulation.clip import known_motion

    lengths = {}
    for wanted, shots in asked(run.recipe, files) if run.recipe.scene else ():
        if wanted.source.motion is None:
            continue
        moved = known_motion(wanted, run)
        for shot in shots:
            name = frame_name(shot.index, wanted.name)
            write_picture(folder / f"{name}{MOTION}", np.moveaxis(moved(shot.moment), 0, -1), CHANNELS)
            if shot.moment == 0:
                lengths[shot.index] = wanted.source.motion.frames
    return lengths


def _write_dng(run: SimulationRun, frames: Iterable[TrainingPair], folder: Path) -> None:
    """Each raw frame as DNG, with the white balance of its light where that is known."""
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
