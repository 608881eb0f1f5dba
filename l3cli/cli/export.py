"""l3 export: camera → files that other software reads."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options, terminal
from l3cli.cli.terminal import show, show_json

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("camera", type=options.CAMERA, metavar="CAMERA")
@click.option("-o", "--output", type=options.FILE, required=True, metavar="DIR", help="Folder to write to.")
@options.force
@options.quiet
@options.as_json
def export(camera: Path, output: Path, force: bool, console: "Console", as_json: bool) -> None:
    """Write CAMERA, a camera.h5 or a camera recipe, as other software reads it: curves (CSV, rawtoaces JSON), data sheet
    (CSV), DCP matrices (JSON), of a Bayer array tuning files of libcamera. Prints how far the matrices for each light leave
    the colours of measured surfaces.

    \b
    Example: l3 export camera.h5 -o exported
    """
    from l3cli.calibration.text import matrix_lines
    from l3cli.stages.exports import export as stage

    matrices = stage(camera, output, console, force=force)
    if as_json:
        show_json({"matrices": matrices}, console)
    elif matrices:
        show(*matrix_lines(matrices, terminal.width()))
