"""l3 train: trains a transform table on training sets, on one machine or in shards on several machines."""

from pathlib import Path

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.options.commands import ShardOptions


@click.command()
@click.argument("files", type=declared.FILE, nargs=-1, required=True, metavar="TRAINING.h5…")
@declared.output("Transform table to write, or partial sums to write with --shard")
@declared.of(ShardOptions)
def train(files: tuple[Path, ...], output: Path, options: ShardOptions) -> Result:
    """Train a transform table on one or more training sets.

    \b
    Example: l3 train training.h5 --classes classes.toml -o table.h5

    Training patches are drawn evenly from all frames. With --shares 1,0.7,0.4, patches are drawn from three training sets in
    these proportions, regardless of how many frames each set contains.

    To train on several machines, divide the work into shards. All shards need the same training sets, shares, recipe and
    seed. Training consists of two passes, because the errors of the first pass determine the weights in the second pass.
    Four steps are therefore needed. The final table is identical to a table that is trained without shards:

    \b
      l3 train training.h5 --shard 1/4 -o a1.h5                    … 4/4
      l3 train --merge a1.h5 a2.h5 a3.h5 a4.h5 -o first.h5
      l3 train training.h5 --shard 1/4 --first first.h5 -o b1.h5   … 4/4
      l3 train --merge b1.h5 b2.h5 b3.h5 b4.h5 -o table.h5

    If the recipe contains first_draws = 0, or if the outputs are neither XYZ nor a spectrum, there is only one pass, and
    only the first two steps are needed. Every [[layer]] of the recipe adds a pass, with --first and the table from the
    previous pass. --merge prints the next step.
    """
    from l3cli.stages.training.train import filling, merge_shards, train_shard
    from l3cli.stages.training.train import train as train_whole

    chosen = options.chosen() != ShardOptions().chosen() or options.inputs() or options.shard or options.scheduler
    if options.merge and chosen:
        raise click.UsageError("--merge reads classes, shares and seed from the shards; remove these options")
    if options.first and not options.shard:
        raise click.UsageError("--first works only with --shard; add --shard I/N")
    if options.shard:
        used = train_shard(files, options.shard, output, options)
        return Result({"partial_sums": str(output), "shard": list(options.shard)}, files=used)
    table, used = (merge_shards if options.merge else train_whole)(files, output, options)
    layers = [{"classes": classes, "without_patches": unfilled} for classes, unfilled in filling(table)]
    lights = [light.name for light in table.lights]
    made = {"table": str(output), "layers": layers, "pass": table.history[-1].options.get("pass")}
    return Result(made | ({"lights": lights} if lights else {}), files=used)
