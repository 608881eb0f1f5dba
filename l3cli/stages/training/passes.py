"""First-layer training: passes over all frames, and the work of each process in a pass.

A pilot first examines a few patches of each frame to determine the class rule. Each pass then sums normal equations over
patches and solves them for the transforms of the first layer.
"""

import collections
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from l3cli.artifacts.partial_sums import ClassSums
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.classes.rule import left_out
from l3cli.parallel import WorkerPool
from l3cli.physics.spectra import light_grid
from l3cli.recipes.faults import refuse_first
from l3cli.stages.training.run import TrainingRun, TrainingSource, frames_of
from l3cli.system.console import Console
from l3cli.system.text import counted
from l3cli.training.accumulate import sum_sites
from l3cli.training.recipe import TrainingRecipe, layer_faults, learning_faults
from l3cli.training.sample_weighting import SampleWeighting, sample_weighting
from l3cli.training.solve import Solution
from l3cli.training.sums import add, empty_sums, same_shapes
from l3cli.training.table import Pilot, assemble, learn_site, pilot_patches, survey, take_pilot
from l3cli.training.training_pass import FIRST, LAST, TrainingPass, WorkShare, frame_blocks, has_two_passes, work_shares

MAX_PILOT_FRAMES = 256  # maximum number of frames in a work unit of the pilot


@dataclass(frozen=True)
class Execution:
    """The workers of a training run, and the console for its messages."""

    pool: WorkerPool
    remote: bool  # whether the workers are on other machines, which must have access to the same files
    console: Console


