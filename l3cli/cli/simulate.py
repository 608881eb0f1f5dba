"""l3 simulate: simulates a training set for a camera."""

from pathlib import Path

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.options.commands import SimulateOptions


@click.command()
@click.argument("scenes", type=declared.RecipeFile("scenes"), metavar="SCENES.toml")
@click.option(
    "--camera",
    type=declared.CAMERA,
    required=True,
    metavar="CAMERA",
    help="Camera model, camera recipe (.toml), or the name of a recipe that comes with l3.",
)
@declared.output("Training set to write")
@declared.of(SimulateOptions, declared.trust)
def simulate(scenes: Path, camera: Path, output: Path, options: SimulateOptions) -> Result:
    """Simulate raw frames of many scenes with a camera, and compute the ideal output for each frame.

    SCENES.toml is a recipe, or the name of a recipe that comes with l3, such as default or small.

    If --skip-bad skips a scene file, the exit code is 1.

    \b
    Example: l3 simulate scenes.toml --camera camera.h5 -o training.h5
    """
    from l3cli.stages.simulation.simulate import simulate as stage

    made = stage(scenes, camera, output, options)
    document = {"training_set": str(output), "frames": made.frames, "scenes_left_out": made.scenes_left_out}
    return Result(document, code=1 if made.scenes_left_out else 0, files=made.files)
