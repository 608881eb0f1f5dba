"""l3 compare: compares evaluations of several cameras at each luminance."""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

import click

from l3cli.cli import options as declared
from l3cli.cli.results import Result
from l3cli.cli.terminal import show, show_table, width
from l3cli.options.commands import CompareOptions
from l3cli.system.text import printable

if TYPE_CHECKING:
    from l3cli.evaluation.comparison import Comparison


@click.command()
@click.argument("evaluations", type=declared.FILE, nargs=-1, required=True, metavar="EVALUATION.json…")
@declared.output("HTML page with the curves", required=False)
@declared.of(CompareOptions)
def compare(evaluations: tuple[Path, ...], output: Path | None, options: CompareOptions) -> Result:
    """Compare the evaluations of several cameras at each luminance. Print which camera is better, and at which luminance
    each camera clips.

    \b
    Example: l3 compare bayer.json rgbw.json --figure psnr -o curves.html
    """
    from l3cli.stages.comparison import compare as stage

    comparison, files = stage(evaluations, output, options)
    return Result(comparison.document(), lambda: _text(comparison), files=files)


def _text(comparison: "Comparison") -> None:
    for figure, curves in comparison.curves.items():
        rows = [
            [f"{luminance:g}", *(f"{curve.value[index]:.2f}" for curve in curves)]
            for index, luminance in enumerate(curves[0].luminance)
        ]
        headings = ["cd/m²", *(printable(curve.name) for curve in curves)]
        show_table([figure], headings, rows, *_lines(comparison.sentences(figure)))
    for line in _lines(comparison.clipping):
        show(line)


def _lines(sentences: list[str]) -> list[str]:
    """Wrap sentences to the width of the terminal."""
    wide = width()
    return [line for each in sentences for line in (textwrap.wrap(printable(each), wide) if wide else [each])]
