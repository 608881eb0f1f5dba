"""l3 lab: camera → simulated lab measurements."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options
from l3cli.cli.results import Result

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("camera", type=options.CAMERA, metavar="CAMERA")
@click.option("-o", "--output", type=options.FILE, required=True, metavar="DIR", help="Folder to write to.")
@click.option(
    "--recipe",
    type=options.RecipeFile("lab"),
    metavar="LAB.toml",
    help="Lab recipe or its name; without it the built-in default.",
)
@options.seed
@options.jobs
@options.force
@options.dry_run
@options.quiet
def lab(camera: Path, output: Path, recipe: Path | None, seed: int, jobs: int, force: bool, console: "Console") -> Result:
    """Simulate the lab measurements of CAMERA, as input for "l3 calibrate". CAMERA is a camera recipe, the name of one
    ("l3 init" lists them) or a camera.h5.

    \b
    Example: l3 lab camera.toml -o lab
    """
    from l3cli.stages.lab import measure

    made = measure(camera, output, console, recipe=recipe, seed=seed, jobs=jobs, force=force)
    return Result({"measurements": str(made)})
