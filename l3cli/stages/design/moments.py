"""The stage of scene moments: scenes × lens and pixel → what any array's error follows from."""

import functools
import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera_recipe import recipe_text
from l3cli.artifacts.design import LightMoments, SceneMoments
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import save
from l3cli.design.moments import empty_sums, gather, in_all_orientations, principal_spectra, spectral_power
from l3cli.design.pixel import is_design, pixel_camera
from l3cli.errors import RecipeError
from l3cli.frames.scene import Scene
from l3cli.options.commands import MomentsOptions
from l3cli.parallel import workers
from l3cli.recipes.toml import load_recipe, read_text
from l3cli.simulation.frame import SimulationRun, spectral_planes
from l3cli.simulation.light import SCENE_LIGHT, photon_weights
from l3cli.simulation.recipe import SceneRecipe
from l3cli.simulation.sources import Spectral, WantedScene, holds_codes, wanted_scenes
from l3cli.stages.design.parts import Parts
from l3cli.stages.simulation.preparation import fitting, input_files, prepare, scene_over_time
from l3cli.stages.simulation.units import key_of
from l3cli.system.checkpoint import parts_folder
from l3cli.system.files import sha256
from l3cli.system.output_guard import OutputGuard
from l3cli.system.plan import Made, before_work

PARTS = 8  # that the scenes are divided into, whatever the number of processes


def gather_moments(scenes: Path, camera: Path, output: Path, options: MomentsOptions) -> SceneMoments:
    """Write the moments of a scene recipe behind the lens and pixel of a camera (model, recipe or design recipe), whatever
    its filters. RecipeError or InputFileError if recipe, camera or files cannot be used, L3Error if the output cannot be
    written."""
    console = options.console
    with OutputGuard(console) as guard:
        recipe, (pixel, pixel_files) = load_recipe(scenes, SceneRecipe), pixel_camera(camera)
        guard.protect(scenes, *pixel_files)
        guard.guard_file(output, options.force)
        _refuse(recipe, scenes)
        run, files = prepare(recipe, scenes, pixel, options.seed)
        files, _ = fitting(run, files, scenes, False, console)
        inputs = {"camera": pixel_files, **input_files(run, files)}
        guard.protect(*itertools.chain(*inputs.values()))
        before_work({"scene recipe": [scenes], **inputs}, Made(output, "scene moments"))
        digests = {role: [sha256(path) for path in paths] for role, paths in inputs.items() if paths}
        text = f"{read_text(scenes)}\n{read_text(camera) if is_design(camera) else recipe_text(camera)}"
        stage = Stage("design moments", options.chosen(), text, digests)
        wanted = [
            each for source, paths in zip(run.recipe.scene, files, strict=True) for each in wanted_scenes(source, paths)
        ]
        size = -(-len(wanted) // PARTS)
        chunks = [list(enumerate(wanted))[start : start + size] for start in range(0, len(wanted), size)]
        parts = Parts(parts_folder(output), key_of(stage))
        with parts.held(options.resume, options.force), workers(options.jobs) as pool:
            spectra = parts.each("spectra", functools.partial(_spectra, run), chunks, pool, console)
            powers = functools.reduce(np.add, (part["power"] for part in spectra))
            lit = {name: run.lights[name] for name in run.recipe.illuminants}
            whites = [photon_weights(run.camera, light, light.wavelength).sum(axis=1) for light in lit.values()]
            bases = [principal_spectra(power, white) for power, white in zip(powers, whites, strict=True)]
            work = functools.partial(_moments, run, bases, options.patches)
            sums = [empty_sums(basis.shape[1]) for basis in bases]
            for part in parts.each("scenes", work, chunks, pool, console):
                for number, of_light in enumerate(sums):
                    for name, total in of_light.items():
                        total += part[f"{name}-{number}"]
            lights = [
                LightMoments(name, basis, white, **in_all_orientations(of_light, basis.shape[1]))
                for name, basis, white, of_light in zip(lit, bases, whites, sums, strict=True)
            ]
            moments = SceneMoments(
                pixel_pitch=run.camera.pixel_pitch,
                f_number=run.camera.optics.f_number,
                wavelength=run.camera.wavelength,
                light=tuple(lights),
                history=(*pixel.history, stage),
            )
            save(moments, output)
        spectra_of = ", ".join(f"{each.illuminant} {each.terms} spectra" for each in lights)
        console.info(f"{output}: {lights[0].patches.sum():.0f} patches, {spectra_of}")
        return moments


def _refuse(recipe: SceneRecipe, path: Path) -> None:
    """Raise RecipeError for scenes without spectra that any light may be laid on."""
    if SCENE_LIGHT in recipe.illuminants:
        raise RecipeError(f'{path}: moments are of named lights; leave "{SCENE_LIGHT}" out of illuminants')
    if recipe.pair or not recipe.scene or any(map(holds_codes, recipe.scene)):
        raise RecipeError(f"{path}: moments are of spectral scenes; leave pairs and pictures of codes out")
    if any(isinstance(each, Spectral) and each.holds != "reflectance" and each.light is None for each in recipe.scene):
        raise RecipeError(f"{path}: moments need reflectance; give the light that radiance was measured under")
    if recipe.lens.transmittance is not None:
        raise RecipeError(f"{path}: lens.transmittance belongs to the filters of a design; leave it out")


Chunk = Sequence[tuple[int, WantedScene]]


def _scene(wanted: WantedScene, run: SimulationRun) -> Scene:
    scene = scene_over_time(wanted, run)(0)
    assert isinstance(scene, Scene)
    return scene


def _spectra(run: SimulationRun, chunk: Chunk) -> dict[str, NDArray]:
    """Return the second moments of photons (light, wavelength, wavelength) of some scenes."""
    power = np.zeros((len(run.recipe.illuminants), run.camera.wavelength.size, run.camera.wavelength.size))
    for _, wanted in chunk:
        scene = _scene(wanted, run)
        for number, name in enumerate(run.recipe.illuminants):
            rate = photon_weights(run.camera, run.lights[name], scene.wavelength)
            power[number] += spectral_power(scene.reflectance, rate)
    return {"power": power}


def _moments(run: SimulationRun, bases: Sequence[NDArray[np.float64]], patches: int, chunk: Chunk) -> dict[str, NDArray]:
    """Return the sums over the patches of some scenes, those of each light under its number."""
    sums = [empty_sums(basis.shape[1]) for basis in bases]
    for place, wanted in chunk:
        scene = _scene(wanted, run)
        for of_light, name, basis in zip(sums, run.recipe.illuminants, bases, strict=True):
            planes, sharp, target = spectral_planes(run.camera, scene, run.lights[name], run.recipe.lens, basis)
            rng = np.random.default_rng([run.seed, place])  # the same patches under every light
            gather(of_light, planes, target, sharp, patches, rng)
    return {f"{name}-{number}": value for number, of_light in enumerate(sums) for name, value in of_light.items()}
