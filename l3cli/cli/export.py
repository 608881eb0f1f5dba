"""l3 export: converts a camera or a transform table to C source, or to files for other software."""

from pathlib import Path

import click

from l3cli.cli import options as declared
from l3cli.cli import terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show
from l3cli.errors import RecipeError
from l3cli.options.commands import ExportOptions
from l3cli.options.option import declarations


@click.command()
@click.argument("artifact", type=declared.CAMERA, metavar="CAMERA|TABLE.h5")
@declared.output("Folder to write to", metavar="DIR")
@declared.of(ExportOptions)
def export(artifact: Path, output: Path, options: ExportOptions) -> Result:
    """Convert a camera or a transform table to files for other software.

    For CAMERA, a camera model or a camera recipe, l3 writes curves (CSV, rawtoaces JSON), a data sheet (CSV), DCP matrices
    (JSON) and, for Bayer arrays, tuning files for libcamera. It prints the colour error of the matrices on measured surfaces
    under each illuminant.

    For TABLE.h5, a transform table, l3 writes C99 source that renders to sRGB without l3, or little-endian arrays for other
    hardware. In the folder of the C source, "make test" compares its output with l3's reference on a test mosaic.

    \b
    Example: l3 export table.h5 -o source --to c
    """
    from l3cli.calibration.figures import matrix_lines
    from l3cli.stages.export import export as export_camera
    from l3cli.stages.export import export_table, is_table

    if is_table(artifact):
        names, files = export_table(artifact, output, options)
        return Result({"files": names}, files=files)
    if of_tables := options.chosen():
        flag = declarations(ExportOptions)[next(iter(of_tables))].flag or next(iter(of_tables))
        raise RecipeError(f"‹{flag}› works only for transform tables, but {artifact} is a camera; remove ‹{flag}›")
    matrices, files = export_camera(artifact, output, options)
    text = (lambda: show(*matrix_lines(matrices, terminal.width()))) if matrices else None
    return Result({"matrices": matrices}, text, files=files)
