"""Scenes of a simulation: their files, read or drawn, as they lie on the sensor; which of them do not fit there."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l3cli.errors import InputFileError, RecipeError
from l3cli.simulation import sources
from l3cli.stages.simulation.run import SimulationRun

if TYPE_CHECKING:
    from l3cli.scene import Scene


def files_of(source: sources.Source, path: Path) -> list[Path]:
    """What is read of a scene of that name: bands of a folder, an ENVI header and its data, else the file itself."""
    from l3cli.io.cubes import band_pictures, envi_files

    if isinstance(source, sources.BandFolder):
        return band_pictures(path)
    return envi_files(path) if isinstance(source, sources.Envi) else [path]


def read_scene(wanted: sources.WantedScene, run: SimulationRun) -> "Scene":
    """The scene, read or drawn, as it lies on the sensor; InputFileError if it does not fit there."""
    from l3cli.simulation import drawn
    from l3cli.simulation.framing import framed

    if wanted.path is None:
        scene = drawn.draw(wanted, run.seed, run.camera.wavelength)
    else:
        scene = READERS[type(wanted.source)](wanted, run)
    culprit = str(wanted.path or wanted.name)
    try:
        scene = framed(scene, wanted.source, run.camera)
    except ValueError as error:
        raise (RecipeError if wanted.path is None else InputFileError)(f"{culprit}: {error}") from error
    sources.check_size(scene.reflectance.shape[:2], run.camera, InputFileError, culprit)
    return scene


def _iset(wanted: sources.WantedScene, run: SimulationRun) -> "Scene":
    from l3cli.io.scene_files import read_iset_scene

    assert wanted.path is not None
    return read_iset_scene(wanted.path, _substitute_light(wanted, run))


def _substitute_light(wanted: sources.WantedScene, run: SimulationRun) -> Any:
    """The light that the recipe gives ISET scenes which lack their own: wavelengths in nm and photons, or None."""
    assert isinstance(wanted.source, sources.IsetScenes)
    light = run.recorded[wanted.source.light] if wanted.source.light else None
    return (light.wavelength, light.radiance) if light else None


def _rgb(wanted: sources.WantedScene, run: SimulationRun) -> "Scene":
    from l3cli.io.scene_files import read_rgb_picture
    from l3cli.simulation import procedural, rgb

    assert wanted.path is not None
    assert isinstance(wanted.source, sources.RgbPictures)
    picture = rgb.shrunk(read_rgb_picture(wanted.path), wanted.source.shrink)
    return rgb.raise_to_spectra(picture, procedural.grid(run.camera.wavelength), wanted.path.stem)


def _cube(wanted: sources.WantedScene, run: SimulationRun) -> "Scene":
    from l3cli.io import cubes
    from l3cli.simulation.cubes import scene_of

    source, path = wanted.source, wanted.path
    assert path is not None
    assert isinstance(source, sources.Spectral)
    if isinstance(source, sources.Cube):
        cube = cubes.read_cube(path, source.variable, source.axes)
    elif isinstance(source, sources.BandFolder):
        cube = cubes.read_band_folder(path)
    else:
        cube = (cubes.read_envi if isinstance(source, sources.Envi) else cubes.read_channels)(path)
    try:
        return scene_of(cube, source, path.stem, run.recorded[source.light] if source.light else None)
    except ValueError as error:
        raise InputFileError(f"{path}: {error}") from error


READERS: dict[type, Callable[[sources.WantedScene, SimulationRun], "Scene"]] = {
    sources.IsetScenes: _iset,
    sources.RgbPictures: _rgb,
    sources.BandFolder: _cube,
    sources.Envi: _cube,
    sources.Cube: _cube,
    sources.ImageChannels: _cube,
}


# --------------------------------------------------------------------------------------------------- sizes of scenes


def refusals(run: SimulationRun, files: list[list[Path]]) -> list[dict[Path, InputFileError]]:
    """Of the files of each source those that cannot be read or do not fit on the sensor, and why, from their headers.
    RecipeError if a drawn scene does not fit."""
    bad: list[dict[Path, InputFileError]] = []
    for source, paths in zip(run.recipe.scene, files, strict=True):
        bad.append({})
        for wanted in sources.wanted_scenes(source, paths):
            try:
                _check_size(wanted, run)
            except InputFileError as error:
                assert wanted.path is not None
                bad[-1][wanted.path] = error
    return bad


def _check_size(wanted: sources.WantedScene, run: SimulationRun) -> None:
    """RecipeError for a drawn scene, InputFileError for a file, if it does not fit on the sensor."""
    from l3cli.simulation.framing import framed_size

    source, error = wanted.source, RecipeError if wanted.path is None else InputFileError
    size = source.size if isinstance(source, sources.Drawn) else SIZES[type(source)](wanted, run)
    name = str(wanted.path or wanted.name)
    try:
        sources.check_size(framed_size(size, source, run.camera), run.camera, error, name)
    except ValueError as wrong:
        raise error(f"{name}: {wrong}") from wrong


def _iset_size(wanted: sources.WantedScene, run: SimulationRun) -> tuple[int, int]:
    from l3cli.io.scene_files import iset_size

    assert wanted.path is not None
    return iset_size(wanted.path, _substitute_light(wanted, run))


def _picture_size(wanted: sources.WantedScene, run: SimulationRun) -> tuple[int, int]:
    from l3cli.io.images import picture_size

    assert wanted.path is not None
    rows, cols = picture_size(wanted.path)
    by = wanted.source.shrink if isinstance(wanted.source, sources.RgbPictures) else 1
    return rows // by, cols // by


def _cube_size(wanted: sources.WantedScene, run: SimulationRun) -> tuple[int, int]:
    from l3cli.io import cubes
    from l3cli.io.images import picture_size

    path, source = wanted.path, wanted.source
    assert path is not None
    if isinstance(source, sources.Cube):
        return cubes.cube_size(path, source.variable, source.axes)
    if isinstance(source, sources.BandFolder) and (pictures := cubes.band_pictures(path)):
        return picture_size(pictures[0])
    rows, cols, _ = (cubes.read_envi if isinstance(source, sources.Envi) else cubes.read_band_folder)(path).values.shape
    return rows, cols  # an ENVI file's data are only mapped; an empty folder is refused


SIZES: dict[type, Callable[[sources.WantedScene, SimulationRun], tuple[int, int]]] = {
    sources.IsetScenes: _iset_size,
    sources.RgbPictures: _picture_size,
    sources.BandFolder: _cube_size,
    sources.Envi: _cube_size,
    sources.Cube: _cube_size,
    sources.ImageChannels: _picture_size,
}
