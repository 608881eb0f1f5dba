"""The stage of a design: moments of scenes × library of filters → arrays by their predicted error."""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import Design, LightMoments, SceneMoments, Truth, Tuned
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import load, save
from l3cli.design.error import Cfa, Level, clips_everything, noise_of, seen_by, wanted_outputs
from l3cli.design.recipe import (
    DesignRecipe,
    OptimiseRecipe,
    PatternRecipe,
    TruthRecipe,
    bare_efficiency,
    design_faults,
    filter_curves,
    level_name,
    require_exposed,
    shown,
    sites_of,
    tuned_filters,
)
from l3cli.design.search import Problem, anneal, bayer_arrays, canonical, every_array, independent_outputs, least_period
from l3cli.design.tuning import Tuning, random_start
from l3cli.errors import InputFileError, L3Error, RecipeError, listed
from l3cli.options.commands import DesignOptions
from l3cli.parallel import WorkerPool, workers
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.toml import load_recipe, read_text
from l3cli.stages.design.moments import pixel_files, pixel_of
from l3cli.stages.design.parts import Parts
from l3cli.stages.design.truth import FIGURES, Trial, camera_of, trained
from l3cli.stages.simulation.units import key_of
from l3cli.system.checkpoint import parts_folder
from l3cli.system.console import Console
from l3cli.system.files import sha256
from l3cli.system.output_guard import OutputGuard
from l3cli.system.plan import Made, before_work

AT_ONCE = 64  # arrays that a process judges in a go
UNITS = {"lab": "ΔE00", "scielab": "ΔE of soft chroma", "luminance": "L*", "linear": "% of white"}
TUNED = " (tuned)"  # behind the name of an array with tuned filters
SHIFT = 5.0  # nm, of a filter that is not as it should be
DOSES = 10.0 ** np.arange(-2.0, 1.26, 0.25)  # cd s/m², of the map of errors over light
SAME = 1e-6  # relative; of numbers that agree


@dataclasses.dataclass(frozen=True)
class Task:
    """A design recipe with all that it names, as every process can make it again."""

    recipe: Path
    moments: Path

    @functools.cached_property
    def wanted(self) -> DesignRecipe:
        recipe = load_recipe(self.recipe, DesignRecipe)
        refuse_first(design_faults(recipe), self.recipe)
        return recipe

    @functools.cached_property
    def scenes(self) -> SceneMoments:
        return load(SceneMoments, self.moments)

    @functools.cached_property
    def curves(self) -> NDArray[np.float64]:
        """Return the quantum efficiency (filter, wavelength)."""
        pixel = pixel_of(self.wanted.pixel, self.recipe.parent)
        return filter_curves(self.wanted, pixel, self.scenes.wavelength, self.recipe.parent)

    @functools.cached_property
    def centres(self) -> NDArray[np.float64]:
        """Return the centroid (filter) in nm of what each passes."""
        return np.asarray(self.curves @ self.scenes.wavelength / self.curves.sum(axis=1))

    @functools.cached_property
    def levels(self) -> tuple[Level, ...]:
        lights = [light.illuminant for light in self.scenes.light]
        levels = []
        for one in self.wanted.level:
            if one.illuminant not in lights:
                known = f"{self.moments} holds moments under {', '.join(lights)}"
                raise RecipeError(f'level "{level_name(one)}": {known}; gather them under {one.illuminant}')
            luminance = one.lux / np.pi if one.lux is not None else one.luminance_cd_m2 or 100.0
            place = lights.index(one.illuminant)
            levels.append(Level(level_name(one), place, one.share, luminance, one.exposure_s or 0.0))
        return tuple(levels)

    @functools.cached_property
    def tuning(self) -> Tuning:
        """Return the array whose filters are tuned."""
        wanted, asked, wavelength = self.wanted, self.wanted.optimise, self.scenes.wavelength
        assert asked is not None
        names, tuned = list(wanted.filters), tuned_filters(asked, wanted.filters)
        given = [wanted.filters[name] for name in tuned]
        return Tuning(
            lights=self.scenes.light,
            wanted=[wanted_outputs(wanted.output, wanted.counts, light, self.curves) for light in self.scenes.light],
            levels=self.levels,
            noise=noise_of(pixel_of(wanted.pixel, self.recipe.parent)),
            cfa=_numbered(self, asked.pattern),
            curves=self.curves,
            wavelength=wavelength,
            bare=bare_efficiency(wanted.pixel.bare, wavelength, self.recipe.parent),
            tuned=[names.index(name) for name in tuned],
            given=np.array([[one.centre_nm, one.sigma_nm, one.peak] for one in given], np.float64),
            floors=[one.floor for one in given],
            peaks=asked.peaks,
        )

    @functools.cached_property
    def problem(self) -> Problem:
        return self.problem_of(self.curves)

    def problem_of(self, curves: NDArray[np.float64]) -> Problem:
        """Return the problem with other filters."""
        wanted, used = self.wanted, {level.light for level in self.levels}
        lights: Sequence[LightMoments] = self.scenes.light
        seen = tuple(
            seen_by(light, curves, wanted_outputs(wanted.output, wanted.counts, light, self.curves))
            for number, light in enumerate(lights)
            if number in used
        )
        order = sorted(used)
        levels = tuple(dataclasses.replace(level, light=order.index(level.light)) for level in self.levels)
        return Problem(seen, levels, noise_of(pixel_of(wanted.pixel, self.recipe.parent)))

    def allowed(self, filters: Sequence[int]) -> bool:
        """Return whether an array of these filters has as many independent outputs as are needed."""
        responses = self.curves[list(filters)] @ self.scenes.light[0].basis
        return len(filters) >= self.wanted.needed and independent_outputs(responses) >= self.wanted.needed


