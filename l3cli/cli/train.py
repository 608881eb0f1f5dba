"""l3 train: training sets → transform table, whole or in shards."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options
from l3cli.errors import shortened

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable
    from l3cli.cli.passes import Course, Work
    from l3cli.parallel.cluster import Scheduler


SHARD = options.Number(0, 1_000_000, "shards", whole=True)
SHARE = options.Number(0, 1e6)


def _shard(context: Any, parameter: Any, text: str | None) -> tuple[int, int] | None:
    """Reads "I/N" with 1 ≤ I ≤ N."""
    if text is None:
        return None
    first, found, second = text.partition("/")
    if not found:
        raise click.BadParameter(f'"{shortened(text)}" is not I/N, such as 1/4')
    try:
        index, count = int(SHARD.read(first)), int(SHARD.read(second))
    except click.BadParameter as error:
        raise click.BadParameter(f'"{shortened(text)}" is not I/N, such as 1/4: {error.message}') from None
    if not 1 <= index <= count:
        raise click.BadParameter(f"{text}: shards count from 1/{max(count, 1)} to {max(count, 1)}/{max(count, 1)}")
    return index, count


def _shares(context: Any, parameter: Any, text: str | None) -> tuple[Fraction, ...] | None:
    """Reads "1,0.7,0.4": numbers that are not all zero."""
    if text is None:
        return None
    try:
        shares = tuple(Fraction(SHARE.read(part)).limit_denominator(10**12) for part in text.split(","))
    except click.BadParameter as error:
        raise click.BadParameter(f"{error.message}, in a list such as 1,0.7,0.4") from None
    if not any(shares):
        raise click.BadParameter(f"{shortened(text)}: one share must be above zero")
    return shares


@click.command()
@click.argument("files", type=options.FILE, nargs=-1, required=True, metavar="TRAINING.h5…")
@click.option(
    "--classes", type=options.RecipeFile("classes"), metavar="TOML",
    help="Class recipe or its name, such as best; without it the built-in default.",
)  # fmt: skip
@click.option(
    "--shares", callback=_shares, metavar="A,B…", help="Patches of each training set in this proportion, not by frames."
)
@options.output("Transform table to write; with --shard the partial sums")
@click.option("--shard", callback=_shard, metavar="I/N", help="Only sum up part I of N, from 1, to be merged later.")
@click.option("--first", type=options.FILE, metavar="FIRST.h5", help="First-pass table, for the shards of the last pass.")
@click.option("--merge", is_flag=True, help="The files are all shards of a pass: make its table from them.")
@options.seed
@options.scheduler
@options.jobs
@options.force
@options.quiet
def train(
    files: tuple[Path, ...], classes: Path | None, shares: tuple[Fraction, ...] | None, output: Path,
    shard: tuple[int, int] | None, first: Path | None, merge: bool, seed: int, jobs: int,
    scheduler: "Scheduler | None", force: bool, quiet: bool,
) -> None:  # fmt: skip
    """Learn a table of local linear transforms from one or more training sets.

    \b
    Example: l3 train training.h5 --classes classes.toml -o table.h5

    Patches are spread evenly over all frames. With --shares 1,0.7,0.4 three training sets get patches in that proportion,
    however many frames they have.

    Over several machines, give every shard the same training sets, shares, recipe and seed. Training takes two passes, the
    errors of the first weigh the rows of the last, so there are four steps; the last table has the same bytes as without
    shards:

    \b
      l3 train training.h5 --shard 1/4 -o a1.h5                    … 4/4
      l3 train --merge a1.h5 a2.h5 a3.h5 a4.h5 -o first.h5
      l3 train training.h5 --shard 1/4 --first first.h5 -o b1.h5   … 4/4
      l3 train --merge b1.h5 b2.h5 b3.h5 b4.h5 -o table.h5

    With first_draws = 0 in the recipe, or other outputs than XYZ, there is one pass: two steps, without --first.
    """
    from l3cli.errors import RecipeError
    from l3cli.parallel import one_blas_thread, workers

    one_blas_thread()
    from l3cli.cli.passes import Work, open_course

    if merge and (classes or shares or shard or first or seed or scheduler):
        raise click.UsageError("--merge takes shards alone: classes, shares and seed are told by them")
    if shares and len(shares) != len(files):
        raise click.UsageError(f"--shares gives {len(shares)} shares for {len(files)} training sets")
    if first and not shard:
        raise click.UsageError("--first goes with --shard")
    options.spare(*files, *filter(None, [classes, first]))
    options.claim_file(output, force)
    if merge:
        merge_shards(files, output, quiet)
        return
    if scheduler:
        files = tuple(path.absolute() for path in files)  # for workers elsewhere
    course = open_course(files, classes, shares, seed)
    try:
        with workers(jobs, scheduler) as crew:  # they start while the first reads
            work = Work(crew, elsewhere=scheduler is not None, quiet=quiet)
            if shard:
                train_shard(course, shard, first, output, work)
            else:
                train_whole(course, output, work)
    except RecipeError as error:
        raise RecipeError(f"{classes or 'the built-in class recipe'}: {error}") from error


def train_whole(course: "Course", output: Path, work: "Work") -> None:
    """Both passes and the table."""
    from l3cli.artifacts.partial_sums import ClassSums
    from l3cli.artifacts.store import save
    from l3cli.cli.passes import first_lesson, learn_part, summed
    from l3cli.train.division import frame_blocks
    from l3cli.train.lesson import LAST
    from l3cli.train.table import assemble, learn_site

    lesson, table = first_lesson(course, work), None
    for number in range(lesson.number, LAST + 1):
        lesson = replace(lesson, number=number)
        found = summed(learn_part, course, lesson, table, frame_blocks(lesson), work)
        solutions = {site: learn_site(lesson, [one], site) if isinstance(one, ClassSums) else one for site, one in found}
        table = assemble(lesson, solutions, course.history(number))
    assert table is not None  # there is at least one pass
    save(table, output)
    _say_table(table, output, work.quiet)


def train_shard(course: "Course", shard: tuple[int, int], first: Path | None, output: Path, work: "Work") -> None:
    """One shard's sums of the first pass or, with `first`, of the last."""
    import numpy as np

    from l3cli.artifacts.partial_sums import PartialSums, write_partial_sums
    from l3cli.artifacts.store import load
    from l3cli.artifacts.table import TransformTable
    from l3cli.cli.passes import first_lesson, sum_part, summed
    from l3cli.errors import InputFileError
    from l3cli.train.division import frame_blocks
    from l3cli.train.lesson import FIRST, LAST, Lesson
    from l3cli.train.sums import empty_sums
    from l3cli.train.table import add_up, canonical_sites

    table = load(TransformTable, first) if first else None
    if table is None:
        lesson = first_lesson(course, work)
    elif table.history == course.history(FIRST):
        about = (course.head, course.patches, table.rule, course.recipe.learning, table.white_point, course.seed)
        lesson = Lesson(*about, LAST, table.exposure)
    else:
        raise InputFileError(
            f"{first} is not the first pass of this run: other training sets, shares, recipe or seed; "
            'make it with "l3 train --merge" of the first pass\'s shards'
        )
    index, count = shard
    blocks = frame_blocks(lesson)[index - 1 :: count]
    sites = canonical_sites(course.head, lesson.rule, lesson.recipe)
    sums = summed(sum_part, course, lesson, table, blocks, work)
    if not blocks:  # more shards than blocks
        sums = ((site, empty_sums(lesson.rule, len(course.head.outputs))) for site in sites)
    head = PartialSums(
        history=course.history(lesson.number),
        shard=index,
        shards=count,
        pass_number=lesson.number,
        patches=np.array(course.patches),
        training=course.head,
        rule=lesson.rule,
        white_point=lesson.white_point,
        sites=np.array(sites),
        exposure=lesson.exposure,
    )
    write_partial_sums(output, head, (add_up(lesson, [own]) for _, own in sums))
    options.say(f"{output}: shard {index} of {count}, {'first' if lesson.number == FIRST else 'last'} pass", work.quiet)


