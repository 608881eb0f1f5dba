"""Collect the pages of the site in one folder: docs/, the README as first page, notebooks, generated reference pages."""

import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from api_pages import api_pages
from artifact_pages import artifact_pages
from command_pages import command_pages
from licence_pages import licence_pages
from recipe_pages import recipe_pages

ROOT = Path(__file__).parents[2]
EXECUTED = ROOT / "build/notebooks"  # written by `make notebooks`
DEMO = ROOT / "build/web"  # written by `make web`
BUILT = "doctrees"  # folder that Sphinx writes next to a site
NOTEBOOKS = "python.md"  # the page that lists the notebooks
FRONT = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md", "SECURITY.md": "security.md"}
AS_THEY_ARE = ("LICENSE", "CITATION.cff")
CONTENTS = {
    "Start": ["install", "how-l3-works", "tutorial", "glossary"],
    "How-to": [
        "own-lab", "raw-files", "video", "many-machines", "spectral-scenes", "arrays", "class-recipes", "measurement",
        "polarisation", "evaluate", "programs", "green-webcam", "export",
    ],
    "Reference": [
        "commands", "reference/commands", "reference/recipes", "artifacts", "reference/artifacts", "python",
        "reference/python", "metrics", "guarantees", "troubleshooting",
    ],
    "Results": ["gallery", "benchmarks", "results", "peers", "limits"],
    "Background": ["method", "implementation", "against-the-paper"],
    "Project": ["architecture", "contributing", "notebook", "changelog", "security", "reference/licences"],
}  # fmt: skip


def gather(folder: Path) -> None:
    """Write the pages of the site into a new `folder`."""
    shutil.copytree(ROOT / "docs", folder, ignore=_left_out)
    for path in folder.rglob("*.md"):
        path.write_text(relinked(path.read_text(encoding="utf-8")), encoding="utf-8")
    for name, page in FRONT.items():
        (folder / page).write_text(relinked((ROOT / name).read_text(encoding="utf-8")), encoding="utf-8")
    for name in AS_THEY_ARE:
        shutil.copy(ROOT / name, folder)
    (folder / "reference").mkdir()
    for name, text in (api_pages() | command_pages() | recipe_pages() | artifact_pages() | licence_pages()).items():
        (folder / "reference" / name).write_text(text, encoding="utf-8")
    if not EXECUTED.is_dir():
        raise SystemExit(f"{EXECUTED} is missing; make notebooks makes it")
    shutil.copytree(EXECUTED, folder / "notebooks", dirs_exist_ok=True)
    listed = (folder / NOTEBOOKS).read_text(encoding="utf-8")
    names = re.findall(r"\]\((notebooks/[\w-]+)\.md\)", listed)
    (folder / NOTEBOOKS).write_text(f"{listed}\n{tree(names)}\n", encoding="utf-8")
    pages = {path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.md")}
    readme = relinked((ROOT / "README.md").read_text(encoding="utf-8"))
    (folder / "index.md").write_text(f"{with_demo(readme)}\n{contents(pages)}", encoding="utf-8")


def _left_out(folder: str, names: list[str]) -> set[str]:
    """Return the names that are not copied, including sites that were built inside docs/."""
    built = {name for name in names if Path(folder, name, BUILT).is_dir()}
    return built | shutil.ignore_patterns("site", "paper", "Dockerfile*", "meta.yaml", "__pycache__")(folder, names)


def relinked(text: str) -> str:
    """Return a page with its links adapted to the site, where the README is in the folder of the pages."""
    for name, page in (FRONT | {"README.md": "index.md"}).items():
        text = re.sub(rf"\]\((\.\./)?{re.escape(name)}", f"]({page}", text)
    text = re.sub(r"\]\((notebooks/[\w-]+)\.ipynb\)", r"](\1.md)", text)
    return text.replace("](docs/", "](")


def with_demo(readme: str) -> str:
    """Return the first page, with a link to the browser demo below the picture if `make web` has built the demo."""
    if not (DEMO / "demo.html").is_file():
        return readme
    words = '<a href="demo.html">Render a raw file in this browser</a>: a Bayer DNG, <a href="demo.dng">this one</a>'
    head, after, rest = readme.partition("\n\n*Part of a simulated frame")
    return f"{head}\n\n{words} or yours; it is sent nowhere ([how](export.md#a-table-in-a-browser)).{after}{rest}"


def contents(pages: set[str]) -> str:
    """Return the tables of contents. A last table lists the pages that are in no other table."""
    listed = {name for names in CONTENTS.values() for name in names}
    listed |= {page for page in pages if page.startswith(("reference/", "notebooks/"))}  # listed on other pages
    more = {"More": others} if (others := sorted(pages - listed)) else {}
    return "\n\n".join(tree(names, f":caption: {caption}") for caption, names in (CONTENTS | more).items()) + "\n"


def tree(names: Iterable[str], *options: str) -> str:
    return "\n".join(["```{toctree}", ":hidden:", *options, "", *names, "```"])
