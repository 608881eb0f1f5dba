"""Tables of numbers in text as instruments export them: what stands before the numbers, and the numbers.

Text is UTF-8, UTF-16 or that of Western Windows. Commas, semicolons, tabs or blanks separate columns; where it is not commas
that do, a comma is a decimal point. Before the numbers may stand lines of any text (`Key: value`, a marker such as
>>>>>Begin Spectral Data<<<<<), of which one is the heading and one may hold the units; behind them may stand an end marker.
A table may lie on its side: a row of wavelengths, then a row for each spectrum. Curves that were digitised from a plot
(WebPlotDigitizer) come as pairs of columns X and Y, each of its own length, below a line of their names.
"""

import codecs
import contextlib
import csv
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from l3cli.errors import InputFileError
from l3cli.spectra import units
from l3cli.system.limits import read_bounded

CURE = "give a CSV file of spectra"
MARKER = re.compile(r"^(?:>{3,}|<{3,}|\*{3,}|={3,}|-{3,})")
CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")  # bytes that no text of Windows has
UNIT_KEY = re.compile(
    r"^(?:y[- ]?(?:axis|unit)|(?:spectral |radiometric |measurement )?units?)\b[^:;=,\t]*[:;=,\t]\s*(.+)$", re.I
)
QUALITY = re.compile(r"\d{5}")  # the code before a measurement of Photo Research's instruments
SIDEWAYS, LIGHT = 10, (150.0, 5000.0)  # wavelengths in a row, and their range in nm, from which on a table lies on its side
WAVELENGTH = ("wavelength", "wavelengths", "lambda", "λ", "wl", "wave", "wvl", "wellenlänge")
SEPARATORS = r"[\s_()\[\]/,]+"
Cells = list[str]


@dataclass(frozen=True)
class TextTable:
    """The rows of numbers of a text, and what it calls its columns."""

    heading: Cells | None  # a name for each column
    rows: list[list[float]]  # all of one length
    pairs: tuple[tuple[str, list[tuple[float, float]]], ...] = ()  # instead of these: of each curve its name, and X and Y


def read_text_table(path: Path) -> TextTable:
    """Return the table in a text; InputFileError if there is none, or one with a broken row."""
    lines = [line.strip(" \r") for line in _text(path).splitlines() if line.strip()]
    comments = list(itertools.takewhile(lambda line: line.startswith("#"), lines))
    lines = [line for line in lines if not line.startswith("#")]
    while lines and MARKER.match(lines[-1]):
        lines.pop()
    separator, decimal_comma = _separator(lines)
    cells = _without_last([_split(line, separator) for line in lines], decimal_comma)
    if pairs := _pairs(cells, decimal_comma, path):
        return TextTable(None, [], pairs)
    cells = _upright(cells, decimal_comma)
    rows, before = _numbers(cells, separator, decimal_comma, path)
    heading = _heading(before, len(rows[0]), decimal_comma, path)
    if heading is None and comments:  # as numpy writes a heading
        names = _split(comments[-1].lstrip("# "), separator)
        heading = names if len(names) == len(rows[0]) and any(map(is_wavelength, names)) else None
    if heading is not None and not any(unit for _, unit in map(units.split, heading)):
        stated = next(filter(None, (_stated_unit(line) for line in lines[: len(before)])), None)
        heading = heading if stated is None else [_with_unit(name, stated) for name in heading]
    elif heading is None and (stated := next(filter(None, map(_stated_unit, lines[: len(before)])), None)):
        heading = ["nm", *(_with_unit(f"{number}", stated) for number in range(1, len(rows[0])))]
    return TextTable(heading, rows)


def _text(path: Path) -> str:
    """Return the text of a file, in the encodings that instruments write."""
    try:
        content = read_bounded(path, CURE)
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return content.decode("utf-16")
        if content[1:64:2].count(0) > len(content[1:64:2]) // 2:  # without its mark
            return content.decode("utf-16-le")
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError:
            if CONTROL.search(content):
                raise
            return content.decode("cp1252")
    except UnicodeDecodeError as error:
        raise InputFileError(f"{path}: not a text file; {CURE}") from error


def _separator(lines: Sequence[str]) -> tuple[str | None, bool]:
    """Return the separator of the columns of the numbers, None for blanks, and whether commas are decimal points."""
    last = next((line for line in reversed(lines) if re.match(r"[-+.]?\d", line)), lines[-1] if lines else "")
    for separator in ";\t":
        if separator in last:
            return separator, True
    if "," in last and re.search(r"\d\s+[-+]?\d", last):  # 380 0,0123
        return None, True
    return ("," if "," in last else None), False


