"""Files of spectra: CSV, as spectrometers, spreadsheets and l3 itself write them, and IES TM-27-14.

A row of CSV is a wavelength and equally many values. Commas, semicolons, tabs or blanks separate them; between semicolons or
tabs a comma is a decimal point. A heading, the first line or the last comment (#) before the numbers, names the columns: the
wavelengths are where it says, other columns are known by their names whatever their order, and units in brackets are
converted. Without a heading the wavelengths, in nm, come first and the columns are in the order that is asked for. Curves
digitised from a plot, pairs of X in nm and Y each, are laid on one grid of 1 nm. IES TM-27-14 (Illuminating Engineering
Society, Standard Format for the Electronic Transfer of Spectral Data) is read through colour-science.
"""

import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import ParseError

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import LONGEST
from l3cli.errors import InputFileError
from l3cli.physics.spectra import colour_science
from l3cli.recipes.toml import LARGEST
from l3cli.spectra import units
from l3cli.spectra.table import CurveTable
from l3cli.spectra.text import SEPARATORS, is_wavelength, read_text_table
from l3cli.system.limits import MOST_TEXT

SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".spdx", ".xml")  # of files that may hold spectra
MOST_ROWS = 100_000
WIDEST_GAP = 20.0  # nm between points of a digitised curve
EDGE = 5.0  # nm from where the first curve begins or the last one ends: others end there with the plot
FOOT = 0.05  # of a digitised curve's peak: below it a curve may end within the plot, and is zero beyond
JITTER = 0.02  # of its peak that a digitised curve may lie below zero
METRES, MICROMETRES, ANGSTROMS = 1e-3, 5.0, 2000.0  # what ends below the first or second, or begins above the third: no nm
SPDX = (".spdx", ".xml")
SPDX_UNITS = {  # of each quantity that the standard has
    "radiance": "W/(sr m² nm)",
    "irradiance": "W/(m² nm)",
    "exitance": "W/(m² nm)",
    "intensity": "W/(sr nm)",
    "flux": "W/nm",
    "relative": "relative power",
    "other": None,
}
Array = NDArray[np.float64]


def read_table(path: Path) -> CurveTable:
    """Return the curves of a file of spectra; InputFileError if it is none, or if its wavelengths are not light's, in nm or
    as it says."""
    if path.suffix.lower() in SPDX:
        return _spdx(path)
    text = read_text_table(path)
    if text.pairs:
        return _digitised(text.pairs, path)
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


def _digitised(curves: Sequence[tuple[str, Sequence[tuple[float, float]]]], path: Path) -> CurveTable:
    """Return the curves of points in any order, interpolated every nm; each is zero beyond its ends, but at the edges of the
    plot."""
    lines = [np.array(sorted(points)).T for _, points in curves]
    every = np.concatenate([x for x, _ in lines])
    if other := other_unit(float(every.min()), float(every.max())):
        raise InputFileError(f"{path}: {other[0]}; give X in nm")
    if not (all((np.abs(line) <= LARGEST).all() for line in lines) and every.max() <= LONGEST):
        raise InputFileError(f"{path}: X must lie within 0…{LONGEST} nm and every Y be a number within ±{LARGEST:g}")
    grid = np.arange(np.ceil(every.min()), np.floor(every.max()) + 1.0)
    values = []
    for (name, _), (x, y) in zip(curves, lines, strict=True):
        gaps, peak = np.diff(x), y.max()
        if not gaps.size or gaps.max() > WIDEST_GAP:
            where = f" between {x[gaps.argmax()]:g} and {x[gaps.argmax() + 1]:g} nm" if gaps.size else ""
            raise InputFileError(f'{path}: "{name}" has a gap{where}; digitise it at least every {WIDEST_GAP:g} nm')
        for end, inside in ((0, x[0] > grid[0] + EDGE), (-1, x[-1] < grid[-1] - EDGE)):
            if inside and y[end] > FOOT * peak:
                share = f"{y[end] / peak:.0%} of its peak"
                raise InputFileError(f'{path}: "{name}" ends at {x[end]:g} nm, at {share}; digitise it down to its foot')
        y = np.where((y < 0) & (y >= -JITTER * peak), 0.0, y)
        left, right = (y[0] if x[0] <= grid[0] + EDGE else 0.0), (y[-1] if x[-1] >= grid[-1] - EDGE else 0.0)
        values.append(np.interp(grid, x, y, left, right))
    names, column_units = zip(*(units.split(name) for name, _ in curves), strict=True)
    return CurveTable(path, grid, np.array(values), names if any(names) else None, column_units)


