"""l3 evaluate: a table's quality on frames with known targets."""

from pathlib import Path

import click
from click.core import ParameterSource

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.options.pipeline import SequenceOptions


@click.command()
@click.argument("table", type=declared.FILE, required=False, metavar="TABLE.h5")
@click.argument("frames", type=declared.FILE, required=False, metavar="TRAINING.h5")
@declared.of(SequenceOptions, declared.dry_run)
def evaluate(table: Path | None, frames: Path | None, options: SequenceOptions) -> Result:
    """Render the raw frames of a training set that TABLE was not trained on and compare them with their targets.

    Pictures are compared as displayed: adapted to D65, the 99th percentile of the target's luminance shown as white.
    Baselines are a basic pipeline that is not learned (interpolation, white balance, colour matrix) and, for a Bayer
    array if colour-demosaicing is installed, Malvar's and Menon's demosaicking with the same matrix.

    Bands of the camera are compared as spectra (angle), linear values, and 8-bit codes of which white is 255. Baselines
    are bilinear interpolation, Malvar and Menon for Bayer, spectral differences (sd) and the pseudo-panchromatic image
    difference (ppid) for arrays in which every band occurs once a period.

    With --rival: pictures of another pipeline beside them, under the name of their folder. Their brightness does not
    matter: one factor a picture is fitted.

    With --sequence: noise and flicker of CIE L* over time on patches that stand still, the largest jump of a frame's
    mean, and beside ideal pictures PSNR, ΔE00 and how the error changes along the known motion.

    \b
    Example: l3 evaluate table.h5 unseen.h5 --json
    """
    if options.sequence is not None:
        return _sequence(options.sequence, table, options)
    if table is None or frames is None or options.ideal is not None:
        raise click.UsageError("give TABLE.h5 and TRAINING.h5, or --sequence PICTURES with or without --ideal")
    from l3cli.cli.quality_tables import print_tables
    from l3cli.stages.evaluation import evaluate as stage

    document = stage(table, frames, options)
    return Result(document, lambda: print_tables(document))


def _sequence(sequence: Path, table: Path | None, options: SequenceOptions) -> Result:
    if table is not None or options.pictures is not None or options.rivals:
        raise click.UsageError("--sequence judges pictures; leave TABLE.h5, TRAINING.h5, --pictures and --rival out")
    for name in ("backend", "viewing", "force"):
        if click.get_current_context().get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise click.UsageError(f"--{name} is for a table; leave it out with --sequence")
    from l3cli.cli.quality_tables import print_sequence
    from l3cli.stages.evaluation import evaluate_sequence

    figures = evaluate_sequence(sequence, options)
    return Result(figures.document(), lambda: print_sequence(figures))
