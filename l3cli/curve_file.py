"""CSV files of spectra, as spectrometers, spreadsheets and l3 itself write them.

A row is a wavelength and equally many values. Commas, semicolons, tabs or blanks separate them; between semicolons or tabs
a comma is a decimal point. A heading, the first line or the last comment (#) before the numbers, names the columns: the
wavelengths are where it says, other columns are known by their names whatever their order, and units in brackets are
converted. Without a heading the wavelengths, in nm, come first and the columns are in the order that is asked for.
"""

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
from l3cli.physics.spdx import read_spdx
from l3cli.table_text import SEPARATORS, is_wavelength, read_text_table

SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".spdx", ".xml")  # of files that may hold spectra
MOST_ROWS = 100_000
METRES, MICROMETRES, ANGSTROMS = 1e-3, 5.0, 2000.0  # what ends below the first or second, or begins above the third: no nm
Array = NDArray[np.float64]


def read_table(path: Path) -> CurveTable:
    """A CSV file of spectra; InputFileError if it is none, or if its wavelengths are not light's, in nm or as it says."""
    if path.suffix.lower() in (".spdx", ".xml"):
        return _spdx(path)
    text = read_text_table(path)
    heading, rows = text.heading, text.rows
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


def _spdx(path: Path) -> CurveTable:
    """The spectrum of an IES TM-27-14 file, in the unit of its quantity; InputFileError if it holds none."""
    try:
        wavelength, values, unit = read_spdx(path)
    except ValueError as error:
        raise InputFileError(f"{path} is no IES TM-27 spectrum ({error}); give one, or CSV") from error
    if wavelength.size < 2 or not _monotonic(wavelength) or not (np.abs(values) <= LARGEST).all():
        raise InputFileError(f"{path}: wavelengths must increase and every value be a number within ±{LARGEST:g}")
    if not (wavelength.min() > 0 and METRES < wavelength.max() <= LONGEST):
        raise InputFileError(f"{path}: give wavelengths within 0…{LONGEST} nm")
    order = np.argsort(wavelength)
    return CurveTable(path, wavelength[order], values[None, order], (path.stem,), (unit,))


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


def _wavelength_column(heading: Sequence[str], path: Path) -> tuple[int, float | None]:
    """Which column holds the wavelengths, and how many nm its unit has, if the heading says it."""
    named = [number for number, cell in enumerate(heading) if is_wavelength(cell)] or ([0] if not heading[0] else [])
    if len(named) != 1:
        which = " and ".join(f'"{heading[number][:40]}"' for number in named[:2]) or f'none of "{", ".join(heading)[:60]}"'
        raise InputFileError(f'{path}: {which} names the wavelengths; call one column "wavelength_nm"')
    words = [word for word in re.split(SEPARATORS, heading[named[0]]) if word]
    scales = [scale for scale in map(units.length_nm, words) if scale is not None]
    if not scales and re.search(r"[(\[/]", heading[named[0]]):
        raise InputFileError(f'{path}: "{heading[named[0]][:40]}" has no unit of wavelength; give nm, um or A')
    return named[0], scales[0] if scales else None
