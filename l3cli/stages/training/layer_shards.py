"""Shards of the pass that learns a layer after the first: its partial sums, merged into the table."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from l3cli.artifacts.partial_sums import PartialLayerSums, PartialSumsReader, write_partial_sums
from l3cli.artifacts.table import PlaneRule, TransformTable, rule_fields
from l3cli.errors import InputFileError
from l3cli.stages.training.conditions import by_noise, with_noises
from l3cli.stages.training.passes import Execution
from l3cli.stages.training.refinement_layers import layer_mosaics, layer_pass, layer_rule, summed_layer
from l3cli.stages.training.run import TrainingRun
from l3cli.training.layers.learn import add_sums, learn_layer, no_sums
from l3cli.training.recipe import TrainingRecipe


def write_layer_shard(
    run: TrainingRun, shard: tuple[int, int], table: TransformTable, output: Path, execution: Execution
) -> None:
    """Write what a shard (number from 1, of how many) sums up for the layer on `table`."""
    mosaics = layer_mosaics(run, len(table.later))
    layer = layer_pass(table, run.recipe, mosaics, run.seed)
    rule = layer_rule(run, layer, execution)
    index, count = shard
    blocks = layer.blocks[index - 1 :: count]
    layers = [layer_pass(each, run.recipe, mosaics, run.seed) for each in by_noise(table)]
    rules = [rule, *(layer_rule(run, each, execution, like=rule) for each in layers[1:])]
    sets = [summed_layer(run, each, rule, blocks, execution) for each, rule in zip(layers, rules, strict=True)]
    head = PartialLayerSums(
        history=run.history_of_layers(layer.number),
        shard=index,
        shards=count,
        mosaics=np.array(mosaics),
        side=layer.recipe.side,
        ratio_taps=layer.ratio_taps,
        **rule_fields(rule),
        gradients=tuple(each.scale for each in rules[1:]),
        table=table,
        sites=np.array(list(sets[0])),
    )
    write_partial_sums(output, head, *(sums.values() for sums in sets))
    execution.console.info(f"{output}: shard {index} of {count}, layer {layer.number}")


def merged_layer(readers: list[PartialSumsReader], recipe: TrainingRecipe, seed: int, path: Path) -> TransformTable:
    """The table with the layer that all shards of its pass give; InputFileError, which names `path`, if they do not fit
    their recipe."""
    head: PartialLayerSums = readers[0].head
    rules: list[PlaneRule] = [head.rule, *(head.rule.scaled_as(scale) for scale in head.gradients)]
    tables = enumerate(zip(by_noise(head.table), rules, strict=True))
    usual, *others = (_with_layer(*each, readers, number, recipe, seed, path) for number, each in tables)
    return with_noises(usual, others, recipe.learning.noises)


def _with_layer(
    table: TransformTable, rule: PlaneRule, readers: list[PartialSumsReader], condition: int, recipe: TrainingRecipe,
    seed: int, path: Path,
) -> TransformTable:  # fmt: skip
    head: PartialLayerSums = readers[0].head
    layer = layer_pass(table, recipe, tuple(head.mosaics.tolist()), seed)
    sums = no_sums(layer, rule)
    if (layer.recipe.side, layer.ratio_taps, list(sums)) != (head.side, head.ratio_taps, head.sites.tolist()):
        raise InputFileError(f"{path} holds sums of other windows or sites than its recipe and camera have; make it again")
    for index, site in enumerate(sums):
        for reader in readers:
            add_sums({site: sums[site]}, {site: reader.site(index, condition)})
    return replace(table, later=(*table.later, learn_layer(layer, rule, sums)), history=head.history)
