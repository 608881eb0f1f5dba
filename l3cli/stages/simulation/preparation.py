"""Preparation of a simulation: check all inputs before any frame is simulated, and read or draw scenes."""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import recipe_text
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import InputFileError, RecipeError, listed, raised_as
from l3cli.io.file_names import find_scenes
from l3cli.io.scenes import format_of, is_folder
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.toml import read_text
from l3cli.simulation import recipe as asked
from l3cli.simulation import sources
from l3cli.simulation.frame import SimulationRun
from l3cli.simulation.light import (
    SCENE_LIGHT,
    beyond_known,
    column_names,
    curves_beyond_known,
    functions_beyond_known,
    lens_beyond_known,
    make_light,
    make_target,
    read_curve,
    recorded_under,
    require_seen,
    surfaces_beyond_known,
)
from l3cli.simulation.recipe import SceneRecipe
from l3cli.simulation.sensor import noise_plugin
from l3cli.simulation.sources import FileSource, name_of
from l3cli.system.console import Console
from l3cli.system.files import sha256
from l3cli.system.plugins import package

if TYPE_CHECKING:
    from l3cli.frames.scene import ChannelPicture, Scene


def scene_files(source: sources.Source, recipe: Path) -> list[Path]:
    """List a source's scene files. The list of a synthetic source is empty.

    Raises
    ------
    InputFileError
        If the source needs files, but none exist.
    """
    return find_scenes(source.file, recipe.parent, is_folder(name_of(source))) if isinstance(source, FileSource) else []


def files_of(source: sources.Source, path: Path) -> list[Path]:
    """List all files of the scene at `path`.

    A folder contains one file per band or angle, and an ENVI header has a separate data file. All other scenes are single
    files.
    """
    return format_of(sources.name_of(source), path).files(path)


def scene_over_time(wanted: sources.WantedScene, run: SimulationRun) -> "Callable[[int], Scene | ChannelPicture]":
    """Read or draw a scene, and return a function that provides the scene for each frame of a clip.

    Returns
    -------
    callable
        Function that takes a frame number in the clip, and returns the scene as it is projected onto the sensor. If the
        scene does not move, the result is the same for all frames.

    Raises
    ------
    InputFileError
        If the scene cannot be read, is too small or larger than the sensor, or has no data at the wavelengths of the camera.
    RecipeError
        If a synthetic scene is unsuitable.
    """
    from l3cli.frames.scene import ChannelPicture, Scene
    from l3cli.simulation import procedural
    from l3cli.simulation.clip import clip_of
    from l3cli.simulation.sources import framed

    scene: Scene | ChannelPicture
    if wanted.path is None:
        scene = procedural.draw(wanted, run.seed, run.camera.wavelength, run.camera.polarisers is not None)
    else:
        scene = _from_file(wanted, wanted.path, run)
    culprit = str(wanted.path or wanted.name)
    with raised_as(wanted.error, culprit):
        if isinstance(scene, Scene) and wanted.path is not None:
            require_seen(scene.wavelength, run.target, run.camera)
        if wanted.source.motion is not None:
            return clip_of(scene, wanted, run)
        if isinstance(scene, ChannelPicture):
            scene = replace(scene, signal=framed(scene.signal, wanted.source, run.camera))
        else:
            scene = sources.on_sensor(scene, wanted.source, run.camera)
    samples = scene.signal if isinstance(scene, ChannelPicture) else scene.reflectance
    sources.check_size(samples.shape[:2], run.camera, InputFileError, culprit)
    return lambda _: scene


