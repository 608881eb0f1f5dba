"""The pages of docs/ are what they are cited as: links and citations resolve, no other page is cited, figures agree."""

import re
import tomllib
from pathlib import Path

import pytest

from tests.helpers.paths import ROOT
from tests.helpers.readme import PAGES as DOCS
from tests.helpers.readme import README

METHOD, BENCHMARKS = DOCS["method.md"], DOCS["benchmarks.md"]
FRONT = ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
CITING = ("l3cli", "opencl", "configs", "tests", "docs", "Makefile", *FRONT)
CITED = r"(?<![\w/.:-])((?:docs/|\.\./)?[\w-]+\.md)#([\w-]*)"
PAGES = {name: (ROOT / name).read_text(encoding="utf-8") for name in FRONT} | {f"docs/{name}": DOCS[name] for name in DOCS}


def anchors(page: str) -> list[str]:
    """The anchor that GitHub gives each heading of a page, in order."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", page, flags=re.MULTILINE | re.DOTALL), re.MULTILINE)
    return [re.sub(r"[^\w -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings]


def texts() -> dict[Path, str]:
    """Every text file that may cite a page."""
    places = [ROOT / name for name in CITING]
    paths = [path for place in places for path in ([place] if place.is_file() else place.rglob("*"))]
    kinds = {".py", ".cl", ".c", ".toml", ".md", ".sh", ""}
    wanted = [path for path in paths if path.is_file() and path.suffix in kinds and path != Path(__file__).resolve()]
    return {path: path.read_text(encoding="utf-8") for path in wanted}


TEXTS = texts()
LINES = [(path, number, line) for path, text in TEXTS.items() for number, line in enumerate(text.splitlines(), 1)]


def test_every_citation_leads_to_a_heading() -> None:
    known = {ROOT / name: set(anchors(page)) for name, page in PAGES.items()}
    cited = [(path, number, cited_page(path, page), anchor)
             for path, number, line in LINES for page, anchor in re.findall(CITED, line)]  # fmt: skip
    lost = [
        (str(path), number, page, anchor) for path, number, page, anchor in cited if anchor not in known.get(page, set())
    ]
    assert not lost


def cited_page(citing: Path, name: str) -> Path:
    """The page that is meant: pages link relative to themselves, all else cites from the top."""
    if (ROOT / "docs/site") in citing.parents:  # what makes pages of docs/reference
        return ROOT / "docs" / Path(name).name
    return (citing.parent / name).resolve() if citing.suffix == ".md" and (citing.parent / name).exists() else ROOT / name


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_somewhere(name: str) -> None:
    for link in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", PAGES[name]):
        if "://" not in link:
            assert (ROOT / name).parent.joinpath(link).exists(), link


def test_the_headline_figures_of_readme_are_those_of_the_benchmarks() -> None:
    rows = [
        row.split("|")[2:4] for row in README.partition("## Figures")[2].partition("\n## ")[0].splitlines() if row[:1] == "|"
    ][2:]
    assert rows
    for ours, rival in rows:
        for figure in re.findall(r"\d+(?:\.\d+)?", re.sub(r"\(\d{4}\)", "", ours + rival)):
            assert re.search(rf"(?<![\d.]){re.escape(figure)}(?![\d.]*\d)", BENCHMARKS), figure


def test_no_page_is_cited_that_is_not_here() -> None:
    left = [(str(path), number) for path, number, line in LINES if re.search(r"\b(METHOD|DESIGN|STYLE) \d", line)]
    assert not left


@pytest.mark.parametrize("name", PAGES)
def test_anchors_are_unambiguous(name: str) -> None:
    every = anchors(PAGES[name])
    assert len(set(every)) == len(every)


@pytest.mark.parametrize("name", PAGES)
def test_links_within_a_page_lead_somewhere(name: str) -> None:
    links = re.findall(r"\]\(#([\w-]+)\)", PAGES[name])
    assert set(links) <= set(anchors(PAGES[name]))


def test_references_are_numbered_in_order_and_all_used() -> None:
    body, _, listed = METHOD.partition("## References\n")
    numbers = [int(number) for number in re.findall(r"^(\d+)\. ", listed, re.MULTILINE)]
    assert numbers == list(range(1, len(numbers) + 1))
    prose = re.sub(r"```.*?```", "", body, flags=re.DOTALL)
    used = {int(number) for group in re.findall(r"\[(\d+(?:, \d+)*)\]", prose) for number in group.split(", ")}
    assert used == set(numbers)


def test_a_source_distribution_holds_the_pages() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    assert {Path(name).parts[0] for name in PAGES} <= set(included)
