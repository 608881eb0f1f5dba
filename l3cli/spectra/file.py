"""Read files of spectra. `read_table` reads every format in FORMATS. Most of this module reads text tables.

A text table is delimited text from a spectrometer, a spreadsheet or l3. Each row contains a wavelength and one value per
curve. Columns are separated by commas, semicolons, tabs or blanks. Commas are decimal points if the separator is a semicolon
or a tab. The heading with the column names is the first line, or the last comment (#) before the numbers. It identifies the
column of wavelengths. The other columns may be in any order, and units in brackets are converted. Without a heading, the
first column contains the wavelengths in nm, and the other columns must be in the order that the caller expects.

CGATS and JCAMP-DX files are recognised by their first line. IES TM-27-14 files (Illuminating Engineering Society, Standard
Format for the Electronic Transfer of Spectral Data) are read with colour-science.

Text may be in UTF-8, UTF-16 or Windows-1252. Lines of text may precede the numbers, such as `Key: value` or the marker
`>>>>>Begin Spectral Data<<<<<`.
"""

import codecs
import contextlib
import csv
import itertools
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import ParseError

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.physics.spectra import LONGEST_NM, colour_science
from l3cli.recipes.toml import MAX_NUMBER
from l3cli.spectra import units
from l3cli.spectra.cgats import is_cgats, read_cgats
from l3cli.spectra.jcamp import is_jcamp, read_jcamp
from l3cli.spectra.table import CurveTable, gaps
from l3cli.system.limits import read_bounded

CURE = "use a CSV file with spectra"
MARKER = re.compile(r"^(?:>{3,}|<{3,}|\*{3,}|={3,}|-{3,}|\+{3,})")
EXCEL_SEPARATOR = re.compile(r'"?sep=.?"?', re.I)  # optional first line that defines the separator for Excel
CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")  # control characters, which do not occur in text
UNIT_KEY = re.compile(
    r"^(?:y[- ]?(?:axis|unit)|(?:spectral |radiometric |measurement )?units?)\b[^:;=,\t]*[:;=,\t]\s*(.+)$", re.I
)
QUALITY = re.compile(r"\d{5}")  # quality code that Photo Research instruments write before a measurement
# A table is transposed if one of its rows contains at least SIDEWAYS wavelengths, all within the range LIGHT in nm.
SIDEWAYS, LIGHT = 10, (150.0, 5000.0)
WAVELENGTH = ("wavelength", "wavelengths", "lambda", "λ", "wl", "wave", "wvl", "wellenlänge")
JAZ = {"d", "r", "s", "p"}  # columns of the Ocean Optics Jaz spectrometer: dark, reference, sample, processed result
SEPARATORS = r"[\s_()\[\]/,]+"
Cells = list[str]
DigitisedCurve = tuple[str, list[tuple[float, float]]]  # name of a curve; X (nm) and Y of each point


@dataclass(frozen=True)
class TextTable:
    """The numbers in a text table, and the names of its columns."""

    heading: Cells | None  # column names, or None without a heading
    rows: list[list[float]]  # rows of equal length, or an empty list if the file contains digitised curves
    pairs: tuple[DigitisedCurve, ...] = ()  # digitised curves
    faults: tuple[str, ...] = ()  # faults in the digitised curves


def _text_table(text: str, path: Path) -> TextTable:
    """Parse a text table: find the separator, the rows of numbers, the heading and the units.

    Raises InputFileError if the text contains no table or an invalid row.
    """
    lines = [line.strip(" \r") for line in text.splitlines() if line.strip()]
    comments = list(itertools.takewhile(lambda line: line.startswith("#"), lines))
    lines = [line for line in lines if not line.startswith("#")]
    if lines and EXCEL_SEPARATOR.fullmatch(lines[0]):
        lines = lines[1:]
    while lines and MARKER.match(lines[-1]):
        lines.pop()
    separator, decimal_comma = _separator(lines)
    cells = _without_last([_split(line, separator) for line in lines], decimal_comma)
    pairs, faults = _pairs(cells, decimal_comma)
    if pairs:
        return TextTable(None, [], pairs, faults)
    cells = _upright(cells, decimal_comma)
    rows, before = _numbers(cells, separator, decimal_comma, path)
    heading = _heading(before, len(rows[0]), decimal_comma, path)
    if heading is None and comments:  # numpy.savetxt writes the heading as a comment
        names = _split(comments[-1].lstrip("# "), separator)
        heading = names if len(names) == len(rows[0]) and any(map(is_wavelength, names)) else None
    if heading is not None and heading[0] == "W" and "P" in heading and {*map(str.lower, heading[1:])} <= JAZ:
        heading = ["nm", *heading[1:]]
    if heading is not None and not any(unit for _, unit in map(units.split, heading)):
        stated = next(filter(None, (_stated_unit(line) for line in lines[: len(before)])), None)
        heading = heading if stated is None else [_with_unit(name, stated) for name in heading]
    elif heading is None and (stated := next(filter(None, map(_stated_unit, lines[: len(before)])), None)):
        heading = ["nm", *(_with_unit(f"{number}", stated) for number in range(1, len(rows[0])))]
    return TextTable(heading, rows)


