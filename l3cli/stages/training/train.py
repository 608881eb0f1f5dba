"""The `l3 train` stage, which trains a transform table.

A table is trained in one run, or in shards. The partial sums of all shards are then merged.
"""

import contextlib
import itertools
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from l3cli.artifacts.layers import PlaneRule, rule_fields
from l3cli.artifacts.partial_sums import (
    ClassSums,
    Head,
    PartialLayerSums,
    PartialSums,
    PartialSumsReader,
    open_partial_sums,
    write_partial_sums,
)
from l3cli.artifacts.schema import Stage, equal
from l3cli.artifacts.store import load, save
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, RecipeError, raised_as
from l3cli.options.commands import ShardOptions, TrainOptions
from l3cli.parallel import workers
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.load import parse_recipe
from l3cli.stages.training.conditions import learn_conditions, runs_by_light
from l3cli.stages.training.passes import Execution, first_pass, learn_first, pass_of, sum_unit, summed
from l3cli.stages.training.refinement_layers import (
    layer_mosaics,
    layer_rule,
    learn_refinement_layers,
    summed_layer,
    warn_of_left_out_layers,
)
from l3cli.stages.training.run import FIRST_PASS, LAYERS, TrainingRun, cached_for_a_run, open_run
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed, files_to_read
from l3cli.system.outputs import OutputGuard
from l3cli.training.layers.learn import LayerPass, add_sums, no_sums
from l3cli.training.recipe import TrainingRecipe, draft_of, layer_faults, require_one_go
from l3cli.training.sums import empty_sums
from l3cli.training.table import add_up, assemble, by_noise, finished_layer, layer_pass, learn_site, passes_of, with_noises
from l3cli.training.training_pass import FIRST, LAST, TrainingPass, frame_blocks


def train(training: tuple[Path, ...], output: Path, options: TrainOptions) -> tuple[TransformTable, FilesUsed]:
    """Train a transform table, and write it to a file.

    Parameters
    ----------
    training : tuple of Path
        Training sets.
    output : Path
        Table to write.
    options : TrainOptions
        Options of `l3 train`.

    Returns
    -------
    TransformTable
        The table.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError, RecipeError
        If a training set or the class recipe is unsuitable.
    L3Error
        If the output cannot be written.
    """
    with execution_of(training, output, options) as (run, execution, used):
        table = _learn(run, execution)
        save(table, output)
    report_table(table, output, options.console)
    return table, used.and_wrote(output)


@contextlib.contextmanager
def execution_of(
    training: tuple[Path, ...], output: Path, options: TrainOptions
) -> Iterator[tuple[TrainingRun, Execution, FilesUsed]]:
    """Open a training run, start its workers and lock the output, for a `with` block.

    The name of the class recipe is added to the message of a RecipeError in the block.

    Yields
    ------
    TrainingRun
        The run.
    Execution
        The workers and the console of the run.
    FilesUsed
        The files that the run reads.
    """
    classes, scheduler = options.classes, options.cluster()
    with OutputGuard(options.console) as guard:
        guard.protect(*training, *itertools.chain(*options.inputs().values()))
        guard.guard_file(output, options.force)
        if scheduler:
            training = tuple(path.absolute() for path in training)  # workers may have a different working directory
        run = open_run(training, options)
        runs_by_light(run)  # raises an error before any work if learning.lights does not match the training sets
        used = files_to_read({"training sets": training, **options.inputs(all=False)})
        blamed = raised_as(RecipeError, classes or "the built-in class recipe", RecipeError)
        with blamed, workers(options.jobs, scheduler) as pool, cached_for_a_run():
            yield run, Execution(pool, scheduler is not None, options.console), used


def _learn(run: TrainingRun, execution: Execution) -> TransformTable:
    """Train all layers of a table, for all illuminants and noise conditions."""
    table = learn_first(run, first_pass(run, execution), execution)
    table = learn_refinement_layers(run, table, execution)
    return learn_conditions(run, table, execution)


