"""Train refinement layers (docs/method.md#layers), with the work divided among processes."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PlaneRule
from l3cli.artifacts.partial_sums import LayerSums
from l3cli.artifacts.plane_rules import GradientScale
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingPair
from l3cli.parallel.threads import threaded
from l3cli.stages.training.passes import Execution
from l3cli.stages.training.run import TrainingRun, TrainingSource, frames_of
from l3cli.system.console import Console
from l3cli.training.layers import rules
from l3cli.training.layers.learn import LayerPass, add_sums, no_sums, sum_layer
from l3cli.training.sums import same_shapes
from l3cli.training.table import finished_layer, layer_pass
from l3cli.training.training_pass import spread_patches

# With more units, progress would be shown in smaller steps, but training would take longer, because every unit returns sums.
UNITS_PER_PROCESS = 8


def learn_refinement_layers(
    run: TrainingRun, table: TransformTable, execution: Execution, like: TransformTable | None = None
) -> TransformTable:
    """Train the refinement layers in the recipe, and add them to the table.

    Parameters
    ----------
    run : TrainingRun
        The run.
    table : TransformTable
        Table with the first layer.
    execution : Execution
        The workers.
    like : TransformTable, optional
        Table with class rules to reuse. By default, class rules are determined from the frames.
    """
    if not run.has_refinement_layers:
        if like is None:
            warn_of_left_out_layers(run, execution.console)
        return table
    if like is not None:
        table = replace(table, components=like.components)
    while len(table.later) < len(run.recipe.layer):
        layer = layer_pass(table, run.given, layer_mosaics(run, len(table.later)), run.seed)
        rule = layer_rule(run, layer, execution, like.later[len(table.later)].rule if like else None)
        sums = summed_layer(run, layer, rule, layer.blocks, execution)
        table = replace(table, later=(*table.later, finished_layer(layer, rule, sums, table)), history=run.history())
    return table


def warn_of_left_out_layers(run: TrainingRun, console: Console) -> None:
    """Report refinement layers in the recipe that are not trained, because they do not apply to the outputs."""
    if run.recipe.layer and not run.has_refinement_layers:
        outputs = ", ".join(run.head.outputs)
        console.report(
            f"the refinement layers of the recipe are skipped, because they do not apply to the outputs {outputs}; a table "
            "with three outputs can have refinement layers if the second output is the luminance, a spectral table can have "
            "one layer without coarse_chroma and leaves, and a table with colours and Stokes parameters can have one layer "
            "without leaves"
        )


def layer_mosaics(run: TrainingRun, number: int) -> tuple[int, ...]:
    """Return each frame's number of training mosaics for the refinement layer `number`, counted from 0."""
    return spread_patches(run.recipe.layer[number].mosaics, [source.frames for source in run.training], run.shares)


@dataclass(frozen=True)
class LayerUnit:
    """Several blocks of frames, which one worker processes when a refinement layer is trained."""

    training: tuple[TrainingSource, ...]
    remote: bool  # whether the process runs on another machine, where it must check that its files have the same bytes
    layer: LayerPass
    known: GradientScale | PlaneRule | None  # part of the class rule that is already known
    blocks: list[range]  # ranges of frames


