"""Shards of the pass that learns a layer after the first: its partial sums, merged into the table."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from l3cli.artifacts.layers import PlaneRule, rule_fields
from l3cli.artifacts.partial_sums import QUIET, USUAL, PartialLayerSums, PartialSumsReader, write_partial_sums
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError
from l3cli.stages.training.later_layers import layer_mosaics, layer_pass, layer_rule, parts_of, summed_layer
from l3cli.stages.training.passes import Execution
from l3cli.stages.training.quiet import quiet_as_table, with_quiet
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
    sets, quiet_fields = [summed_layer(run, layer, rule, frames, execution)], {}
    if table.quiet:
        layer_of_quiet = layer_pass(quiet_as_table(table), run.recipe, mosaics, run.seed)
        quiet_rule = layer_rule(run, layer_of_quiet, execution, like=rule)
        quiet_fields = {f"quiet_{name}": each for name, each in rule_fields(quiet_rule).items()}
        sets.append(summed_layer(run, layer_of_quiet, quiet_rule, frames, execution))
    head = PartialLayerSums(
        history=run.history_of_layers(layer.number),
        shard=index,
        shards=count,
        mosaics=np.array(mosaics),
        side=layer.recipe.side,
        ratio_taps=layer.ratio_taps,
        **rule_fields(rule),
        **quiet_fields,
        table=table,
        sites=np.array(list(sets[0])),
    )
    write_partial_sums(output, head, *(sums.values() for sums in sets))
    execution.console.info(f"{output}: shard {index} of {count}, layer {layer.number}")


def merged_layer(readers: list[PartialSumsReader], recipe: TrainingRecipe, seed: int, path: Path) -> TransformTable:
    """The table with the layer that all shards of its pass give; InputFileError, which names `path`, if they do not fit
    their recipe."""
    head: PartialLayerSums = readers[0].head
    usual = replace(head.table, quiet=None)
    table = _with_layer(usual, head.rule, readers, USUAL, recipe, seed, path)
    if head.table.quiet is None or head.quiet_rule is None:
        return table
    quiet = _with_layer(quiet_as_table(head.table), head.quiet_rule, readers, QUIET, recipe, seed, path)
    return with_quiet(table, head.table.quiet.noise_left, quiet)


def _with_layer(
    table: TransformTable, rule: PlaneRule, readers: list[PartialSumsReader], of_set: str, recipe: TrainingRecipe, seed: int,
    path: Path,
) -> TransformTable:  # fmt: skip
    head: PartialLayerSums = readers[0].head
    layer = layer_pass(table, recipe, tuple(head.mosaics.tolist()), seed)
    sums = no_sums(layer, rule)
    if (layer.recipe.side, layer.ratio_taps, list(sums)) != (head.side, head.ratio_taps, head.sites.tolist()):
        raise InputFileError(f"{path} holds sums of other windows or sites than its recipe and camera have; make it again")
    for index, site in enumerate(sums):
        for reader in readers:
            add_sums({site: sums[site]}, {site: reader.site(index, of_set)})
    return replace(table, later=(*table.later, learn_layer(layer, rule, sums)), history=head.history)
