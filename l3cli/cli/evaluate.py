"""l3 evaluate: a table's quality on frames with known targets."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options
from l3cli.cli.results import Result

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("table", type=options.FILE, metavar="TABLE.h5")
@click.argument("frames", type=options.FILE, metavar="TRAINING.h5")
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
@click.option("--force", is_flag=True, help="Write pictures into a folder that is not empty.")
@options.dry_run
@options.quiet
def evaluate(
    table: Path,
    frames: Path,
    backend: str,
    viewing: float,
    border: int | None,
    pictures: Path | None,
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

    \b
    Example: l3 evaluate table.h5 unseen.h5 --json
    """
    from l3cli.stages.evaluation import evaluate as stage

    document = stage(table, frames, console, backend=backend, viewing=viewing, border=border, pictures=pictures, force=force)
    from l3cli.cli.quality_tables import print_tables

    return Result(document, lambda: print_tables(document))