def _text(path: Path) -> str:
    """Read a text file in UTF-8, UTF-16 or Windows-1252. Raises InputFileError if the file is not text."""
    try:
        content = read_bounded(path, CURE)
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return content.decode("utf-16")
        if content[1:64:2].count(0) > len(content[1:64:2]) // 2:  # the text is UTF-16 without a byte order mark
            return content.decode("utf-16-le")
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError:
            if CONTROL.search(content):
                raise
            return content.decode("cp1252")
    except UnicodeDecodeError as error:
        raise InputFileError(f"{path} is not a text file; {CURE}") from error


def _separator(lines: Sequence[str]) -> tuple[str | None, bool]:
    """Detect the column separator (None for blanks), and whether commas are decimal points.

    Both follow from the last line that begins with a number.
    """
    last = next((line for line in reversed(lines) if re.match(r"[-+.]?\d", line)), lines[-1] if lines else "")
    for separator in ";\t":
        if separator in last:
            return separator, True
    if "," in last and re.search(r"\d\s+[-+]?\d", last):  # for example "380 0,0123"
        return None, True
    return ("," if "," in last else None), False


def _split(line: str, separator: str | None) -> Cells:
    """Split a line into cells at a separator (None for blanks). Cells in quotation marks may contain the separator."""
    if separator is None:
        return line.split()
    cells = line.split(separator)
    if '"' in line:
        with contextlib.suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator))
    return [cell.strip() for cell in cells]


def _without_last(cells: list[Cells], decimal_comma: bool) -> list[Cells]:
    """Remove the empty last column if all rows of numbers end with a separator."""
    rows = [row for row in cells if _is_number(row[0], decimal_comma)]
    if not rows or any(len(row) < 3 or row[-1] for row in rows):
        return cells
    return [row[:-1] if len(row) > 1 and not row[-1] else row for row in cells]


def _number(cell: str, decimal_comma: bool) -> float:
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
    """Return the rows of numbers at the end of a file, and the lines before these rows.

    Raises InputFileError if the file does not end with rows of numbers. Also raises it if other text separates rows of
    numbers, because this text is probably a damaged row.
    """
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
        raise InputFileError(f'{path}: "{(separator or " ").join(wrong)[:40]}" is not a row of numbers; correct this row')
    if decimal_comma and {",", "."} <= {letter for row in rows for cell in row for letter in cell if letter in ",."}:
        raise InputFileError(f"{path}: the numbers contain both commas and points; use a single decimal separator")
    if not rows or len({len(row) for row in rows}) != 1 or len(rows[0]) < 2:
        raise InputFileError(
            f"{path} is not a table with a wavelength in nm and the same number of values in each row; correct the file"
        )
    return [[_number(cell, decimal_comma) for cell in row] for row in rows], before


