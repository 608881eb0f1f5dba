"""l3 evaluate: a table's quality on frames with known targets."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from l3cli.cli import options
from l3cli.cli.results import Result

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("table", type=options.FILE, required=False, metavar="TABLE.h5")
@click.argument("frames", type=options.FILE, required=False, metavar="TRAINING.h5")
@click.option(
    "--sequence", type=options.FILE, metavar="PICTURES",
    help="Instead of a table: rendered pictures (folder, pattern, glob, video) to be judged over time.",
)  # fmt: skip
@click.option(
    "--ideal", type=options.FILE, metavar="PICTURES",
    help="What the sequence should be, such as the folder of l3 simulate --pictures.",
)  # fmt: skip
@options.backend
@click.option(
    "--viewing",
    type=options.Number(2, 1000, "samples/degree"),
    default=50.0,
    show_default=True,
    metavar="2…1000",
    help="Samples a degree of visual angle, for S-CIELAB.",
)
@click.option(
    "--border",
    type=options.Number(0, 1000, "pixels", whole=True),
    metavar="0…1000",
    help="Pixels left out at each edge of a frame; without it those whose patch is not inside the frame.",
)
@click.option(
    "--pictures",
    type=options.FILE,
    metavar="DIR",
    help="Write the table's, ideal and basic picture and an error map (black: ΔE00 0, white: 10) of every frame as PNG.",
)
@click.option(
    "--rival", "rivals", type=options.FILE, metavar="PICTURES", multiple=True,
    help="sRGB pictures of the frames by another pipeline (folder, pattern, glob), in their order.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Write pictures into a folder that is not empty.")
@options.dry_run
@options.quiet
def evaluate(
    table: Path | None,
    frames: Path | None,
    sequence: Path | None,
    ideal: Path | None,
    backend: str,
    viewing: float,
    border: int | None,
    pictures: Path | None,
    rivals: tuple[Path, ...],
    force: bool,
    console: "Console",
) -> Result:
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
    if sequence is not None:
        if table is not None or pictures is not None or rivals:
            raise click.UsageError("--sequence judges pictures; leave TABLE.h5, TRAINING.h5, --pictures and --rival out")
        for name in ("backend", "viewing", "force"):
            if click.get_current_context().get_parameter_source(name) is not ParameterSource.DEFAULT:
                raise click.UsageError(f"--{name} is for a table; leave it out with --sequence")
        return _evaluate_sequence(sequence, ideal, border, console)
    if table is None or frames is None or ideal is not None:
        raise click.UsageError("give TABLE.h5 and TRAINING.h5, or --sequence PICTURES with or without --ideal")
    from l3cli.stages.evaluation import evaluate as stage

    document = stage(
        table,
        frames,
        console,
        backend=backend,
        viewing=viewing,
        border=border,
        pictures=pictures,
        rivals=rivals,
        force=force,
    )
    from l3cli.cli.quality_tables import print_tables

    return Result(document, lambda: print_tables(document))


def _evaluate_sequence(sequence: Path, ideal: Path | None, border: int | None, console: "Console") -> Result:
    from l3cli.cli.quality_tables import print_sequence
    from l3cli.stages.evaluation import document, evaluate_sequence

    figures = evaluate_sequence(sequence, console, ideal=ideal, border=border)
    return Result(document(figures), lambda: print_sequence(figures))