def _spdx(path: Path) -> CurveTable:
    """Return the spectrum of an IES TM-27-14 file, in the unit of its quantity; InputFileError if it holds none."""
    try:
        wavelength, values, unit = _read_spdx(path)
    except ValueError as error:
        raise InputFileError(f"{path} is no IES TM-27 spectrum ({error}); give one, or CSV") from error
    if wavelength.size < 2 or not _monotonic(wavelength) or not (np.abs(values) <= LARGEST).all():
        raise InputFileError(f"{path}: wavelengths must increase and every value be a number within ±{LARGEST:g}")
    if not (wavelength.min() > 0 and METRES < wavelength.max() <= LONGEST):
        raise InputFileError(f"{path}: give wavelengths within 0…{LONGEST} nm")
    order = np.argsort(wavelength)
    return CurveTable(path, wavelength[order], values[None, order], (path.stem,), (unit,))


def _read_spdx(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], str | None]:
    """Return wavelengths (nm), values, and the unit of their quantity, None where it has none; ValueError if the file holds
    no spectrum."""
    if path.stat().st_size > MOST_TEXT:
        raise ValueError(f"larger than {MOST_TEXT >> 20} MB")
    colour = colour_science()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            spectrum = colour.SpectralDistribution_IESTM2714(str(path)).read()
    except (ParseError, OSError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(str(error).splitlines()[0] if str(error) else type(error).__name__) from error
    quantity = (spectrum.spectral_quantity or "other").lower()
    wavelength, values = np.asarray(spectrum.wavelengths, np.float64), np.asarray(spectrum.values, np.float64)
    return wavelength, values, SPDX_UNITS.get(quantity)


def _monotonic(wavelength: Array) -> bool:
    steps = np.diff(wavelength)
    return bool((steps > 0).all() or (steps < 0).all())


def other_unit(first: float, last: float) -> tuple[str, str] | None:
    """Return what is wrong with a grid of wavelengths from `first` to `last` that should be in nm, and the unit they seem
    to be in; None if they may be in nm."""
    if first <= 0 or (last >= MICROMETRES and first <= ANGSTROMS):
        return None
    unit, nm = ("m", 1e9) if last < METRES else ("um", 1e3) if last < MICROMETRES else ("A", 0.1)
    return f"wavelengths {first:g}…{last:g} are not in nm, but perhaps {first * nm:g}…{last * nm:g} nm in {unit}", unit


def _wavelength_column(heading: Sequence[str], path: Path) -> tuple[int, float | None]:
    """Return the column that holds the wavelengths, and how many nm its unit has, if the heading says it."""
    named = [number for number, cell in enumerate(heading) if is_wavelength(cell)] or ([0] if not heading[0] else [])
    if len(named) != 1:
        which = " and ".join(f'"{heading[number][:40]}"' for number in named[:2]) or f'none of "{", ".join(heading)[:60]}"'
        raise InputFileError(f'{path}: {which} names the wavelengths; call one column "wavelength_nm"')
    words = [word for word in re.split(SEPARATORS, heading[named[0]]) if word]
    scales = [scale for scale in map(units.length_nm, words) if scale is not None]
    if not scales and re.search(r"[(\[/]", heading[named[0]]):
        raise InputFileError(f'{path}: "{heading[named[0]][:40]}" has no unit of wavelength; give nm, um or A')
    return named[0], scales[0] if scales else None