def _pairs(cells: list[Cells], decimal_comma: bool) -> tuple[tuple[DigitisedCurve, ...], tuple[str, ...]]:
    """Return the digitised curves in a text (X and Y of each point), and a message for each error in them.

    If there are no digitised curves, both results are empty. Programs for digitising plots write several curves in one of
    two forms:

    1. The curves are side by side, each with a column for X and a column for Y. If the heading has two lines, the names of
       the curves are above X, Y, X, Y, …. If it has one line, each column for X has a word for wavelength as its heading,
       and each column for Y the name of the curve.
    2. The curves follow one another, each with its own heading.
    """
    numeric = [_is_number(row[0], decimal_comma) for row in cells]
    above = [_is_lettered(row) or follows for row, follows in zip(cells, [*numeric, False][1:], strict=True)]
    heads = [(number, pairs) for number, row in enumerate(cells) if above[number] and (pairs := _pair_heads(row))]
    lettered = [_is_lettered(cells[number]) for number, _ in heads]
    if not heads or (len(heads) == 1 and not lettered[0] and len(heads[0][1]) < 2):
        return (), ()
    curves: list[DigitisedCurve] = []
    faults: list[str] = []
    for which, (number, pairs) in enumerate(heads):
        end = heads[which + 1][0] if which + 1 < len(heads) else len(cells)
        rows = cells[number + 1 : end]
        if which + 1 < len(heads) and lettered[which + 1] and rows and not numeric[end - 1]:
            rows.pop()  # remove the line with the names of the next curves
        names = cells[number - 1] if number and lettered[which] and not numeric[number - 1] else []
        for place, (x_head, y_head) in enumerate(pairs):
            name = (names[2 * place] if len(names) > 2 * place else "") if lettered[which] else y_head
            _, unit = units.split(y_head)
            if unit and lettered[which]:
                name = f"{name} ({unit})"
            label = f"curve {len(curves) + 1}" + (f" ({name})" if name else "")
            points = [point for row in rows if any(point := row[2 * place : 2 * place + 2])]
            wrong = [point for point in points if len(point) < 2 or not _all_numbers(point, decimal_comma)]
            if wrong:
                more = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
                faults.append(f'"{", ".join(wrong[0])[:40]}"{more} in {label} is not a pair of X and Y')
            elif not points:
                faults.append(f"{label} has no points")
            scale = units.length_nm(units.split(x_head)[1] or "nm") or 1.0
            kept = [point for point in points if point not in wrong]
            curve = [(_number(x, decimal_comma) * scale, _number(y, decimal_comma)) for x, y in kept]
            curves.append((name, curve))
    return tuple(curves), tuple(faults)


def _pair_heads(row: Cells) -> list[tuple[str, str]]:
    """Split a row into pairs of headings (X, Y), or return an empty list if this is impossible."""
    cells = [cell for cell in row if cell]
    pairs = list(zip(cells[::2], cells[1::2], strict=False))
    if not pairs or len(cells) % 2 or any(not (_is_x(x) and not _is_x(y)) for x, y in pairs):
        return []
    return pairs


def _is_x(cell: str) -> bool:
    return units.split(cell)[0].casefold() == "x" or is_wavelength(cell)


def _is_lettered(row: Cells) -> bool:
    """Whether a row of headings starts with X, Y, so that the line above contains the names of the curves."""
    first = itertools.islice(filter(None, row), 2)
    return [units.split(cell)[0].casefold() for cell in first] == ["x", "y"]


def _all_numbers(row: Cells, decimal_comma: bool) -> bool:
    return all(_is_number(cell, decimal_comma) for cell in row)


def _upright(cells: list[Cells], decimal_comma: bool) -> list[Cells]:
    """Transpose a table if its wavelengths are in a row, so that there is one row per wavelength."""
    for number, row in enumerate(cells):
        if len(row) <= SIDEWAYS or _is_number(_without_nm(row[0]), decimal_comma):
            continue  # the row contains no wavelengths
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
        named = len(first) > 2 and _all_numbers(first, decimal_comma)
        if named and _is_grid([_number(each, decimal_comma) for each in first]):
            return cells  # the first column also contains wavelengths, so the table is already upright
        names = [" ".join(filter(None, other[:labels])) for other in spectra]
        return [*cells[:number], ["nm", *names], *map(list, zip(grid, *(other[labels:] for other in spectra), strict=True))]
    return cells


def _without_nm(cell: str) -> str:
    return re.sub(r"\s*\[?\(?nm\)?\]?$", "", cell)


def _is_grid(values: Sequence[float]) -> bool:
    """Whether numbers are plausible wavelengths in nm, in increasing or decreasing order."""
    ordered = sorted(values)
    return LIGHT[0] <= ordered[0] and ordered[-1] <= LIGHT[1] and len(set(values)) == len(values) and (
        list(values) in (ordered, ordered[::-1])
    )  # fmt: skip


# -------------------------------------------------------------------------------------------------------- headings


