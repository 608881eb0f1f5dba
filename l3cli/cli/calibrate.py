"""l3 calibrate: lab measurements → camera model."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options, terminal
from l3cli.cli.terminal import show, show_json

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("measurements", type=options.FILE, metavar="MEASUREMENTS.toml")
@options.output("Camera model to write")
@click.option("--truth", type=options.CAMERA, metavar="CAMERA", help="Camera that a virtual lab measured, to compare with.")
@click.option("--export", type=options.FILE, metavar="DIR", help="Also write the curves as CSV and as rawtoaces JSON there.")
@click.option(
    "--accept", is_flag=True, help="Write the model even if it fails its checks, such as predicting its charts badly."
)
@options.jobs
@options.trust
@options.force
@options.quiet
@options.as_json
def calibrate(
    measurements: Path,
    output: Path,
    truth: Path | None,
    export: Path | None,
    accept: bool,
    jobs: int,
    force: bool,
    console: "Console",
    as_json: bool,
) -> None:
    """Estimate responsivities, gain and noise of a camera from its lab measurements.

    \b
    Example: l3 calibrate lab/MEASUREMENTS.toml -o camera.h5
    """
    from l3cli.calibration import acceptance, text
    from l3cli.stages.calibration import calibrate as stage

    camera, result = stage(measurements, output, console, truth=truth, export=export, accept=accept, jobs=jobs, force=force)
    if as_json:
        show_json(result, console)
    else:
        show(*text.as_text(result, terminal.width()))
    if shortfall := acceptance.shortfall(camera):
        console.say(f"accepted although {shortfall.partition(';')[0]}")
    if result["saturation reached"] is False:
        console.say("no white frame saturates: the converter's last value is taken for it; add one exposed longer")
    console.say(f"{output}: written")
