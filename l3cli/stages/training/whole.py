"""Training in one go: both passes and the table."""

import contextlib
import itertools
from collections.abc import Iterator
from pathlib import Path

from l3cli.artifacts.store import save
from l3cli.artifacts.table import TransformTable
from l3cli.errors import RecipeError
from l3cli.options.commands import TrainOptions
from l3cli.parallel import workers
from l3cli.stages.training.conditions import learn_conditions, runs_by_light
from l3cli.stages.training.passes import Execution, first_pass, learn_first
from l3cli.stages.training.refinement_layers import learn_refinement_layers
from l3cli.stages.training.run import TrainingRun, cached_for_a_run, open_run
from l3cli.system.console import Console
from l3cli.system.output_guard import OutputGuard
from l3cli.system.plan import Made, before_work
from l3cli.training.recipe import beyond_black_level


def train(training: tuple[Path, ...], output: Path, options: TrainOptions) -> TransformTable:
    """Learn a transform table from training sets and write it. InputFileError or RecipeError if sets or recipe cannot be
    used, L3Error if the output cannot be written."""
    with execution_of(training, output, options, "transform table") as (run, execution):
        table = _learn(run, execution)
        save(table, output)
    report_table(table, output, options.console)
    return table


@contextlib.contextmanager
def execution_of(
    training: tuple[Path, ...], output: Path, options: TrainOptions, what: str
) -> Iterator[tuple[TrainingRun, Execution]]:
    """Yield the run of these training sets, and who does its work, while the output is claimed for `what` is made; errors
    in the recipe name its file."""
    classes, scheduler = options.classes, options.cluster()
    with OutputGuard(options.console) as guard:
        guard.protect(*training, *itertools.chain(*options.inputs().values()))
        guard.guard_file(output, options.force)
        if scheduler:
            training = tuple(path.absolute() for path in training)  # for workers elsewhere
        run = open_run(training, options)
        runs_by_light(run)  # refused before any work
        for text in beyond_black_level(run.recipe.learning, run.head.camera):
            options.console.warn(text)
        frames = sum(source.frames for source in run.training)
        made = Made(output, f"{what} of {sum(run.patches)} patches in {frames} frames")
        before_work({"training sets": training, "class recipe": [classes] if classes else []}, made)
        try:
            with workers(options.jobs, scheduler) as pool, cached_for_a_run():  # workers start while the first reads
                yield run, Execution(pool, scheduler is not None, options.console)
        except RecipeError as error:
            raise RecipeError(f"{classes or 'the built-in class recipe'}: {error}") from error


def _learn(run: TrainingRun, execution: Execution) -> TransformTable:
    """Return all passes of all layers, for all conditions."""
    table = learn_first(run, first_pass(run, execution), execution)
    table = learn_refinement_layers(run, table, execution)
    return learn_conditions(run, table, execution)


def report_table(table: TransformTable, output: Path, console: Console) -> None:
    """Report what has been learned, in a line."""
    for number, (classes, unfilled) in enumerate(filling(table), start=1):
        which = f", layer {number}" if table.later else ""
        console.info(f"{output}{which}: {classes} classes, {unfilled} of them without patches of their own")


def filling(table: TransformTable) -> list[tuple[int, int]]:
    """Return the number of classes of each layer, and of those without patches of their own."""
    return [(len(layer.weights), int((layer.samples == 0).sum())) for layer in table.layers]