def merge_shards(shards: tuple[Path, ...], output: Path, quiet: bool) -> None:
    """The table of all shards of a pass; InputFileError if some are missing, doubled or of another run."""
    import contextlib

    from l3cli.artifacts.partial_sums import open_partial_sums
    from l3cli.artifacts.schema import Stage
    from l3cli.artifacts.store import save
    from l3cli.config import parse_recipe
    from l3cli.errors import InputFileError
    from l3cli.train.lesson import FIRST, Lesson
    from l3cli.train.recipe import TrainingRecipe
    from l3cli.train.table import assemble, canonical_sites, learn_site

    with contextlib.ExitStack() as stack:
        readers = [stack.enter_context(open_partial_sums(path)) for path in shards]
        _require_all_shards(shards, [reader.head for reader in readers])
        head = readers[0].head
        stage = head.history[-1] if head.history else Stage("", {})
        if type(stage.options.get("seed")) is not int:
            raise InputFileError(f"{shards[0]} does not tell the run it is a shard of; make it again")
        recipe = parse_recipe(stage.recipe, TrainingRecipe, str(shards[0])).learning
        about = (
            head.training,
            tuple(head.patches.tolist()),
            head.rule,
            recipe,
            head.white_point,
            stage.options["seed"],
            head.pass_number,
            head.exposure,
        )
        lesson = Lesson(*about)
        if head.sites.tolist() != canonical_sites(head.training, head.rule, recipe):
            raise InputFileError(f"{shards[0]} holds sums of other sites than its camera has; make it again")
        solutions = {
            int(site): learn_site(lesson, (reader.site(index) for reader in readers), int(site))
            for index, site in enumerate(head.sites)
        }
    table = assemble(lesson, solutions, head.history)
    save(table, output)
    _say_table(table, output, quiet)
    if lesson.number == FIRST:
        options.say(f"this is the first pass: go on with --shard I/N --first {output}", quiet)


def _require_all_shards(paths: tuple[Path, ...], heads: list) -> None:
    from l3cli.artifacts.schema import equal
    from l3cli.errors import InputFileError

    seen: dict[int, Path] = {}
    for path, head in zip(paths, heads, strict=True):
        same = replace(head, shard=heads[0].shard)
        if head.history != heads[0].history or not equal(same, heads[0]):
            raise InputFileError(f"{path} and {paths[0]} are of different runs or passes; merge the shards of one")
        if head.shard in seen:
            raise InputFileError(f"{path} and {seen[head.shard]} are the same shard, {head.shard} of {head.shards}")
        seen[head.shard] = path
    missing = [f"{index}/{heads[0].shards}" for index in range(1, heads[0].shards + 1) if index not in seen]
    if missing:
        named = ", ".join(missing[:8]) + (" …" if len(missing) > 8 else "")
        raise InputFileError(f"shards are missing: {named}; make them with l3 train --shard")


def _say_table(table: "TransformTable", output: Path, quiet: bool) -> None:
    filled = int((table.samples == 0).sum())
    options.say(f"{output}: {len(table.weights)} classes, {filled} of them without patches of their own", quiet)
