"""The parts of a report as data classes, and their conversion to an HTML page.

A report is a list of sections with tables, figures and pictures. The template page.html converts them to a self-contained
page. Pictures are embedded as data URIs of limited size. The script downloads.js lets the reader save drawings as SVG files.
"""

import base64
import csv
import io
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar

import jinja2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from l3cli.artifacts.schema import Stage
from l3cli.physics.display import displayed, srgb_codes, white_luminance

# Matches a number or a range of numbers.
NUMBER = re.compile(r"^(?=.*[0-9])[−+]?[0-9.,–×⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+$")


@dataclass(frozen=True)
class Table:
    """A table of text cells with column headings. The first cell of each row is its heading."""

    kind: ClassVar[str] = "table"
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Whether each column contains only numbers and is right-aligned. The first column never is."""
        columns = range(1, len(self.headings))
        return (False, *(all(NUMBER.match(row[column]) for row in self.rows) for column in columns))


@dataclass(frozen=True)
class Key:
    """An entry in the legend of a figure."""

    label: str
    colour: str  # CSS colour
    mark: str = "line"  # "line", "dashed", "dotted", "box", "dot", "plus" or "cross"
    opacity: float = 1.0


@dataclass(frozen=True)
class Data:
    """The numbers in a drawing, as a table."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A drawing with a title, a legend and a caption."""

    title: str
    svg: Markup
    finding: str  # caption with the main result in numbers, also used as the text for screen readers
    legend: tuple[Key, ...] = ()
    narrow: bool = False  # whether the drawing must not be enlarged
    data: Data | None = None  # numbers in the drawing, which the reader can save as a CSV file


@dataclass(frozen=True)
class Figures:
    """Figures in rows, with as many figures per row as the page width allows."""

    kind: ClassVar[str] = "figures"
    figures: tuple[Figure, ...]


@dataclass(frozen=True)
class Picture:
    """A picture with a caption. The size is in pixels."""

    uri: str  # data URI
    rows: int
    cols: int
    caption: str
    alt: str  # alternative text


@dataclass(frozen=True)
class Gallery:
    """Small pictures side by side."""

    kind: ClassVar[str] = "gallery"
    pictures: tuple[Picture, ...]
    wide: bool = False  # whether to show the pictures as large as the page allows


@dataclass(frozen=True)
class Comparison:
    """Pictures of one frame. The reader selects two of them and compares them with a slider.

    If scripts are disabled, the page shows all pictures side by side.
    """

    kind: ClassVar[str] = "comparison"
    anchor: str  # HTML anchor
    title: str
    pictures: tuple[Picture, ...]
    key: tuple[Key, ...] = ()  # legend of the error map
    size: tuple[int, int] = (0, 0)  # rows and columns of the original frame

    @property
    def width(self) -> int:
        """Maximum width on the screen in pixels. It limits the enlargement of small frames, which would look blurred."""
        return max(3 * self.pictures[0].cols, 480)


@dataclass(frozen=True)
class Front:
    """The comparison at the top of a page, with the main metrics beside the pictures."""

    kind: ClassVar[str] = "front"
    comparison: Comparison
    score: str  # main metric of the transform table, as text
    meaning: str  # explanation of the score
    verdict: str  # sentences that state whether the transform table is better than the other pipelines
    table: Table  # metrics of all pipelines


@dataclass(frozen=True)
class PixelPicker:
    """A crop of a frame in which the reader can select a pixel to see its classes and transforms."""

    kind: ClassVar[str] = "pixels"
    anchor: str  # HTML anchor of the comparison with the whole frame
    text: str
    pictures: tuple[Picture, ...]
    packed: str  # classes and transforms, encoded with `pixels.packed`


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Details:
    """A long text, such as a recipe, which is hidden until the reader expands it."""

    kind: ClassVar[str] = "details"
    title: str
    text: str


Block = Table | Figures | Gallery | Comparison | Front | PixelPicker | Text | Details