def _heading(before: list[Cells], columns: int, decimal_comma: bool, path: Path) -> Cells | None:
    """Find the column names in the lines before the numbers, or return None if there is no heading.

    Units on the line below the names are appended to the names. Raises InputFileError if the heading and the rows have
    different numbers of columns.
    """
    if not before:
        return None
    if len(before) == 1 and not QUALITY.fullmatch(before[0][0]) and not MARKER.match(before[0][0]):
        if len(before[0]) == columns:
            return before[0]
        if len(before[0]) == 1 and not is_wavelength(before[0][0]):
            return None  # the line is a title, not a heading
        raise InputFileError(_mismatch(len(before[0]), columns, path))
    fitting = [row for row in before if len(row) == columns]
    named = next((number for number in reversed(range(len(fitting))) if any(map(is_wavelength, fitting[number]))), None)
    if named is None:
        other = next((row for row in reversed(before) if len(row) > 1 and any(map(is_wavelength, row))), None)
        if other is not None:
            raise InputFileError(_mismatch(len(other), columns, path))
        last = before[-1]
        return last if len(last) == columns > 2 and not any(_is_number(cell, decimal_comma) for cell in last) else None
    heading = fitting[named]
    below = fitting[named + 1] if named + 1 < len(fitting) else None
    if named and all(_bare(cell) is not None or not cell for cell in heading):  # a line of units, below the names
        heading, below = fitting[named - 1], heading
    if below and all(_bare(cell) is not None or not cell for cell in below):
        return [_with_unit(name, _bare(unit) or "") for name, unit in zip(heading, below, strict=True)]
    return heading


def _mismatch(named: int, columns: int, path: Path) -> str:
    return (
        f"{path}: the heading has {named} columns, but the rows have {columns}; "
        "name every column, begin title lines with #, and separate columns by semicolons if commas are decimal points"
    )


def is_wavelength(heading: str) -> bool:
    """Whether a heading identifies a column of wavelengths.

    Such a heading begins with a word for wavelength, or consists only of a unit of length other than "m" and "A".
    """
    words = [word for word in re.split(SEPARATORS, heading) if word]
    lone = len(words) == 1 and words[0] not in ("m", "A") and units.length_nm(words[0]) is not None
    return bool(words) and (words[0].lower() in WAVELENGTH or lone)


def _bare(cell: str) -> str | None:
    """Return the unit in a cell without its brackets, or None if the cell contains anything else."""
    inside = cell.strip("[]() ")
    known = units.parse(inside) is not None or units.RAW.fullmatch(inside) or inside.lower() == "a.u."
    return inside if inside and (known or re.fullmatch(r"% ?\w+", inside)) else None


def _with_unit(name: str, unit: str) -> str:
    """Append a unit in brackets to a column heading. A heading of wavelengths gets only units of length."""
    if not unit or (is_wavelength(name) and units.length_nm(unit) is None):
        return name
    return f"{name} ({unit})"


def _stated_unit(line: str) -> str | None:
    """Return the unit of values from a line such as "Units: µW/cm²/nm", or None for any other line."""
    found = UNIT_KEY.match(line)
    unit = found[1].strip(' ;,\t[]"') if found else ""
    known = units.RAW.fullmatch(unit) or (units.parse(unit) is not None and units.length_nm(unit) is None)
    return unit if unit and known else None


MOST_ROWS = 100_000  # maximum number of wavelengths in a text table
WIDEST_GAP = 20.0  # maximum distance between neighbouring points of a digitised curve, in nm
PLOT_EDGE_NM = 5.0  # distance from the edge of the plot within which a curve is assumed to continue beyond the edge
FOOT = 0.05  # largest last value of a curve that ends inside the plot, as a fraction of its peak
JITTER = 0.02  # largest tolerated negative value of a digitised curve, as a fraction of its peak
# Wavelengths are probably in m if all are below METRES, in µm if all are below MICROMETRES, and in Å if all are above
# ANGSTROMS.
METRES, MICROMETRES, ANGSTROMS = 1e-3, 5.0, 2000.0
SPDX = (".spdx", ".xml")
SPDX_UNITS = {  # units by spectral quantity in an IES TM-27 file
    "radiance": "W/(sr m² nm)",
    "irradiance": "W/(m² nm)",
    "exitance": "W/(m² nm)",
    "intensity": "W/(sr nm)",
    "flux": "W/nm",
    "relative": "relative power",
    "other": None,
}
READINGS = ("dark", "ref", "reference", "sample", "scope", "white")  # column names of raw readings
Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpectrumFormat:
    """A file format for spectra. docs/own-lab.md lists all formats."""

    name: str
    suffixes: tuple[str, ...]  # file suffixes in lower case; comparisons ignore case
    holds: str  # description of what l3 reads, for the documentation
    is_of: Callable[[str], bool] | None  # tests whether a text has this format, or None if the suffix determines the format
    read: Callable[[str, Path], CurveTable]  # reads the text of a file, given its path for messages


