"""What the workers of l3 simulate do: read or draw a scene, simulate its frames, store each in a file of its own."""

import contextlib
import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import open_artifact, read_history
from l3cli.artifacts.training_set import TrainingPair, read_part, whole_part, write_part
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.files import is_ours, refuse_spared, require_same, sweep, write_whole
from l3cli.parallel import Crew
from l3cli.parallel.cluster import scratch_folder
from l3cli.simulate import sources
from l3cli.simulate.light import OWN, Light
from l3cli.simulate.recipe import Pair, SceneRecipe, Shot
from l3cli.simulate.targets import Target

if TYPE_CHECKING:
    from l3cli.scene import Scene

MARK = "run"  # names, in a folder of stored frames, the run they belong to
SENT = 64 << 20  # bytes of frames that a worker of another machine sends at a time, if it is more than one frame


@dataclass(frozen=True)
class Run:
    """What all frames share."""

    recipe: SceneRecipe
    camera: CameraModel
    target: Target
    lights: Mapping[str, Light]  # of 1 cd/m²
    recorded: Mapping[str, Light]  # the lights that scenes were recorded under
    seed: int
    base: Path  # folder of the recipe
    key: str  # what key_of says, once it is known
    folder: Path  # of the stored frames

    def part(self, index: int) -> Path:
        return self.folder / f"{index:06d}.h5"


@dataclass(frozen=True)
class Job:
    """Some frames of one scene, or one real pair."""

    run: Run
    what: sources.WantedScene | Pair
    shots: list[Shot]
    digests: Mapping[Path, str] = field(default_factory=dict)  # SHA-256 of its files, to be checked where they are read

    @property
    def files(self) -> list[Path]:
        """What it reads."""
        if isinstance(self.what, Pair):
            return [self.run.base / self.what.raw, self.run.base / self.what.picture]
        return files_of(self.what.source, self.what.path) if self.what.path else []


def files_of(source: sources.Source, path: Path) -> list[Path]:
    """What is read of a scene of that name: bands of a folder, an ENVI header and its data, else the file itself."""
    from l3cli.io.cubes import band_pictures, envi_files

    if isinstance(source, sources.BandFolder):
        return band_pictures(path)
    return envi_files(path) if isinstance(source, sources.Envi) else [path]