@dataclass(frozen=True)
class Subsection:
    """Blocks under a third-level heading."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Section:
    """Subsections under a second-level heading. The first paragraph, `lead`, summarises the section."""

    title: str
    lead: str
    parts: tuple[Subsection, ...] = field(default=())


Array = NDArray[np.floating]
Pixels = NDArray[np.uint8]
# A JPEG encoder takes an 8-bit sRGB picture (row, col, 3) and a quality from 1 to 100, and returns the bytes of a JPEG file.
Jpeg = Callable[[Pixels, int], bytes]
# (reduction factor, JPEG quality), from best to worst.
JPEG_ATTEMPTS = (
    (1, 92),
    (1, 85),
    (1, 75),
    (2, 90),
    (2, 75),
    (4, 85),
    (8, 80),
    (16, 75),
)
THUMBNAIL = 160  # maximum length of the longer side of a thumbnail in px


def thumbnail(target: Array, white: Array) -> Pixels:
    """Convert a target to a small sRGB picture.

    Parameters
    ----------
    target : ndarray, (3, row, col)
        XYZ of the target.
    white : ndarray, (3,)
        XYZ of white, which is adapted to D65.

    Returns
    -------
    ndarray of uint8, (row, col, 3)
        sRGB picture with at most about THUMBNAIL pixels on its longer side. The 99th percentile of Y is rendered white.
    """
    step = max(1, -(-max(target.shape[1:]) // THUMBNAIL))
    small = reduced(np.moveaxis(target, 0, -1), step)
    return srgb_codes(displayed(np.moveaxis(np.asarray(small, np.float64), -1, 0), white, white_luminance(target[1])))


def reduced(pixels: Array | Pixels, step: int) -> Array | Pixels:
    """Downsample a picture by averaging squares of pixels.

    Parameters
    ----------
    pixels : ndarray, (row, col, channel)
        The picture.
    step : int
        Side of the squares in pixels. Incomplete squares at the right and lower edges are discarded.

    Returns
    -------
    ndarray, (row, col, channel)
        Mean of each square. If `step` is 1 or the picture is smaller than a square, the picture itself.
    """
    rows, cols = (max(1, length // step) for length in pixels.shape[:2])
    if step == 1 or min(pixels.shape[:2]) < step:
        return pixels
    return pixels[: rows * step, : cols * step].reshape(rows, step, cols, step, -1).mean(axis=(1, 3))


def fitted(pixels: Pixels, limit: int, jpeg: Jpeg) -> tuple[str, tuple[int, int]]:
    """Encode a picture as a JPEG data URI of limited size.

    The first reduction factor and quality in JPEG_ATTEMPTS that meet the limit are used, or the last ones if none does.

    Parameters
    ----------
    pixels : ndarray of uint8, (row, col, 3)
        sRGB picture.
    limit : int
        Maximum length of the base64 text in bytes.
    jpeg : callable
        JPEG encoder, see `Jpeg`.

    Returns
    -------
    uri : str
        The data URI.
    size : tuple of int
        Rows and columns of the encoded picture.
    """
    for step, quality in JPEG_ATTEMPTS:
        small = np.rint(reduced(pixels, step)).astype(np.uint8)
        coded = base64.b64encode(jpeg(small, quality))
        if len(coded) <= limit:
            break
    return "data:image/jpeg;base64," + coded.decode(), (small.shape[0], small.shape[1])


MAX_PAGE_BYTES = 10_000_000  # approximate maximum size of a page in bytes
FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")  # first characters of cells that spreadsheets interpret as formulas
MAX_FILE_NAME = 60  # maximum length of a saved file's name in characters


def render_page(title: str, lead: str, sections: list[Section]) -> str:
    """Convert a report to a self-contained HTML page with embedded drawings, pictures and scripts. All text is escaped.

    Parameters
    ----------
    title : str
        Heading of the page.
    lead : str
        Paragraph below the heading.
    sections : list of Section
        Contents of the page.

    Returns
    -------
    str
        The HTML text.
    """
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
    """Convert a title to a file name without suffix that is valid on all operating systems."""
    return re.sub("[^a-z0-9]+", "-", title.lower())[:MAX_FILE_NAME].strip("-") or "figure"


def csv_uri(data: Data) -> str:
    """Encode the numbers in a drawing as a CSV file in a data URI.

    Text that a spreadsheet would interpret as a formula is prefixed with a space.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in (data.headings, *data.rows):
        writer.writerow([_harmless(cell) if isinstance(cell, str) else f"{cell:.9g}" for cell in row])
    return "data:text/csv;charset=utf-8;base64," + base64.b64encode(text.getvalue().encode()).decode()


def _harmless(text: str) -> str:
    return f" {text}" if text.startswith(FORMULA_STARTS) else text


def history_section(files: list[tuple[str, str, str, tuple[Stage, ...]]]) -> Section:
    """Build the section with the input files of a report and the commands that created them.

    Parameters
    ----------
    files : list of (name, type, SHA-256, stages)
        Name, type, digest and history of each file. The history lists the processing stages in order, and may be empty.
    """
    given = tuple((name, kind, digest) for name, kind, digest, _ in files)
    parts = [Subsection("Files", (Table("Files of this report", ("file", "type", "SHA-256"), given),))]
    parts += [_stages(name, stages) for name, _, _, stages in files if stages]
    lead = "For each artifact, the commands that created it and their inputs. Each artifact contains this record."
    return Section("History", lead, tuple(parts))


def _stages(name: str, stages: tuple[Stage, ...]) -> Subsection:
    rows = []
    for number, stage in enumerate(stages, 1):
        given = ((f"--{key.replace('_', '-')}", value) for key, value in sorted(stage.options.items()))
        chosen = " ".join(key if value is True else f"{key} {value}" for key, value in given)
        inputs = "; ".join(_digests(role, digests) for role, digests in sorted(stage.inputs.items()) if digests)
        rows.append((f"{number}", f"l3 {stage.command}", chosen or "–", inputs or "–", stage.version))
    headings = ("stage", "command", "options", "inputs (first digits of the SHA-256)", "l3cli version")
    table = Table(f"Stages of {name}", headings, tuple(rows))
    recipes = [Details(f"Recipe of stage {n}, {s.command}", s.recipe) for n, s in enumerate(stages, 1) if s.recipe]
    return Subsection(name, (table, *recipes))


def _digests(role: str, digests: list[str]) -> str:
    """List a role, such as "camera", and at most four of its input files by the first 12 digits of their SHA-256."""
    more = f" … ({len(digests)} files)" if len(digests) > 4 else ""
    return " ".join((role, *(digest[:12] for digest in digests[:4]))) + more
