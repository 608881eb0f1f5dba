"""l3 calibrate: lab measurements → camera model."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from l3cli.cli import options


@click.command()
@click.argument("measurements", type=options.FILE, metavar="MEASUREMENTS.toml")
@options.output("Camera model to write")
@click.option("--truth", type=options.FILE, metavar="CAMERA", help="The camera behind a virtual lab, to compare with.")
@options.force
@options.quiet
@options.as_json
def calibrate(measurements: Path, output: Path, truth: Path | None, force: bool, quiet: bool, as_json: bool) -> None:
    """Find responsivities, gain and noise of a camera from its lab measurements.

    Example: l3 calibrate build/lab/MEASUREMENTS.toml -o build/camera.h5
    """
    from l3cli.artifacts.base import save
    from l3cli.artifacts.camera import load_camera
    from l3cli.calibrate import model, report
    from l3cli.files import refuse_existing
    from l3cli.io.measurements import history, load_measurements

    refuse_existing(output, force)
    true = load_camera(truth) if truth else None
    measured = load_measurements(measurements)
    camera = replace(model.calibrate(measured), history=(history(measurements),))
    result: dict[str, Any] = report.figures(camera)
    if true is not None:
        result["truth"] = report.compare(camera, true)
    save(camera, output)
    click.echo(json.dumps(result, indent=2, ensure_ascii=False) if as_json else report.as_text(result))
    if not result["saturation reached"]:
        options.say("no white frame saturates: the saturation level is taken to be the converter's last value", quiet)
    options.say(f"{output}: written", quiet)
