"""l3 train: training sets → transform table, whole or in shards."""

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options
from l3cli.cli.results import Result
from l3cli.errors import shortened

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler
    from l3cli.stages.console import Console


SHARE = options.Number(0, 1e6)


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
    "--shares", callback=_shares, metavar="A,B…", help="Proportion of patches from each training set, not by frames."
)
@options.output("Transform table to write; with --shard the partial sums")
@click.option(
    "--shard",
    callback=options.shard,
    metavar="I/N",
    help="Only compute the partial sums of part I of N, from 1, for --merge.",
)
@click.option("--first", type=options.FILE, metavar="FIRST.h5", help="Table of the pass before, for the shards of the next.")
@click.option("--merge", is_flag=True, help="Make the table of a pass from its partial sums, all of which must be given.")
@options.seed
@options.scheduler
@options.jobs
@options.force
@options.dry_run
@options.quiet
def train(
    files: tuple[Path, ...], classes: Path | None, shares: tuple[Fraction, ...] | None, output: Path,
    shard: tuple[int, int] | None, first: Path | None, merge: bool, seed: int, jobs: int,
    scheduler: "Scheduler | None", force: bool, console: "Console",
) -> Result:  # fmt: skip
    """Learn a table of local linear transforms from one or more training sets.

    \b
    Example: l3 train training.h5 --classes classes.toml -o table.h5

    Patches are spread evenly over all frames. With --shares 1,0.7,0.4 three training sets get patches in that proportion,
    however many frames they have.

    Over several machines, give every shard the same training sets, shares, recipe and seed. Training takes two passes, as
    the errors of the first weigh the rows of the second, so there are four steps; the final table has the same bytes as
    without shards:

    \b
      l3 train training.h5 --shard 1/4 -o a1.h5                    … 4/4
      l3 train --merge a1.h5 a2.h5 a3.h5 a4.h5 -o first.h5
      l3 train training.h5 --shard 1/4 --first first.h5 -o b1.h5   … 4/4
      l3 train --merge b1.h5 b2.h5 b3.h5 b4.h5 -o table.h5

    With first_draws = 0 in the recipe, or outputs other than XYZ and the camera's channels, there is one pass: two steps,
    without --first. Every [[layer]] of the recipe is a pass more, with --first and the table of the pass before. --merge
    says what comes next.
    """
    from l3cli.stages.training.shards import merge_shards, train_shard
    from l3cli.stages.training.whole import filling
    from l3cli.stages.training.whole import train as train_whole

    if merge and (classes or shares or shard or first or seed or scheduler):
        raise click.UsageError("--merge takes shards alone: classes, shares and seed are stored in them")
    if shares and len(shares) != len(files):
        raise click.UsageError(f"--shares gives {len(shares)} shares for {len(files)} training sets")
    if first and not shard:
        raise click.UsageError("--first goes with --shard")
    asked: dict[str, Any] = {"classes": classes, "shares": shares, "seed": seed, "jobs": jobs, "scheduler": scheduler}
    if shard and not merge:
        train_shard(files, shard, output, console, first=first, force=force, **asked)
        return Result({"partial_sums": str(output), "shard": list(shard)})
    if merge:
        table = merge_shards(files, output, console, force=force)
    else:
        table = train_whole(files, output, console, force=force, **asked)
    layers = [{"classes": classes, "without_patches": unfilled} for classes, unfilled in filling(table)]
    lights = [light.name for light in table.lights]
    made = {"table": str(output), "layers": layers, "pass": table.history[-1].options.get("pass")}
    return Result(made | ({"lights": lights} if lights else {}))
