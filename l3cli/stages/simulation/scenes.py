"""Scenes of a simulation: their files, read or synthetic, as they lie on the sensor; which of them do not fit there."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l3cli.errors import InputFileError, RecipeError
from l3cli.io.scenes.registry import format_of
from l3cli.simulation import sources
from l3cli.simulation.run import SimulationRun

if TYPE_CHECKING:
    from l3cli.frames.scene import ChannelPicture, Scene


def files_of(source: sources.Source, path: Path) -> list[Path]:
    """Return the files of a scene of that name: bands of a folder, an ENVI header and its data, else the file itself."""
    return format_of(sources.name_of(source), path).files(path)


def scene_over_time(wanted: sources.WantedScene, run: SimulationRun) -> "Callable[[int], Scene | ChannelPicture]":
    """The scene, read or synthetic, as it lies on the sensor in each frame of its clip; one that stands still is the same in
    all. InputFileError if it does not fit there."""
    from l3cli.frames.scene import ChannelPicture
    from l3cli.simulation import procedural
    from l3cli.simulation.clip import clip_of
    from l3cli.simulation.framing import framed

    scene: Scene | ChannelPicture
    if wanted.path is None:
        scene = procedural.draw(wanted, run.seed, run.camera.wavelength)
    else:
        scene = _from_file(wanted, wanted.path, run)
    culprit = str(wanted.path or wanted.name)
    try:
        if wanted.source.motion is not None:
            return clip_of(scene, wanted, run)
        if isinstance(scene, ChannelPicture):
            scene = replace(scene, signal=framed(scene.signal, wanted.source, run.camera))
        else:
            scene = replace(scene, reflectance=framed(scene.reflectance, wanted.source, run.camera))
    except ValueError as error:
        raise (RecipeError if wanted.path is None else InputFileError)(f"{culprit}: {error}") from error
    samples = scene.signal if isinstance(scene, ChannelPicture) else scene.reflectance
    sources.check_size(samples.shape[:2], run.camera, InputFileError, culprit)
    return lambda _: scene


def _from_file(wanted: sources.WantedScene, path: Path, run: SimulationRun) -> "Scene | ChannelPicture":
    """The scene of a file: read as such, or made of a picture or a cube."""
    from l3cli.frames.scene import ChannelPicture, Scene, SpectralCube

    source = wanted.source
    content = format_of(sources.name_of(source), path).read(path, **_keys(source, path, run))
    if isinstance(content, Scene):
        return content
    if isinstance(content, SpectralCube):
        from l3cli.simulation.cubes import scene_of

        assert isinstance(source, sources.Spectral)
        try:
            return scene_of(content, source, path.stem, run.recorded[source.light] if source.light else None)
        except ValueError as error:
            raise InputFileError(f"{path}: {error}") from error
    from l3cli.simulation import procedural, reflectances

    assert isinstance(source, sources.RgbPictures)
    linear = reflectances.shrunk(content, source.shrink)
    if sources.holds_codes(source):
        order = [sources.CODED.index(channel) for channel in run.camera.channels]
        try:
            return ChannelPicture(path.stem, linear[..., order])
        except ValueError as error:
            raise InputFileError(f"{path}: {error}") from error
    return reflectances.raise_to_spectra(linear, procedural.grid(run.camera.wavelength), path.stem)


def _keys(source: sources.Source, path: Path, run: SimulationRun) -> dict[str, Any]:
    """Return the keys of the recipe that the reader of a file takes; a light by its wavelengths in nm and photons, None
    without one."""
    keys = {key: getattr(source, key) for key in format_of(sources.name_of(source), path).keys}
    if keys.get("light"):
        light = run.recorded[keys["light"]]
        keys["light"] = (light.wavelength, light.radiance)
    return keys


# --------------------------------------------------------------------------------------------------- sizes of scenes


def refusals(run: SimulationRun, files: list[list[Path]]) -> list[dict[Path, InputFileError]]:
    """Return, of the files of each source, those that cannot be read or do not fit on the sensor, and why, from their
    headers. RecipeError if a synthetic scene does not fit."""
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
    """RecipeError for a synthetic scene, InputFileError for a file, if it does not fit on the sensor."""
    error = RecipeError if wanted.path is None else InputFileError
    sources.check_size(size_of(wanted, run), run.camera, error, str(wanted.path or wanted.name))


def size_of(wanted: sources.WantedScene, run: SimulationRun) -> tuple[int, int]:
    """(rows, cols) of a scene as it lies on the sensor, of a file by its header; errors as of `refusals`."""
    from l3cli.simulation.framing import framed_size

    source = wanted.source
    size = source.size if isinstance(source, sources.Synthetic) else _file_size(wanted, run)
    try:
        return framed_size(size, source, run.camera)
    except ValueError as wrong:
        error = RecipeError if wanted.path is None else InputFileError
        raise error(f"{wanted.path or wanted.name}: {wrong}") from wrong


def _file_size(wanted: sources.WantedScene, run: SimulationRun) -> tuple[int, int]:
    path, source = wanted.path, wanted.source
    assert path is not None
    rows, cols = format_of(sources.name_of(source), path).size(path, **_keys(source, path, run))
    by = source.shrink if isinstance(source, sources.RgbPictures) else 1
    return rows // by, cols // by
