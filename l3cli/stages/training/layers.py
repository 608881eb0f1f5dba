"""Layers after the first: what the processes of a training run do for them (docs/method.md#layers)."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.structure_rule import StructureRule
from l3cli.artifacts.table import TransformTable
from l3cli.classes.planes import fixed_point, opponent_basis
from l3cli.errors import RecipeError
from l3cli.stages.training.passes import Execution
from l3cli.stages.training.run import TrainingRun, TrainingSource, frames_of
from l3cli.training.layers.learn import (
    PILOT_MOSAICS,
    LayerPass,
    add_sums,
    learn_layer,
    luminance_noise,
    structure_rule,
    sum_layer,
)
from l3cli.training.layers.rows import LayerSums
from l3cli.training.lesson import spread_patches

UNITS = 8  # a process: more tell progress better, but every one hands on its own sums


def has_later_layers(run: TrainingRun) -> bool:
    """Whether layers follow the first one: they read luminance and chroma, so for XYZ only."""
    return bool(run.recipe.layer) and run.head.outputs == ("X", "Y", "Z")


def learn_later(run: TrainingRun, table: TransformTable, execution: Execution) -> TransformTable:
    """The table with the layers that the recipe wants after the first."""
    if not has_later_layers(run):
        return table
    layer = layer_pass(run, table)
    rule = layer_rule(run, layer, execution)
    kinds = f"({rule.structures} structures + {rule.cases - 1} saturation cases)"
    execution.console.say(f"second layer: {sum(layer.mosaics)} mosaics, {rule.levels} levels × {kinds} a site")
    sums: dict[int, LayerSums] = {}
    for part in summed_layer(run, layer, rule, range(len(run.patches)), execution):
        if sums:
            add_sums(sums, part)
        else:
            sums = part
    return replace(table, later=(learn_layer(layer, rule, sums),), history=run.history())


def layer_pass(run: TrainingRun, table: TransformTable) -> LayerPass:
    """The pass that learns the second layer on a table of one. RecipeError if the recipe wants more."""
    if len(run.recipe.layer) > 1:
        raise RecipeError("layer: one layer after the first can be learned")
    recipe = run.recipe.layer[0]
    frames = [source.frames for source in run.training]
    return LayerPass(
        camera=run.head.camera,
        rule=table.first.rule,
        fixed=fixed_point(table),
        basis=opponent_basis(table.white_point),
        white_point=table.white_point,
        recipe=recipe,
        learning=run.recipe.learning,
        mosaics=spread_patches(recipe.mosaics, frames, run.shares),
        exposure=table.exposure,
        seed=run.seed,
    )


@dataclass(frozen=True)
class LayerUnit:
    """A work unit of a layer's pass: some frames; without a rule it measures the noise that the rule is made from."""

    training: tuple[TrainingSource, ...]
    remote: bool  # as of WorkUnit
    layer: LayerPass
    rule: StructureRule | None
    frames: range


def layer_rule(run: TrainingRun, layer: LayerPass, execution: Execution) -> StructureRule:
    """The layer's class rule, from a pilot over all frames."""
    units = _units(run, layer, None, range(len(run.patches)), execution)
    measured = execution.console.progress(execution.crew(_measure, units), len(units), "pilot")
    return structure_rule(layer, [noise for part in measured for noise in part])


def summed_layer(
    run: TrainingRun, layer: LayerPass, rule: StructureRule, frames: range, execution: Execution
) -> Iterator[dict[int, LayerSums]]:
    """Sums of the canonical sites over parts of `frames`."""
    units = _units(run, layer, rule, frames, execution)
    yield from execution.console.progress(execution.crew(_sum, units), len(units), "second layer")


def _units(
    run: TrainingRun, layer: LayerPass, rule: StructureRule | None, frames: range, execution: Execution
) -> list[LayerUnit]:
    count = min(len(frames), UNITS * execution.crew.size)
    edges = [frames.start + len(frames) * part // count for part in range(count + 1)] if count else []
    about = (run.training, execution.remote, layer, rule)
    return [LayerUnit(*about, range(first, last)) for first, last in itertools.pairwise(edges)]


def _measure(unit: LayerUnit) -> list[NDArray[np.float64]]:
    frames = frames_of(unit.training, unit.frames, unit.remote)
    every = -(-len(unit.layer.mosaics) // PILOT_MOSAICS)
    return luminance_noise(unit.layer, frames, unit.frames.start, every)


def _sum(unit: LayerUnit) -> dict[int, LayerSums]:
    assert unit.rule is not None
    return sum_layer(unit.layer, unit.rule, frames_of(unit.training, unit.frames, unit.remote), unit.frames.start)