def report_table(table: TransformTable, output: Path, console: Console) -> None:
    """Print each layer's number of classes and number of classes without training patches."""
    for number, (classes, unfilled) in enumerate(filling(table), start=1):
        which = f", layer {number}" if table.later else ""
        console.info(f"{output}{which}: {classes} classes, {unfilled} of them without training patches")


def filling(table: TransformTable) -> list[tuple[int, int]]:
    """Return each layer's number of classes and number of classes without training patches."""
    return [(len(layer.weights), int((layer.samples == 0).sum())) for layer in table.layers]


PASS_NAMES = {FIRST_PASS: "first pass"} | dict(zip(LAYERS, LAYERS, strict=True))  # names of intermediate tables in messages


def train_shard(training: tuple[Path, ...], shard: tuple[int, int], output: Path, options: ShardOptions) -> FilesUsed:
    """Compute the partial sums of one shard, and write them to a file.

    Parameters
    ----------
    training : tuple of Path
        Training sets.
    shard : tuple of int
        Number of the shard, counted from 1, and number of shards.
    output : Path
        File of partial sums to write.
    options : ShardOptions
        Options of `l3 train`. The option `first` is the table of the previous pass. Without `first`, the sums of the first
        pass are computed.

    Returns
    -------
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError
        If a training set is unsuitable, or if the table of the previous pass belongs to another run.
    RecipeError
        If the class recipe is unsuitable.
    L3Error
        If the output cannot be written.
    """
    first = options.first
    with execution_of(training, output, options) as (run, execution, used):
        require_one_go(run.recipe.learning)
        table = load(TransformTable, first) if first else None
        warn_of_left_out_layers(run, options.console)
        if table and run.has_refinement_layers and _is_of(run, table, LAYERS[len(table.later)]):
            refuse_first(layer_faults(run.recipe.layer))
            write_layer_shard(run, shard, table, output, execution)
        else:
            pass_ = _last_pass(run, table, first) if table else first_pass(run, execution)
            _write_shard(run, shard, pass_, table, output, execution)
    return used.and_wrote(output)


def _write_shard(
    run: TrainingRun, shard: tuple[int, int], pass_: TrainingPass, table: TransformTable | None, output: Path,
    execution: Execution,
) -> None:  # fmt: skip
    index, count = shard
    sites = list(pass_.divisors)
    passes = passes_of(pass_, run.given)
    tables = by_noise(table) if table else [None for _ in passes]
    sets = [_sums(run, *each, shard, execution) for each in zip(passes, tables, strict=True)]
    head = PartialSums(
        history=run.history_of_pass(pass_.number),
        shard=index,
        shards=count,
        pass_number=pass_.number,
        patches=np.array(run.patches),
        training=run.head,
        rule=pass_.rule,
        white_point=pass_.white_point,
        sites=np.array(sites),
        exposure=pass_.exposure,
        light=pass_.light,
    )
    write_partial_sums(output, head, *sets)
    last = "layer 1" if run.has_refinement_layers else "last pass"
    what = "first pass" if pass_.number == FIRST else last
    execution.console.info(f"{output}: shard {index} of {count}, {what}")


def _sums(
    run: TrainingRun, pass_: TrainingPass, table: TransformTable | None, shard: tuple[int, int], execution: Execution
) -> Iterator[ClassSums]:
    """Yield the normal equations for each group of symmetric CFA sites, summed over the frames of a shard.

    The sums are zero if the shard has no frames.
    """
    index, count = shard
    blocks = frame_blocks(pass_.patches)[index - 1 :: count]
    sums = summed(sum_unit, run, pass_, table, blocks, execution)
    if not blocks:  # there are more shards than blocks, so this shard has no frames
        sums = ((site, empty_sums(pass_.rule, len(run.head.outputs), run.head.camera)) for site in pass_.divisors)
    return (add_up(pass_, [site_sums]) for _, site_sums in sums)


def _is_of(run: TrainingRun, table: TransformTable, pass_: str) -> bool:
    """Return whether a table is the result of the pass `pass_` of this run."""
    noises = tuple(each.noise for each in table.conditions)
    return table.history == run.history(pass_) and noises == run.recipe.learning.noises


