"""l3 calibrate: lab measurements, or photos of a chart → camera model."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options, terminal
from l3cli.cli.terminal import show, show_json

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("measurements", type=options.FILE, metavar="[MEASUREMENTS.toml]", required=False)
@click.option(
    "--photo", "photos", type=options.FILE, metavar="RAW", multiple=True, help="Raw photo of a ColorChecker instead."
)
@click.option("--light", metavar="LIGHT", help='Its light: "D65", "3200K"…; without, it is guessed.')
@options.output("Camera model to write")
@click.option("--truth", type=options.CAMERA, metavar="CAMERA", help="Camera that a virtual lab measured, to compare with.")
@click.option("--export", type=options.FILE, metavar="DIR", help='Also write there what "l3 export" writes.')
@click.option(
    "--accept", is_flag=True, help="Write the model even if it fails its checks, such as predicting its charts badly."
)
@options.jobs
@options.trust
@options.force
@options.quiet
@options.as_json
def calibrate(measurements: Path | None, output: Path, console: "Console", as_json: bool, **others: Any) -> None:
    """Estimate responsivities, gain and noise of a camera from its lab measurements, or from photos of a chart.

    \b
    Example: l3 calibrate lab/MEASUREMENTS.toml -o camera.h5
             l3 calibrate --photo chart.dng --light 3200K -o camera.h5
    """
    from l3cli.calibration import text
    from l3cli.stages.calibration import calibrate as stage

    _, result = stage(measurements, output, console, **others)
    if as_json:
        show_json(result, console)
    else:
        show(*text.as_text(result, terminal.width()))
