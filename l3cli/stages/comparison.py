"""The comparison stage: evaluations of several cameras → figures over the light, and where the better camera changes."""

import itertools
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError, RecipeError
from l3cli.evaluation.comparison import Curve, crossings, curve_of, require_comparable
from l3cli.files import write_whole
from l3cli.limits import read_bounded
from l3cli.stages.claims import Claims
from l3cli.stages.console import Console
from l3cli.stages.plan import Made, before_work

GIVE = 'give what "l3 evaluate --json" prints'


@dataclass(frozen=True)
class Change:
    """Where the better of two cameras changes."""

    figure: str
    one: str
    other: str
    luminances: tuple[float, ...]  # cd/m² of a perfect white, rising

    def sentence(self) -> str:
        """The same in words."""
        where = ", ".join(f"{luminance:.3g}" for luminance in self.luminances) or "nowhere here"
        unit = " cd/m²" if self.luminances else ""
        return f"{self.figure}: the better of {self.one} and {self.other} changes at {where}{unit}."


@dataclass(frozen=True)
class Comparison:
    """Each figure of every camera over the light, and of every two cameras where the better one changes."""

    curves: dict[str, list[Curve]]  # by figure, in the order of the evaluations
    changes: dict[str, list[Change]]  # by figure

    def sentences(self, figure: str) -> list[str]:
        """The changes of a figure in words."""
        return [change.sentence() for change in self.changes[figure]]

    def document(self) -> dict[str, Any]:
        """All of it, ready for JSON."""
        cameras = [
            {"camera": camera.name, "luminance": list(camera.luminance)}
            | {figure: list(curves[index].value) for figure, curves in self.curves.items()}
            for index, camera in enumerate(next(iter(self.curves.values())))
        ]
        return {"curves": cameras, "crossings": [asdict(each) for each in itertools.chain(*self.changes.values())]}


def compare(
    evaluations: tuple[Path, ...], figures: tuple[str, ...], console: Console, *, page: Path | None = None,
    force: bool = False,
) -> Comparison:  # fmt: skip
    """Compare cameras by figures of their evaluations (what `l3 evaluate --json` prints) at each luminance.

    `page`: HTML file to write with the curves, which with `force` may be there. InputFileError if a file is no evaluation or
    has other luminances than the others, RecipeError for a figure that there is none of, L3Error if the page cannot be
    written.
    """
    if page is not None and page.suffix != ".html":
        raise RecipeError(f"{page}: curves are drawn on a page; name a file that ends in .html")
    with Claims(console) as claims:
        if page is not None:
            claims.spare(*evaluations)
            claims.claim_file(page, force)
        documents = [_read(path) for path in evaluations]
        curves = {figure: [curve_of(document, figure) for document in documents] for figure in figures}
        require_comparable(next(iter(curves.values())))
        comparison = Comparison(curves, {figure: _changes(figure, cameras) for figure, cameras in curves.items()})
        before_work({"evaluations": evaluations}, *([Made(page, "page")] if page is not None else []))
        if page is not None:
            _write_page(comparison, page)
        return comparison


def _changes(figure: str, cameras: list[Curve]) -> list[Change]:
    pairs = itertools.combinations(cameras, 2)
    return [Change(figure, one.name, other.name, tuple(crossings(one, other, figure))) for one, other in pairs]


def _read(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(read_bounded(path, GIVE))
    except (OSError, ValueError, RecursionError) as error:
        raise InputFileError(f"{path}: not readable as JSON; {GIVE}") from error
    if not isinstance(document, dict):
        raise InputFileError(f"{path} is no evaluation; {GIVE}")
    return document


def _write_page(comparison: Comparison, page: Path) -> None:
    from l3cli.report.evaluation import luminance_section  # only where a page is wanted: drawing takes long to load
    from l3cli.report.page import render_page

    names = " and ".join(curve.name for curve in next(iter(comparison.curves.values())))
    values = {
        figure: [(curve.name, curve.luminance, curve.value) for curve in curves]
        for figure, curves in comparison.curves.items()
    }
    sentences = {figure: comparison.sentences(figure) for figure in comparison.curves}
    lead = " ".join(itertools.chain(*sentences.values()))
    write_whole(page, render_page(f"{names} over the light", lead, [luminance_section(values, sentences)]))
