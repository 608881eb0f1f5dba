"""Parts of a report as plain data: sections of tables, figures and pictures, these small enough, as data URIs. page.html
lays them out as one page that needs nothing but itself; a script (downloads.js) turns what drawings offer into pictures."""

import base64
import csv
import io
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from l3cli.artifacts.schema import Stage
from l3cli.physics.display import displayed, srgb_codes, white_luminance

NUMBER = re.compile(r"^(?=.*[0-9])[−+]?[0-9.,–×⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+$")


@dataclass(frozen=True)
class Table:
    """Rows of text below headings; the first cell of a row is its heading."""

    kind: ClassVar[str] = "table"
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Return which columns beside the first hold nothing but numbers, to be set flush right."""
        columns = range(1, len(self.headings))
        return (False, *(all(NUMBER.match(row[column]) for row in self.rows) for column in columns))


@dataclass(frozen=True)
class Key:
    """One entry of a figure's legend: what a colour (CSS) and a mark stand for, which is "line", "dashed", "dotted", "box",
    "dot", "plus" or "cross"."""

    label: str
    colour: str
    mark: str = "line"
    opacity: float = 1.0


@dataclass(frozen=True)
class Data:
    """The numbers of a drawing: rows below headings."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A drawing with its title and what it shows; `finding`, with figures, is also read out in its place."""

    title: str
    svg: Markup
    finding: str
    legend: tuple[Key, ...] = ()
    narrow: bool = False  # a small drawing that should not be blown up
    data: Data | None = None  # to be taken from the page as a file


@dataclass(frozen=True)
class Figures:
    """Figures side by side, as many as the page is wide."""

    kind: ClassVar[str] = "figures"
    figures: tuple[Figure, ...]


@dataclass(frozen=True)
class Picture:
    """A picture as a data URI with its size in pixels, its caption and what stands in its place."""

    uri: str
    rows: int
    cols: int
    caption: str
    alt: str


@dataclass(frozen=True)
class Gallery:
    """Small pictures side by side."""

    kind: ClassVar[str] = "gallery"
    pictures: tuple[Picture, ...]
    wide: bool = False  # pictures as large as the page lets them be


@dataclass(frozen=True)
class Comparison:
    """One frame: ours first, or another that is named, then what it is compared with, behind a slider where scripts run."""

    kind: ClassVar[str] = "comparison"
    anchor: str
    title: str
    pictures: tuple[Picture, ...]
    key: tuple[Key, ...] = ()  # of the error map
    size: tuple[int, int] = (0, 0)  # rows and columns of the frame

    @property
    def width(self) -> int:
        """Return the pixels on the screen beyond which a small frame would only be blurred."""
        return max(3 * self.pictures[0].cols, 480)


@dataclass(frozen=True)
class Front:
    """A comparison with the verdict and the figures beside it."""

    kind: ClassVar[str] = "front"
    comparison: Comparison
    score: str  # the main figure of ours, as a number
    meaning: str  # what that number is
    verdict: str
    table: Table


@dataclass(frozen=True)
class PixelPicker:
    """Part of a frame in which a script shows any pixel's classes and transforms."""

    kind: ClassVar[str] = "pixels"
    anchor: str  # that of the comparison which shows the whole frame
    text: str
    pictures: tuple[Picture, ...]
    packed: str  # as pixels.packed has it


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Details:
    """A long text, such as a recipe, folded away."""

    kind: ClassVar[str] = "details"
    title: str
    text: str


Block = Table | Figures | Gallery | Comparison | Front | PixelPicker | Text | Details


@dataclass(frozen=True)
class Subsection:
    """Blocks below a heading of the third level."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Section:
    """Subsections below a heading of the second level; `lead` says the most important in a sentence or two."""

    title: str
    lead: str
    parts: tuple[Subsection, ...] = field(default=())


Array = NDArray[np.floating]
Pixels = NDArray[np.uint8]
Jpeg = Callable[[Pixels, int], bytes]  # (row, col, 3) encoded sRGB and quality 1…100 → a JPEG file
TRIED = ((1, 92), (1, 85), (1, 75), (2, 90), (2, 75), (4, 85), (8, 80), (16, 75))  # reduction and quality, best first
THUMBNAIL = 160  # px, longest side


def thumbnail(target: Array, white: Array) -> Pixels:
    """Return sRGB (row, col, 3), at most THUMBNAIL long, of XYZ planes (3, row, col), `white` (3) adapted to D65."""
    step = max(1, -(-max(target.shape[1:]) // THUMBNAIL))
    small = reduced(np.moveaxis(target, 0, -1), step)
    return srgb_codes(displayed(np.moveaxis(np.asarray(small, np.float64), -1, 0), white, white_luminance(target[1])))


def reduced(pixels: Array | Pixels, step: int) -> Array | Pixels:
    """Return the means (row, col, channel) of squares of `step` pixels; what does not fill a square is cut off."""
    rows, cols = (max(1, length // step) for length in pixels.shape[:2])
    if step == 1 or min(pixels.shape[:2]) < step:
        return pixels
    return pixels[: rows * step, : cols * step].reshape(rows, step, cols, step, -1).mean(axis=(1, 3))


def fitted(pixels: Pixels, limit: int, jpeg: Jpeg) -> tuple[str, tuple[int, int]]:
    """Return a data URI of at most about `limit` bytes and the size (rows, cols) of its picture."""
    for step, quality in TRIED:
        small = np.rint(reduced(pixels, step)).astype(np.uint8)
        coded = base64.b64encode(jpeg(small, quality))
        if len(coded) <= limit:
            break
    return "data:image/jpeg;base64," + coded.decode(), (small.shape[0], small.shape[1])


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
        given = ((f"--{key.replace('_', '-')}", value) for key, value in sorted(stage.options.items()))
        chosen = " ".join(key if value is True else f"{key} {value}" for key, value in given)
        inputs = "; ".join(_digests(role, digests) for role, digests in sorted(stage.inputs.items()) if digests)
        rows.append((f"{number}", f"l3 {stage.command}", chosen or "–", inputs or "–", stage.version))
    table = Table(f"Stages of {name}", ("stage", "command", "options", "inputs, SHA-256", "l3cli"), tuple(rows))
    recipes = [Details(f"Recipe of stage {n}, {s.command}", s.recipe) for n, s in enumerate(stages, 1) if s.recipe]
    return Subsection(name, (table, *recipes))


def _digests(role: str, digests: list[str]) -> str:
    """Return a role and its files by the first digits of their SHA-256."""
    more = f" … ({len(digests)} files)" if len(digests) > 4 else ""
    return " ".join((role, *(digest[:12] for digest in digests[:4]))) + more
