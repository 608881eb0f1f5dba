"""Work of the processes of a training run: a pilot of all frames, the sums of a pass, and the transforms."""

import collections
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.classes.rule import left_out
from l3cli.parallel import WorkerPool
from l3cli.recipes.faults import refuse_first
from l3cli.stages.training.run import TrainingRun, TrainingSource, frames_of
from l3cli.system.console import Console
from l3cli.training.accumulate import sum_sites
from l3cli.training.recipe import TrainingRecipe, layer_faults, learning_faults
from l3cli.training.sample_weighting import SampleWeighting, sample_weighting
from l3cli.training.solve import Solution
from l3cli.training.sums import add
from l3cli.training.table import Pilot, assemble, learn_site, pilot_patches, survey, take_pilot
from l3cli.training.training_pass import FIRST, LAST, TrainingPass, WorkShare, frame_blocks, has_two_passes, work_shares

MOST_PILOTED = 256  # frames in one work unit of the pilot


@dataclass(frozen=True)
class Execution:
    """Workers of a run, and the console for its messages."""

    pool: WorkerPool
    remote: bool  # whether workers are on other machines, which must see the same files
    console: Console


def first_pass(run: TrainingRun, execution: Execution) -> TrainingPass:
    """Return the first pass, or the only one, with the class rule from a pilot of all frames."""
    learning = run.recipe.learning
    refuse_first(learning_faults(learning))
    refuse_first(layer_faults(run.recipe.layer))
    for name in left_out(run.recipe.classes, run.head.camera):
        sites = "×".join(map(str, run.head.camera.cfa.shape))
        patch = run.recipe.classes.patch
        execution.console.report(
            f"classes.{name} is left out: an array of {sites} sites leaves no room for it in patches of {patch} pixels"
        )
    patches = pilot_patches(run.patches)
    size = max(1, min(MOST_PILOTED, len(patches) // (4 * execution.pool.size)))
    chunks = (range(first, min(first + size, len(patches))) for first in range(0, len(patches), size))
    about = (run.training, execution.remote, run.head, run.recipe, run.seed)
    units = [PilotUnit(*about, frames, patches[frames.start : frames.stop]) for frames in chunks]
    pilots = execution.console.progress(execution.pool(_pilot, units), len(units), "pilot")
    rule, white, exposure, light = survey(pilots, run.patches, run.head, run.recipe, run.seed)
    kinds = f"({rule.chromas} chromas + {rule.cases - 1} saturation cases)"
    features = "".join(f" × {feature.size} values of {feature.name}" for feature in rule.feature_list)
    classes = f"{rule.levels} levels × {rule.contrasts} contrasts{features} × {kinds}"
    execution.console.info(f"{len(run.patches)} frames, {classes} per site")
    return TrainingPass(run.head, run.patches, rule, learning, white, run.seed, _first_number(run), exposure, light)


def pass_of(run: TrainingRun, table: TransformTable, number: int | None = None) -> TrainingPass:
    """Return the first pass, or pass `number`, with the class rule and white of a table."""
    about = (run.head, run.patches, table.first.rule, run.recipe.learning, table.white_point, run.seed)
    return TrainingPass(*about, number or _first_number(run), table.exposure, table.light)


def _first_number(run: TrainingRun) -> int:
    return FIRST if has_two_passes(run.head, run.recipe.learning) else LAST


@dataclass(frozen=True)
class PilotUnit:
    """Work unit of the pilot: some frames."""

    training: tuple[TrainingSource, ...]
    remote: bool  # as of WorkUnit
    head: TrainingSet
    recipe: TrainingRecipe
    seed: int
    frames: range
    patches: list[int]  # (frame)


def _pilot(unit: PilotUnit) -> Pilot:
    frames = frames_of(unit.training, unit.frames, unit.remote)
    return take_pilot(frames, unit.frames.start, unit.patches, unit.head, unit.recipe, unit.seed)


@dataclass(frozen=True)
class WorkUnit:
    """Work unit of a pass: the sums of some sites over some blocks of frames."""

    training: tuple[TrainingSource, ...]
    remote: bool  # whether a worker on another machine must verify that its files are the same
    pass_: TrainingPass
    share: WorkShare
    weightings: dict[int, SampleWeighting | None]


def summed(
    function: Callable[[WorkUnit], dict[int, Any]], run: TrainingRun, pass_: TrainingPass, first: TransformTable | None,
    blocks: list[range], execution: Execution,
) -> Iterator[tuple[int, Any]]:  # fmt: skip
    """Apply `function` to the work units, and yield its result for each canonical site in order.

    The result is the sums over `blocks`, added up if several units share a site, or what the workers have solved already.
    """
    units = []
    for share in work_shares(pass_, pass_.divisors, blocks, execution.pool.size):
        weightings = {
            site: sample_weighting(first, site, pass_.recipe.error_power) if first is not None else None
            for site in share.sites
        }
        units.append(WorkUnit(run.training, execution.remote, pass_, share, weightings))
    left = collections.Counter(site for unit in units for site in unit.weightings)
    waiting: dict[int, ClassSums] = {}
    for results in execution.console.progress(execution.pool(function, units), len(units), "sums"):
        for site, result in results.items():
            left[site] -= 1
            if site in waiting:
                add(waiting[site], result)
            else:
                waiting[site] = result
            if not left[site]:
                yield site, waiting.pop(site)


def learn_first(run: TrainingRun, pass_: TrainingPass, execution: Execution) -> TransformTable:
    """Return the one-layer table that this pass and the following ones produce."""
    table = None
    for number in range(pass_.number, LAST + 1):
        pass_ = replace(pass_, number=number)
        sums = summed(learn_unit, run, pass_, table, frame_blocks(pass_.patches), execution)
        solutions = {site: learn_site(pass_, [one], site) if isinstance(one, ClassSums) else one for site, one in sums}
        table = assemble(pass_, solutions, run.history_of_pass(number))
    assert table is not None  # there is at least one pass
    return table


def sum_unit(unit: WorkUnit) -> dict[int, ClassSums]:
    """Return the sums of each site of a work unit."""
    training = unit.training
    blocks = ((block[0], sites, frames_of(training, block, unit.remote)) for block, sites in unit.share.blocks)
    return sum_sites(unit.pass_, blocks, unit.weightings)


def learn_unit(unit: WorkUnit) -> dict[int, ClassSums | Solution]:
    """Return solutions for the sites whose sums are complete, which avoids sending them, and sums for the others."""
    results: dict[int, Any] = dict(sum_unit(unit))
    for site in unit.share.whole:
        results[site] = learn_site(unit.pass_, [results[site]], site)
    return results