def jobs_of(run: Run, work: list[tuple[sources.WantedScene, list[Shot]]], workers: int) -> list[Job]:
    """One job a scene, so that each is read once; a scene is shared out where there are fewer scenes than workers need."""
    pieces = -(-2 * workers // max(1, len(work))) if workers > 1 else 1
    jobs = []
    for wanted, shots in work:
        size = -(-len(shots) // pieces)
        jobs += [Job(run, wanted, shots[start : start + size]) for start in range(0, len(shots), size)]
    first = sum(len(shots) for _, shots in work)
    return jobs + [Job(run, pair, [Shot(first + i, "", 0.0, 0.0)]) for i, pair in enumerate(run.recipe.pair)]


def work_off(job: Job) -> int:
    """Simulate and store those frames of a job that are not stored yet; how many frames it has."""
    run = job.run
    shots = [shot for shot in job.shots if not whole_part(run.part(shot.index), run.key)]
    if not shots:
        return len(job.shots)
    if isinstance(job.what, Pair):
        write_part(run.part(shots[0].index), _pair(job.what, run), 0.0, run.key)
        return 1
    from l3cli.simulate.light import uncovered_share

    scene = _scene(job.what, run)
    missing = uncovered_share(run.camera, scene.wavelength)
    for shot in shots:
        write_part(run.part(shot.index), _frame(scene, shot, run), missing, run.key)
    return len(job.shots)


def stored(crew: Crew, work: list[Job], digests: Mapping[Path, str]) -> Iterator[int]:
    """Work off all jobs by workers of other machines, which see the same inputs, and store what they send: how many frames
    are done, again and again."""
    needed = []
    for job in work:
        missing = [shot for shot in job.shots if not whole_part(job.run.part(shot.index), job.run.key)]
        yield len(job.shots) - len(missing)
        most = max(1, SENT // frame_bytes(job.run))
        own = {path: digests[path] for path in job.files}
        needed += [replace(job, shots=missing[at : at + most], digests=own) for at in range(0, len(missing), most)]
    for parts in crew(_sent, needed):
        for index, content in parts:
            write_whole(needed[0].run.part(index), content)
        yield len(parts)


def _sent(job: Job) -> list[tuple[int, bytes]]:
    """On another machine: the job's frames, each with the content of its file."""
    for path, digest in job.digests.items():
        require_same(path, digest)
    with scratch_folder() as folder:
        here = replace(job, run=replace(job.run, folder=folder))
        work_off(here)
        return [(shot.index, here.run.part(shot.index).read_bytes()) for shot in job.shots]


def frame_bytes(run: Run) -> int:
    """Of the largest frame: electrons of every channel, raw mosaic, target."""
    return run.camera.rows * run.camera.cols * (4 * len(run.camera.channels) + 2 + 4 * len(run.target.outputs))


def _frame(scene: "Scene", shot: Shot, run: Run) -> Any:
    from l3cli.simulate import light
    from l3cli.simulate.frame import Averaging, Saturating, simulate

    own = shot.illuminant == OWN
    falling = light.own_light(scene, shot.luminance) if own else run.lights[shot.illuminant].at(shot.luminance)
    way, _ = run.recipe.exposures()
    exposure: float | Saturating | Averaging = shot.exposure
    if way == "share":
        exposure = light.automatic_exposure(run.camera, falling, shot.exposure)
    elif way == "saturated":
        exposure = Saturating(shot.exposure)
    elif way == "mean":
        exposure = Averaging(shot.exposure)
    noise, seed = run.recipe.sensor.noise, (run.seed, shot.index)
    try:
        return simulate(run.camera, scene, falling, exposure, run.recipe.lens, seed, run.target, noise)
    except ValueError as error:
        raise InputFileError(f"scene {scene.name}: {error}") from error


# ------------------------------------------------------------------------------------------------------- scenes


def _scene(wanted: sources.WantedScene, run: Run) -> "Scene":
    """The scene, read or drawn, as it lies on the sensor; InputFileError if it does not fit there."""
    from l3cli.simulate import drawn
    from l3cli.simulate.framing import framed

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


def _iset(wanted: sources.WantedScene, run: Run) -> "Scene":
    from l3cli.io.scene_files import read_iset_scene

    assert wanted.path is not None
    return read_iset_scene(wanted.path, _own_light(wanted, run))


def _own_light(wanted: sources.WantedScene, run: Run) -> Any:
    """The light that the recipe gives ISET scenes which lack their own: wavelengths in nm and photons, or None."""
    assert isinstance(wanted.source, sources.IsetScenes)
    light = run.recorded[wanted.source.light] if wanted.source.light else None
    return (light.wavelength, light.radiance) if light else None


def _rgb(wanted: sources.WantedScene, run: Run) -> "Scene":
    from l3cli.io.scene_files import read_rgb_picture
    from l3cli.simulate import procedural, rgb

    assert wanted.path is not None
    assert isinstance(wanted.source, sources.RgbPictures)
    picture = rgb.shrunk(read_rgb_picture(wanted.path), wanted.source.shrink)
    return rgb.raise_to_spectra(picture, procedural.grid(run.camera.wavelength), wanted.path.stem)


def _cube(wanted: sources.WantedScene, run: Run) -> "Scene":
    from l3cli.io import cubes
    from l3cli.simulate.cubes import scene_of

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


READERS: dict[type, Callable[[sources.WantedScene, Run], "Scene"]] = {
    sources.IsetScenes: _iset,
    sources.RgbPictures: _rgb,
    sources.BandFolder: _cube,
    sources.Envi: _cube,
    sources.Cube: _cube,
    sources.ImageChannels: _cube,
}


# --------------------------------------------------------------------------------------------------- sizes of scenes


def refusals(run: Run, files: list[list[Path]]) -> list[dict[Path, InputFileError]]:
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


def _check_size(wanted: sources.WantedScene, run: Run) -> None:
    """RecipeError for a drawn scene, InputFileError for a file, if it does not fit on the sensor."""
    from l3cli.simulate.framing import framed_size

    source, error = wanted.source, RecipeError if wanted.path is None else InputFileError
    size = source.size if isinstance(source, sources.Drawn) else SIZES[type(source)](wanted, run)
    name = str(wanted.path or wanted.name)
    try:
        sources.check_size(framed_size(size, source, run.camera), run.camera, error, name)
    except ValueError as wrong:
        raise error(f"{name}: {wrong}") from wrong


def _iset_size(wanted: sources.WantedScene, run: Run) -> tuple[int, int]:
    from l3cli.io.scene_files import iset_size

    assert wanted.path is not None
    return iset_size(wanted.path, _own_light(wanted, run))


def _picture_size(wanted: sources.WantedScene, run: Run) -> tuple[int, int]:
    from l3cli.io.images import picture_size

    assert wanted.path is not None
    rows, cols = picture_size(wanted.path)
    by = wanted.source.shrink if isinstance(wanted.source, sources.RgbPictures) else 1
    return rows // by, cols // by


def _cube_size(wanted: sources.WantedScene, run: Run) -> tuple[int, int]:
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


SIZES: dict[type, Callable[[sources.WantedScene, Run], tuple[int, int]]] = {
    sources.IsetScenes: _iset_size,
    sources.RgbPictures: _picture_size,
    sources.BandFolder: _cube_size,
    sources.Envi: _cube_size,
    sources.Cube: _cube_size,
    sources.ImageChannels: _picture_size,
}


# -------------------------------------------------------------------------------------------------------- pairs


def _pair(pair: Pair, run: Run) -> Any:
    from l3cli.io.images import read_image
    from l3cli.io.raw_files import KnownBetter, read_raw
    from l3cli.io.scene_files import read_rgb_picture
    from l3cli.physics.display import xyz_from_srgb_matrix
    from l3cli.simulate.pairs import make_pair

    raw_path, path = run.base / pair.raw, run.base / pair.picture
    raw = read_raw(raw_path, run.camera, KnownBetter(phase=pair.phase))
    outputs = run.target.outputs
    pixels, names = read_image(path)
    if set(outputs) <= set(names):
        picture = np.ascontiguousarray(pixels[..., [names.index(output) for output in outputs]], np.float32)
    elif set(outputs) <= {"X", "Y", "Z"}:
        to_xyz = xyz_from_srgb_matrix()[["XYZ".index(output) for output in outputs]]
        picture = read_rgb_picture(path) @ to_xyz.T.astype(np.float32)
    else:
        raise InputFileError(f"{path} has no channels called {', '.join(outputs)}; give an EXR with them")
    try:
        return make_pair(raw, picture, outputs, run.camera, pair, path.stem)
    except ValueError as error:
        raise InputFileError(f"{path}: {error}") from error


# ------------------------------------------------------------------------------------------------ stored frames


def key_of(stage: Stage) -> str:
    """What tells a run from others: all that its frames depend on."""
    return hashlib.sha256(json.dumps(dataclasses.asdict(stage), sort_keys=True).encode()).hexdigest()


def open_folder(output: Path, key: str, resume: bool, force: bool) -> Path:
    """The folder beside `output` for the frames of the run called `key`: with `resume` what an earlier run left there,
    else empty. If that run was another one, RecipeError, or with `force` empty, too. L3Error if the folder is not of l3's
    making."""
    folder, mark = _folder_and_mark(output)
    if folder.exists():
        for each in folder.iterdir():
            refuse_spared(each)
        if not mark.is_file() and not all(is_ours(each.name) for each in folder.iterdir()):
            raise L3Error(f"{folder} is in the way; move it elsewhere")
        if resume and mark.is_file():
            if mark.read_text() == key:
                sweep(folder)
                return folder
            if not force:
                raise RecipeError(
                    f"{folder} is of a run with another recipe, camera, seed or version; leave --resume out or add --force"
                )
        _remove(folder)
    write_whole(mark, key)
    return folder


@contextlib.contextmanager
def close_folder(folder: Path) -> Iterator[None]:
    """Remove the folder after the block; if that fails or is interrupted, keep what frames there are for --resume."""
    try:
        yield
    except BaseException:
        sweep(folder)  # what worker processes left that were ended
        if not any(folder.glob("*.h5")):
            _remove(folder)
        raise
    _remove(folder)


def remove_finished(output: Path) -> None:
    """Remove the folder of a run that was killed after `output` had appeared, which holds all its frames."""
    folder, mark = _folder_and_mark(output)
    if mark.is_file() and is_of_run(output, mark.read_text()):
        _remove(folder)


def is_of_run(output: Path, key: str) -> bool:
    """Whether `output` is the whole training set of the run called `key`."""
    if not output.is_file():
        return False
    try:
        with open_artifact(output) as root:
            history = read_history(root, output)
    except InputFileError:
        return False
    return bool(history) and key_of(history[-1]) == key


@dataclass(frozen=True)
class StoredFrames:
    """All stored frames of a run in their order, read one by one."""

    run: Run
    total: int

    def __iter__(self) -> Iterator[TrainingPair]:
        for index in range(self.total):
            yield read_part(self.run.part(index), self.run.key)


def _folder_and_mark(output: Path) -> tuple[Path, Path]:
    folder = output.with_name(f"{output.name}.parts")
    return folder, folder / MARK


def _remove(folder: Path) -> None:
    """Remove the folder, its mark last: without one nobody would know whose it is."""
    for each in folder.iterdir():
        if each.name != MARK:
            each.unlink(missing_ok=True)
    (folder / MARK).unlink(missing_ok=True)
    folder.rmdir()
