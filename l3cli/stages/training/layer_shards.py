"""Shards of the pass that learns a layer after the first: its partial sums, merged into the table."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from l3cli.artifacts.layer_sums import PartialLayerSums
from l3cli.artifacts.layers import rule_fields
from l3cli.artifacts.partial_sums import PartialSumsReader, write_partial_sums
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError
from l3cli.stages.training.later_layers import layer_mosaics, layer_pass, layer_rule, parts_of, summed_layer
from l3cli.stages.training.passes import Execution
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
    frames = list(parts_of(range(len(mosaics)), count))[index - 1]
    sums = summed_layer(run, layer, rule, frames, execution)
    head = PartialLayerSums(
        history=run.history_of_layers(layer.number),
        shard=index,
        shards=count,
        mosaics=np.array(mosaics),
        side=layer.recipe.side,
        ratio_taps=layer.ratio_taps,
        **rule_fields(rule),
        table=table,
        sites=np.array(list(sums)),
    )
    write_partial_sums(output, head, sums.values())
    execution.console.say(f"{output}: shard {index} of {count}, layer {layer.number}")


def merged_layer(readers: list[PartialSumsReader], recipe: TrainingRecipe, seed: int, path: Path) -> TransformTable:
    """The table with the layer that all shards of its pass give; InputFileError, which names `path`, if they do not fit
    their recipe."""
    head: PartialLayerSums = readers[0].head
    layer = layer_pass(head.table, recipe, tuple(head.mosaics.tolist()), seed)
    sums = no_sums(layer, head.rule)
    if (layer.recipe.side, layer.ratio_taps, list(sums)) != (head.side, head.ratio_taps, head.sites.tolist()):
        raise InputFileError(f"{path} holds sums of other windows or sites than its recipe and camera have; make it again")
    for index, site in enumerate(sums):
        for reader in readers:
            add_sums({site: sums[site]}, {site: reader.site(index)})
    return replace(head.table, later=(*head.table.later, learn_layer(layer, head.rule, sums)), history=head.history)