def _split(line: str, separator: str | None) -> Cells:
    """Return the cells of a line."""
    if separator is None:
        return line.split()
    cells = line.split(separator)
    if '"' in line:
        with contextlib.suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator))
    return [cell.strip() for cell in cells]


def _without_last(cells: list[Cells], decimal_comma: bool) -> list[Cells]:
    """Return the cells where every row of numbers ends in a separator, with nothing behind it."""
    rows = [row for row in cells if _is_number(row[0], decimal_comma)]
    if not rows or any(len(row) < 3 or row[-1] for row in rows):
        return cells
    return [row[:-1] if len(row) > 1 and not row[-1] else row for row in cells]


def _number(cell: str, decimal_comma: bool) -> float:
    """Return the number in a cell; ValueError if there is none."""
    return float(cell.replace(",", ".") if decimal_comma else cell)


def _is_number(cell: str, decimal_comma: bool) -> bool:
    try:
        _number(cell, decimal_comma)
    except ValueError:
        return False
    return True


# -------------------------------------------------------------------------------------------------------- numbers


def _numbers(
    cells: list[Cells], separator: str | None, decimal_comma: bool, path: Path
) -> tuple[list[list[float]], list[Cells]]:
    """Return the rows of numbers at the end of a text, and the lines before them. InputFileError if there are none, or
    others before the last line that is none: a broken row must not pass for the end of a preamble."""
    numeric = [all(_is_number(cell, decimal_comma) for cell in row) for row in cells]
    start = len(cells)
    while start and numeric[start - 1]:
        start -= 1
    rows, before = cells[start:], cells[:start]
    if len(rows) > 1 and QUALITY.fullmatch(rows[0][0]) and len(rows[0]) != len(rows[1]):
        before, rows = [*before, rows[0]], rows[1:]
    columns = len(rows[0]) if rows else 0
    earlier = [
        number
        for number, row in enumerate(before[:start])
        if (numeric[number] and len(row) > 1) or (len(row) == columns and _is_number(row[0], decimal_comma))
    ]
    if not rows and not earlier:
        earlier = [number for number, row in enumerate(before) if re.match(r"[-+.]?\d", row[0])][-1:]
    if earlier:
        wrong = next(row for number, row in enumerate(before) if number >= earlier[0] and not numeric[number])
        raise InputFileError(f'{path}: "{(separator or " ").join(wrong)[:40]}" is not a row of numbers')
    if decimal_comma and {",", "."} <= {letter for row in rows for cell in row for letter in cell if letter in ",."}:
        raise InputFileError(f"{path}: numbers have commas and points; write decimals with one of them, thousands with none")
    if not rows or len({len(row) for row in rows}) != 1 or len(rows[0]) < 2:
        raise InputFileError(f"{path}: rows must be a wavelength in nm and equally many values each")
    return [[_number(cell, decimal_comma) for cell in row] for row in rows], before


