"""The stage of scene moments: scenes × lens and pixel → what any array's error follows from."""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera_recipe import recipe_text
from l3cli.artifacts.design import WEIGHTINGS, LightMoments, SceneMoments
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import save
from l3cli.design.moments import (
    CONTRAST_EDGES,
    LEVEL_EDGES,
    SIDE,
    Gathered,
    gather,
    light_moments,
    principal_spectra,
    spectral_power,
)
from l3cli.design.pixel import is_design, pixel_camera, pixel_files
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

PARTS = 16  # that the scenes are divided into, whatever the number of processes


def gather_moments(scenes: Path, camera: Path, output: Path, options: MomentsOptions) -> SceneMoments:
    """Write the moments of a scene recipe behind the lens and pixel of a camera (model, recipe or design recipe), whatever
    its filters. RecipeError or InputFileError if recipe, camera or files cannot be used, L3Error if the output cannot be
    written."""
    console = options.console
    with OutputGuard(console) as guard:
        guard.protect(scenes, *pixel_files(camera))
        guard.guard_file(output, options.force)
        recipe, pixel = load_recipe(scenes, SceneRecipe), pixel_camera(camera)
        _refuse(recipe, scenes)
        run, files = prepare(recipe, scenes, pixel, options.seed)
        files, _ = fitting(run, files, scenes, False, console)
        inputs = {"camera": pixel_files(camera), **input_files(run, files)}
        guard.protect(*itertools.chain(*inputs.values()))
        before_work({"scene recipe": [scenes], **inputs}, Made(output, "scene moments"))
        sums = {role: [sha256(path) for path in paths] for role, paths in inputs.items() if paths}
        text = "\n".join([read_text(scenes), *([recipe_text(camera)] if not is_design(camera) else [read_text(camera)])])
        stage = Stage("design moments", options.chosen(), text, sums)
        wanted = [
            each for source, paths in zip(run.recipe.scene, files, strict=True) for each in wanted_scenes(source, paths)
        ]
        size = -(-len(wanted) // PARTS)
        chunks = [list(enumerate(wanted))[start : start + size] for start in range(0, len(wanted), size)]
        parts = Parts(parts_folder(output), key_of(stage))
        with parts.held(options.resume, options.force), workers(options.jobs) as pool:
            spectra = parts.each("spectra", functools.partial(_spectra, run), chunks, pool, console)
            powers = functools.reduce(np.add, (part["power"] for part in spectra))
            bases = _bases(run, powers)
            work = functools.partial(_moments, run, bases, options.patches)
            totals: dict[str, NDArray] = {}
            for part in parts.each("scenes", work, chunks, pool, console):
                totals = {name: totals[name] + value if totals else value for name, value in part.items()}
            lights = tuple(_light(totals, number, basis) for number, basis in enumerate(bases))
            moments = SceneMoments(
                pixel_pitch=run.camera.pixel_pitch,
                f_number=run.camera.optics.f_number,
                side=SIDE,
                wavelength=run.camera.wavelength,
                level_edge=np.array(LEVEL_EDGES),
                contrast_edge=np.array(CONTRAST_EDGES),
                weightings=WEIGHTINGS,
                light=lights,
                history=(*pixel.history, stage),
            )
            save(moments, output)
        for each in lights:
            console.info(f"{output}: {each.illuminant}, {each.patches.sum():.0f} patches, {each.terms} spectra")
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


@dataclass(frozen=True)
class _Basis:
    """Principal spectra under a light."""

    illuminant: str
    spectra: NDArray[np.float64]  # (wavelength, term)
    white: NDArray[np.float64]  # (wavelength) photons/s of a perfect white of 1 cd/m²
    lost: float


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


def _bases(run: SimulationRun, powers: NDArray[np.float64]) -> list[_Basis]:
    bases = []
    for name, power in zip(run.recipe.illuminants, powers, strict=True):
        light = run.lights[name]
        white = photon_weights(run.camera, light, light.wavelength).sum(axis=1)
        spectra, lost = principal_spectra(power, white)
        bases.append(_Basis(name, spectra, white, lost))
    return bases


def _moments(run: SimulationRun, bases: Sequence[_Basis], patches: int, chunk: Chunk) -> dict[str, NDArray]:
    """Return the sums over the patches of some scenes, those of each light under its number."""
    sums: dict[int, Gathered] = {}
    for place, wanted in chunk:
        scene = _scene(wanted, run)
        for number, basis in enumerate(bases):
            planes, sharp, target = spectral_planes(
                run.camera, scene, run.lights[basis.illuminant], run.recipe.lens, basis.spectra
            )
            rng = np.random.default_rng([run.seed, place])  # the same patches under every light
            of_scene = gather(planes, target, sharp, patches, rng)
            sums[number] = sums[number] + of_scene if number in sums else of_scene
    return {f"{name}-{number}": value for number, each in sums.items() for name, value in vars(each).items()}


def _light(totals: dict[str, NDArray], number: int, basis: _Basis) -> LightMoments:
    """Return the moments of one light from the sums over all scenes."""
    sums = Gathered(**{field.name: totals[f"{field.name}-{number}"] for field in dataclasses.fields(Gathered)})
    return light_moments(basis.illuminant, basis.spectra, basis.white, basis.lost, sums)
