"""Numbers, lines and tables as plain text, for pages, terminals of any width and pipes."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

GAP = "  "


def printable(text: str) -> str:
    """Return `text` as one line that a terminal can show, "?" in the place of what it cannot or would obey: control
    characters, ends of lines, marks that turn the direction of writing, bytes of a file name that are no text."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def figure(value: float, form: str) -> str:
    """Return a number as the format `form` says, a dash where there is none."""
    return format(value, form) if math.isfinite(value) else "–"


def tidy(value: float, digits: int = 3) -> str:
    """Return a number to so many significant digits, without exponent where it can be read without; a dash where there is
    none."""
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
    """Return an integer as an exponent is written."""
    return str(number).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def counted(number: int, what: str) -> str:
    """Return a number and what it counts, such as "1 frame" or "2 frames"."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def size_text(count: int) -> str:
    """Return a number of bytes, in words."""
    return f"{count / 1e9:.3g} GB" if count >= 1e9 else f"{count / 1e6:.3g} MB"


def unit(text: str) -> str:
    """Return a unit as ASCII artifacts write it, as print does."""
    return text.replace("e-", "e⁻").replace("m^2", "m²").replace("^2", "²")


def short_names(paths: Iterable[Path]) -> list[str]:
    """Return the shortest end of each path that no other path has, as tables call files."""
    every = [path.absolute().parts for path in paths]

    def distinguished(parts: tuple[str, ...]) -> str:
        ends = (parts[-length:] for length in range(1, len(parts) + 1))
        return "/".join(next(end for end in ends if all(parts == other or other[-len(end) :] != end for other in every)))

    return [distinguished(parts) for parts in every]


def columns(headings: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None) -> list[str]:
    """Return the lines of a table: the first column to the left, the others to the right, below their headings of one or
    more lines.

    A table wider than `width` characters is divided into several, one below the other, all with the first column. What is
    not `printable` is replaced.
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