def _last_pass(run: TrainingRun, table: TransformTable, path: Path | None) -> TrainingPass:
    """Return the settings of the second pass, based on the result of the first pass in `table`.

    Raises
    ------
    InputFileError
        If the table belongs to another run.
    """
    if not _is_of(run, table, FIRST_PASS):
        layers = "".join(f" or {layer}" for layer in LAYERS[: len(run.recipe.layer)]) if run.has_refinement_layers else ""
        raise InputFileError(
            f"{path} is not the table of the first pass{layers} of this run, because its training sets, shares, recipe "
            "or seed are different; set ‹first› to the table that ‹merge› wrote for the shards of the previous pass"
        )
    return pass_of(run, table, LAST)


def merge_shards(shards: tuple[Path, ...], output: Path, options: ShardOptions) -> tuple[TransformTable, FilesUsed]:
    """Merge the partial sums of all shards in a pass, and write the resulting table.

    Unless this is the last pass of the training, l3 prints the command for the next pass.

    Parameters
    ----------
    shards : tuple of Path
        Files of partial sums.
    output : Path
        Table to write.
    options : ShardOptions
        Options of `l3 train`.

    Returns
    -------
    TransformTable
        The table.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError
        If a shard is missing, occurs twice or belongs to another run.
    """
    console = options.console
    with OutputGuard(console) as guard:
        guard.protect(*shards)
        guard.guard_file(output, options.force)
        used = files_to_read({"partial sums": shards})
        table = _merged(shards)
        save(table, output)
        report_table(table, output, console)
        if made := table.history[-1].options.get("pass"):
            console.info(
                f"{output} is the table of the {PASS_NAMES[str(made)]}; continue training with ‹shard› I/N ‹first› {output}"
            )
        return table, used.and_wrote(output)


def _merged(shards: tuple[Path, ...]) -> TransformTable:
    with contextlib.ExitStack() as stack:
        readers = [stack.enter_context(open_partial_sums(path)) for path in shards]
        _require_all_shards(shards, [reader.head for reader in readers])
        head = readers[0].head
        recipe, seed = _recipe_and_seed(readers[0], shards[0])
        if isinstance(head, PartialLayerSums):
            return merged_layer(readers, recipe, seed, shards[0])
        return _merged_pass(readers, recipe, seed, shards[0])


def _merged_pass(readers: list[PartialSumsReader], recipe: TrainingRecipe, seed: int, path: Path) -> TransformTable:
    head: PartialSums = readers[0].head
    about = (head.training, tuple(head.patches.tolist()), head.rule, recipe.learning, head.white_point)
    pass_ = TrainingPass(*about, seed, head.pass_number, head.exposure, head.light)
    if head.sites.tolist() != list(pass_.divisors):
        raise InputFileError(
            f"{path} contains training data for CFA sites that its camera does not have; train this shard again"
        )
    usual, *others = (_learned(each, readers, number) for number, each in enumerate(passes_of(pass_, recipe)))
    return with_noises(usual, others, recipe.learning.noises)


def _learned(pass_: TrainingPass, readers: list[PartialSumsReader], condition: int) -> TransformTable:
    head: PartialSums = readers[0].head
    solutions = {
        int(site): learn_site(pass_, (reader.site(index, condition) for reader in readers), int(site))
        for index, site in enumerate(head.sites)
    }
    return assemble(pass_, solutions, head.history)


def _recipe_and_seed(reader: PartialSumsReader, path: Path) -> tuple[TrainingRecipe, int]:
    """Read the class recipe and the seed of a training run from the history of its partial sums.

    Raises
    ------
    InputFileError
        If the history contains no seed, or if the recipe does not match the sums.
    """
    head = reader.head
    stage = head.history[-1] if head.history else Stage("", {})
    seed = stage.options.get("seed")
    recipe = parse_recipe(stage.recipe, TrainingRecipe, str(path))
    recipe = draft_of(recipe) if stage.options.get("draft") else recipe
    is_of_recipe = len(recipe.learning.noises) == reader.conditions
    if type(seed) is not int or not is_of_recipe or (isinstance(head, PartialLayerSums) and not recipe.layer):
        raise InputFileError(f"{path} does not contain the recipe and seed of its training run; train this shard again")
    return recipe, seed