def layer_rule(run: TrainingRun, layer: LayerPass, execution: Execution, like: PlaneRule | None = None) -> PlaneRule:
    """Determine the class rule of a refinement layer. A pilot pass over all frames measures what the rule depends on.

    Parameters
    ----------
    like : PlaneRule, optional
        Class rule of the same layer for the camera's own noise. If it is set, its classes are used, and the pilot pass only
        adapts the gradient scale to the noise of `layer.camera`. No pilot pass is needed if this noise is the camera's own
        noise. [default: a new class rule]
    """
    if like is not None and (layer.camera.gain, layer.camera.noise_left) == (run.head.camera.gain, 1):
        return like
    units = _units(run, layer, None, layer.blocks, execution)
    measured = execution.console.progress(
        execution.pool(_measure, units, _is_measured), len(units), f"layer {layer.number}, pilot"
    )
    scale = rules.gradient_scale(layer, [noise for part in measured for noise in part])
    if like is not None:
        return like.scaled_as(scale)
    if not layer.recipe.leaves:
        rule: PlaneRule = rules.structure_rule(layer, scale)
        classes = f"{rule.levels} levels × ({rule.structures} structures + {rule.cases - 1} saturation cases)"
    else:
        units = _units(run, layer, scale, layer.blocks, execution)
        sampled = execution.console.progress(
            execution.pool(_sample, units, _are_samples), len(units), f"layer {layer.number}, tree"
        )
        samples = [sample for part in sampled for sample in part]
        with threaded(execution.pool.size) as mapped:  # as many threads as processes, which are idle now
            rule = rules.tree_rule(layer, scale, samples, mapped)
        classes = f"{rule.structures} leaves (tree depth {rule.depth}) + {rule.cases - 1} saturation cases"
    execution.console.info(f"layer {layer.number}: {sum(layer.mosaics)} mosaics, classes per site: {classes}")
    return rule


def summed_layer(
    run: TrainingRun, layer: LayerPass, rule: PlaneRule, blocks: list[range], execution: Execution
) -> dict[int, LayerSums]:
    """Sum the normal equations of a refinement layer over blocks of frames, for each group of symmetric CFA sites."""
    sums = no_sums(layer, rule)
    units = _units(run, layer, rule, blocks, execution)
    for part in execution.console.progress(execution.pool(_sum, units, _are_sums), len(units), f"layer {layer.number}"):
        add_sums(sums, part)
    return sums


def _units(
    run: TrainingRun, layer: LayerPass, known: GradientScale | PlaneRule | None, blocks: list[range], execution: Execution
) -> list[LayerUnit]:
    about = (run.training, execution.remote, layer, known)
    count = min(len(blocks), UNITS_PER_PROCESS * execution.pool.size)
    edges = [len(blocks) * part // count for part in range(count + 1)] if count else []
    return [LayerUnit(*about, blocks[first:last]) for first, last in itertools.pairwise(edges)]


def _read(unit: LayerUnit) -> Iterator[tuple[int, Iterator[TrainingPair]]]:
    """Yield the index of the first frame and an iterator over all frames, for each block of a unit."""
    return ((block.start, frames_of(unit.training, block, unit.remote)) for block in unit.blocks)


def _measure(unit: LayerUnit) -> list[NDArray[np.float64]]:
    every = -(-len(unit.layer.mosaics) // rules.PILOT_MOSAICS)
    return [noise for first, frames in _read(unit) for noise in rules.luminance_noise(unit.layer, frames, first, every)]


def _sample(unit: LayerUnit) -> list[dict[int, rules.TreeSamples]]:
    assert isinstance(unit.known, GradientScale)
    known = unit.known
    return [sample for first, frames in _read(unit) for sample in rules.sample_tree(unit.layer, known, frames, first)]


def _sum(unit: LayerUnit) -> dict[int, LayerSums]:
    assert isinstance(unit.known, PlaneRule)
    return sum_layer(unit.layer, unit.known, _read(unit))


def _is_measured(unit: LayerUnit, measured: list[NDArray[np.float64]]) -> bool:
    """Return whether the arrays in a result from another machine have the shapes that `_measure` returns."""
    return all((noise.dtype, noise.shape) == (np.float64, (2, unit.layer.rule.levels)) for noise in measured)


def _are_samples(unit: LayerUnit, sampled: list[dict[int, rules.TreeSamples]]) -> bool:
    """Return whether the arrays in a result from another machine have the shapes that `_sample` returns."""
    frames = sum(map(len, unit.blocks))
    return len(sampled) == frames and all(rules.are_samples(unit.layer, samples) for samples in sampled)


def _are_sums(unit: LayerUnit, sums: dict[int, LayerSums]) -> bool:
    """Return whether the arrays in a result from another machine have the shapes that `_sum` returns."""
    assert isinstance(unit.known, PlaneRule)
    empty = no_sums(unit.layer, unit.known)
    return set(sums) == set(empty) and all(same_shapes(sums[site], empty[site]) for site in empty)