_task = functools.lru_cache(maxsize=1)(Task)  # of this process


def design(recipe: Path, output: Path, options: DesignOptions) -> Design:
    """Write the design of a recipe: its arrays by predicted error. RecipeError or InputFileError if recipe, moments or files
    cannot be used, L3Error if the output cannot be written."""
    if options.moments is None:
        raise RecipeError('‹moments› is missing; make them with "l3 design moments"')
    console = options.console
    with OutputGuard(console) as guard:
        guard.protect(recipe, options.moments)
        guard.guard_file(output, options.force)
        task = Task(recipe, options.moments)
        files = [*pixel_files(recipe), *_curve_files(task.wanted, recipe.parent)]
        guard.protect(*files)
        _check_pixel(task)
        problem = task.problem
        clipped = [clips_everything(problem.seen[level.light], level, problem.noise) for level in problem.levels]
        require_exposed([level.name for level in problem.levels], clipped)
        lists = [_arrays(task, pattern, number) for number, pattern in enumerate(task.wanted.pattern)]
        before_work({"recipe": files, "moments": [options.moments]}, Made(output, "design"))
        sums = {"recipe": [sha256(path) for path in files], "moments": [sha256(options.moments)]}
        stage = Stage("design", options.chosen(), read_text(recipe), sums)
        parts = Parts(parts_folder(output), key_of(stage))
        with parts.held(options.resume, options.force), workers(options.jobs) as pool:
            arrays = list(_candidates(task, lists, parts, pool, options))
            errors = _judged(task, arrays, parts, pool, console)
            made = _design(task, arrays, errors, options.top)
            if task.wanted.optimise is not None:
                made = dataclasses.replace(made, tuned=_tuned(task, task.wanted.optimise, parts, pool, options))
            if options.truth or task.wanted.truth:
                made = dataclasses.replace(made, truth=_truth(task, made, parts, pool, options))
            made = dataclasses.replace(made, history=(*task.scenes.history, stage))
            save(made, output)
        console.info(f"{output}: {made.tried} arrays, {len(made.filters)} filters, {len(made.levels)} levels")
        return made


