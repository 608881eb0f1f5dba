"""Read optical spectra from JCAMP-DX files (versions 4.24 and 5) with one block or several linked blocks.

A block is a list of records `##LABEL= value`. The data are in the record XYDATA or XYPOINTS. XYDATA has the form
(X++(Y..Y)): each line contains an abscissa, the ordinate at this abscissa, and the ordinates at the following abscissas,
which are equally spaced. XYPOINTS has the form (XY..XY), with pairs of numbers. Numbers are decimals (AFFN), but ordinates
may be compressed in one of the ASDF forms:

=====  ==========================================================================  =======================
PAC    signs separate the numbers: +1-2+3
SQZ    a letter replaces the sign and the first digit                              @ A…I a…i: 0, 1…9, −1…−9
DIF    differences; a line starts with the last ordinate of the previous line      % J…R j…r: 0, 1…9, −1…−9
DUP    total number of consecutive occurrences of the preceding number             S…Z s: 1…8, 9
=====  ==========================================================================  =======================

Reference: R. S. McDonald, P. A. Wilks, "JCAMP-DX: A standard form for exchange of infrared spectra in computer readable
form", Applied Spectroscopy 42 (1988) 151–162.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.spectra import units

RECORD = re.compile(r"^\s*##([^=]*)=(.*)$")
AFFN = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
PACKED = re.compile(r"[%@A-DF-Za-df-s]")  # characters that occur only in compressed numbers
ASDF = re.compile(r"([@A-Ia-i%J-Rj-rS-Zs]|[-+]|(?=[\d.]))(\d*\.?\d*)")
SQZ = {letter: digit for digit, letter in enumerate("@ABCDEFGHI")} | {
    letter: -digit for digit, letter in enumerate("abcdefghi", 1)
}
DIF = {letter: digit for digit, letter in enumerate("%JKLMNOPQR")} | {
    letter: -digit for digit, letter in enumerate("jklmnopqr", 1)
}
DUP = {letter: digit for digit, letter in enumerate("STUVWXYZs", 1)}
NM = {  # units of the abscissae in nm
    "NANOMETERS": 1.0,
    "NANOMETRES": 1.0,
    "NM": 1.0,
    "MICROMETERS": 1e3,
    "MICROMETRES": 1e3,
    "MICRONS": 1e3,
    "UM": 1e3,
    "ANGSTROMS": 0.1,
    "A": 0.1,
}
FRACTION_OF_LETTER = {  # unit by first letter of transmittance, transmission, reflectance or reflection
    "T": "transmittance",
    "R": "reflectance",
}


@dataclass
class Block:
    """One block of a JCAMP-DX file."""

    records: dict[str, str] = field(default_factory=dict)  # values by label, without blanks and punctuation
    kind: str = ""  # label of the record with the data, or "" if there are none
    lines: list[str] = field(default_factory=list)  # lines of data

    def of(self, label: str, default: str = "") -> str:
        return self.records.get(label, default)


def is_jcamp(text: str) -> bool:
    """Whether a text is a JCAMP-DX file, with the title as its first record."""
    return re.match(r"\s*##\s*TITLE\s*=", text, re.I) is not None


def read_jcamp(text: str, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...], str | None]:
    """Read one spectrum from a JCAMP-DX file.

    If a block contains the processed spectrum, as in files from SpectraSuite, this block is read. Otherwise, the first block
    with data is read.

    Parameters
    ----------
    text : str
        Content of the file.
    path : Path
        The file, for messages.

    Returns
    -------
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm, in the order of the file.
    values : ndarray, (1, wavelength)
        Values in `unit`.
    names : tuple of str
        Title of the block, as the only element.
    unit : str or None
        Unit of the values, or None if the values are relative.

    Raises
    ------
    InputFileError
        If the file contains no spectrum over wavelength, if values are missing or damaged, or if their number is not
        NPOINTS.
    """
    blocks = [block for block in _blocks(text) if block.kind]
    if not blocks:
        raise InputFileError(f"{path} contains neither XYDATA nor XYPOINTS; export the spectrum in one of these forms")
    block = next((each for each in blocks if "PROCESSED" in each.of("TITLE").upper()), blocks[0])
    xunits = block.of("XUNITS").strip().upper()
    if xunits not in NM:
        stated = f'"{xunits}"' if xunits else "missing"
        raise InputFileError(f"{path}: XUNITS is {stated}; export the spectrum with XUNITS NANOMETERS")
    comma = re.fullmatch(r"-?\d+,\d+", block.of("FIRSTX").strip()) is not None
    if block.kind == "XYDATA":
        x, y = _ordinates(block, comma, path)
    elif block.kind == "XYPOINTS":
        x, y = _pairs(block, comma, path)
    else:
        raise InputFileError(f"{path} contains {block.kind}, which is not a spectrum; export XYDATA or XYPOINTS")
    y, unit = _in_unit(y, block.of("YUNITS").strip())
    return x * NM[xunits], y[None], (block.of("TITLE").strip(),), unit


def _blocks(text: str) -> list[Block]:
    blocks: list[Block] = []
    data = False
    for line in text.splitlines():
        plain = line.partition("$$")[0].rstrip()
        record = RECORD.match(plain)
        if record is None:
            if data and plain.strip():
                blocks[-1].lines.append(plain.strip())
            continue
        label = re.sub(r"[\s\-/_]", "", record[1]).upper()
        if label == "TITLE" or not blocks:
            blocks.append(Block())
        data = label in ("XYDATA", "XYPOINTS", "PEAKTABLE", "DATATABLE", "RADATA")
        if data:
            blocks[-1].kind = label
        else:
            blocks[-1].records[label] = record[2]
    return blocks


def _figure(block: Block, label: str, comma: bool, path: Path, default: float | None = None) -> float:
    """Return the number in a record, or `default` if the record is missing.

    Raises InputFileError if the record is not a number, or if it is missing and there is no default.
    """
    text = block.of(label).strip()
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError as error:
        if not text and default is not None:
            return default
        raise InputFileError(f'{path}: {label} is "{text}", not a number; export the spectrum again') from error


def _ordinates(block: Block, comma: bool, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the abscissae and ordinates of XYDATA. Raises InputFileError if values are missing or NPOINTS is wrong."""
    lines = [line.replace(",", ".") if comma else line for line in block.lines]
    if any("?" in line for line in lines):
        raise InputFileError(f'{path} contains missing values ("?"); measure the spectrum again')
    packed = any(PACKED.search(line) for line in lines)
    values = _unpacked(lines, path) if packed else [float(each) for line in lines for each in AFFN.findall(line)[1:]]
    first, last = (_figure(block, label, comma, path) for label in ("FIRSTX", "LASTX"))
    count = _figure(block, "NPOINTS", comma, path)
    if count != len(values):
        raise InputFileError(
            f"{path} contains {len(values)} values, but NPOINTS is {count:g}; copy the file from the instrument again"
        )
    return np.linspace(first, last, len(values)), np.array(values) * _figure(block, "YFACTOR", comma, path, 1.0)


