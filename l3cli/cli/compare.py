"""l3 compare: evaluations of several cameras beside each other, over the light on the scene."""

import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options, terminal
from l3cli.cli.terminal import show, show_json
from l3cli.columns import columns, printable

if TYPE_CHECKING:
    from l3cli.evaluation.comparison import Curve


@click.command()
@click.argument("evaluations", type=options.FILE, nargs=-1, required=True, metavar="EVALUATION.json…")
@click.option(
    "--figure",
    "figures",
    multiple=True,
    default=("scielab",),
    show_default=True,
    metavar="NAME",
    help="Which figure of the evaluations, such as mean_delta_e or psnr; several times for several.",
)
@options.output("HTML page with the curves", required=False)
@options.force
@options.as_json
def compare(
    evaluations: tuple[Path, ...], figures: tuple[str, ...], output: Path | None, force: bool, as_json: bool
) -> None:
    """Compare cameras by figures of their evaluations at each luminance, and tell where the better one changes.

    \b
    Example: l3 compare bayer.json rgbw.json --figure psnr -o curves.html
    """
    from l3cli.errors import RecipeError
    from l3cli.evaluation.comparison import crossings, curve_of, require_comparable

    if output is not None:
        if output.suffix != ".html":
            raise RecipeError(f"{output}: curves are drawn on a page; name a file that ends in .html")
        claims = options.claims(terminal.Terminal())
        claims.spare(*evaluations)
        claims.claim_file(output, force)
    documents = [_read(path) for path in evaluations]
    curves = {figure: [curve_of(document, figure) for document in documents] for figure in figures}
    require_comparable(next(iter(curves.values())))
    pairs = {figure: list(itertools.combinations(found, 2)) for figure, found in curves.items()}
    changes = {
        figure: [(one.name, other.name, crossings(one, other, figure)) for one, other in pairs[figure]] for figure in curves
    }
    told = {
        figure: [
            f"{figure}: the better of {one} and {other} changes at "
            f"{', '.join(f'{luminance:.3g}' for luminance in luminances) or 'nowhere here'}"
            + (" cd/m²." if luminances else ".")
            for one, other, luminances in found
        ]
        for figure, found in changes.items()
    }
    if output is not None:
        _page(curves, told, output)
    if as_json:
        rows = [
            {"camera": one.name, "luminance": list(one.luminance)}
            | {figure: list(found[index].value) for figure, found in curves.items()}
            for index, one in enumerate(next(iter(curves.values())))
        ]
        keys = ("figure", "one", "other", "luminances")
        found = [dict(zip(keys, (figure, *change), strict=True)) for figure, group in changes.items() for change in group]
        show_json({"curves": rows, "crossings": found}, terminal.Terminal())
        return
    for figure, found_curves in curves.items():
        lines = [
            [f"{luminance:g}", *(f"{curve.value[index]:.2f}" for curve in found_curves)]
            for index, luminance in enumerate(found_curves[0].luminance)
        ]
        named = ["cd/m²", *(printable(curve.name) for curve in found_curves)]
        show(figure, *columns(named, lines, terminal.width()), *told[figure])


def _read(path: Path) -> dict:
    import json

    from l3cli.errors import InputFileError
    from l3cli.limits import read_bounded

    try:
        document = json.loads(read_bounded(path, 'give what "l3 evaluate --json" prints'))
    except (OSError, ValueError, RecursionError) as error:
        raise InputFileError(f'{path}: not readable as JSON; give what "l3 evaluate --json" prints') from error
    if not isinstance(document, dict):
        raise InputFileError(f'{path} is no evaluation; give what "l3 evaluate --json" prints')
    return document


def _page(curves: dict[str, list["Curve"]], told: dict[str, list[str]], output: Path) -> None:
    from l3cli.files import write_whole
    from l3cli.report.evaluation import luminance_section
    from l3cli.report.page import render_page

    names = " and ".join(curve.name for curve in next(iter(curves.values())))
    values = {figure: [(curve.name, curve.luminance, curve.value) for curve in found] for figure, found in curves.items()}
    page = render_page(
        f"{names} over the light", " ".join(itertools.chain(*told.values())), [luminance_section(values, told)]
    )
    write_whole(output, page)
