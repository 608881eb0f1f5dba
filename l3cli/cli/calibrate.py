"""l3 calibrate: estimates a camera model from lab measurements or from photos of a chart."""

from pathlib import Path

import click

from l3cli.cli import options as declared
from l3cli.cli import terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show
from l3cli.options.commands import DraftOptions


@click.command()
@click.argument("measurements", type=declared.FILE, metavar="[MEASUREMENTS.toml]", required=False)
@declared.output("Camera model to write, or measurement file to write with --draft")
@declared.of(DraftOptions, declared.trust)
def calibrate(measurements: Path | None, output: Path, options: DraftOptions) -> Result:
    """Estimate the spectral responsivities, the gain and the noise of a camera from lab measurements or from photos of a
    ColorChecker.

    \b
    Example: l3 calibrate --draft captures -o MEASUREMENTS.toml
             l3 calibrate MEASUREMENTS.toml -o camera.h5
             l3 calibrate --photo chart.dng --light 3200K -o camera.h5
    """
    if options.draft is not None:
        return _draft(options.draft, measurements, output, options)
    if options.camera is not None:
        raise click.UsageError(
            "--camera works only with --draft, because a measurement file describes its camera; remove --camera"
        )
    from l3cli.calibration import figures
    from l3cli.io.raw.files import is_photo

    if measurements is not None and is_photo(measurements):
        raise click.UsageError(
            f"{measurements} is a raw file; to use a photo of a ColorChecker, write --photo {measurements}"
        )
    from l3cli.stages.calibration import calibrate as stage

    _, result, files = stage(measurements, output, options)
    return Result(result, lambda: show(*figures.as_text(result, terminal.width())), files=files)


def _draft(folder: Path, measurements: Path | None, output: Path, options: DraftOptions) -> Result:
    """Write a draft measurement file.

    Raises UsageError if the user also specified a measurement file or a calibration option.
    """
    from l3cli.stages.calibration import draft

    given = [name for name in ("photos", "light", "truth", "accept") if getattr(options, name)]
    if measurements is not None or given:
        name = "MEASUREMENTS.toml" if measurements is not None else f"--{given[0].removesuffix('s')}"
        raise click.UsageError(f"--draft only writes a measurement file and does not calibrate; remove {name}")
    files = draft(folder, output, options)
    return Result({"measurements": str(output)}, files=files)
