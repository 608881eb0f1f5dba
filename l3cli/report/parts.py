"""Parts of a report as plain data: sections of tables, figures and pictures. page.html lays them out."""

import re
from dataclasses import dataclass, field
from typing import ClassVar

from markupsafe import Markup

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
        """Which columns beside the first hold nothing but numbers, to be set flush right."""
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
        """Pixels on the screen beyond which a small frame would only be blurred."""
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