def first_pass(run: TrainingRun, execution: Execution) -> TrainingPass:
    """Determine the settings of a run's first pass.

    A pilot examines a few patches of each frame and determines the class rule. The number of classes is printed on the
    console, as well as class features that are omitted because the patches are too small for them.

    Raises
    ------
    RecipeError
        If the class recipe has faults.
    """
    learning = run.recipe.learning
    refuse_first(learning_faults(learning))
    refuse_first(layer_faults(run.recipe.layer))
    for name in left_out(run.recipe.classes, run.head.camera):
        sites = "×".join(map(str, run.head.camera.cfa.shape))
        patch = run.recipe.classes.patch
        execution.console.report(
            f"the class feature {name} is not used, because patches of {patch}×{patch} pixels are too small for this "
            f"feature with a CFA of {sites} sites; set a larger classes.patch to use the feature"
        )
    patches = pilot_patches(run.patches)
    size = max(1, min(MAX_PILOT_FRAMES, len(patches) // (4 * execution.pool.size)))
    chunks = (range(first, min(first + size, len(patches))) for first in range(0, len(patches), size))
    about = (run.training, execution.remote, run.head, run.recipe, run.seed)
    units = [PilotUnit(*about, frames, patches[frames.start : frames.stop]) for frames in chunks]
    pilots = execution.console.progress(execution.pool(_pilot, units, _is_pilot_of), len(units), "pilot")
    rule, white, exposure, light = survey(pilots, run.patches, run.head, run.recipe, run.seed)
    kinds = f"({counted(rule.chromas, 'chroma')} + {counted(rule.cases - 1, 'saturation case')})"
    features = "".join(f" × {feature.size} values of {feature.name}" for feature in rule.feature_list)
    classes = f"{counted(rule.levels, 'level')} × {counted(rule.contrasts, 'contrast')}{features} × {kinds}"
    execution.console.info(f"{len(run.patches)} frames, classes per site: {classes}")
    return TrainingPass(run.head, run.patches, rule, learning, white, run.seed, _first_number(run), exposure, light)


def pass_of(run: TrainingRun, table: TransformTable, number: int | None = None) -> TrainingPass:
    """Return the settings of pass `number`, by default the first, with the class rule and the white of a table."""
    about = (run.head, run.patches, table.first.rule, run.recipe.learning, table.white_point, run.seed)
    return TrainingPass(*about, number or _first_number(run), table.exposure, table.light)


def _first_number(run: TrainingRun) -> int:
    return FIRST if has_two_passes(run.head, run.recipe.learning) else LAST


@dataclass(frozen=True)
class PilotUnit:
    """A range of frames, of which one worker examines a few patches in the pilot (see the module docstring)."""

    training: tuple[TrainingSource, ...]
    remote: bool  # whether the worker is on another machine and must verify the bytes of its files
    head: TrainingSet
    recipe: TrainingRecipe
    seed: int
    frames: range
    patches: list[int]  # number of patches for each frame


def _pilot(unit: PilotUnit) -> Pilot:
    frames = frames_of(unit.training, unit.frames, unit.remote)
    return take_pilot(frames, unit.frames.start, unit.patches, unit.head, unit.recipe, unit.seed)


def _is_pilot_of(unit: PilotUnit, pilot: Pilot) -> bool:
    """Return whether a result from another machine is a Pilot with arrays of the required types and shapes."""
    channels, frames = len(unit.head.camera.channels), len(unit.frames)
    measured = (pilot.shares, pilot.whites, pilot.lights, pilot.exposures, *pilot.observed.values())
    return (
        isinstance(pilot, Pilot)
        and (pilot.occurrences.dtype, pilot.occurrences.shape) == (np.int64, (2**channels,))
        and all(isinstance(values, np.ndarray) and values.dtype.kind == "f" for values in measured)
        and pilot.shares.shape[1:] == (channels,)
        and pilot.whites.shape == (frames, len(unit.head.outputs))
        and pilot.lights.shape == (frames, light_grid(unit.head.camera.wavelength).size)
        and pilot.exposures.shape == (frames,)
    )


@dataclass(frozen=True)
class WorkUnit:
    """Blocks of frames and CFA sites, for which one worker sums normal equations in a training pass."""

    training: tuple[TrainingSource, ...]
    remote: bool  # whether the worker is on another machine and must verify the bytes of its files
    pass_: TrainingPass
    share: WorkShare
    weightings: dict[int, SampleWeighting | None]


def summed(
    function: Callable[[WorkUnit], dict[int, Any]], run: TrainingRun, pass_: TrainingPass, first: TransformTable | None,
    blocks: list[range], execution: Execution,
) -> Iterator[tuple[int, Any]]:  # fmt: skip
    """Apply `function` to the work units of a pass, and yield the result for each canonical site.

    A canonical site represents all CFA sites that are symmetric to it. If several work units share a site, their sums are
    added.

    Parameters
    ----------
    function : callable
        `sum_unit` or `learn_unit`.
    run : TrainingRun
        The run.
    pass_ : TrainingPass
        The pass.
    first : TransformTable or None
        Table of the previous pass, which determines the weights of the samples.
    blocks : list of range
        Blocks of frames.
    execution : Execution
        The workers.

    Yields
    ------
    (int, ClassSums or Solution)
        Canonical site, and its sums over `blocks`. With `learn_unit`, the solution is returned instead if one worker has all
        sums of the site.
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
    for results in execution.console.progress(execution.pool(function, units, _are_results_of), len(units), "sums"):
        for site, result in results.items():
            left[site] -= 1
            if site in waiting:
                add(waiting[site], result)
            else:
                waiting[site] = result
            if not left[site]:
                yield site, waiting.pop(site)


def _are_results_of(unit: WorkUnit, results: dict[int, ClassSums | Solution]) -> bool:
    """Return whether results from another machine are valid for a work unit.

    They must contain sums or a solution for exactly the sites of the unit, with arrays of the expected shapes.
    """
    outputs = len(unit.pass_.head.outputs)
    empty = empty_sums(unit.pass_.rule, outputs, unit.pass_.head.camera)

    def fits(site: int, result: ClassSums | Solution) -> bool:
        if isinstance(result, ClassSums):
            return same_shapes(result, empty)
        shape = (empty.count.size, unit.pass_.rule.patch**2 + 1, outputs)
        return site in unit.share.whole and isinstance(result, Solution) and result.taps.shape == shape

    return set(results) == set(unit.share.sites) and all(itertools.starmap(fits, results.items()))


def learn_first(run: TrainingRun, pass_: TrainingPass, execution: Execution) -> TransformTable:
    """Train the first layer, beginning with the pass `pass_`, and return a table with this layer."""
    table = None
    for number in range(pass_.number, LAST + 1):
        pass_ = replace(pass_, number=number)
        sums = summed(learn_unit, run, pass_, table, frame_blocks(pass_.patches), execution)
        solutions = {site: learn_site(pass_, [one], site) if isinstance(one, ClassSums) else one for site, one in sums}
        table = assemble(pass_, solutions, run.history_of_pass(number))
    assert table is not None  # there is at least one pass
    return table


def sum_unit(unit: WorkUnit) -> dict[int, ClassSums]:
    """Sum the normal equations of a work unit, and return the sums of each site."""
    training = unit.training
    blocks = ((block[0], sites, frames_of(training, block, unit.remote)) for block, sites in unit.share.blocks)
    return sum_sites(unit.pass_, blocks, unit.weightings)


def learn_unit(unit: WorkUnit) -> dict[int, ClassSums | Solution]:
    """Sum the normal equations of a work unit, and solve them for each site with complete sums.

    A solution is much smaller than the sums, so that less data is sent to the main process. All other sites return their
    sums.
    """
    results: dict[int, Any] = dict(sum_unit(unit))
    for site in unit.share.whole:
        results[site] = learn_site(unit.pass_, [results[site]], site)
    return results
