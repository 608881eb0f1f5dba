"""l3 calibrate: lab measurements, or photos of a chart → camera model."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from l3cli.cli import options, terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show

if TYPE_CHECKING:
    from l3cli.stages.console import Console


def _draft(
    folder: Path, output: Path, camera: Path | None, console: "Console", force: bool, measurements: Path | None,
    others: dict[str, Any],
) -> Result:  # fmt: skip
    """Write the draft; UsageError if what only a calibration takes is given, too."""
    from l3cli.stages.drafting.draft import draft

    given = [name for name in ("photos", "light", "truth", "export", "accept") if others[name]]
    if measurements is not None or given:
        name = "MEASUREMENTS.toml" if measurements is not None else f"--{given[0].removesuffix('s')}"
        raise click.UsageError(f"--draft writes a measurement file and calibrates nothing; leave {name} out")
    draft(folder, output, console, camera=camera, force=force)
    return Result({"measurements": str(output)})


@click.command()
@click.argument("measurements", type=options.FILE, metavar="[MEASUREMENTS.toml]", required=False)
@click.option(
    "--photo", "photos", type=options.FILE, metavar="RAW", multiple=True, help="Raw photo of a ColorChecker instead."
)
@click.option("--light", metavar="LIGHT", help='Its light: "D65", "3200K"…; without, it is guessed.')
@click.option(
    "--draft",
    type=options.FILE,
    metavar="FOLDER",
    help="Write a measurement file of the captures or tables in FOLDER instead.",
)
@click.option("--camera", type=options.CAMERA, metavar="CAMERA", help="Sensor, array and optics of the draft.")
@options.output("Camera model to write; with --draft the measurement file")
@click.option("--truth", type=options.CAMERA, metavar="CAMERA", help="Camera that a virtual lab measured, to compare with.")
@click.option("--export", type=options.FILE, metavar="DIR", help='Also write there what "l3 export" writes.')
@click.option(
    "--accept", is_flag=True, help="Write the model even if it fails its checks, such as predicting its charts badly."
)
@options.jobs
@options.trust
@options.force
@options.dry_run
@options.quiet
def calibrate(
    measurements: Path | None, output: Path, draft: Path | None, camera: Path | None, console: "Console",
    force: bool, **others: Any,
) -> Result:  # fmt: skip
    """Estimate responsivities, gain and noise of a camera from its lab measurements, or from photos of a chart.

    \b
    Example: l3 calibrate --draft captures -o MEASUREMENTS.toml
             l3 calibrate MEASUREMENTS.toml -o camera.h5
             l3 calibrate --photo chart.dng --light 3200K -o camera.h5
    """
    if draft is not None:
        return _draft(draft, output, camera, console, force, measurements, others)
    if camera is not None:
        raise click.UsageError("--camera goes with --draft; a measurement file states its camera itself")
    from l3cli.calibration import figures
    from l3cli.io.raw.registry import is_photo

    if measurements is not None and is_photo(measurements):
        raise click.UsageError(f"{measurements} is a raw file; a photo of a ColorChecker goes with --photo")
    from l3cli.stages.calibration import calibrate as stage

    _, result = stage(measurements, output, console, force=force, **others)
    return Result(result, lambda: show(*figures.as_text(result, terminal.width())))
