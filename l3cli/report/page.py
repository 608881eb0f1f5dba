"""Sections to one HTML page that needs nothing but itself: drawings offer their data as files, which a script turns into
pictures, too (downloads.js)."""

import base64
import csv
import io
import re
from typing import Any

from l3cli.artifacts.schema import Stage
from l3cli.report.parts import Data, Details, Section, Subsection, Table

LIMIT = 10_000_000  # bytes of a page
FORMULAS = ("=", "+", "-", "@", "\t", "\r")  # with which spreadsheets take a text for something to compute
LONGEST = 60  # letters of a file's name


def render_page(title: str, lead: str, sections: list[Section]) -> str:
    """Return the page; every text is escaped, drawings and pictures lie inside."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("l3cli.report", ""),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {"file_stem": file_stem, "csv_uri": csv_uri}
    return environment.get_template("page.html").render(title=title, lead=lead, sections=sections)


def file_stem(title: str) -> str:
    """Return a title as the name of a file on any system."""
    return re.sub("[^a-z0-9]+", "-", title.lower())[:LONGEST].strip("-") or "figure"


def csv_uri(data: Data) -> str:
    """Return the data of a drawing as a CSV file inside a data URI. Texts that a spreadsheet would compute begin with a
    space."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in (data.headings, *data.rows):
        writer.writerow([_harmless(cell) if isinstance(cell, str) else f"{cell:.9g}" for cell in row])
    return "data:text/csv;charset=utf-8;base64," + base64.b64encode(text.getvalue().encode()).decode()


def _harmless(text: str) -> str:
    return f" {text}" if text.startswith(FORMULAS) else text


def history_section(files: list[tuple[str, str, str, tuple[Stage, ...]]]) -> Section:
    """Return the origin of everything: `files` are name, kind, SHA-256 and stages, oldest first."""
    given = tuple((name, kind, digest) for name, kind, digest, _ in files)
    parts = [Subsection("Files", (Table("Files of this report", ("file", "kind", "SHA-256"), given),))]
    parts += [_stages(name, stages) for name, _, _, stages in files if stages]
    return Section("History", "What was run on what, as the artifacts record it.", tuple(parts))


def _stages(name: str, stages: tuple[Stage, ...]) -> Subsection:
    rows = []
    for number, stage in enumerate(stages, 1):
        chosen = " ".join(_option(*option) for option in sorted(stage.options.items()))
        inputs = "; ".join(_digests(role, digests) for role, digests in sorted(stage.inputs.items()) if digests)
        rows.append((f"{number}", f"l3 {stage.command}", chosen or "–", inputs or "–", stage.version))
    table = Table(f"Stages of {name}", ("stage", "command", "options", "inputs, SHA-256", "l3cli"), tuple(rows))
    recipes = [Details(f"Recipe of stage {n}, {s.command}", s.recipe) for n, s in enumerate(stages, 1) if s.recipe]
    return Subsection(name, (table, *recipes))


def _option(key: str, value: Any) -> str:
    """Return an option as it is given on the command line."""
    return f"--{key.replace('_', '-')}" + ("" if value is True else f" {value}")


def _digests(role: str, digests: list[str]) -> str:
    """Return a role and its files by the first digits of their SHA-256."""
    return (
        f"{role} "
        + " ".join(digest[:12] for digest in digests[:4])
        + (f" … ({len(digests)} files)" if len(digests) > 4 else "")
    )