def _curve_files(recipe: DesignRecipe, folder: Path) -> list[Path]:
    """Return the files of curves that a recipe names."""
    names = [one.file for one in recipe.filters.values() if one.file is not None]
    bare = [recipe.pixel.bare] if isinstance(recipe.pixel.bare, str) else []
    return [folder / name for name in (*names, *bare)]


def _check_pixel(task: Task) -> None:
    """Raise InputFileError if the moments are of another lens or pixel."""
    pixel, scenes = pixel_of(task.wanted.pixel, task.recipe.parent), task.scenes
    for what, unit, ours, theirs in (
        ("pixels", "µm", pixel.pixel_pitch * 1e6, scenes.pixel_pitch * 1e6),
        ("f-number", "", pixel.optics.f_number, scenes.f_number),
    ):
        if abs(ours - theirs) > SAME * ours:
            given = f"{what} of {theirs:g} {unit}".strip()
            raise InputFileError(
                f"{task.moments} is of {given}, the design of {ours:g}; gather moments with ‹camera› {task.recipe}"
            )


def _names(task: Task) -> list[str]:
    return list(task.wanted.filters)


def _numbered(task: Task, rows: list[str]) -> Cfa:
    """Return an array of names as numbers of filters."""
    names = _names(task)
    return np.array([[names.index(name) for name in row] for row in sites_of(rows)])


def _arrays(task: Task, pattern: PatternRecipe, number: int) -> list[Cfa] | None:
    """Return the arrays of a pattern that are judged; None: there are too many, and they are annealed. RecipeError if none
    has as many independent outputs as are needed."""
    needed, where = task.wanted.needed, f"{task.recipe}: pattern {number + 1}"
    if pattern.shape is None:
        listed_arrays = [_numbered(task, rows) for rows in pattern.arrays]
        if wrong := [cfa for cfa in listed_arrays if not task.allowed(np.unique(cfa).tolist())]:
            shortage = listed(shown(cfa, _names(task)) for cfa in wrong)
            raise RecipeError(f"{where}: {shortage} has fewer than {needed} independent outputs; add a filter")
        return listed_arrays
    filters = _filters(task, pattern)
    if not task.allowed(filters):
        raise RecipeError(f"{where}: its filters have fewer than {needed} independent outputs; add one")
    counts = list(pattern.counts.values()) if pattern.counts else None
    every = every_array(pattern.shape, filters, counts, task.allowed)
    if every == []:
        raise RecipeError(f"{where}: no array of that shape has {needed} independent outputs; make it larger")
    return every


def _filters(task: Task, pattern: PatternRecipe) -> list[int]:
    names = _names(task)
    return [names.index(name) for name in (pattern.counts or pattern.filters or names)]


def _candidates(
    task: Task, lists: Sequence[list[Cfa] | None], parts: Parts, pool: WorkerPool, options: DesignOptions
) -> Iterator[Cfa]:
    """Yield every array that is judged, Bayer's of the library among them, each once."""
    annealed = [
        (number, run)
        for number, arrays in enumerate(lists)
        if arrays is None
        for run in range(task.wanted.pattern[number].runs)
    ]
    work = functools.partial(_annealed, task.recipe, task.moments, options.seed)
    found = [part["cfa"] for part in parts.each("annealings", work, annealed, pool, options.console)] if annealed else []
    bayer = (cfa for cfa in bayer_arrays(range(len(task.curves)), task.centres) if task.allowed(np.unique(cfa).tolist()))
    known: set[tuple[Any, ...]] = set()
    for cfa in map(least_period, itertools.chain(*filter(None, lists), found, bayer)):
        key = (cfa.shape, canonical(cfa))
        if key not in known:
            known.add(key)
            yield cfa