def _from_file(wanted: sources.WantedScene, path: Path, run: SimulationRun) -> "Scene | ChannelPicture":
    """Read a scene file.

    Spectral cubes and pictures become scenes with reflectances. Pictures with holds = "codes" in the recipe become a
    ChannelPicture.
    """
    from l3cli.frames.scene import ChannelPicture, PolarisedPictures, Scene, SpectralCube

    source = wanted.source
    content = format_of(sources.name_of(source), path).read(path, **_keys(source, path, run))
    if isinstance(content, Scene):
        return content
    if isinstance(content, SpectralCube):
        from l3cli.simulation.sources import scene_of

        assert isinstance(source, sources.Spectral)
        with raised_as(InputFileError, path):
            return scene_of(content, source, path.stem, run.recorded[source.light] if source.light else None)
    from l3cli.simulation import procedural, reflectances

    if isinstance(content, PolarisedPictures):
        from l3cli.simulation.polarised_pictures import scene_of_stokes, stokes_of_pictures

        assert isinstance(source, sources.PolarisedPictures)
        with raised_as(InputFileError, path):
            scene = scene_of_stokes(stokes_of_pictures(content, source), procedural.grid(run.camera.wavelength), wanted.name)
        return scene if run.camera.polarisers is not None else replace(scene, polarisation=None)
    assert isinstance(source, sources.RgbPictures)
    linear = reflectances.shrunk(content, source.shrink)
    if sources.holds_codes(source):
        order = [sources.CODED.index(channel) for channel in run.camera.channels]
        with raised_as(InputFileError, path):
            return ChannelPicture(path.stem, linear[..., order])
    return reflectances.raise_to_spectra(linear, procedural.grid(run.camera.wavelength), path.stem)


def _keys(source: sources.Source, path: Path, run: SimulationRun) -> dict[str, Any]:
    """Return the recipe keys that the reader of a scene file needs, as keyword arguments.

    Illuminant names are replaced by wavelengths in nm and photon radiances.
    """
    keys = {key: getattr(source, key) for key in format_of(sources.name_of(source), path).keys}
    if keys.get("light"):
        light = run.recorded[keys["light"]]
        keys["light"] = (light.wavelength, light.radiance)
    return keys


# --------------------------------------------------------------------------------------------------- sizes of scenes


def refusals(run: SimulationRun, files: list[list[Path]]) -> list[dict[Path, InputFileError]]:
    """Find scene files that are unreadable, too small, or larger than the sensor. Only the headers are read.

    Returns
    -------
    list of dict
        The unsuitable files of each source, with their errors.

    Raises
    ------
    RecipeError
        If a synthetic scene is too small, or larger than the sensor.
    """
    bad: list[dict[Path, InputFileError]] = []
    for source, paths in zip(run.recipe.scene, files, strict=True):
        bad.append({})
        for wanted in sources.wanted_scenes(source, paths):
            try:
                name = str(wanted.path or wanted.name)
                sources.check_size(size_of(wanted, run), run.camera, wanted.error, name)
            except InputFileError as error:
                assert wanted.path is not None
                bad[-1][wanted.path] = error
    return bad


def size_of(wanted: sources.WantedScene, run: SimulationRun) -> tuple[int, int]:
    """Return the size (rows, columns) of a scene after cropping, rotating and scaling for the sensor.

    Only the header of a scene file is read.

    Raises
    ------
    InputFileError
        If a scene file cannot be read, or if the crop or the moving camera extends beyond the scene.
    RecipeError
        If the crop or the moving camera extends beyond a synthetic scene.
    """
    from l3cli.simulation.sources import framed_size

    source = wanted.source
    size = source.size if isinstance(source, sources.Synthetic) else _file_size(wanted, run)
    with raised_as(wanted.error, wanted.path or wanted.name):
        return framed_size(size, source, run.camera)


def _file_size(wanted: sources.WantedScene, run: SimulationRun) -> tuple[int, int]:
    path, source = wanted.path, wanted.source
    assert path is not None
    rows, cols = format_of(sources.name_of(source), path).size(path, **_keys(source, path, run))
    by = source.shrink if isinstance(source, sources.Pictures) else 1
    return rows // by, cols // by