def read_table(path: Path) -> CurveTable:
    """Read a file of spectra in one of the FORMATS.

    Parameters
    ----------
    path : Path
        The file. The suffixes .spdx and .xml indicate IES TM-27. Otherwise, the content determines the format.

    Returns
    -------
    CurveTable
        The columns of the file, with increasing wavelengths in nm.

    Raises
    ------
    InputFileError
        If the file does not exist or is invalid, or if the wavelengths are implausible in the stated unit. The
        unit is nm if the file states none.
    """
    if path.suffix.lower() in SPDX:
        return _spdx("", path)
    text = _text(path)
    return next(each for each in FORMATS if each.is_of is not None and each.is_of(text)).read(text, path)


def names_file(name: str) -> bool:
    """Whether the name of an illuminant, chart or transmittance is a file name with one of SUFFIXES."""
    return name.lower().endswith(SUFFIXES)


def _cgats(content: str, path: Path) -> CurveTable:
    """Read a CGATS file into a table with one column per sample."""
    spectra = read_cgats(content, path)
    return _over_wavelengths(path, spectra.wavelength, spectra.values, spectra.names, spectra.unit)


def _jcamp(content: str, path: Path) -> CurveTable:
    return _over_wavelengths(path, *read_jcamp(content, path))


def _over_wavelengths(path: Path, wavelength: Array, values: Array, names: tuple[str, ...], unit: str | None) -> CurveTable:
    """Build a table from curves (column, wavelength) with a common unit, sorted by wavelength.

    Raises InputFileError if a value is not finite, or if the wavelengths are not monotonic or not plausible in nm.
    """
    _require_light(path, wavelength, values)
    if other := other_unit(float(wavelength.min()), float(wavelength.max())):
        raise InputFileError(f"{path}: {other[0]}; export wavelengths in nm")
    order = np.argsort(wavelength)
    return CurveTable(path, wavelength[order], values[:, order], names, (unit,) * len(values))


def _result(table: CurveTable) -> CurveTable:
    """Remove columns with raw readings if exactly one other column remains.

    This column is the instrument's result. For example, Avantes writes the columns Sample, Dark and Reference in counts, and
    Transmittance in percent.
    """
    if table.names is None or len(table.values) < 2:
        return table
    plain = [name.strip().lower() for name in table.names]
    if {"s", "p"} <= set(plain) <= JAZ:
        results = [plain.index("p")]
    else:
        results = [number for number, unit in enumerate(table.units) if unit is None or not units.RAW.fullmatch(unit)]
        if not all(name in READINGS or number in results for number, name in enumerate(plain)):
            return table
    if len(results) != 1:
        return table
    at = slice(results[0], results[0] + 1)
    left_out = tuple(name for number, name in enumerate(table.names) if number != results[0])
    return replace(table, values=table.values[at], names=table.names[at], units=table.units[at], left_out=left_out)


def _text_curves(content: str, path: Path) -> CurveTable:
    """Read the curves in a text table, sorted by wavelength.

    Raises InputFileError if the table is invalid or has too many rows, or if the wavelengths are implausible in their unit.
    """
    text = _text_table(content, path)
    if text.pairs:
        return _digitised(text.pairs, text.faults, path)
    heading, rows = text.heading, text.rows
    if len(rows) > MOST_ROWS:
        raise InputFileError(f"{path} has {len(rows)} wavelengths, but l3 reads at most {MOST_ROWS}; remove some")
    table = np.array(rows)
    at, scale = (0, None) if heading is None else _wavelength_column(heading, path)
    wavelength = table[:, at] * (scale or 1.0)
    if scale in (None, 1.0) and (other := other_unit(float(wavelength.min()), float(wavelength.max()))):
        raise InputFileError(f'{path}: {other[0]}; rename the wavelength column to "wavelength_{other[1]}"')
    column = "" if scale is None or heading is None else f' ("{heading[at]}")'
    _require_light(path, wavelength, table, column)
    if wavelength[0] > wavelength[-1]:
        wavelength, table = wavelength[::-1], table[::-1]
    values = np.ascontiguousarray(np.delete(table, at, axis=1).T)
    if heading is None:
        return CurveTable(path, wavelength, values, None, (None,) * len(values))
    names, column_units = zip(*(units.split(name) for number, name in enumerate(heading) if number != at), strict=True)
    return _result(CurveTable(path, wavelength, values, names, column_units))


