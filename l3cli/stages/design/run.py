"""The stage of a design: moments of scenes × library of filters → arrays by their predicted error."""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import Design, Truth, Tuned, shown
from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import save
from l3cli.design.error import Cfa, clips_everything
from l3cli.design.pixel import pixel_camera
from l3cli.design.ranking import designed
from l3cli.design.recipe import OptimiseRecipe, curve_files
from l3cli.design.search import canonical
from l3cli.design.task import Task
from l3cli.errors import L3Error, RecipeError, listed
from l3cli.frames.frame import least_period
from l3cli.options.commands import DesignOptions
from l3cli.parallel import WorkerPool, workers
from l3cli.recipes.toml import read_text
from l3cli.stages.design.parts import Parts
from l3cli.stages.design.truth import FIGURES, Trial, trained
from l3cli.stages.simulation.units import key_of
from l3cli.system.checkpoint import parts_folder
from l3cli.system.files import sha256
from l3cli.system.output_guard import OutputGuard
from l3cli.system.plan import Made, before_work

AT_ONCE = 64  # arrays that a process judges in a go
RUNS, STARTS = 2, 4  # of annealing, from random arrays; of tuning, the first of them from the given filters
TUNED = " (tuned)"  # behind the name of an array with tuned filters


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
        files = [*pixel_camera(recipe)[1], *curve_files(task.wanted, recipe.parent)]
        guard.protect(*files)
        task.require_same_pixel()
        seen, noise = task.problem.seen, task.problem.noise
        if wrong := [each.name for each in task.levels if clips_everything(seen[each.light], each, noise)]:
            raise RecipeError(f"{listed(wrong)}: every filter clips in every part of the scenes; expose less")
        lists = [task.arrays_of(pattern, number) for number, pattern in enumerate(task.wanted.pattern)]
        before_work({"recipe": files, "moments": [options.moments]}, Made(output, "design"))
        sums = {"recipe": [sha256(path) for path in files], "moments": [sha256(options.moments)]}
        stage = Stage("design", options.chosen(), read_text(recipe), sums)
        parts = Parts(parts_folder(output), key_of(stage))
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
        console.info(f"{output}: {made.tried} arrays, {len(made.filters)} filters, {len(made.levels)} levels")
        return made


@dataclasses.dataclass(frozen=True)
class _Run:
    """The steps of a design, whose parts are stored as they are finished."""

    task: Task
    parts: Parts
    pool: WorkerPool
    options: DesignOptions

    def _each(self, what: str, work: Any, items: Sequence[Any]) -> Iterator[dict[str, NDArray]]:
        return self.parts.each(what, work, items, self.pool, self.options.console)

    def candidates(self, lists: Sequence[list[Cfa] | None]) -> Iterator[Cfa]:
        """Yield every array that is judged, Bayer's of the library among them, each once."""
        runs = [(number, run) for number, arrays in enumerate(lists) if arrays is None for run in range(RUNS)]
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
        """Return the errors (array, level, group)."""
        groups = [arrays[start : start + AT_ONCE] for start in range(0, len(arrays), AT_ONCE)]
        return np.concatenate([part["errors"] for part in self._each("arrays", self.task.judged, groups)])

    def tuned(self, asked: OptimiseRecipe) -> Tuned:
        """Return the tuned filters of an array, from the start that leads to the least error."""
        task = self.task
        ends = list(self._each("tunings", functools.partial(task.descended, self.options.seed), range(STARTS)))
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
        """Return arrays trained and judged: the best ones, Bayer's, the rivals of the recipe and the tuned one."""
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
            raise L3Error("the arrays were not judged on the same scenes; report this as a fault of l3")
        figures, crops = (np.array([end[name] for end in ends]) for name in ("figures", "crops"))
        figures = figures.mean(axis=2)  # over scenes
        return Truth(tuple(wanted), np.array(expected), FIGURES, figures, crops, ends[0]["ideals"], digests.pop())
