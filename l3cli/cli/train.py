"""l3 train: training sets → transform table."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from l3cli.artifacts.table import ClassRule
    from l3cli.artifacts.training_set import TrainingPair, TrainingSet
    from l3cli.train.recipe import TrainingRecipe
    from l3cli.train.solve import Solution


@click.command()
@click.argument("training", type=options.FILE, nargs=-1, required=True, metavar="TRAINING.h5…")
@click.option("--classes", type=options.FILE, metavar="TOML", help="Class recipe; without it the built-in default.")
@options.output("Transform table to write")
@options.seed
@options.jobs
@options.force
@options.quiet
def train(
    training: tuple[Path, ...], classes: Path | None, output: Path, seed: int, jobs: int, force: bool, quiet: bool
) -> None:
    """Learn a table of local linear transforms from one or more training sets.

    Example: l3 train training.h5 --classes configs/classes/default.toml -o table.h5
    """
    from l3cli.artifacts.base import Stage, save
    from l3cli.config import load_recipe, read_text
    from l3cli.files import refuse_existing, sha256
    from l3cli.parallel import ordered_map
    from l3cli.train.recipe import TrainingRecipe
    from l3cli.train.table import assemble, canonical_sites, mean_white, training_rule

    refuse_existing(output, force)
    recipe = load_recipe(classes, TrainingRecipe) if classes else TrainingRecipe()
    head, total = _common_head(training)
    rule = training_rule(_frames(training), total, head, recipe, seed)
    sites = canonical_sites(head, rule)
    options.say(
        f"{total} frames, {len(sites)} of {head.camera.cfa.size} sites to train, "
        f"{rule.levels} levels × {rule.contrasts} contrasts × "
        f"({rule.chromas} chromas + {rule.cases - 1} saturation cases)",
        quiet,
    )
    white_point = mean_white(_frames(training))
    work = [SiteWork(training, total, head, rule, site, recipe, white_point, seed) for site in sites]
    results = options.progress(ordered_map(_train_site, work, jobs), len(sites), "sites", quiet)
    solutions = dict(zip(sites, results, strict=True))
    inputs = {"training set": [sha256(path) for path in training]}
    stage = Stage("train", {"seed": seed}, read_text(classes) if classes else "", inputs)
    table = assemble(head, rule, solutions, recipe, white_point, (*head.history, stage))
    save(table, output)
    filled = int((table.samples == 0).sum())
    options.say(f"{output}: {len(table.weights)} classes, {filled} of them filled from their neighbours", quiet)


@dataclass(frozen=True)
class SiteWork:
    """All that a worker needs to train one canonical site."""

    training: tuple[Path, ...]
    total: int
    head: "TrainingSet"
    rule: "ClassRule"
    site: int
    recipe: "TrainingRecipe"
    white_point: "NDArray[np.float64]"
    seed: int


def _train_site(work: SiteWork) -> "Solution":
    from l3cli.train.table import train_site

    def read_frames() -> Iterator["TrainingPair"]:
        return _frames(work.training)

    return train_site(read_frames, work.total, work.head, work.rule, work.site, work.recipe, work.white_point, work.seed)


def _frames(training: tuple[Path, ...]) -> Iterator["TrainingPair"]:
    from l3cli.artifacts.training_set import open_training_set

    for path in training:
        with open_training_set(path) as reader:
            yield from reader


def _common_head(training: tuple[Path, ...]) -> tuple["TrainingSet", int]:
    """The head that all sets share and the number of their frames; InputFileError if they are of different cameras."""
    from l3cli.artifacts.base import equal
    from l3cli.artifacts.training_set import open_training_set
    from l3cli.errors import InputFileError

    total, head = 0, None
    for path in training:
        with open_training_set(path) as reader:
            total += len(reader)
            if head is None:
                head = reader.head
            elif not equal(head, reader.head):
                raise InputFileError(f"{path} and {training[0]} have different cameras or targets; train them apart")
    assert head is not None  # click asks for at least one file
    return head, total