def _annealed(recipe: Path, moments: Path, seed: int, which: tuple[int, int]) -> dict[str, NDArray]:
    """Return the array that annealing of a pattern comes to, in whatever process."""
    task, (number, run) = _task(recipe, moments), which
    pattern = task.wanted.pattern[number]
    assert pattern.shape is not None
    rng = np.random.default_rng([seed, number, run])
    counts = list(pattern.counts.values()) if pattern.counts else None
    _, cfa = anneal(task.problem, pattern.shape, _filters(task, pattern), counts, task.allowed, pattern.steps, rng)
    return {"cfa": cfa}


def _judged(task: Task, arrays: Sequence[Cfa], parts: Parts, pool: WorkerPool, console: Console) -> NDArray[np.float64]:
    """Return the errors (array, level, group)."""
    groups = [list(arrays[start : start + AT_ONCE]) for start in range(0, len(arrays), AT_ONCE)]
    work = functools.partial(_errors, task.recipe, task.moments)
    return np.concatenate([part["errors"] for part in parts.each("arrays", work, groups, pool, console)])


def _errors(recipe: Path, moments: Path, arrays: list[Cfa]) -> dict[str, NDArray]:
    problem = _task(recipe, moments).problem
    return {"errors": np.array([problem.errors(cfa) for cfa in arrays])}


def _design(task: Task, arrays: Sequence[Cfa], errors: NDArray[np.float64], top: int) -> Design:
    """Return the design, its best `top` arrays and the best of Bayer's among them."""
    problem, names = task.problem, _names(task)
    scores = np.array([problem.score(each) for each in errors])
    order = np.lexsort((np.arange(len(scores)), np.round(np.log(scores), 9)))
    places = {canonical(cfa): place for place, cfa in enumerate(arrays) if cfa.shape == (2, 2)}
    listed_places = list(order[:top])
    best = _best_bayer(task, range(len(names)), places, scores)
    if best is not None and best not in listed_places:
        listed_places.append(best)
    dyes = [_best_bayer(task, np.unique(arrays[place]).tolist(), places, scores) for place in listed_places]
    levels = (errors * problem.share).sum(axis=2)
    leaders = [order[0], *([] if best is None else [best]), *levels.argmin(axis=0)]
    mapped = list(dict.fromkeys(int(place) for place in leaders))
    over_light = [Level("", problem.levels[0].light, None, float(dose), 1.0) for dose in DOSES]
    light = dataclasses.replace(problem, levels=tuple(over_light), noise=dataclasses.replace(problem.noise, dark=0.0))
    return Design(
        name=task.wanted.name,
        unit=UNITS[task.wanted.counts if task.wanted.output == "XYZ" else "linear"],
        wavelength=task.scenes.wavelength,
        filters=tuple(names),
        efficiency=task.curves,
        levels=tuple(level.name for level in problem.levels),
        groups=task.scenes.groups,
        share=problem.share,
        tried=len(arrays),
        patterns=tuple(shown(arrays[place], names) for place in listed_places),
        error=errors[listed_places],
        dyes=np.array([np.zeros(len(problem.levels)) if each is None else levels[each] for each in dyes]),
        sensitivity=_sensitivity(task, arrays[order[0]]),
        dose=DOSES,
        mapped=tuple(shown(arrays[place], names) for place in mapped),
        map_error=np.array([(light.errors(arrays[place]) * light.share).sum(axis=1) for place in mapped]),
        bayer=-1 if best is None else listed_places.index(best),
    )


def _sensitivity(task: Task, cfa: Cfa) -> NDArray[np.float64]:
    """Return by how much (filter) the error of an array changes, relative, if one filter lies SHIFT nm off."""
    changes, given = np.zeros(len(task.curves)), task.problem.score(task.problem.errors(cfa))
    for place in np.unique(cfa):
        for shift in (-SHIFT, SHIFT):
            curves = task.curves.copy()
            curves[place] = np.interp(task.scenes.wavelength - shift, task.scenes.wavelength, curves[place])
            problem = task.problem_of(curves)
            change = problem.score(problem.errors(cfa)) / given - 1
            changes[place] = max(changes[place], change, key=abs)
    return changes


