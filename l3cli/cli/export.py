"""l3 export: camera or transform table → files that other software reads, or that run elsewhere."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from l3cli.cli import options, terminal
from l3cli.cli.results import Result
from l3cli.cli.terminal import show
from l3cli.errors import RecipeError

if TYPE_CHECKING:
    from l3cli.stages.console import Console


class Form(click.Choice):
    """The choices of --to; names what serves instead of one that went."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "onnx":
            raise RecipeError(
                "ONNX graphs are no longer written; give --to c (C99 source, with a test) or --to folder (plain arrays)"
            )
        return super().convert(value, param, ctx)


@click.command()
@click.argument("artifact", type=options.CAMERA, metavar="CAMERA|TABLE.h5")
@click.option("-o", "--output", type=options.FILE, required=True, metavar="DIR", help="Folder to write to.")
@click.option(
    "--to",
    "form",
    type=Form(["c", "folder"]),
    help="Of a table: C99 source (as without it), or arrays with a JSON.",
)
@click.option(
    "--words",
    type=click.Choice(["float32", "int16"]),
    help="Of C source: outputs as floats, or in steps of 2^-12. [float32]",
)
@click.option(
    "--white",
    metavar="LIGHT|X,Y",
    help="Of a table: C source shows this white neutral; transforms of several lights are mixed for it. [the table's]",
)
@click.option("--prefix", metavar="NAME", help="Of C source: what its symbols and files begin with. [l3]")
@click.option(
    "--set",
    "which",
    type=click.Choice(["usual", "quiet"]),
    help="Of a table of two sets of transforms: the one that C source holds. [usual]",
)
@options.force
@options.dry_run
@options.quiet
def export(
    artifact: Path,
    output: Path,
    form: Literal["c", "folder"] | None,
    words: Literal["float32", "int16"] | None,
    white: str | None,
    prefix: str | None,
    which: Literal["usual", "quiet"] | None,
    force: bool,
    console: "Console",
) -> Result:
    """Write CAMERA, a camera.h5 or a camera recipe, as other software reads it: curves (CSV, rawtoaces JSON), data sheet
    (CSV), DCP matrices (JSON), of a Bayer array tuning files of libcamera. Prints how far the matrices for each light leave
    the colours of measured surfaces.

    Or write TABLE.h5, a transform table, as C99 source that renders to sRGB without l3 (make test compares it with
    l3's reference on a test mosaic), or as little-endian arrays for other hardware.

    \b
    Example: l3 export table.h5 -o source --to c
    """
    from l3cli.calibration.figures import matrix_lines
    from l3cli.stages.exports import export as export_camera
    from l3cli.stages.exports import is_table

    if is_table(artifact):
        from l3cli.stages.table_exports import export_table

        files = export_table(
            artifact, output, form or "c", console, words=words, white=white, which=which, prefix=prefix, force=force
        )
        return Result({"files": files})
    given = {"--to": form, "--words": words, "--white": white, "--prefix": prefix, "--set": which}
    if option := next((name for name, value in given.items() if value is not None), None):
        raise RecipeError(f"{option} is for transform tables; {artifact} is a camera: leave it out")
    matrices = export_camera(artifact, output, console, force=force)
    return Result({"matrices": matrices}, lambda: show(*matrix_lines(matrices, terminal.width())) if matrices else None)