def _require_all_shards(paths: tuple[Path, ...], heads: list[Head]) -> None:
    seen: dict[int, Path] = {}
    for path, head in zip(paths, heads, strict=True):
        same = replace(head, shard=heads[0].shard)
        if head.history != heads[0].history or type(head) is not type(heads[0]) or not equal(same, heads[0]):
            raise InputFileError(
                f"{path} and {paths[0]} belong to different runs or passes; merge only shards of the same run and pass"
            )
        if head.shard in seen:
            raise InputFileError(
                f"{path} and {seen[head.shard]} are the same shard, {head.shard} of {head.shards}; use each shard once"
            )
        seen[head.shard] = path
    missing = [f"{index}/{heads[0].shards}" for index in range(1, heads[0].shards + 1) if index not in seen]
    if missing:
        named = ", ".join(missing[:8]) + (" …" if len(missing) > 8 else "")
        are = "are" if len(missing) > 1 else "is"
        raise InputFileError(
            f"{paths[0]} is one of {heads[0].shards} shards, but ‹shard› {named} {are} missing; merge the files of all "
            "shards"
        )


def write_layer_shard(
    run: TrainingRun, shard: tuple[int, int], table: TransformTable, output: Path, execution: Execution
) -> None:
    """Compute the partial sums of one shard for the next refinement layer, and write them to a file.

    Parameters
    ----------
    run : TrainingRun
        The run.
    shard : tuple of int
        Number of the shard, counted from 1, and number of shards.
    table : TransformTable
        Table with all previous layers.
    output : Path
        File of partial sums to write.
    execution : Execution
        The workers.
    """
    layer = _layer(table, run)
    rule = layer_rule(run, layer, execution)
    index, count = shard
    layers = [_layer(each, run) for each in by_noise(table)]
    rules = [rule, *(layer_rule(run, each, execution, like=rule) for each in layers[1:])]
    sets = [
        summed_layer(run, each, rule, each.blocks[index - 1 :: count], execution)
        for each, rule in zip(layers, rules, strict=True)
    ]
    head = PartialLayerSums(
        history=run.history_of_layers(layer.number),
        shard=index,
        shards=count,
        mosaics=np.array(layer.mosaics),
        side=layer.recipe.side,
        ratio_taps=layer.recipe.ratio_taps,
        **rule_fields(rule),
        gradients=tuple(each.scale for each in rules[1:]),
        table=table,
        sites=np.array(list(sets[0])),
    )
    write_partial_sums(output, head, *(sums.values() for sums in sets))
    execution.console.info(f"{output}: shard {index} of {count}, layer {layer.number}")


def _layer(table: TransformTable, run: TrainingRun) -> LayerPass:
    return layer_pass(table, run.given, layer_mosaics(run, len(table.later)), run.seed)


def merged_layer(readers: list[PartialSumsReader], recipe: TrainingRecipe, seed: int, path: Path) -> TransformTable:
    """Solve the next refinement layer from the partial sums of all shards, and add it to the table.

    Parameters
    ----------
    readers : list of PartialSumsReader
        The partial sums of each shard.
    recipe : TrainingRecipe
        Class recipe of the run.
    seed : int
        Seed of the run.
    path : Path
        File of the first shard, for error messages.

    Raises
    ------
    InputFileError
        If the sums do not match the recipe.
    """
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
    if (layer.recipe.side, layer.recipe.ratio_taps, list(sums)) != (head.side, head.ratio_taps, head.sites.tolist()):
        raise InputFileError(
            f"{path} contains training data for CFA sites or window sizes that do not match its camera and class recipe; "
            "train this shard again"
        )
    for index, site in enumerate(sums):
        for reader in readers:
            add_sums({site: sums[site]}, {site: reader.site(index, condition)})
    return replace(table, later=(*table.later, finished_layer(layer, rule, sums, table)), history=head.history)
