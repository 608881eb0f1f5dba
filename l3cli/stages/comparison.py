"""The `l3 compare` stage, which compares the metrics of several cameras at each scene luminance."""

import itertools
import json
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.comparison import Comparison, curve_of, named_by_files, require_comparable, same_scenes
from l3cli.options.commands import CompareOptions
from l3cli.system.files import FilesUsed, files_to_read, write_whole
from l3cli.system.limits import read_bounded
from l3cli.system.outputs import OutputGuard

EXPECTED = 'use a file that contains the output of "l3 evaluate --json"'


def compare(evaluations: tuple[Path, ...], page: Path | None, options: CompareOptions) -> tuple[Comparison, FilesUsed]:
    """Compare the metrics of several cameras at each luminance, and optionally write a page with curves.

    A warning is printed on the console if the evaluations may not be comparable.

    Parameters
    ----------
    evaluations : tuple of Path
        Files with the output of `l3 evaluate --json`.
    page : Path or None
        HTML page to write, which plots each metric against luminance.
    options : CompareOptions
        Options of `l3 compare`.

    Returns
    -------
    Comparison
        The metrics.
    FilesUsed
        The files that were read and written.

    Raises
    ------
    InputFileError
        If a file is not an evaluation, if an evaluation lacks one of the metrics, or if the files contain different
        luminances.
    RecipeError
        If the file name of the page does not end in .html.
    L3Error
        If the page cannot be written.
    """
    if page is not None and page.suffix != ".html":
        raise RecipeError(f"{page} is not the name of an HTML page; use a file name that ends in .html")
    figures, console = options.figures, options.console
    with OutputGuard(console) as guard:
        if page is not None:
            guard.protect(*evaluations)
            guard.guard_file(page, options.force)
        files = files_to_read({"evaluations": evaluations})
        documents = [_read(path) for path in evaluations]
        given = list(zip(evaluations, documents, strict=True))
        curves = {
            figure: named_by_files([curve_of(document, figure, path) for path, document in given], evaluations)
            for figure in figures
        }
        require_comparable(next(iter(curves.values())))
        comparison = Comparison(curves, same_scenes(documents))
        if comparison.doubt:
            console.warn(comparison.doubt)
        if page is not None:
            _write_page(comparison, page)
            files = files.and_wrote(page)
        return comparison, files


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(read_bounded(path, EXPECTED))
    except (OSError, ValueError, RecursionError) as error:
        raise InputFileError(f"{path} is not a JSON file; {EXPECTED}") from error
    if not isinstance(document, dict):
        raise InputFileError(f"{path} is not a result of l3 evaluate; {EXPECTED}")
    return document


def _write_page(comparison: Comparison, page: Path) -> None:
    from l3cli.report.evaluation import luminance_section  # imported here, because the import is slow
    from l3cli.report.parts import render_page

    names = " and ".join(curve.name for curve in comparison.cameras)
    values = {
        figure: [(curve.name, curve.luminance, curve.value) for curve in curves]
        for figure, curves in comparison.curves.items()
    }
    sentences = {figure: comparison.sentences(figure) for figure in comparison.curves}
    doubt = [f"But {comparison.doubt}."] if comparison.doubt else []
    lead = " ".join([*itertools.chain(*sentences.values()), *comparison.clipping, *doubt])
    write_whole(page, render_page(f"{names} at different luminances", lead, [luminance_section(values, sentences)]))
