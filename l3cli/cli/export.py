"""l3 export: camera or transform table → files that other software reads, or that run elsewhere."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from l3cli.cli import options, terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show

if TYPE_CHECKING:
    from l3cli.stages.console import Console


@click.command()
@click.argument("artifact", type=options.CAMERA, metavar="CAMERA|TABLE.h5")
@click.option("-o", "--output", type=options.FILE, required=True, metavar="DIR", help="Folder to write to.")
@click.option(
    "--to",
    "form",
    type=click.Choice(["c", "folder", "onnx"]),
    help="Of a table: C99 source (as without it), arrays with a JSON, or an ONNX graph (slow: for verification).",
)
@click.option(
    "--words",
    type=click.Choice(["float32", "int16"]),
    help="Of C source: outputs as floats, or in steps of 2^-12. [float32]",
)
@click.option("--white", metavar="LIGHT|X,Y", help="Of a table of several lights: mix its transforms for this white.")
@click.option(
    "--set",
    "which",
    type=click.Choice(["usual", "quiet"]),
    help="Of a table of two sets of transforms: the one that C source or a graph holds. [usual]",
)
@options.force
@options.dry_run
@options.quiet
def export(
    artifact: Path,
    output: Path,
    form: Literal["c", "folder", "onnx"] | None,
    words: Literal["float32", "int16"] | None,
    white: str | None,
    which: Literal["usual", "quiet"] | None,
    force: bool,
    console: "Console",
) -> Result:
    """Write CAMERA, a camera.h5 or a camera recipe, as other software reads it: curves (CSV, rawtoaces JSON), data sheet
    (CSV), DCP matrices (JSON), of a Bayer array tuning files of libcamera. Prints how far the matrices for each light leave
    the colours of measured surfaces.

    Or write TABLE.h5, a transform table, as C99 source that renders without l3 (make test compares it with l3's reference
    on a test mosaic), as little-endian arrays for other hardware, or as an ONNX graph.

    \b
    Example: l3 export table.h5 -o source --to c
    """
    from l3cli.calibration.text import matrix_lines
    from l3cli.errors import RecipeError
    from l3cli.stages.exports import export as export_camera
    from l3cli.stages.exports import is_table

    if is_table(artifact):
        from l3cli.stages.table_exports import export_table

        files = export_table(artifact, output, form or "c", console, words=words, white=white, which=which, force=force)
        return Result({"files": files})
    if option := "--to" if form else "--words" if words else "--white" if white else "--set" if which else None:
        raise RecipeError(f"{option} is for transform tables; {artifact} is a camera: leave it out")
    matrices = export_camera(artifact, output, console, force=force)
    return Result({"matrices": matrices}, lambda: show(*matrix_lines(matrices, terminal.width())) if matrices else None)