def _digitised(curves: Sequence[DigitisedCurve], faults: Sequence[str], path: Path) -> CurveTable:
    """Interpolate digitised curves to steps of 1 nm. The points of a curve may be in any order.

    All curves are extended to the wavelength range of the plot. A curve that ends at an edge of the plot continues with its
    last value. A curve that ends inside the plot continues with zeros. If the curves have faults, InputFileError is raised
    with a list of all faults.
    """
    wrong = list(faults)
    lines = [np.array(sorted(points), np.float64).reshape(-1, 2).T for _, points in curves]
    every = np.concatenate([x for x, _ in lines])
    if every.size and (other := other_unit(float(every.min()), float(every.max()))):
        wrong.append(f"{other[0]}; convert X to nm")
    elif not all((np.abs(line) <= MAX_NUMBER).all() for line in lines) or every.max(initial=0.0) > LONGEST_NM:
        wrong.append(f"an X is not within 0…{LONGEST_NM} nm, or a Y is not a number within ±{MAX_NUMBER:g}")
    elif every.size:
        grid = np.arange(np.ceil(every.min()), np.floor(every.max()) + 1.0)
        wrong += [fault for (name, _), line in zip(curves, lines, strict=True) for fault in _curve_faults(name, line, grid)]
    if wrong or not every.size:
        raise InputFileError(f"{path}: {'; '.join(wrong)}; digitise the curve{'s' * (len(curves) != 1)} again")
    values = []
    for x, y in lines:
        y = np.where((y < 0) & (y >= -JITTER * y.max()), 0.0, y)
        left, right = (y[0] if x[0] <= grid[0] + PLOT_EDGE_NM else 0.0), (y[-1] if x[-1] >= grid[-1] - PLOT_EDGE_NM else 0.0)
        values.append(np.interp(grid, x, y, left, right))
    names, column_units = zip(*(units.split(name) for name, _ in curves), strict=True)
    return CurveTable(path, grid, np.array(values), names if any(names) else None, column_units)


def _curve_faults(name: str, line: Array, grid: Array) -> Iterator[str]:
    """Yield the faults in a digitised curve `line` (X and Y, point). `grid` contains the wavelengths of the whole plot."""
    x, y = line
    if x.size < 2:
        if x.size:
            yield f'"{name}" has only one point'
        return
    peak = float(y.max())
    for first, last in gaps(x, y[None], WIDEST_GAP):
        yield f'"{name}" has a gap from {first:g} to {last:g} nm, which is wider than the limit of {WIDEST_GAP:g} nm'
    for end, inside in ((0, x[0] > grid[0] + PLOT_EDGE_NM), (-1, x[-1] < grid[-1] - PLOT_EDGE_NM)):
        if inside and y[end] > FOOT * peak:
            yield f'"{name}" ends at {x[end]:g} nm, where its value is still {y[end] / peak:.0%} of the peak'