def _tuned(task: Task, asked: OptimiseRecipe, parts: Parts, pool: WorkerPool, options: DesignOptions) -> Tuned:
    """Return the tuned filters of an array, from the start that leads to the least error."""
    work = functools.partial(_descended, task.recipe, task.moments, options.seed)
    ends = list(parts.each("tunings", work, range(asked.starts), pool, options.console))
    scores = np.array([float(end["score"]) for end in ends])
    parameters = ends[int(scores.argmin())]["parameters"]
    curves, cfa = task.tuning.curves_of(parameters), _numbered(task, asked.pattern)
    problem = task.problem_of(curves)
    rivals = [problem.errors(each) for each in bayer_arrays(np.unique(cfa).tolist(), task.centres)]
    best = min(rivals, key=problem.score) if rivals else np.zeros_like(problem.share)
    judged = task.problem.errors(cfa), problem.errors(cfa), best
    before, after, bayer = ((each * problem.share).sum(axis=1) for each in judged)
    names = tuple(tuned_filters(asked, task.wanted.filters))
    return Tuned(shown(cfa, _names(task)), parameters, names, curves, before, after, bayer, np.exp(scores))


def _descended(recipe: Path, moments: Path, seed: int, number: int) -> dict[str, NDArray]:
    """Return the end that a start leads to; the first start is the given filters."""
    tuning = _task(recipe, moments).tuning
    given = tuning.given
    start = given if number == 0 else random_start(given, np.random.default_rng([seed, number]))
    score, parameters = tuning.descend(start)
    return {"score": np.array(score), "parameters": parameters}


def _truth(task: Task, made: Design, parts: Parts, pool: WorkerPool, options: DesignOptions) -> Truth:
    """Return arrays trained and judged: the best ones, Bayer's, the rivals of the recipe and the tuned one."""
    asked, names = task.wanted.truth or TruthRecipe(), _names(task)
    best = [*made.patterns[: options.truth or asked.arrays], *([made.patterns[made.bayer]] if made.bayer >= 0 else [])]
    tuned = [] if made.tuned is None else [made.tuned.pattern]
    rivals = [shown(_numbered(task, rows), names) for rows in asked.rivals]
    wanted = dict.fromkeys((*best, *rivals, *tuned), (task.curves, task.problem))
    if made.tuned is not None:
        curves = made.tuned.tuned_efficiency
        wanted[f"{made.tuned.pattern}{TUNED}"] = curves, task.problem_of(curves)
    pixel = pixel_of(task.wanted.pixel, task.recipe.parent)
    levels = [(task.scenes.light[level.light].illuminant, level) for level in task.levels]
    trials, expected = [], []
    for text, (curves, problem) in wanted.items():
        cfa = _numbered(task, text.removesuffix(TUNED).split(" / "))
        camera = camera_of(pixel, cfa, names, task.scenes.wavelength, curves)
        trials.append(Trial(camera, levels, asked, options.seed))
        expected.append((problem.errors(cfa) * problem.share).sum(axis=1))
    ends = list(parts.each("trainings", trained, trials, pool, options.console))
    digests = {end["digest"].tobytes().hex() for end in ends}
    if len(digests) > 1:
        raise L3Error("the arrays were not judged on the same scenes; report this as a fault of l3")
    return Truth(tuple(wanted), np.array(expected), FIGURES, np.array([end["figures"] for end in ends]), digests.pop())


def _best_bayer(task: Task, filters: Sequence[int], places: dict[bytes, int], scores: NDArray[np.float64]) -> int | None:
    """Return the place of the best Bayer array of some filters; None: there is none."""
    keys = map(canonical, bayer_arrays(filters, task.centres))
    return min((places[key] for key in keys if key in places), key=lambda place: scores[place], default=None)
