"""The stage of a design: moments of scenes × library of filters → arrays by their predicted error."""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import Design, Truth, Tuned
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import save
from l3cli.design.error import Cfa, clips_everything
from l3cli.design.pixel import camera_with, pixel_files
from l3cli.design.ranking import designed
from l3cli.design.recipe import (
    DesignRecipe,
    OptimiseRecipe,
    TruthRecipe,
    require_exposed,
    shown,
    tuned_filters,
)
from l3cli.design.search import anneal, bayer_arrays, canonical
from l3cli.design.task import Task
from l3cli.design.tuning import random_start
from l3cli.errors import L3Error, RecipeError
from l3cli.frames.frame import least_period
from l3cli.options.commands import DesignOptions
from l3cli.parallel import WorkerPool, workers
from l3cli.recipes.toml import read_text
from l3cli.stages.design.parts import Parts
from l3cli.stages.design.truth import FIGURES, Trial, trained
from l3cli.stages.simulation.units import key_of
from l3cli.system.checkpoint import parts_folder
from l3cli.system.console import Console
from l3cli.system.files import sha256
from l3cli.system.output_guard import OutputGuard
from l3cli.system.plan import Made, before_work

AT_ONCE = 64  # arrays that a process judges in a go
TUNED = " (tuned)"  # behind the name of an array with tuned filters


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
        task.require_same_pixel()
        problem = task.problem
        clipped = [clips_everything(problem.seen[level.light], level, problem.noise) for level in problem.levels]
        require_exposed([level.name for level in problem.levels], clipped)
        lists = [task.arrays_of(pattern, number) for number, pattern in enumerate(task.wanted.pattern)]
        before_work({"recipe": files, "moments": [options.moments]}, Made(output, "design"))
        sums = {"recipe": [sha256(path) for path in files], "moments": [sha256(options.moments)]}
        stage = Stage("design", options.chosen(), read_text(recipe), sums)
        parts = Parts(parts_folder(output), key_of(stage))
        with parts.held(options.resume, options.force), workers(options.jobs) as pool:
            arrays = list(_candidates(task, lists, parts, pool, options))
            errors = _judged(task, arrays, parts, pool, console)
            made = designed(task, arrays, errors, options.top)
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
    _, cfa = anneal(task.problem, pattern.shape, task.filters_of(pattern), counts, task.allowed, pattern.steps, rng)
    return {"cfa": cfa}


def _judged(task: Task, arrays: Sequence[Cfa], parts: Parts, pool: WorkerPool, console: Console) -> NDArray[np.float64]:
    """Return the errors (array, level, group)."""
    groups = [list(arrays[start : start + AT_ONCE]) for start in range(0, len(arrays), AT_ONCE)]
    work = functools.partial(_errors, task.recipe, task.moments)
    return np.concatenate([part["errors"] for part in parts.each("arrays", work, groups, pool, console)])


def _errors(recipe: Path, moments: Path, arrays: list[Cfa]) -> dict[str, NDArray]:
    problem = _task(recipe, moments).problem
    return {"errors": np.array([problem.errors(cfa) for cfa in arrays])}


def _tuned(task: Task, asked: OptimiseRecipe, parts: Parts, pool: WorkerPool, options: DesignOptions) -> Tuned:
    """Return the tuned filters of an array, from the start that leads to the least error."""
    work = functools.partial(_descended, task.recipe, task.moments, options.seed)
    ends = list(parts.each("tunings", work, range(asked.starts), pool, options.console))
    scores = np.array([float(end["score"]) for end in ends])
    parameters = ends[int(scores.argmin())]["parameters"]
    curves, cfa = task.tuning.curves_of(parameters), task.numbered(asked.pattern)
    problem = task.problem_of(curves)
    rivals = [problem.errors(each) for each in bayer_arrays(np.unique(cfa).tolist(), task.centres)]
    best = min(rivals, key=problem.score) if rivals else np.zeros_like(problem.share)
    judged = task.problem.errors(cfa), problem.errors(cfa), best
    before, after, bayer = ((each * problem.share).sum(axis=1) for each in judged)
    names = tuple(tuned_filters(asked, task.wanted.filters))
    return Tuned(shown(cfa, task.names), parameters, names, curves, before, after, bayer, np.exp(scores))


def _descended(recipe: Path, moments: Path, seed: int, number: int) -> dict[str, NDArray]:
    """Return the end that a start leads to; the first start is the given filters."""
    tuning = _task(recipe, moments).tuning
    given = tuning.given
    start = given if number == 0 else random_start(given, np.random.default_rng([seed, number]))
    score, parameters = tuning.descend(start)
    return {"score": np.array(score), "parameters": parameters}


def _truth(task: Task, made: Design, parts: Parts, pool: WorkerPool, options: DesignOptions) -> Truth:
    """Return arrays trained and judged: the best ones, Bayer's, the rivals of the recipe and the tuned one."""
    asked, names = task.wanted.truth or TruthRecipe(), task.names
    best = [*made.patterns[: options.truth or asked.arrays], *([made.patterns[made.bayer]] if made.bayer >= 0 else [])]
    tuned = [] if made.tuned is None else [made.tuned.pattern]
    rivals = [shown(task.numbered(rows), names) for rows in asked.rivals]
    wanted = dict.fromkeys((*best, *rivals, *tuned), (task.curves, task.problem))
    if made.tuned is not None:
        curves = made.tuned.tuned_efficiency
        wanted[f"{made.tuned.pattern}{TUNED}"] = curves, task.problem_of(curves)
    pixel = task.pixel
    levels = [(task.scenes.light[level.light].illuminant, level) for level in task.levels]
    trials, expected = [], []
    for text, (curves, problem) in wanted.items():
        cfa = task.numbered(text.removesuffix(TUNED).split(" / "))
        camera = camera_with(pixel, cfa, names, task.scenes.wavelength, curves)
        trials.append(Trial(camera, levels, asked, options.seed))
        expected.append((problem.errors(cfa) * problem.share).sum(axis=1))
    ends = list(parts.each("trainings", trained, trials, pool, options.console))
    digests = {end["digest"].tobytes().hex() for end in ends}
    if len(digests) > 1:
        raise L3Error("the arrays were not judged on the same scenes; report this as a fault of l3")
    figures, crops = (np.array([end[name] for end in ends]) for name in ("figures", "crops"))
    return Truth(tuple(wanted), np.array(expected), FIGURES, figures, crops, ends[0]["ideals"], digests.pop())