def prepare(recipe: SceneRecipe, path: Path, camera: CameraModel, seed: int) -> tuple[SimulationRun, list[list[Path]]]:
    """Check a scene recipe for a camera, and read its curves and illuminants. Scene files are listed but not read.

    Parameters
    ----------
    recipe : SceneRecipe
        The scene recipe.
    path : Path
        Path of the recipe. File names are relative to its folder.
    camera : CameraModel
        The camera. The recipe can change its properties in the returned run, for example the lens.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    SimulationRun
        The run, with the curves and illuminants of the recipe.
    list of list of Path
        The scene files of each source.

    Raises
    ------
    RecipeError, InputFileError
        If the recipe has faults, or if a curve or a scene file is unsuitable.
    """
    with raised_as(RecipeError, path, RecipeError):
        refuse_first(asked.scene_faults(recipe, camera))
        named = asked.curve_files(recipe)
        curves = {name: read_curve(path.parent / name, role) for name, role in named.items()}
        fitted = asked.set_up(camera, recipe, curves)
        other = recipe.target.illuminant
        wanted = {*recipe.illuminants, *filter(None, [other])} - {SCENE_LIGHT}
        lights = {name: make_light(name, curves, fitted.wavelength) for name in sorted(wanted)}
        recorded = {name: recorded_under(name, curves, fitted.wavelength) for name in asked.recorded_lights(recipe)}
    outputs = recipe.target.outputs
    names = column_names(path.parent / outputs) if outputs in curves else ()
    target = make_target(outputs, curves.get(outputs), names, lights[other] if other else None, fitted)
    files = [scene_files(source, path) for source in recipe.scene]
    return SimulationRun(recipe, fitted, target, lights, recorded, seed, path.parent), files


def unknown_of(run: SimulationRun, camera: CameraModel, recipe: Path | None = None) -> list[str]:
    """Return warnings about spectra that do not cover all wavelengths at which the camera collects electrons.

    Parameters
    ----------
    run : SimulationRun
        The run.
    camera : CameraModel
        The camera of the run, without the lens of the scene recipe.
    recipe : Path or None
        The camera file. If it is a recipe, its responsivity file is checked too.

    Returns
    -------
    list of str
        At most one warning per illuminant, and one each for surfaces, lens, matching functions and camera responsivities.
    """
    named = asked.curve_files(run.recipe)
    curves = {name: read_curve(run.base / name, role) for name, role in named.items()}
    warnings = [beyond_known(light, curves, run.camera) for light in run.lights.values()]
    if recipe is not None:
        ends = (curves_beyond_known(recipe, light, camera) for light in run.lights.values())
        warnings.append(next(filter(None, ends), ""))
    lens, functions = run.recipe.lens.transmittance, run.recipe.target.outputs
    if isinstance(lens, str):
        passed = (lens_beyond_known(str(run.base / lens), curves[lens], light, camera) for light in run.lights.values())
        warnings.append(next(filter(None, passed), ""))
    if functions in curves:
        about = str(run.base / functions), curves[functions], run.target.outputs
        seen = (functions_beyond_known(*about, light) for light in run.lights.values())
        warnings.append(next(filter(None, seen), ""))
    if any(map(sources.of_measured_surfaces, run.recipe.scene)):
        surfaces = (surfaces_beyond_known(light, run.camera) for light in run.lights.values())
        warnings.append(next(filter(None, surfaces), ""))
    return list(filter(None, warnings))


