"""l3 compare: evaluations of several cameras beside each other, over the light on the scene."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options

if TYPE_CHECKING:
    from l3cli.evaluate.comparison import Curve


@click.command()
@click.argument("evaluations", type=options.FILE, nargs=-1, required=True, metavar="EVALUATION.json…")
@click.option("--figure", default="scielab", show_default=True, help="Which figure of the evaluations.")
@options.output("PNG with the curves", required=False)
@options.force
@options.as_json
def compare(evaluations: tuple[Path, ...], figure: str, output: Path | None, force: bool, as_json: bool) -> None:
    """Compare cameras by a figure of their evaluations at each luminance, and tell where the better one changes.

    Example: l3 compare bayer.json rgbw.json --figure psnr -o curve.png
    """
    import itertools
    import json

    from l3cli.evaluate.comparison import crossings, curve_of, require_comparable
    from l3cli.files import refuse_existing

    if output is not None:
        refuse_existing(output, force)
    curves = [curve_of(_read(path), figure) for path in evaluations]
    require_comparable(curves)
    found = [
        {"one": one.name, "other": other.name, "luminances": crossings(one, other, figure)}
        for one, other in itertools.combinations(curves, 2)
    ]
    if output is not None:
        _draw(curves, figure, output)
    if as_json:
        rows = [{"camera": c.name, "luminance": list(c.luminance), figure: list(c.value)} for c in curves]
        click.echo(json.dumps({"figure": figure, "curves": rows, "crossings": found}, indent=2))
        return
    click.echo("  ".join(["cd/m²".rjust(8), *(curve.name.rjust(8) for curve in curves)]))
    for index, luminance in enumerate(curves[0].luminance):
        values = [f"{curve.value[index]:.2f}".rjust(max(8, len(curve.name))) for curve in curves]
        click.echo("  ".join([f"{luminance:g}".rjust(8), *values]))
    for each in found:
        where = ", ".join(f"{luminance:.3g}" for luminance in each["luminances"]) or "nowhere here"
        click.echo(f"{figure}: the better of {each['one']} and {each['other']} changes at {where} cd/m²")


def _read(path: Path) -> dict:
    import json

    from l3cli.errors import InputFileError

    try:
        document = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputFileError(f'{path}: not readable as JSON; give what "l3 evaluate --json" prints') from error
    if not isinstance(document, dict):
        raise InputFileError(f'{path} is no evaluation; give what "l3 evaluate --json" prints')
    return document


def _draw(curves: list["Curve"], figure: str, output: Path) -> None:
    import io

    from matplotlib.figure import Figure

    from l3cli.files import atomic_output

    plot = Figure(figsize=(6, 4), layout="constrained")
    axes = plot.subplots()
    for curve in curves:
        axes.semilogx(curve.luminance, curve.value, marker="o", label=curve.name)
    axes.set(xlabel="luminance of a white, cd/m²", ylabel=figure)
    axes.grid(alpha=0.3)
    axes.legend()
    content = io.BytesIO()
    plot.savefig(content, format="png", dpi=120, metadata={"Software": None})
    with atomic_output(output) as path:
        path.write_bytes(content.getvalue())
