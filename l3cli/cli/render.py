"""l3 render: raw frames through a table."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from l3cli.cli import options
from l3cli.errors import L3Error, RecipeError


def _pair(separator: str) -> Callable[[Any, Any, str | None], tuple[int, int] | None]:
    """Reads "a<separator>b" as two whole numbers."""

    def read(context: Any, parameter: Any, text: str | None) -> tuple[int, int] | None:
        parts = text.split(separator) if text is not None else []
        if text is not None and not (len(parts) == 2 and all(part.isascii() and part.isdecimal() for part in parts)):
            raise click.BadParameter(f'"{text}" is not {parameter.metavar}')
        return (int(parts[0]), int(parts[1])) if text is not None else None

    return read


def _exposure(context: Any, parameter: Any, text: str) -> float | None:
    """Reads a positive number, or "auto" as None."""
    try:
        value = None if text == "auto" else float(text)
    except ValueError:
        raise click.BadParameter(f'"{text}" is neither auto nor a number') from None
    if value is not None and not 0 < value < float("inf"):
        raise click.BadParameter(f"{text} is not positive")
    return value


def _targets(inputs: tuple[Path, ...], output: Path, suffix: str, bits: int, force: bool) -> list[Path]:
    """The file for each input: `output` for one, files named by the inputs' stems in the folder `output` for several."""
    from l3cli.files import refuse_existing
    from l3cli.io.images import check_format

    targets = [output] if len(inputs) == 1 else [output / f"{path.stem}.{suffix}" for path in inputs]
    if len(set(targets)) < len(targets):
        raise RecipeError("two inputs have the same name and would write the same file; render them one by one")
    if len(inputs) > 1 and output.exists() and not output.is_dir():
        raise L3Error(f"{output} is a file; name a folder as the output of several inputs")
    for target in targets:
        check_format(target, bits)
        refuse_existing(target, force)
    return targets


@click.command()
@click.argument("table", type=options.FILE)
@click.argument("inputs", type=options.FILE, nargs=-1, required=True, metavar="INPUT...")
@options.output("Picture (.png .tif .jpg) or linear outputs (.exr); the folder for them if there are several inputs")
@click.option("--format", "suffix", default="png", show_default=True, help="Suffix of the files in a folder.")
@click.option("--backend", type=click.Choice(["opencl", "reference"]), default="opencl", show_default=True, help="Engine.")
@click.option("--exposure", default="auto", callback=_exposure, metavar="auto|VALUE", help="Y × VALUE = 1 is shown white.")
@click.option(
    "--white", metavar="NAME|x,y", help="Scene white shown neutral: illuminant or chromaticity [default: table's]."
)
@click.option("--bits", type=click.Choice(["8", "16"]), default="8", show_default=True, help="Bits a value of a picture.")
@click.option("--black", type=float, metavar="DN", help="Black level of the inputs [default: the file's or the table's].")
@click.option("--white-level", type=float, metavar="DN", help="White level of the inputs [default: the file's or table's].")
@click.option("--phase", callback=_pair(","), metavar="ROW,COL", help="CFA site of the inputs' first pixel.")
@click.option("--size", callback=_pair("x"), metavar="ROWSxCOLS", help="Size of headerless inputs [default: the table's].")
@options.force
@options.quiet
def render(
    table: Path, inputs: tuple[Path, ...], output: Path, suffix: str, backend: str, exposure: float | None,
    white: str | None, bits: str, black: float | None, white_level: float | None, phase: tuple[int, int] | None,
    size: tuple[int, int] | None, force: bool, quiet: bool,
) -> int:  # fmt: skip
    """Render each INPUT (camera raw, one-channel TIFF or PNG, .npy, headerless .raw or .bin) through TABLE.

    With --exposure auto the 99th percentile of Y is shown white.

    Example: l3 render table.h5 frame.dng -o picture.png
    """
    import numpy as np

    from l3cli.artifacts.base import load
    from l3cli.artifacts.table import TransformTable
    from l3cli.frame import upright
    from l3cli.io.images import is_linear, write_linear, write_picture
    from l3cli.io.raw_files import KnownBetter, read_raw
    from l3cli.render.display import automatic_exposure, make_display, require_xyz, scene_white
    from l3cli.render.renderer import make_renderer

    targets = _targets(inputs, output, suffix, int(bits), force)
    linear = is_linear(targets[0])
    if linear and (exposure is not None or white is not None):
        raise RecipeError(".exr files hold the outputs as they are; --exposure and --white are for pictures")
    transforms = load(TransformTable, table)
    if not linear:
        require_xyz(transforms.outputs)
        adapted = transforms.white_point if white is None else scene_white(white)
    known = KnownBetter(black, white_level, phase, size)
    renderer = make_renderer(backend, transforms)
    failures = 0
    for source, target in options.progress(zip(inputs, targets, strict=True), len(inputs), "frames", quiet):
        try:
            frame = read_raw(source, transforms, known)
            if linear:
                planes = np.moveaxis(renderer.outputs(frame), 0, -1)
                write_linear(target, upright(planes, frame.orientation), transforms.outputs)
                continue
            # Automatic exposure needs the whole frame's luminance before the first value can be encoded: two runs.
            scale = exposure or automatic_exposure(renderer.outputs(frame)[1])
            picture = renderer.picture(frame, make_display(adapted, scale, int(bits)))
            write_picture(target, upright(picture, frame.orientation))
        except (L3Error, OSError) as error:
            if len(inputs) == 1:
                raise
            failures += 1
            click.echo(f"l3: {error}", err=True)
    return 1 if failures else 0
