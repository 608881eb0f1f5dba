"""The `l3 design moments` and `l3 design` stages.

`l3 design moments` simulates how a lens and the bare pixels of a sensor record scenes, and stores second moments of image
patches. From these moments, l3 can predict the error of any colour filter array. `l3 design` ranks all arrays that are
possible with a library of filters by their predicted error. Optionally, it trains and evaluates tables for the best arrays
to verify the predictions.
"""

import dataclasses
import functools
import hashlib
import io
import itertools
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import recipe_text
from l3cli.artifacts.design import Design, LightMoments, SceneMoments, Truth, Tuned, shown
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingFrame, open_training_set
from l3cli.design.error import (
    Cfa,
    Level,
    clips_everything,
    empty_sums,
    gather,
    in_all_orientations,
    principal_spectra,
    spectral_power,
)
from l3cli.design.recipe import OptimiseRecipe, curve_files, is_design, pixel_camera
from l3cli.design.search import canonical
from l3cli.design.task import Task, designed
from l3cli.errors import L3Error, RecipeError, listed
from l3cli.evaluation.evaluation import raw_of
from l3cli.evaluation.quality import Target
from l3cli.frames.scene import Scene
from l3cli.options.commands import DesignOptions, MomentsOptions, PartsOptions, SimulateOptions, TrainOptions
from l3cli.parallel import WorkerPool, workers
from l3cli.physics.display import displayed, srgb_codes, white_luminance
from l3cli.physics.mosaic import least_period
from l3cli.recipes.builtin import find_recipe
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import read_text, toml_value
from l3cli.simulation.frame import SimulationRun, spectral_planes
from l3cli.simulation.light import SCENE_LIGHT, Filters, named_beyond_known, photon_weights
from l3cli.simulation.recipe import SceneRecipe
from l3cli.simulation.sources import Spectral, WantedScene, holds_codes, wanted_scenes
from l3cli.stages.evaluation import FrameRenderers
from l3cli.stages.simulation.preparation import fitting, input_files, prepare, scene_over_time, unknown_of
from l3cli.stages.simulation.simulate import simulate
from l3cli.stages.simulation.units import is_of_run, key_of
from l3cli.stages.training.train import train
from l3cli.system.checkpoint import PartsFolder
from l3cli.system.console import Console, Silent
from l3cli.system.files import FilesUsed, files_to_read, refuse_existing, sha256, write_whole
from l3cli.system.outputs import OutputGuard
from l3cli.system.text import counted

T = TypeVar("T")
Arrays = Mapping[str, NDArray]


class Parts(PartsFolder):
    """Stored intermediate results of a run, as files with named NumPy arrays."""

    def each(
        self, what: str, work: Callable[[T], Arrays], items: Sequence[T], pool: WorkerPool, console: Console
    ) -> Iterator[dict[str, NDArray]]:
        """Apply `work` to each item, store the results, and yield them in order.

        If an earlier run has stored the result of an item, the stored result is yielded.

        Parameters
        ----------
        what : str
            Name of the results in the plural, for file names and the progress bar.
        work : callable
            Function that computes a dictionary of arrays from an item. The function must be picklable.
        items : sequence
            The items.
        pool : WorkerPool
            The worker processes.
        console : Console
            Shows the progress.
        """
        paths = [self.folder / f"{what}-{number:05d}.npz" for number in range(len(items))]
        done = [path.is_file() for path in paths]
        fresh = pool(work, [item for item, stored in zip(items, done, strict=True) if not stored])
        for path, stored in console.progress(zip(paths, done, strict=True), len(paths), what):
            if not stored:
                content = io.BytesIO()
                np.savez(content, **next(fresh))  # type: ignore[arg-type]
                write_whole(path, content.getvalue())
            with np.load(path, allow_pickle=False) as arrays:
                yield {name: arrays[name] for name in arrays.files}


PARTS = 8  # parts into which the scenes are divided, whatever the number of processes