def _spdx(_: str, path: Path) -> CurveTable:
    """Read an IES TM-27-14 file. Its spectral quantity determines the unit. Raises InputFileError if it is invalid."""
    read_bounded(path, CURE)
    colour = colour_science()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spectrum = colour.SpectralDistribution_IESTM2714(str(path)).read()
        wavelength, values = np.asarray(spectrum.wavelengths, np.float64), np.asarray(spectrum.values, np.float64)
    except (ParseError, OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise InputFileError(f"{path} is not an IES TM-27 spectrum ({reason}); use a valid file or a CSV table") from error
    _require_light(path, wavelength, values)
    order = np.argsort(wavelength)
    unit = SPDX_UNITS.get((spectrum.spectral_quantity or "other").lower())
    return CurveTable(path, wavelength[order], values[None, order], (path.stem,), (unit,))


def _require_light(path: Path, wavelength: Array, values: Array, column: str = "") -> None:
    """Raise InputFileError unless the wavelengths are monotonic and plausible in nm, and all values are finite.

    `column` identifies the wavelength column in the message.
    """
    steps = np.diff(wavelength)
    if not (np.abs(values) <= MAX_NUMBER).all() or not ((steps > 0).all() or (steps < 0).all()):
        raise InputFileError(
            f"{path}: the wavelengths are not in order, or a value is not a number within ±{MAX_NUMBER:g}; correct the file"
        )
    if not (wavelength.size and wavelength.min() > 0 and METRES < wavelength.max() <= LONGEST_NM):
        raise InputFileError(f"{path}: some wavelengths{column} are not within 0…{LONGEST_NM} nm; correct the file")


def other_unit(first: float, last: float) -> tuple[str, str] | None:
    """Detect wavelengths that are probably in m, µm or Å instead of nm.

    Parameters
    ----------
    first, last : float
        Smallest and largest wavelength.

    Returns
    -------
    tuple of str, or None
        Description of the fault, and the probable unit ("m", "um" or "A"). None if the wavelengths are plausible in nm, or
        if `first` is not positive.
    """
    if first <= 0 or (last >= MICROMETRES and first <= ANGSTROMS):
        return None
    unit, nm = ("m", 1e9) if last < METRES else ("um", 1e3) if last < MICROMETRES else ("A", 0.1)
    return (
        f"the wavelengths {first:g}…{last:g} are implausible in nm, but in {unit} they are {first * nm:g}…{last * nm:g} nm",
        unit,
    )


def _wavelength_column(heading: Sequence[str], path: Path) -> tuple[int, float | None]:
    """Return the index of the wavelength column, and the factor from its unit to nm. Without a unit, the factor is None.

    Raises InputFileError unless exactly one column contains wavelengths.
    """
    named = [number for number, cell in enumerate(heading) if is_wavelength(cell)] or ([0] if not heading[0] else [])
    if len(named) != 1:
        names = " and ".join(f'"{heading[number][:40]}"' for number in named[:2])
        fault = f"the columns {names} both contain" if names else f'no column of "{", ".join(heading)[:60]}" contains'
        raise InputFileError(
            f'{path}: {fault} wavelengths; name exactly one column "wavelength_nm", and begin title lines with #'
        )
    words = [word for word in re.split(SEPARATORS, heading[named[0]]) if word]
    scales = [scale for scale in map(units.length_nm, words) if scale is not None]
    if not scales and re.search(r"[(\[/]", heading[named[0]]):
        raise InputFileError(f'{path}: the heading "{heading[named[0]][:40]}" has no unit of length; use nm, um or A')
    return named[0], scales[0] if scales else None


FORMATS = (
    SpectrumFormat("IES TM-27", SPDX, "one spectrum, in the unit that the file states", None, _spdx),
    SpectrumFormat(
        "CGATS.17, ArgyllCMS",
        (".sp", ".ti3", ".cie", ".ccss", ".cgats"),
        "illuminants, reflectances and charts; the spectral fields must have names such as SPEC_380, SPECTRAL_NM380 or "
        "nm380",
        is_cgats,
        _cgats,
    ),
    SpectrumFormat(
        "JCAMP-DX",
        (".jdx", ".dx", ".jcamp"),
        "one spectrum, with wavelengths in nm, µm or Å, compressed (ASDF) or uncompressed; from a file written by "
        "SpectraSuite, l3 reads the processed spectrum",
        is_jcamp,
        _jcamp,
    ),
    SpectrumFormat(
        "text table",
        (".csv", ".tsv", ".txt", ".dat", ".asc", ".spd", ".irr", ".trm", ".trt", ".ttt", ".jaz", ".jazirrad"),
        "one row per wavelength or one row per spectrum, from spreadsheets, CIE data, WebPlotDigitizer, or instruments by "
        "Ocean Optics (SpectraSuite, OceanView, Jaz), Avantes, StellarNet, Konica Minolta and Photo Research",
        lambda _: True,
        _text_curves,
    ),
)
SUFFIXES = tuple(suffix for each in FORMATS for suffix in each.suffixes)


def formats_table() -> str:
    """Return FORMATS as a Markdown table for docs/own-lab.md."""
    rows = [f"| {each.name} | {' '.join(f'`{suffix}`' for suffix in each.suffixes)} | {each.holds} |" for each in FORMATS]
    return "\n".join(["| format | suffixes | content |", "|---|---|---|", *rows])
