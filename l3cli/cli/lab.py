"""l3 lab: simulates lab measurements of a camera."""

from pathlib import Path

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.options.commands import LabOptions


@click.command()
@click.argument("camera", type=declared.CAMERA, metavar="CAMERA")
@declared.output("Folder to write to", metavar="DIR")
@declared.of(LabOptions)
def lab(camera: Path, output: Path, options: LabOptions) -> Result:
    """Simulate lab measurements of CAMERA, and write a measurement file for "l3 calibrate". CAMERA is a camera recipe, the
    name of a recipe ("l3 init" lists the names) or a camera model.

    \b
    Example: l3 lab camera.toml -o lab
    """
    from l3cli.stages.lab import measure

    measurements, files = measure(camera, output, options)
    return Result({"measurements": str(measurements)}, files=files)