def _pairs(cells: list[Cells], decimal_comma: bool, path: Path) -> tuple[tuple[str, list[tuple[float, float]]], ...]:
    """Return the curves of a text whose columns are called X, Y, X, Y…; none of any other. InputFileError if one is
    broken."""
    heads = [[cell.casefold() for cell in row if cell] for row in cells]
    head = next((number for number, row in enumerate(heads) if row and row == ["x", "y"] * (len(row) // 2)), None)
    if head is None:
        return ()
    count = len(heads[head]) // 2
    names = cells[head - 1] if head else []
    curves = []
    for number in range(count):
        points = [row[2 * number : 2 * number + 2] for row in cells[head + 1 :]]
        points = [point for point in points if any(point)]
        wrong = next((point for point in points if len(point) < 2 or not _all_numbers(point, decimal_comma)), None)
        if wrong is not None or not points:
            what = f'"{", ".join(wrong)[:40]}" is' if wrong is not None else "there is"
            raise InputFileError(f"{path}: {what} no pair of X and Y of curve {number + 1}; digitise it again")
        name = names[2 * number] if len(names) > 2 * number else ""
        curves.append((name, [(_number(x, decimal_comma), _number(y, decimal_comma)) for x, y in points]))
    return tuple(curves)


def _all_numbers(row: Cells, decimal_comma: bool) -> bool:
    return all(_is_number(cell, decimal_comma) for cell in row)


def _upright(cells: list[Cells], decimal_comma: bool) -> list[Cells]:
    """Return the table with a row for each wavelength, also where it lies on its side below a row of many wavelengths."""
    for number, row in enumerate(cells):
        if len(row) <= SIDEWAYS or _is_number(_without_nm(row[0]), decimal_comma):
            continue  # as most rows are
        across = [_without_nm(cell) for cell in row]
        labels = next((at for at, cell in enumerate(across) if _is_number(cell, decimal_comma)), len(row))
        grid = across[labels:]
        if len(grid) < SIDEWAYS or not _all_numbers(grid, decimal_comma):
            continue
        values = [_number(cell, decimal_comma) for cell in grid]
        spectra = [other for other in cells[number + 1 :] if len(other) == len(row)]
        if not _is_grid(values) or not spectra or not all(_all_numbers(other[labels:], decimal_comma) for other in spectra):
            return cells
        first = [other[0] for other in spectra]
        if (
            _all_numbers(first, decimal_comma)
            and len(first) > 2
            and _is_grid([_number(each, decimal_comma) for each in first])
        ):
            return cells  # columns that are called by their wavelengths
        names = [" ".join(filter(None, other[:labels])) for other in spectra]
        return [*cells[:number], ["nm", *names], *map(list, zip(grid, *(other[labels:] for other in spectra), strict=True))]
    return cells


def _without_nm(cell: str) -> str:
    return re.sub(r"\s*\[?\(?nm\)?\]?$", "", cell)


def _is_grid(values: Sequence[float]) -> bool:
    """Return whether numbers may be wavelengths in nm, in order."""
    ordered = sorted(values)
    return LIGHT[0] <= ordered[0] and ordered[-1] <= LIGHT[1] and len(set(values)) == len(values) and (
        list(values) in (ordered, ordered[::-1])
    )  # fmt: skip


# -------------------------------------------------------------------------------------------------------- headings


def _heading(before: list[Cells], columns: int, decimal_comma: bool, path: Path) -> Cells | None:
    """Return the line before the numbers that names their columns, with the units of a line below it."""
    if not before:
        return None
    if len(before) == 1 and not QUALITY.fullmatch(before[0][0]) and not MARKER.match(before[0][0]):
        if len(before[0]) == columns:
            return before[0]
        if len(before[0]) == 1 and not is_wavelength(before[0][0]):
            return None  # a title
        raise InputFileError(_mismatch(len(before[0]), columns, path))
    fitting = [row for row in before if len(row) == columns]
    named = next((number for number in reversed(range(len(fitting))) if any(map(is_wavelength, fitting[number]))), None)
    if named is None:
        other = next((row for row in reversed(before) if len(row) > 1 and any(map(is_wavelength, row))), None)
        if other is not None:
            raise InputFileError(_mismatch(len(other), columns, path))
        return (
            before[-1]
            if len(before[-1]) == columns > 2 and not any(_is_number(x, decimal_comma) for x in before[-1])
            else None
        )
    heading = fitting[named]
    below = fitting[named + 1] if named + 1 < len(fitting) else None
    if named and all(_bare(cell) is not None or not cell for cell in heading):  # units alone: the names stand above them
        heading, below = fitting[named - 1], heading
    if below and all(_bare(cell) is not None or not cell for cell in below):
        return [_with_unit(name, _bare(unit) or "") for name, unit in zip(heading, below, strict=True)]
    return heading


def _mismatch(named: int, columns: int, path: Path) -> str:
    return (
        f"{path}: its heading names {named} columns, its rows have {columns}; "
        "name each, and with decimal commas separate columns by semicolons"
    )


def is_wavelength(heading: str) -> bool:
    """Return whether a heading names wavelengths: by a word for them, or by a unit of length alone."""
    words = [word for word in re.split(SEPARATORS, heading) if word]
    lone = len(words) == 1 and words[0] not in ("m", "A") and units.length_nm(words[0]) is not None
    return bool(words) and (words[0].lower() in WAVELENGTH or lone)


def _bare(cell: str) -> str | None:
    """Return the unit that a cell holds and nothing else, in brackets or not."""
    inside = cell.strip("[]() ")
    return inside if inside and (units.parse(inside) is not None or inside.lower() in ("counts", "a.u.")) else None


def _with_unit(name: str, unit: str) -> str:
    """Return a heading with its unit in brackets, wavelengths without the unit of the others."""
    if not unit or (is_wavelength(name) and units.length_nm(unit) is None):
        return name
    return f"{name} ({unit})"


def _stated_unit(line: str) -> str | None:
    """Return the unit of all values that a line of the preamble states: "Units: µW/cm²/nm"."""
    found = UNIT_KEY.match(line)
    unit = found[1].strip(' ;,\t[]"') if found else ""
    return unit if unit and units.parse(unit) is not None and units.length_nm(unit) is None else None