def fitting(
    run: SimulationRun, files: list[list[Path]], path: Path, skip_bad: bool, console: Console
) -> tuple[list[list[Path]], int]:
    """Check the headers of the scene files, and return the usable files.

    If `skip_bad` is set, unsuitable files are reported and skipped.

    Returns
    -------
    list of list of Path
        The usable files of each source.
    int
        Number of skipped files.

    Raises
    ------
    InputFileError
        If a file is unsuitable and `skip_bad` is not set, or if no scene remains.
    """
    refused = refusals(run, files)
    bad = [error for errors in refused for error in errors.values()]
    if not bad:
        return files, 0
    if not skip_bad:
        count = sum(map(len, files))
        if len(bad) == 1:
            raise InputFileError(f"{bad[0]}, or skip the scene with ‹skip_bad›" if count > 1 else str(bad[0]))
        cures = dict.fromkeys(str(error).partition("; ")[2] for error in bad)
        why = listed(str(error).partition("; ")[0] for error in bad)
        cure = ", ".join([*filter(None, cures), "or skip these scenes with ‹skip_bad›"])
        raise InputFileError(f"{len(bad)} of {count} scenes cannot be used: {why}; {cure}")
    readable = [[path for path in paths if path not in errors] for paths, errors in zip(files, refused, strict=True)]
    synthetic = any(not isinstance(source, FileSource) for source in run.recipe.scene)
    if not (any(readable) or synthetic or run.recipe.pair):
        raise InputFileError(f"{path}: none of the {len(bad)} scenes can be used: {listed(map(str, bad))}")
    for error in bad:
        console.report(f"l3: {error}")
    return readable, len(bad)


def note_unknown_fields(run: SimulationRun, files: list[list[Path]], console: Console) -> None:
    """Report unknown fields in the headers of scene files that may affect the meaning of the values."""
    found: dict[str, Path] = {}  # unknown field → first file that contains it
    for source, paths in zip(run.recipe.scene, files, strict=True):
        for path in paths:
            for field in format_of(sources.name_of(source), path).unknown(path):
                found.setdefault(field, path)
    if found:
        first = next(iter(found.values()))
        console.info(
            f"{first}: l3 ignores the unknown field{'s' if len(found) > 1 else ''} {listed(found)} in the header; "
            "if such a field changes the meaning of the values, convert the values before you use the file"
        )


def polarisation_notes(run: SimulationRun, files: list[list[Path]]) -> tuple[list[str], list[str]]:
    """Read the scenes that are pictures of polarised light, and describe their inconsistencies.

    Parameters
    ----------
    run : SimulationRun
        The run.
    files : list of list of Path
        The scene files of each source.

    Returns
    -------
    list of str
        Warnings about pictures that contradict Malus's law.
    list of str
        Notes about pixels with a degree of polarisation above 1.
    """
    from l3cli.frames.scene import PolarisedPictures
    from l3cli.simulation.polarised_pictures import CONTRADICTION, stokes_of_pictures

    warnings, notes = [], []
    for source, paths in zip(run.recipe.scene, files, strict=True):
        if not isinstance(source, sources.PolarisedPictures):
            continue
        for path in paths:
            content = format_of(name_of(source), path).read(path, **_keys(source, path, run))
            assert isinstance(content, PolarisedPictures)
            with raised_as(InputFileError, path):
                found = stokes_of_pictures(content, source)
            if found.contradiction > CONTRADICTION:
                warnings.append(
                    f"{path}: the pictures contradict Malus's law by {found.contradiction:.1%} of their mean intensity; "
                    "check their angles and exposures"
                )
            if found.impossible:
                notes.append(
                    f"{path}: {found.impossible:.2%} of the pixels have a degree of polarisation above 1; l3 limits it to 1"
                )
    return warnings, notes


def input_files(run: SimulationRun, files: list[list[Path]]) -> dict[str, list[Path]]:
    """Return all input files of a run by role ("scene", "spectrum" or "pair"), given the scene files of each source."""
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
    """Create the header of the training set: camera, outputs, and history with the digests of all input files.

    Parameters
    ----------
    run : SimulationRun
        The run.
    camera : CameraModel
        The camera. Its history becomes the first part of the training set's history.
    recipes : (Path, Path)
        Files of the scene recipe and of the camera.
    inputs : dict
        The input files by role.
    chosen : dict
        The options to record in the history.
    """
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
