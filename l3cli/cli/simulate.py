"""l3 simulate: camera × scenes × lights → training set."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options
from l3cli.cli.results import Result

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler
    from l3cli.stages.console import Console


@click.command()
@click.argument("scenes", type=options.RecipeFile("scenes"), metavar="SCENES.toml")
@click.option(
    "--camera", type=options.CAMERA, required=True, metavar="CAMERA", help="Camera model, camera recipe (.toml) or its name."
)
@options.output("Training set to write")
@click.option(
    "--pictures", type=options.FILE, metavar="DIR", help="Also write each raw frame (TIFF) and ideal picture (PNG)."
)
@click.option("--dng", type=options.FILE, metavar="DIR", help="Also write each raw frame as DNG, for other raw developers.")
@click.option(
    "--resume", is_flag=True, help="Continue with the frames in OUTPUT.parts, or make the pictures of an existing set."
)
@click.option(
    "--skip-bad", is_flag=True,
    help="Leave out scenes whose files have no readable header or do not fit the sensor; exit code 1 if there were any.",
)  # fmt: skip
@options.seed
@options.scheduler
@options.jobs
@options.trust
@options.force
@options.dry_run
@options.quiet
def simulate(
    scenes: Path, camera: Path, output: Path, pictures: Path | None, dng: Path | None, resume: bool, skip_bad: bool,
    seed: int, jobs: int, scheduler: "Scheduler | None", force: bool, console: "Console",
) -> Result:  # fmt: skip
    """Simulate raw frames of many scenes by a camera, and their ideal pictures.

    SCENES.toml is a recipe, or the name of one that comes with l3, such as default or small.

    \b
    Example: l3 simulate scenes.toml --camera camera.h5 -o training.h5
    """
    from l3cli.stages.simulation.simulate import simulate as stage

    frames, bad = stage(
        scenes, camera, output, console, pictures=pictures, dng=dng, resume=resume, skip_bad=skip_bad, seed=seed, jobs=jobs,
        scheduler=scheduler, force=force,
    )  # fmt: skip
    return Result({"training_set": str(output), "frames": frames, "scenes_left_out": bad}, code=1 if bad else 0)
