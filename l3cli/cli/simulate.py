"""l3 simulate: camera × scenes × lights → training set."""

import dataclasses
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from l3cli.cli import options

if TYPE_CHECKING:
    from l3cli.artifacts.camera import CameraModel
    from l3cli.artifacts.training_set import TrainingFrame, TrainingSet
    from l3cli.scene import Scene
    from l3cli.simulate.recipe import DrawnScene, FileScene, Lens, Shot

NEGLIGIBLE = 1e-3  # share of a channel's light that may go unseen without a word


@click.command()
@click.argument("scenes", type=options.FILE, metavar="SCENES.toml")
@click.option("--camera", type=options.FILE, required=True, metavar="FILE", help="Camera model or camera recipe (.toml).")
@options.output("Training set to write")
@click.option(
    "--pictures", type=options.FILE, metavar="DIR", help="Also write each raw frame (TIFF) and ideal picture (PNG)."
)
@options.seed
@options.jobs
@options.force
@options.quiet
def simulate(
    scenes: Path, camera: Path, output: Path, pictures: Path | None, seed: int, jobs: int, force: bool, quiet: bool
) -> None:
    """Simulate what a camera sees of many scenes, and the pictures it should make of them.

    Example: l3 simulate configs/scenes/default.toml --camera camera.h5 -o training.h5
    """
    from l3cli.artifacts.camera import load_camera
    from l3cli.artifacts.training_set import write_training_set
    from l3cli.config import load_recipe
    from l3cli.files import refuse_existing, refuse_filled_folder
    from l3cli.io.scene_files import find
    from l3cli.parallel import ordered_map
    from l3cli.simulate.recipe import SceneRecipe, check, patterns, shots

    refuse_existing(output, force)
    if pictures:
        refuse_filled_folder(pictures, force)
    model, recipe = load_camera(camera), load_recipe(scenes, SceneRecipe)
    check(recipe, model, str(scenes))
    files = [find(pattern, scenes.parent) if pattern else [] for pattern in patterns(recipe)]
    head = _head(model, scenes, camera, files, seed)
    work = [Work(shot, model, recipe.lens, (seed, index)) for index, shot in enumerate(shots(recipe, files))]
    uncovered: dict[str, float] = {}
    with write_training_set(output, head) as writer:
        for frame, missing in options.progress(ordered_map(_simulate, work, jobs), len(work), "frames", quiet):
            writer.append(frame)
            uncovered[frame.scene] = missing
    worst = max(uncovered, key=lambda scene: uncovered[scene])
    if uncovered[worst] > NEGLIGIBLE:
        share = f"{uncovered[worst]:.1%} of the light that a channel collects from white"
        options.say(f"warning: {worst} holds no data for {share}", quiet)
    if pictures:
        _write_pictures(output, pictures)
    options.say(f"{output}: {len(work)} frames", quiet)


@dataclass(frozen=True)
class Work:
    """All that a worker needs to simulate one frame."""

    shot: "Shot"
    camera: "CameraModel"
    lens: "Lens"
    seed: tuple[int, int]


def _simulate(work: Work) -> tuple["TrainingFrame", float]:
    """The frame, and the share of white's electrons for which the scene holds no data."""
    from l3cli.errors import InputFileError
    from l3cli.simulate import frame, light
    from l3cli.simulate.recipe import FileScene, check_size

    shot, camera = work.shot, work.camera
    scene = _scene(shot.scene, tuple(camera.wavelength), work.seed[0])
    if isinstance(shot.scene, FileScene):
        check_size(scene.reflectance.shape[:2], camera, InputFileError, str(shot.scene.path))
    if shot.illuminant == light.OWN:
        falling = light.own_light(scene, shot.luminance)
    else:
        falling = light.named_light(shot.illuminant, shot.luminance, camera.wavelength)
    exposure = light.automatic_exposure(camera, falling, shot.exposure) if shot.automatic else shot.exposure
    missing = light.uncovered_share(camera, scene.wavelength)
    return frame.simulate(camera, scene, falling, exposure, work.lens, work.seed), missing


@functools.lru_cache(maxsize=1)
def _scene(wanted: "DrawnScene | FileScene", camera_wavelength: tuple[float, ...], seed: int) -> "Scene":
    """Read or draw one scene; the last one is kept, since lights and exposures follow each other."""
    from l3cli.io.scene_files import read_iset_scene, read_rgb_picture
    from l3cli.simulate import procedural, rgb
    from l3cli.simulate.recipe import DrawnScene

    wavelength = procedural.grid(np.array(camera_wavelength))
    if isinstance(wanted, DrawnScene):
        rng = np.random.default_rng([seed, *wanted.seed])
        return procedural.draw(wanted.kind, rng, wanted.size, wavelength, wanted.name)
    if wanted.kind == "iset":
        return read_iset_scene(wanted.path)
    picture = rgb.shrunk(read_rgb_picture(wanted.path), wanted.shrink)
    return rgb.raise_to_spectra(picture, wavelength, wanted.path.stem)


def _head(camera: "CameraModel", recipe_path: Path, camera_path: Path, files: list[list[Path]], seed: int) -> "TrainingSet":
    """The training set's head, with this stage as the last of the camera's history."""
    from l3cli.artifacts.base import Stage
    from l3cli.artifacts.camera import recipe_text
    from l3cli.artifacts.training_set import TrainingSet
    from l3cli.config import read_text
    from l3cli.files import sha256

    texts = [read_text(recipe_path), recipe_text(camera_path)]
    inputs = {"camera": [sha256(camera_path)]}
    if any(files):
        inputs["scene"] = [sha256(path) for found in files for path in found]
    stage = Stage("simulate", {"seed": seed}, "\n".join(text for text in texts if text), inputs)
    return TrainingSet(
        camera=dataclasses.replace(camera, history=()),
        outputs=("X", "Y", "Z"),
        target_description="CIE 1931 XYZ of the scene under its own light, without lens or noise",
        history=(*camera.history, stage),
    )


def _write_pictures(training: Path, folder: Path) -> None:
    """Each frame of a training set as raw mosaic and as the picture it should become, white at display white."""
    from l3cli.artifacts.training_set import open_training_set
    from l3cli.io.images import write_picture
    from l3cli.io.scene_files import write_mosaic
    from l3cli.render.display import encode, make_display

    with open_training_set(training) as frames:
        for index, frame in enumerate(frames):
            name = options.frame_name(index, frame.scene)
            write_mosaic(folder / f"{name}_raw.tif", frame.raw)
            display = make_display(frame.white, 1.0 / frame.white[1], bits=8)
            write_picture(folder / f"{name}_ideal.png", encode(frame.target, display))
