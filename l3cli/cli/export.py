"""l3 export: camera or transform table → C source, or files for other software."""

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
    """Write files for other software.

    Of CAMERA, a camera.h5 or a camera recipe: curves (CSV, rawtoaces JSON), a data sheet (CSV), DCP matrices (JSON) and, for
    Bayer arrays, tuning files of libcamera. The colour error of the matrices on measured surfaces is printed for each light.

    Of TABLE.h5, a transform table: C99 source that renders to sRGB without l3 ("make test" compares it with l3's reference
    on a test mosaic), or little-endian arrays for other hardware.

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
        raise RecipeError(f"‹{flag}› is for transform tables; {artifact} is a camera: leave it out")
    matrices, files = export_camera(artifact, output, options)
    text = (lambda: show(*matrix_lines(matrices, terminal.width()))) if matrices else None
    return Result({"matrices": matrices}, text, files=files)
