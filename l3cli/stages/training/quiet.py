"""The quiet set of a table: the same frames learned once more, for less noise (docs/method.md#noise-sets)."""

from dataclasses import replace

from l3cli.artifacts.quiet_set import QuietSet
from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError
from l3cli.stages.training.later_layers import learn_later
from l3cli.stages.training.passes import Execution, learn_first
from l3cli.stages.training.run import TrainingRun
from l3cli.training.quiet import FilteredCamera, quiet_rule
from l3cli.training.training_pass import FIRST, LAST, TrainingPass, has_two_passes


def learn_quiet(run: TrainingRun, table: TransformTable, execution: Execution) -> TransformTable:
    """The table with the quiet set that the recipe wants, if it does."""
    learning = run.recipe.learning
    if not learning.noise_left:
        return table
    execution.console.say(f"a second set, for {learning.noise_left:g} of the noise over time")
    camera = FilteredCamera.of(run.head.camera, learning.noise_left)
    filtered = replace(run, head=replace(run.head, camera=camera))
    rule = quiet_rule(table.first.rule, run.recipe.classes, camera, camera.dark_signal(table.exposure))
    number = FIRST if has_two_passes(run.head, learning) else LAST
    about = (filtered.head, run.patches, rule, learning, table.white_point, run.seed, number, table.exposure, table.light)
    made = learn_later(filtered, learn_first(filtered, TrainingPass(*about), execution), execution, like=table)
    return replace(table, quiet=QuietSet(learning.noise_left, made.first, made.later))


def require_whole(run: TrainingRun) -> None:
    """RecipeError if a shard of the run is asked for and a quiet set is wanted, too."""
    if run.recipe.learning.noise_left:
        raise RecipeError(
            "learning.noise_left: a second set is learned in one go, not in shards; train without ‹shard›, on several "
            "machines with ‹scheduler›"
        )
