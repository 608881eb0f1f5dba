"""Format numbers and tables as text, and parse numbers.

The number parser is stricter than Python's, which also accepts 1_000, nan and non-ASCII digits.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from l3cli.errors import shortened

GAP = "  "
DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
WHOLE = re.compile(r"([+-]?)0*(\d+)", re.ASCII)
MOST_DIGITS = 40  # longer numbers exceed every permitted range, and Python refuses to convert more than 4300 digits
LARGEST_WHOLE = 2**63 - 1  # largest integer that TOML, HDF5 and numpy can store


def printable(text: str) -> str:
    """Make text safe to print on one line of a terminal.

    Line ends, control characters, direction marks and undecodable bytes become question marks.
    """
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def figure(value: float, form: str) -> str:
    """Format a number with the format specification `form`, such as ".3g". NaN and infinity become a dash."""
    return format(value, form) if math.isfinite(value) else "–"


def tidy(value: float, digits: int = 3) -> str:
    """Format a number with `digits` significant digits. NaN becomes a dash.

    Magnitudes below 1e-4 and from 1e5 are written with a power of ten.
    """
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e5:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
        return f"{mantissa}×10{superscript(int(exponent))}".replace("-", "−")
    rounded = float(f"{value:.{digits - 1}e}")
    text = f"{rounded:.10f}".rstrip("0").rstrip(".")
    return text.replace("-", "−")


def superscript(number: int) -> str:
    """Format an integer in superscript characters, such as "⁻³"."""
    return str(number).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def counted(number: int, what: str) -> str:
    """Format a number with a noun, such as "1 frame" or "2 frames". The noun's plural must end in "s"."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def a(what: str) -> str:
    """Prepend the article "a" to a noun, unless it is a plural such as "partial sums"."""
    return what if what.endswith("s") else f"a {what}"


def size_text(count: int) -> str:
    """Format a number of bytes in MB or GB."""
    return f"{count / 1e9:.3g} GB" if count >= 1e9 else f"{count / 1e6:.3g} MB"


def seconds_text(value: float) -> str:
    """Format an exposure time in s or ms."""
    return f"{figure(value, '.4g')} s" if value >= 1 else f"{value * 1e3:.3g} ms"


def array_lines(rows: list[list[str]]) -> list[str]:
    """Format a colour filter array, given as rows of channel names, as lines of text with aligned columns."""
    wide = max(len(name) for row in rows for name in row)
    return [" ".join(name.ljust(wide) for name in row).rstrip() for row in rows]


def unit(text: str) -> str:
    """Convert a unit from the ASCII form that artifacts store, such as "e-/m^2", to the displayed form, such as "e⁻/m²"."""
    return text.replace("e-", "e⁻").replace("m^2", "m²").replace("^2", "²")


def short_names(paths: Iterable[Path]) -> list[str]:
    """Return the shortest unique name for each path: as many of its last parts as necessary."""
    every = [path.absolute().parts for path in paths]

    def distinguished(parts: tuple[str, ...]) -> str:
        ends = (parts[-length:] for length in range(1, len(parts) + 1))
        return "/".join(next(end for end in ends if all(parts == other or other[-len(end) :] != end for other in every)))

    return [distinguished(parts) for parts in every]


def columns(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None) -> list[str]:
    """Format a table as lines of text, with the first column left-aligned and all others right-aligned.

    Parameters
    ----------
    headings : sequence of str
        Column headings. A heading may consist of several lines.
    rows : sequence of sequence of str
        The cells of each row. Unprintable characters become question marks.
    width : int, optional
        Maximum width in characters. A wider table is split into several tables, one below the other, each of which repeats
        the first column. [default: unlimited]

    Returns
    -------
    list of str
        The lines, without trailing spaces.
    """
    named = [[printable(line) for line in heading.split("\n")] for heading in headings]
    high = max(map(len, named))
    lines = [[([""] * (high - len(name)) + name)[line] for name in named] for line in range(high)] + [
        [printable(cell) for cell in row] for row in rows
    ]
    wide = [max(len(line[index]) for line in lines) for index in range(len(headings))]
    parts, used = [[0]], wide[0]
    for index in range(1, len(headings)):
        if width is not None and len(parts[-1]) > 1 and used + len(GAP) + wide[index] > width:
            parts.append([0])
            used = wide[0]
        parts[-1].append(index)
        used += len(GAP) + wide[index]
    blocks = [[_line(line, part, wide) for line in lines] for part in parts]
    return [line for number, part in enumerate(blocks) for line in ([""] if number else []) + part]


def _line(cells: Sequence[str], part: Sequence[int], wide: Sequence[int]) -> str:
    first, *others = part
    return GAP.join([cells[first].ljust(wide[first]), *(cells[index].rjust(wide[index]) for index in others)]).rstrip()


class NoSuchNumber(ValueError):
    """Raised if a text is not a number or is out of range. The message states the permitted range."""


@dataclass(frozen=True)
class Quantity:
    """A permitted range of numbers, including both limits, with a unit."""

    least: float
    most: float
    unit: str = ""
    whole: bool = False  # whether only whole numbers are permitted

    def __str__(self) -> str:
        return f"{_written(self.least)}…{_written(self.most)}{' ' if self.unit else ''}{self.unit}"

    def read(self, text: str) -> float:
        """Parse a number as an int if `whole` is set, otherwise as a float.

        Raises NoSuchNumber if the text is not such a number, or if the number is out of range.
        """
        spelled = WHOLE if self.whole else DECIMAL
        if not spelled.fullmatch(text):
            what = "whole number" if self.whole and DECIMAL.fullmatch(text) else "number"
            raise NoSuchNumber(f'"{shortened(text)}" is not a {what}; use a {what} within {self}')
        number = _whole(text) if self.whole else float(text) + 0.0  # + 0.0 turns -0.0 into 0.0
        if not self.least <= number <= self.most:
            nearest = self.least if number < self.least else self.most
            raise NoSuchNumber(f"{shortened(text)} is not within {self}; the nearest valid value is {_written(nearest)}")
        return number


def _whole(text: str) -> float:
    """Convert text that matches WHOLE to an int, or to ±infinity if it has more than MOST_DIGITS digits."""
    match = WHOLE.fullmatch(text)
    assert match is not None
    sign, digits = match.groups()
    return int(sign + digits) if len(digits) <= MOST_DIGITS else float(f"{sign}inf")


def _written(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
