"""The parts of a report as data classes, and the conversion of a report to an HTML page.

A report is a list of sections, and a section contains tables, figures and pictures. The template page.html converts the
sections to a self-contained HTML page. Pictures are embedded as data URIs of limited size. With the script downloads.js, the
reader can save a drawing as an SVG file.
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

# Matches cells that contain a number or a range of numbers. A column is right-aligned if all its cells match.
NUMBER = re.compile(r"^(?=.*[0-9])[−+]?[0-9.,–×⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+$")


@dataclass(frozen=True)
class Table:
    """A table of text cells with column headings. The first cell of each row is the heading of the row."""

    kind: ClassVar[str] = "table"
    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Whether each column is right-aligned.

        A column is right-aligned if all its cells contain numbers or ranges of numbers, and if it is not the first column.
        """
        columns = range(1, len(self.headings))
        return (False, *(all(NUMBER.match(row[column]) for row in self.rows) for column in columns))


@dataclass(frozen=True)
class Key:
    """One entry of the legend of a figure."""

    label: str
    colour: str  # CSS colour
    mark: str = "line"  # "line", "dashed", "dotted", "box", "dot", "plus" or "cross"
    opacity: float = 1.0


@dataclass(frozen=True)
class Data:
    """The numbers that a drawing shows, as a table."""

    headings: tuple[str, ...]
    rows: tuple[tuple[str | float, ...], ...]


@dataclass(frozen=True)
class Figure:
    """A drawing with a title, a legend and a caption."""

    title: str
    svg: Markup
    finding: str  # caption, also used as the text for screen readers; states the main result with numbers
    legend: tuple[Key, ...] = ()
    narrow: bool = False  # whether the page must not enlarge the drawing
    data: Data | None = None  # numbers in the drawing, which the reader can save as a CSV file


@dataclass(frozen=True)
class Figures:
    """Figures in rows. Each row contains as many figures as fit into the width of the page."""

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
    wide: bool = False  # whether the pictures are shown as large as the page permits


@dataclass(frozen=True)
class Comparison:
    """Pictures of one frame. The reader selects two of the pictures and compares them with a slider.

    If scripts are disabled, the page shows all pictures side by side.
    """

    kind: ClassVar[str] = "comparison"
    anchor: str  # HTML anchor
    title: str
    pictures: tuple[Picture, ...]
    key: tuple[Key, ...] = ()  # legend of the error map
    size: tuple[int, int] = (0, 0)  # rows and columns of the frame, before the pictures were reduced

    @property
    def width(self) -> int:
        """Maximum width on the screen in pixels. Without a limit, small frames would be enlarged until they look blurred."""
        return max(3 * self.pictures[0].cols, 480)


@dataclass(frozen=True)
class Front:
    """The comparison at the top of a page, with the main metrics beside the pictures."""

    kind: ClassVar[str] = "front"
    comparison: Comparison
    score: str  # value of the main metric of the transform table, as text
    meaning: str  # explanation of the score
    verdict: str  # sentences that state whether the transform table is better than the other pipelines
    table: Table  # metrics of all pipelines


@dataclass(frozen=True)
class PixelPicker:
    """A crop of a frame. If the reader selects a pixel, the page shows the classes and the transforms of the pixel."""

    kind: ClassVar[str] = "pixels"
    anchor: str  # HTML anchor of the comparison that shows the whole frame
    text: str
    pictures: tuple[Picture, ...]
    packed: str  # classes and transforms, in the encoding of the function pixels.packed


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Details:
    """A long text, for example a recipe, which is hidden until the reader expands it."""

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
# A JPEG encoder. It converts an 8-bit sRGB picture (row, col, 3) and a quality from 1 to 100 to the bytes of a JPEG file.
Jpeg = Callable[[Pixels, int], bytes]
# (reduction factor, JPEG quality), from the best to the worst.
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
    """Make a small sRGB picture of a target.

    Parameters
    ----------
    target : ndarray, (3, row, col)
        XYZ of the target.
    white : ndarray, (3,)
        XYZ of white, which is adapted to D65.

    Returns
    -------
    ndarray of uint8, (row, col, 3)
        sRGB picture. Its longer side usually has at most THUMBNAIL pixels. The 99th percentile of Y becomes white.
    """
    step = max(1, -(-max(target.shape[1:]) // THUMBNAIL))
    small = reduced(np.moveaxis(target, 0, -1), step)
    return srgb_codes(displayed(np.moveaxis(np.asarray(small, np.float64), -1, 0), white, white_luminance(target[1])))


def reduced(pixels: Array | Pixels, step: int) -> Array | Pixels:
    """Reduce a picture by averaging squares of pixels.

    Parameters
    ----------
    pixels : ndarray, (row, col, channel)
        The picture.
    step : int
        Side of the squares in pixels. Incomplete squares at the right and lower edges are discarded.

    Returns
    -------
    ndarray, (row, col, channel)
        Mean of each square. If `step` is 1, or if the picture is smaller than one square, the picture is returned unchanged.
    """
    rows, cols = (max(1, length // step) for length in pixels.shape[:2])
    if step == 1 or min(pixels.shape[:2]) < step:
        return pixels
    return pixels[: rows * step, : cols * step].reshape(rows, step, cols, step, -1).mean(axis=(1, 3))


def fitted(pixels: Pixels, limit: int, jpeg: Jpeg) -> tuple[str, tuple[int, int]]:
    """Encode a picture as a JPEG data URI of limited size.

    The function uses the first reduction factor and quality in JPEG_ATTEMPTS with which the picture does not exceed the
    limit. If the picture always exceeds the limit, the last reduction factor and quality are used.

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
MAX_FILE_NAME = 60  # maximum length of the name of a saved file in characters


def render_page(title: str, lead: str, sections: list[Section]) -> str:
    """Convert a report to a self-contained HTML page, with embedded drawings, pictures and scripts. All text is escaped.

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
    """Convert a title to a file name without suffix. The name is valid on all operating systems."""
    return re.sub("[^a-z0-9]+", "-", title.lower())[:MAX_FILE_NAME].strip("-") or "figure"


def csv_uri(data: Data) -> str:
    """Encode the numbers of a drawing as a CSV file in a data URI.

    A space is prepended to text that a spreadsheet would otherwise interpret as a formula.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for row in (data.headings, *data.rows):
        writer.writerow([_harmless(cell) if isinstance(cell, str) else f"{cell:.9g}" for cell in row])
    return "data:text/csv;charset=utf-8;base64," + base64.b64encode(text.getvalue().encode()).decode()


def _harmless(text: str) -> str:
    return f" {text}" if text.startswith(FORMULA_STARTS) else text


def history_section(files: list[tuple[str, str, str, tuple[Stage, ...]]]) -> Section:
    """Build the section that lists the input files of a report and the commands that wrote these files.

    Parameters
    ----------
    files : list of (name, type, SHA-256, stages)
        Name, type, checksum and history of each file. The history lists the stages in the order in which they ran, and may
        be empty.
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
    """List at most four input files of a role, such as "camera". A file is represented by 12 digits of its SHA-256."""
    more = f" … ({len(digests)} files)" if len(digests) > 4 else ""
    return " ".join((role, *(digest[:12] for digest in digests[:4]))) + more
