"""Read spectra from CGATS.17 text files, such as ArgyllCMS .sp, .ti3, .cie and .ccss, and exports of chart readers.

A file contains one or more tables. A table consists of keywords (`KEYWORD "value"`), the names of its fields between
BEGIN_DATA_FORMAT and END_DATA_FORMAT, and one row per sample between BEGIN_DATA and END_DATA. A spectrum is stored in
consecutive fields that are named after the wavelengths: SPEC_380 (ArgyllCMS), SPECTRAL_NM380, nm380, R_380. ArgyllCMS rounds
the wavelengths in these names to whole nanometres, and writes the exact grid as SPECTRAL_BANDS, SPECTRAL_START_NM and
SPECTRAL_END_NM. The values must be divided by SPECTRAL_NORM.

References: ANSI CGATS.17; ArgyllCMS documentation, "File formats".
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError

FIRST_LINE = re.compile(r"\s*(?:CGATS|SPECT\s|CTI[1-4]|CCSS|CIE\b|CMF\b|ISO28178|IT8|NUMBER_OF_FIELDS|BEGIN_DATA)", re.I)
TOKEN = re.compile(r'"((?:[^"]|"")*)"|([^\s"]+)')
COMMENT = re.compile(r'^((?:[^"#]|"[^"]*")*)#.*$')
BAND = re.compile(r"^(?:(?:SPEC|SPECTRAL|R|NM)_?)?(?:NM_?)?(\d{3,4}(?:\.\d+)?)(?:_?NM)?$", re.I)
NAMES = ("SAMPLE_NAME", "SAMPLE_LOC", "SAMPLEID", "SAMPLE_ID")  # fields that name the sample, in order of precedence
PERCENT_ABOVE = 2.0  # value above which a file contains percentages, because no surface reflects twice the incident light
MEAS_TYPE_UNITS = {  # unit by value of the keyword MEAS_TYPE; all other values indicate a light source
    "REFLECTIVE": "reflectance",
    "TRANSMISSIVE": "transmittance",
}


@dataclass
class CgatsTable:
    """One table of a CGATS file: its keywords, field names and rows of cells."""

    keywords: dict[str, str] = field(default_factory=dict)
    fields: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)


@dataclass(frozen=True)
class Spectra:
    """The spectra of the samples in a CGATS file."""

    wavelength: NDArray[np.float64]  # (wavelength,) nm
    values: NDArray[np.float64]  # (sample, wavelength)
    names: tuple[str, ...]
    unit: str | None  # unit of all samples, or None if it is unknown


def is_cgats(text: str) -> bool:
    """Whether a text is probably a CGATS file, with a typical first line and the marker BEGIN_DATA."""
    return FIRST_LINE.match(text) is not None and re.search(r"^\s*BEGIN_DATA\b", text, re.M | re.I) is not None


def read_cgats(text: str, path: Path) -> Spectra:
    """Read the spectra of a CGATS file.

    Parameters
    ----------
    text : str
        Content of the file.
    path : Path
        The file, for messages.

    Returns
    -------
    Spectra
        One spectrum per row of the table with spectra. Other tables are ignored.

    Raises
    ------
    InputFileError
        If no table or several tables contain spectra, if a row is incomplete or not numeric, or if the keywords for the
        wavelength grid contradict the fields.
    """
    tables = _tables(text, path)
    spectral = [table for table in tables if _bands(table) or "SPECTRAL_NM" in map(str.upper, table.fields)]
    spectral = spectral or [table for table in tables if "SPECTRAL_BANDS" in table.keywords][:1]
    if len(spectral) > 1:
        raise InputFileError(
            f"{path} contains {len(spectral)} tables with spectra; save the required table as a separate file"
        )
    if spectral:
        return _spectra(spectral[0], text.split(None, 1)[0].upper(), path)
    fields = " ".join(dict.fromkeys(name for table in tables for name in table.fields))
    raise InputFileError(
        f"{path} contains no spectra ({fields[:60] or 'no data'}); export spectral data with fields such as SPEC_380"
    )


def _tables(text: str, path: Path) -> list[CgatsTable]:
    """Split a file into its tables. Raises InputFileError if a row is incomplete."""
    tables, inside = [CgatsTable()], ""
    for line in text.splitlines():
        plain = COMMENT.sub(r"\1", line)
        tokens = _tokens(plain)
        if not tokens:
            continue
        word, table = tokens[0].upper(), tables[-1]
        if word in ("BEGIN_DATA_FORMAT", "BEGIN_DATA"):
            if word == "BEGIN_DATA_FORMAT" and table.rows:
                tables.append(CgatsTable(dict(table.keywords)))
            inside = word
        elif word in ("END_DATA_FORMAT", "END_DATA"):
            inside = ""
        elif inside == "BEGIN_DATA_FORMAT":
            table.fields += tokens
        elif inside == "BEGIN_DATA":
            by_tab = [cell.strip().strip('"') for cell in plain.strip("\r\n").split("\t")]
            table.rows.append(by_tab if len(by_tab) == len(table.fields) else tokens)
        elif len(tokens) > 1 and word != "KEYWORD":
            table.keywords[word] = tokens[1]
    for table in tables:
        width = len(table.fields)
        if width and any(len(row) != width for row in table.rows):  # a row may extend over several lines of the file
            cells = [cell for row in table.rows for cell in row]
            if len(cells) % width:
                number = next(number for number, row in enumerate(table.rows, 1) if len(row) != width)
                raise InputFileError(
                    f"{path}: row {number} has {len(table.rows[number - 1])} values for {width} fields; "
                    "export the file again"
                )
            table.rows = [cells[at : at + width] for at in range(0, len(cells), width)]
    return tables


def _tokens(line: str) -> list[str]:
    return [quoted.replace('""', '"') if quoted or not plain else plain for quoted, plain in TOKEN.findall(line)]


def _bands(table: CgatsTable) -> list[tuple[int, float]]:
    """Return (index, wavelength in nm) of each field that is named after a wavelength."""
    found = [(place, BAND.match(name)) for place, name in enumerate(table.fields)]
    return [(place, float(match[1])) for place, match in found if match]


def _number(text: str) -> float:
    """Convert text to a number, with a point or a comma as the decimal separator."""
    return float(text.replace(",", "."))


def _spectra(table: CgatsTable, identifier: str, path: Path) -> Spectra:
    upper = [name.upper() for name in table.fields]
    kind = MEAS_TYPE_UNITS.get(table.keywords.get("MEAS_TYPE", "").upper())
    if kind is None and identifier.startswith("CTI") and table.keywords.get("DEVICE_CLASS", "OUTPUT").upper() != "DISPLAY":
        kind = "reflectance"
    norm = 100.0 if identifier.startswith("CTI") else None
    try:
        if "SPECTRAL_NM" in upper:  # rows are pairs of wavelength and value
            at = [place for place, name in enumerate(upper) if name == "SPECTRAL_NM"]
            wavelength = np.array([_number(table.rows[0][place]) for place in at])
            places = [place + 1 for place in at]
            norm = 100.0 if upper[places[0]] == "SPECTRAL_PCT" else None
        else:
            bands = _bands(table)
            places = [place for place, _ in bands] or list(range(len(table.rows[0])))
            wavelength = _grid(table, [nm for _, nm in bands], len(places), path)
        values = np.array([[_number(row[place]) for place in places] for row in table.rows])
        if "SPECTRAL_NORM" in table.keywords:
            norm = _number(table.keywords["SPECTRAL_NORM"])
    except (ValueError, IndexError) as error:
        raise InputFileError(f"{path} contains data that are not numbers ({error}); export the file again") from error
    if norm is None and kind is None and values.max() > PERCENT_ABOVE:
        unit: str | None = "%"
    else:
        values, unit = values / (norm or 1.0), kind
    label = next((name for name in NAMES if name in upper), None)
    names = [row[upper.index(label)] if label else path.stem for row in table.rows]
    return Spectra(wavelength, values, tuple(names), unit)


def _grid(table: CgatsTable, named: list[float], count: int, path: Path) -> NDArray[np.float64]:
    """Return a table's wavelengths in nm from its keywords or, if keywords are missing, from its field names.

    Raises InputFileError if the keywords contradict the fields.
    """
    keys = ("SPECTRAL_BANDS", "SPECTRAL_START_NM", "SPECTRAL_END_NM")
    if not all(key in table.keywords for key in keys):
        return np.array(named)
    bands, first, last = (_number(table.keywords[key]) for key in keys)
    grid = np.linspace(first, last, count)
    if bands != count or (named and np.abs(grid - named).max() > 1.0):
        raise InputFileError(
            f"{path} declares {bands:g} bands from {first:g} to {last:g} nm, but contains {count} bands from "
            f"{named[0] if named else first:g} to {named[-1] if named else last:g} nm; export the file again"
        )
    return grid
