"""CSV files of spectra, as spectrometers, spreadsheets and l3 itself write them.

A row is a wavelength and equally many values. Commas, semicolons, tabs or blanks separate them; between semicolons or tabs
a comma is a decimal point. A heading, the first line or the last comment (#) before the numbers, names the columns: the
wavelengths are where it says, other columns are known by their names whatever their order, and units in brackets are
converted. Without a heading the wavelengths, in nm, come first and the columns are in the order that is asked for.
"""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli import units
from l3cli.artifacts.camera import LONGEST
from l3cli.config import LARGEST
from l3cli.curve_table import CurveTable
from l3cli.errors import InputFileError
from l3cli.limits import read_bounded

MOST_ROWS = 100_000
WAVELENGTH = ("wavelength", "wavelengths", "lambda", "λ", "wl", "wave", "wvl")
METRES, MICROMETRES, ANGSTROMS = 1e-3, 5.0, 2000.0  # what ends below the first or second, or begins above the third: no nm
SEPARATORS = r"[\s_()\[\]/,]+"
Array = NDArray[np.float64]


def read_table(path: Path) -> CurveTable:
    """A CSV file of spectra; InputFileError if it is none, or if its wavelengths are not light's, in nm or as it says."""
    heading, rows = _rows(path)
    if len(rows) > MOST_ROWS:
        raise InputFileError(f"{path}: give {MOST_ROWS} wavelengths at most, within 0…{LONGEST} nm")
    table = np.array(rows)
    at, scale = (0, None) if heading is None else _wavelength_column(heading, path)
    wavelength = table[:, at] * (scale or 1.0)
    if scale in (None, 1.0) and (other := other_unit(float(wavelength.min()), float(wavelength.max()))):
        raise InputFileError(f'{path}: {other[0]}; name that column "wavelength_{other[1]}"')
    if not (np.abs(table) <= LARGEST).all() or not _monotonic(wavelength):
        raise InputFileError(f"{path}: wavelengths must increase and every value be a number within ±{LARGEST:g}")
    if not (wavelength.min() > 0 and METRES < wavelength.max() <= LONGEST):
        column = "" if scale is None or heading is None else f' ("{heading[at]}")'
        raise InputFileError(f"{path}: give {MOST_ROWS} wavelengths at most, within 0…{LONGEST} nm{column}")
    if wavelength[0] > wavelength[-1]:
        wavelength, table = wavelength[::-1], table[::-1]
    values = np.ascontiguousarray(np.delete(table, at, axis=1).T)
    if heading is None:
        return CurveTable(path, wavelength, values, None, (None,) * len(values))
    names, column_units = zip(*(units.split(name) for number, name in enumerate(heading) if number != at), strict=True)
    return CurveTable(path, wavelength, values, names, column_units)


def _monotonic(wavelength: Array) -> bool:
    steps = np.diff(wavelength)
    return bool((steps > 0).all() or (steps < 0).all())


def other_unit(first: float, last: float) -> tuple[str, str] | None:
    """What is wrong with a grid of wavelengths from `first` to `last` that ought to be in nm, and the unit they seem to be
    in; None if they may be in nm."""
    if first <= 0 or (last >= MICROMETRES and first <= ANGSTROMS):
        return None
    unit, nm = ("m", 1e9) if last < METRES else ("um", 1e3) if last < MICROMETRES else ("A", 0.1)
    return f"wavelengths {first:g}…{last:g} are no nm, but perhaps {first * nm:g}…{last * nm:g} nm in {unit}", unit


def _rows(path: Path) -> tuple[list[str] | None, list[list[float]]]:
    """The heading, if there is one, and the rows of numbers, all of one length."""
    try:
        lines = [
            line.strip(" \r")
            for line in read_bounded(path, "give a CSV file of spectra").decode("utf-8-sig").splitlines()
            if line.strip()
        ]
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputFileError(f"{path}: {reason}; give a CSV file of spectra") from error
    comments = list(itertools.takewhile(lambda line: line.startswith("#"), lines))
    lines = [line for line in lines if not line.startswith("#")]
    separator = next((each for each in ";\t," if any(each in line for line in lines)), None)
    cells = [[cell.strip() for cell in line.split(separator)] for line in lines]
    heading = cells.pop(0) if cells and not _is_number(cells[0][0], separator) else None
    rows = [_numbers(row, separator, path) for row in cells]
    if separator in (";", "\t") and {",", "."} <= {
        letter for row in cells for cell in row for letter in cell if letter in ",."
    }:
        raise InputFileError(f"{path}: numbers have commas and points; write decimals with one of them, thousands with none")
    if not rows or len({len(row) for row in rows}) != 1 or len(rows[0]) < 2:
        raise InputFileError(f"{path}: rows must be a wavelength in nm and equally many values each")
    if heading is None and comments:  # as numpy writes a heading
        names = [cell.strip() for cell in comments[-1].lstrip("# ").split(separator)]
        heading = names if len(names) == len(rows[0]) and any(map(_is_wavelength, names)) else None
    if heading is not None and len(heading) != len(rows[0]):
        raise InputFileError(
            f"{path}: its heading names {len(heading)} columns, its rows have {len(rows[0])}; "
            "name each, and with decimal commas separate columns by semicolons"
        )
    return heading, rows


def _numbers(row: list[str], separator: str | None, path: Path) -> list[float]:
    """The cells of a row, between semicolons or tabs with decimal commas or points."""
    try:
        return [float(_with_point(cell, separator)) for cell in row]
    except ValueError:
        raise InputFileError(f'{path}: "{(separator or " ").join(row)[:40]}" is not a row of numbers') from None


def _with_point(cell: str, separator: str | None) -> str:
    return cell.replace(",", ".") if separator in (";", "\t") else cell


def _is_number(cell: str, separator: str | None) -> bool:
    try:
        float(_with_point(cell, separator))
    except ValueError:
        return False
    return True


def _wavelength_column(heading: Sequence[str], path: Path) -> tuple[int, float | None]:
    """Which column holds the wavelengths, and how many nm its unit has, if the heading says it."""
    named = [number for number, cell in enumerate(heading) if _is_wavelength(cell)] or ([0] if not heading[0] else [])
    if len(named) != 1:
        which = " and ".join(f'"{heading[number][:40]}"' for number in named[:2]) or f'none of "{", ".join(heading)[:60]}"'
        raise InputFileError(f'{path}: {which} names the wavelengths; call one column "wavelength_nm"')
    words = [word for word in re.split(SEPARATORS, heading[named[0]]) if word]
    scales = [scale for scale in map(units.length_nm, words) if scale is not None]
    if not scales and re.search(r"[(\[/]", heading[named[0]]):
        raise InputFileError(f'{path}: "{heading[named[0]][:40]}" has no unit of wavelength; give nm, um or A')
    return named[0], scales[0] if scales else None


def _is_wavelength(heading: str) -> bool:
    words = [word for word in re.split(SEPARATORS, heading) if word]
    lone = len(words) == 1 and words[0] not in ("m", "A") and units.length_nm(words[0]) is not None
    return bool(words) and (words[0].lower() in WAVELENGTH or lone)