def gather_moments(scenes: Path, camera: Path, output: Path, options: MomentsOptions) -> tuple[SceneMoments, FilesUsed]:
    """Compute and write second moments of scenes as recorded by a camera's pixels and lens, without its colour filters.

    Parameters
    ----------
    scenes : Path
        Scene recipe.
    camera : Path
        Camera model, camera recipe or design recipe.
    output : Path
        File of moments to write.
    options : MomentsOptions
        Options of `l3 design moments`.

    Returns
    -------
    SceneMoments
        The moments. If `resume` is set and the output is finished, the moments are read from the output.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    RecipeError, InputFileError
        If the recipe, the camera or a scene file is unsuitable.
    L3Error
        If the output cannot be written.
    """
    console = options.console
    with OutputGuard(console) as guard:
        recipe, (pixel, pixel_files) = load_recipe(scenes, SceneRecipe), pixel_camera(camera)
        guard.protect(scenes, *pixel_files)
        guard.guard_file(output, options.force or options.resume)
        _refuse(recipe, scenes)
        run, files = prepare(recipe, scenes, pixel, options.seed)
        files, _ = fitting(run, files, scenes, False, console)
        inputs = {"camera": pixel_files, **input_files(run, files)}
        guard.protect(*itertools.chain(*inputs.values()))
        digests = {role: [sha256(path) for path in paths] for role, paths in inputs.items() if paths}
        text = f"{read_text(scenes)}\n{read_text(camera) if is_design(camera) else recipe_text(camera)}"
        stage = Stage("design moments", options.chosen(), text, digests)
        parts = Parts(output, key_of(stage))
        used = files_to_read({"scene recipe": [scenes], **inputs}).and_wrote(output)
        if _is_finished(output, parts, options):
            return load(SceneMoments, output), used
        for unknown in unknown_of(run, pixel):
            console.warn(unknown)
        wanted = [
            each for source, paths in zip(run.recipe.scene, files, strict=True) for each in wanted_scenes(source, paths)
        ]
        size = -(-len(wanted) // PARTS)
        chunks = [list(enumerate(wanted))[start : start + size] for start in range(0, len(wanted), size)]
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
        spectra_of = ", ".join(f"{each.terms} principal spectra under {each.illuminant}" for each in lights)
        console.info(f"{output} contains the moments of {lights[0].patches.sum():.0f} patches ({spectra_of})")
        return moments, used


def _is_finished(output: Path, parts: Parts, options: PartsOptions) -> bool:
    """Return whether `resume` is set and an earlier run with the same inputs and options has finished the output.

    In this case, stored parts are removed, and the console shows a message.

    Raises
    ------
    L3Error
        If the output exists but is not finished, and `force` is not set.
    """
    finished = options.resume and not options.force and is_of_run(output, parts.key)
    if not finished:
        refuse_existing(output, options.force)
    if finished:
        parts.remove()  # parts remain if a run was killed just after writing the output
        options.console.info(f"{output} is already finished")
    return finished


def _refuse(recipe: SceneRecipe, path: Path) -> None:
    """Raise RecipeError unless the scenes can be simulated under all illuminants and behind all filters.

    Scenes must have reflectance spectra, and the recipe must not set a lens transmittance.
    """
    if SCENE_LIGHT in recipe.illuminants:
        raise RecipeError(
            f'{path}: "{SCENE_LIGHT}" in illuminants cannot be used for moments; set illuminants such as "D65"'
        )
    if recipe.pair or not recipe.scene or any(map(holds_codes, recipe.scene)):
        raise RecipeError(
            f"{path}: moments can be computed only from spectral scenes; remove each [[pair]] and each scene with "
            'holds = "codes"'
        )
    if any(isinstance(each, Spectral) and each.holds != "reflectance" and each.light is None for each in recipe.scene):
        raise RecipeError(
            f'{path}: moments can be computed only from reflectances, but a scene contains radiances; add the key "light" '
            "with the illuminant of the scene"
        )
    if recipe.lens.transmittance is not None:
        raise RecipeError(
            f"{path}: moments are computed without lens.transmittance; remove this key, and multiply the "
            "transmittances of the filters by the transmittance of the lens"
        )


Chunk = Sequence[tuple[int, WantedScene]]


def _scene(wanted: WantedScene, run: SimulationRun) -> Scene:
    scene = scene_over_time(wanted, run)(0)
    assert isinstance(scene, Scene)
    return scene


def _spectra(run: SimulationRun, chunk: Chunk) -> dict[str, NDArray]:
    """Sum the `spectral_power` of scenes: mean products of the photon rates at each pair of wavelengths.

    Returns one array named "power", with the shape (illuminant, wavelength, wavelength).
    """
    power = np.zeros((len(run.recipe.illuminants), run.camera.wavelength.size, run.camera.wavelength.size))
    for _, wanted in chunk:
        scene = _scene(wanted, run)
        for number, name in enumerate(run.recipe.illuminants):
            rate = photon_weights(run.camera, run.lights[name], scene.wavelength)
            power[number] += spectral_power(scene.reflectance, rate)
    return {"power": power}


def _moments(run: SimulationRun, bases: Sequence[NDArray[np.float64]], patches: int, chunk: Chunk) -> dict[str, NDArray]:
    """Sum the moments of random patches over scenes (`LightMoments`), using the same patches under all illuminants.

    The names of the returned arrays end in the index of the illuminant.
    """
    sums = [empty_sums(basis.shape[1]) for basis in bases]
    for place, wanted in chunk:
        scene = _scene(wanted, run)
        for of_light, name, basis in zip(sums, run.recipe.illuminants, bases, strict=True):
            planes, sharp, target = spectral_planes(run.camera, scene, run.lights[name], run.recipe.lens, basis)
            rng = np.random.default_rng([run.seed, place])  # draws the same patches under all illuminants
            gather(of_light, planes, target, sharp, patches, rng)
    return {f"{name}-{number}": value for number, of_light in enumerate(sums) for name, value in of_light.items()}


CLASS_RECIPE = "single"  # class recipe for tables that verify the predictions
CROP = 72  # side in pixels of the crop from the first scene that is stored in a design
FIGURES = ("mean_delta_e", "scielab", "output_psnr")  # attributes of Quality that are stored in a design
# scene recipe for training the tables
TRAINING_SCENES = """illuminants = {lights}
exposure_share = [0.9]
[[scene]]
source = "dead leaves"
size = [160, 160]
count = 24
[[scene]]
source = "surfaces"
size = [160, 160]
count = 2
patches = [4, 4]
"""
# scene recipe for evaluating the tables
EVALUATION_SCENES = """illuminants = ["{light}"]
luminances_cd_m2 = [{luminance}]
{exposure}
[[scene]]
source = "composition"
size = [180, 320]
seed = 7
[[scene]]
source = "dead leaves"
size = [160, 160]
seed = 8
count = 2
"""


@dataclass(frozen=True)
class Trial:
    """A camera with a candidate CFA, and the light levels at which its trained table is evaluated."""

    camera: CameraModel
    levels: Sequence[tuple[str, Level]]  # illuminant and exposure of each condition
    seed: int


def trained(trial: Trial) -> dict[str, NDArray]:
    """Train a table for a CFA and evaluate it on other scenes, using only temporary files.

    Returns
    -------
    dict of str to ndarray
        The keys are:

        * "figures", (level, scene, metric): the metrics in FIGURES.
        * "crops", (level, row, col, 3): a crop of the rendered first scene, as sRGB codes.
        * "ideals", (level, row, col, 3): the same crop of the ideal picture.
        * "digest", (byte,): the SHA-256 of the content of all evaluated scenes.
    """
    with tempfile.TemporaryDirectory(prefix="l3-") as name:
        folder, shown, ends = Path(name), hashlib.sha256(), []
        save(trial.camera, folder / "camera.h5")
        lights = toml_value(list(dict.fromkeys(light for light, _ in trial.levels)))
        training = _simulated(TRAINING_SCENES.format(lights=lights), folder, "training", trial.seed)
        train((training,), folder / "table.h5", TrainOptions(classes=find_recipe(CLASS_RECIPE, "classes"), seed=trial.seed))
        table = load(TransformTable, folder / "table.h5")
        for number, (light, level) in enumerate(trial.levels):
            exposure = f"exposure_share = [{level.share}]" if level.share is not None else f"exposure_s = [{level.seconds}]"
            text = EVALUATION_SCENES.format(light=light, luminance=level.luminance, exposure=exposure)
            ends.append(_judged(table, _simulated(text, folder, f"unseen{number}", trial.seed + 1), shown))
        figures, crops, ideals = map(np.array, zip(*ends, strict=True))
        digest = np.frombuffer(shown.digest(), np.uint8)
        return {"figures": figures, "crops": crops, "ideals": ideals, "digest": digest}


def _simulated(text: str, folder: Path, name: str, seed: int) -> Path:
    recipe, frames = folder / f"{name}.toml", folder / f"{name}.h5"
    recipe.write_text(text)
    simulate(recipe, folder / "camera.h5", frames, SimulateOptions(seed=seed))
    return frames


def _judged(table: TransformTable, frames: Path, shown: "hashlib._Hash") -> tuple[NDArray, NDArray, NDArray]:
    """Evaluate a table on simulated frames, and add their scenes to the hash `shown`.

    Returns
    -------
    (ndarray, ndarray, ndarray)
        Metrics in FIGURES, (frame, metric); crop of the first rendered frame; crop of its ideal picture.
    """
    rows, crops = [], list[NDArray]()
    renderers = FrameRenderers("reference", table, Silent())
    with open_training_set(frames) as reader:
        for index in range(len(reader)):
            frame = reader.frame(index)
            assert isinstance(frame, TrainingFrame)
            assert frame.shown is not None
            shown.update(f"{np.round(frame.shown.scene, 3).tolist()} {frame.luminance} {frame.illuminant}".encode())
            outputs = renderers.of(frame).outputs(raw_of(frame, index, reader.head.camera))
            outputs = outputs * (table.output_unit / frame.exposure)
            quality = Target(frame.target, frame.white, table.first.rule.radius).judge(outputs)[0]
            rows.append([getattr(quality, name) for name in FIGURES])
            if not crops:
                scale = white_luminance(frame.target[1])
                inside = tuple(slice((size - CROP) // 2, (size + CROP) // 2) for size in frame.target.shape[1:])
                cut = [planes[:, *inside] for planes in (outputs, frame.target)]
                crops = [srgb_codes(displayed(planes, frame.white, scale)) for planes in cut]
    ours, ideal = crops
    return np.array(rows), ours, ideal


CFAS_PER_PART = 64  # number of CFAs whose predicted errors are stored together
ANNEALING_RUNS = 2  # runs of simulated annealing per pattern; see Task.annealed for their starting points
TUNING_STARTS = 4  # number of starting points for filter tuning; the first consists of the recipe's filters
TUNED = " (tuned)"  # suffix for the names of CFAs with tuned filters


def design(recipe: Path, output: Path, options: DesignOptions) -> tuple[Design, FilesUsed]:
    """Rank the possible CFAs of a design recipe by their predicted error, and write the design.

    If the recipe contains the table [optimise], filters are also tuned. If `options.truth` is set, tables for the best CFAs
    are trained and evaluated to verify the predictions.

    Parameters
    ----------
    recipe : Path
        Design recipe.
    output : Path
        Design to write.
    options : DesignOptions
        Options of `l3 design`.

    Returns
    -------
    Design
        The design. If `resume` is set and the output is finished, the design is read from the output.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    RecipeError, InputFileError
        If the recipe, the moments or a file of spectra is unsuitable.
    L3Error
        If the output cannot be written.
    """
    if options.moments is None:
        raise RecipeError('the option ‹moments› is missing; set it to a file from "l3 design moments"')
    console = options.console
    with OutputGuard(console) as guard:
        guard.protect(recipe, options.moments)
        guard.guard_file(output, options.force or options.resume)
        task = Task(recipe, options.moments)
        files = [*pixel_camera(recipe)[1], *curve_files(task.wanted, recipe.parent)]
        guard.protect(*files)
        task.require_same_pixel()
        seen, noise = task.problem.seen, task.problem.noise
        if wrong := [each.name for each in task.levels if clips_everything(seen[each.light], each, noise)]:
            raise RecipeError(
                f"at the light level {listed(wrong)}, all pixels of all scenes clip behind every filter; reduce the exposure"
            )
        lists = [task.arrays_of(pattern, number) for number, pattern in enumerate(task.wanted.pattern)]
        sums = {"recipe": [sha256(path) for path in files], "moments": [sha256(options.moments)]}
        stage = Stage("design", options.chosen(), read_text(recipe), sums)
        parts = Parts(output, key_of(stage))
        used = files_to_read({"recipe": files, "moments": [options.moments]}).and_wrote(output)
        if _is_finished(output, parts, options):
            return load(Design, output), used
        filters = Filters.of(dict(zip(task.names, task.curves, strict=True)), task.scenes.wavelength)
        for unknown in named_beyond_known((light.illuminant for light in task.lights), filters):
            console.warn(unknown)
        with parts.held(options.resume, options.force), workers(options.jobs) as pool:
            run = _Run(task, parts, pool, options)
            arrays = list(run.candidates(lists))
            made = designed(task, arrays, run.judged(arrays))
            if task.wanted.optimise is not None:
                made = dataclasses.replace(made, tuned=run.tuned(task.wanted.optimise))
            if options.truth is not None:
                made = dataclasses.replace(made, truth=run.truth(made, options.truth))
            made = dataclasses.replace(made, history=(*task.scenes.history, stage))
            save(made, output)
        found = counted(made.tried, "CFA"), counted(len(made.filters), "filter"), counted(len(made.levels), "level")
        console.info(f"{output}: {', '.join(found)}")
        return made, used


@dataclasses.dataclass(frozen=True)
class _Run:
    """The steps of `l3 design`. Each step stores its results, so that an interrupted run can be continued."""

    task: Task
    parts: Parts
    pool: WorkerPool
    options: DesignOptions

    def _each(self, what: str, work: Any, items: Sequence[Any]) -> Iterator[dict[str, NDArray]]:
        return self.parts.each(what, work, items, self.pool, self.options.console)

    def candidates(self, lists: Sequence[list[Cfa] | None]) -> Iterator[Cfa]:
        """Yield each candidate CFA once.

        Candidates are all CFAs that match a pattern in the recipe or, if too many match, the results of simulated annealing.
        All Bayer CFAs with filters from the library are candidates too.

        Parameters
        ----------
        lists : sequence of list of CFA, or None
            The CFAs that match each pattern, or None if there are too many.
        """
        runs = [(number, run) for number, arrays in enumerate(lists) if arrays is None for run in range(ANNEALING_RUNS)]
        work = functools.partial(self.task.annealed, self.options.seed)
        annealed = [part["cfa"] for part in self._each("annealings", work, runs)] if runs else []
        known: set[tuple[Any, ...]] = set()
        bayer = self.task.bayer(range(len(self.task.curves)))
        for cfa in map(least_period, itertools.chain(*filter(None, lists), annealed, bayer)):
            key = (cfa.shape, canonical(cfa))
            if key not in known:
                known.add(key)
                yield cfa

    def judged(self, arrays: Sequence[Cfa]) -> NDArray[np.float64]:
        """Predict the errors of CFAs: (CFA, light level, group of patches)."""
        groups = [arrays[start : start + CFAS_PER_PART] for start in range(0, len(arrays), CFAS_PER_PART)]
        return np.concatenate([part["errors"] for part in self._each("arrays", self.task.judged, groups)])

    def tuned(self, asked: OptimiseRecipe) -> Tuned:
        """Tune the filters of a CFA from several starting points, and return the best result."""
        task = self.task
        ends = list(self._each("tunings", functools.partial(task.descended, self.options.seed), range(TUNING_STARTS)))
        parameters = min(ends, key=lambda end: float(end["score"]))["parameters"]
        curves, cfa = task.tuned_curves(parameters), task.numbered(asked.pattern)
        problem = task.problem_of(curves)
        bayer = min(task.bayer(np.unique(cfa).tolist()), key=problem.score, default=None)
        return Tuned(
            pattern=shown(cfa, task.names),
            parameters=parameters,
            tuned_filters=tuple(task.wanted.tuned),
            tuned_efficiency=curves,
            before=task.problem.means(cfa),
            after=problem.means(cfa),
            bayer=np.zeros(len(task.levels)) if bayer is None else problem.means(bayer),
        )

    def truth(self, made: Design, most: int) -> Truth:
        """Train and evaluate tables for the best CFAs, to verify their predicted errors.

        The CFAs are the `most` best CFAs of the design, the best Bayer CFA, and the rival CFAs in the recipe. If filters
        were tuned, their CFA is included with the original and with the tuned filters.

        Raises
        ------
        L3Error
            If the CFAs were not evaluated on the same scenes.
        """
        task, names = self.task, self.task.names
        given = [made.patterns[place] for place in made.best(most)]
        given += [shown(task.numbered(rows), names) for rows in task.wanted.rivals]
        wanted = {text: (text, task.curves) for text in given}
        if made.tuned is not None:
            text, curves = made.tuned.pattern, made.tuned.tuned_efficiency
            wanted |= {text: (text, task.curves), f"{text}{TUNED}": (text, curves)}
        levels = [(task.lights[level.light].illuminant, level) for level in task.levels]
        trials, expected = [], []
        for text, curves in wanted.values():
            trials.append(Trial(made.camera(text, curves), levels, self.options.seed))
            expected.append(task.problem_of(curves).means(task.numbered(text.split("/"))))
        ends = list(self._each("trainings", trained, trials))
        digests = {end["digest"].tobytes().hex() for end in ends}
        if len(digests) > 1:
            raise L3Error("the CFAs were not evaluated on the same scenes, which is a bug in l3; please report it")
        figures, crops = (np.array([end[name] for end in ends]) for name in ("figures", "crops"))
        figures = figures.mean(axis=2)  # mean over the scenes
        return Truth(tuple(wanted), np.array(expected), FIGURES, figures, crops, ends[0]["ideals"], digests.pop())