def _unpacked(lines: list[str], path: Path) -> list[float]:
    """Decompress lines of XYDATA (ASDF).

    If a line ends with a difference, the next line repeats the last ordinate as a check. The repetition is removed. Raises
    InputFileError if it differs from the last ordinate.
    """
    values: list[float] = []
    by_difference = False  # whether the previous number was a difference
    for line in lines:
        abscissa = re.match(r"[-+]?\d*\.?\d*", line)
        rest = line[abscissa.end() if abscissa else 0 :]
        check, first, last, step = by_difference, True, 0.0, 0.0
        for letter, digits in ASDF.findall(rest):
            if letter in DUP:
                again = int(f"{DUP[letter]}{digits}") - 1
                for _ in range(again):
                    values.append(values[-1] + step)
                continue
            if letter in DIF:
                step = _signed(DIF[letter], digits)
                values.append(values[-1] + step)
                by_difference = True
                continue
            last = _signed(SQZ[letter], digits) if letter in SQZ else float((letter + digits) or 0)
            step, by_difference = 0.0, False
            if check and first:
                if last != values[-1]:
                    raise InputFileError(
                        f"{path}: a line begins with {last:g} instead of {values[-1]:g}, the last value of the previous "
                        "line; copy the file from the instrument again"
                    )
            else:
                values.append(last)
            first = False
    return values


def _signed(digit: int, digits: str) -> float:
    number = float(f"{abs(digit)}{digits}")
    return -number if digit < 0 else number


def _pairs(block: Block, comma: bool, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the abscissae and ordinates of XYPOINTS. Raises InputFileError if the number of pairs is not NPOINTS."""
    lines = [re.sub(r"(?<=\d),(?=\d)", ".", line) if comma else line for line in block.lines]
    numbers = [float(each) for line in lines for each in AFFN.findall(line)]
    count = int(_figure(block, "NPOINTS", comma, path, len(numbers) / 2))
    if not numbers or len(numbers) != 2 * count:
        raise InputFileError(
            f"{path} contains {len(numbers) / 2:g} pairs, but NPOINTS is {count}; copy the file from the instrument again"
        )
    x, y = np.array(numbers).reshape(-1, 2).T
    return x * _figure(block, "XFACTOR", comma, path, 1.0), y * _figure(block, "YFACTOR", comma, path, 1.0)


def _in_unit(values: NDArray[np.float64], text: str) -> tuple[NDArray[np.float64], str | None]:
    """Return values and their unit from the record YUNITS (`text`). If the values are relative, the unit is None.

    Percentages of transmittance or reflectance are converted to fractions.
    """
    share = re.fullmatch(r"(%?)\s*(?:([TR])|(T)RANSMI\w+|(R)EFLECT\w+)\s*(\(?%\)?)?", text.upper())
    if share:
        percent = bool(share[1] or share[5])
        return values / (100.0 if percent else 1.0), FRACTION_OF_LETTER[share[2] or share[3] or share[4]]
    if not text or re.search(r"ARBITRARY|RELATIVE|INTENSITY$|IRRADIANCE$|RADIANCE$|POWER$|FLUX$", text, re.I):
        return values, None
    name, unit = units.split(text)
    return values, unit or name
