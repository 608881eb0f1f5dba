"""l3 compare: evaluations of several cameras over luminance."""

from pathlib import Path

import click

from l3cli.cli import options
from l3cli.cli.terminal import Terminal, show_json, show_table
from l3cli.columns import printable


@click.command()
@click.argument("evaluations", type=options.FILE, nargs=-1, required=True, metavar="EVALUATION.json…")
@click.option(
    "--figure",
    "figures",
    multiple=True,
    default=("scielab",),
    show_default=True,
    metavar="NAME",
    help="Figure of the evaluations, such as mean_delta_e or psnr. May be repeated.",
)
@options.output("HTML page with the curves", required=False)
@options.force
@options.dry_run
@options.as_json
def compare(
    evaluations: tuple[Path, ...], figures: tuple[str, ...], output: Path | None, force: bool, as_json: bool
) -> None:
    """Compare cameras by figures of their evaluations at each luminance, and print where the ranking changes.

    \b
    Example: l3 compare bayer.json rgbw.json --figure psnr -o curves.html
    """
    from l3cli.stages.comparison import compare as stage

    comparison = stage(evaluations, figures, Terminal(), page=output, force=force)
    if as_json:
        show_json(comparison.document(), Terminal())
        return
    for figure, curves in comparison.curves.items():
        rows = [
            [f"{luminance:g}", *(f"{curve.value[index]:.2f}" for curve in curves)]
            for index, luminance in enumerate(curves[0].luminance)
        ]
        headings = ["cd/m²", *(printable(curve.name) for curve in curves)]
        show_table([figure], headings, rows, *comparison.sentences(figure))
