"""The quiet set of a table: the same frames learned once more, for less noise (docs/method.md#noise-sets)."""

from dataclasses import replace

from l3cli.artifacts.quiet_set import QuietSet
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.stages.training.later_layers import learn_refinement_layers
from l3cli.stages.training.passes import Execution, learn_first
from l3cli.stages.training.run import TrainingRun
from l3cli.training.quiet import FilteredCamera, quiet_rule
from l3cli.training.training_pass import FIRST, LAST, TrainingPass, has_two_passes


def learn_quiet(run: TrainingRun, table: TransformTable, execution: Execution) -> TransformTable:
    """The table with the quiet set that the recipe wants, if it does."""
    learning = run.recipe.learning
    if not learning.noise_left:
        return table
    execution.console.info(f"a second set, for {learning.noise_left:g} of the noise over time")
    number = FIRST if has_two_passes(run.head, learning) else LAST
    about = (run.head, run.patches, table.first.rule, learning, table.white_point, run.seed, number, table.exposure)
    pass_ = quiet_pass(run, TrainingPass(*about, table.light))
    filtered = replace(run, head=pass_.head)
    made = learn_refinement_layers(filtered, learn_first(filtered, pass_, execution), execution, like=table)
    return with_quiet(table, learning.noise_left, made)


def quiet_pass(run: TrainingRun, usual: TrainingPass) -> TrainingPass:
    """The pass of the quiet set beside the usual one: for frames of less noise, by lower edges."""
    head = filtered_head(usual.head, run.recipe.learning.noise_left)
    assert isinstance(head.camera, FilteredCamera)
    rule = quiet_rule(usual.rule, run.recipe.classes, head.camera, head.camera.dark_signal(usual.exposure))
    return replace(usual, head=head, rule=rule)


def filtered_head(head: TrainingSet, noise_left: float) -> TrainingSet:
    """Return the common part of training sets as if their frames were of a filtered camera."""
    return replace(head, camera=FilteredCamera.of(head.camera, noise_left))


def quiet_as_table(table: TransformTable) -> TransformTable:
    """The quiet set of a table, which must be there, as a table for the filtered camera."""
    assert table.quiet is not None
    assert table.camera is not None  # tables have had one since there are quiet sets
    camera = FilteredCamera.of(table.camera, table.quiet.noise_left)
    return replace(table, first=table.quiet.first, later=table.quiet.later, camera=camera, quiet=None)


def with_quiet(table: TransformTable, noise_left: float, quiet: TransformTable) -> TransformTable:
    """The table with another one, learned for this share of the noise, as its quiet set."""
    return replace(table, quiet=QuietSet(noise_left, quiet.first, quiet.later))
