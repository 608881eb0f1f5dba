"""Determine the wavelengths of bands from lists of numbers, or from the names of bands, pages, files and arrays."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.spectra.units import length_nm

NAMES = (
    "wave", "wavelength", "wavelengths", "lambda", "wl", "wvl", "bands", "wlens", "wavelengthlist", "bandwavelengths",
    "centerwavelength", "centerwavelengths", "centrewavelength", "centrewavelengths", "bandcenters", "bandcentres",
)  # fmt: skip
GOOD_NAMES = ("bbl", "goodwavelengths", "goodbands")  # names of lists in which 0 marks bad bands and 1 marks good bands
UNSTATED = ("", "unknown", "none", "n/a")  # header values that mean "not specified"
INVERSE_CM = ("wavenumber", "wavenumbers", "cm-1", "1/cm", "cm^-1", "cm⁻¹")
HERTZ = {"thz": 1e12, "ghz": 1e9, "mhz": 1e6, "khz": 1e3, "hz": 1.0}
METRIC = {"millimeter": 1e6, "millimetre": 1e6, "centimeter": 1e7, "centimetre": 1e7, "meter": 1e9, "metre": 1e9}
LIGHT_SPEED_NM = 299792458e9  # nm/s
MICROMETRES = 100.0  # numbers without a unit are in µm if all of them are below this limit
UNIT_WORDS = "Nanometers, Micrometers, Millimeters, Centimeters, Meters, Angstroms, Wavenumber, GHz, MHz, Index"
SHORTEST, LONGEST = 300.0, 2600.0  # nm; only numbers in this range are wavelengths if a name contains no unit
IN_NAME = re.compile(r"(\d+(?:[.,]\d+)?)[\s_]*(nm|nanomet\w*|[uµμ]m|micromet\w*|microns?)(?![A-Za-z])", re.IGNORECASE)


def in_nm(values: Sequence[float] | NDArray, unit: str) -> NDArray[np.float64] | None:
    """Convert wavelengths, wavenumbers or frequencies to nm.

    Parameters
    ----------
    values : array, (band,)
        Wavelengths, wavenumbers or frequencies in `unit`.
    unit : str
        Name of the unit in the file. If it is empty or "unknown", consecutive integers from 0 or 1 are assumed to be band
        indices. Other numbers without a unit are assumed to be in µm if all of them are below 100, and otherwise in nm.

    Returns
    -------
    ndarray, (band,), or None
        Wavelengths in nm. None if the numbers are band indices.

    Raises
    ------
    ValueError
        If the unit is not a unit of wavelength, or if a number is not positive and finite.
    """
    numbers, word = np.asarray(values, np.float64).ravel(), " ".join(unit.split()).strip("{}()[] ")
    counted = numbers.size > 1 and numbers[0] in (0, 1) and (np.diff(numbers) == 1).all()
    if word.lower() == "index" or (word.lower() in UNSTATED and counted):
        return None
    if not (numbers.size and np.isfinite(numbers).all() and numbers.min() > 0):
        raise ValueError("wavelengths must be numbers above zero")
    if word.lower() in UNSTATED:
        return numbers * (1e3 if numbers.max() < MICROMETRES else 1.0)
    if word.lower() in INVERSE_CM:
        return 1e7 / numbers
    if word.lower() in HERTZ:
        return LIGHT_SPEED_NM / (numbers * HERTZ[word.lower()])
    scale = length_nm(word) or length_nm(word.lower()) or METRIC.get(word.lower().rstrip("s"))
    if scale is None:
        raise ValueError(f'"{word[:40]}" is not a unit of wavelength; use one of {UNIT_WORDS}')
    return numbers * scale


def in_name(name: str) -> float | None:
    """Return the wavelength in nm in a name such as "red (650.5 nm)", or None if the name contains no wavelength.

    A comma or a period in the number is a decimal separator. If the wavelength would then be below 100 nm, it starts after
    the separator instead: "S0.450nm" is 450 nm.
    """
    found = IN_NAME.search(name)
    if found is None:
        return None
    number, scale = found[1].replace(",", "."), 1.0 if found[2].lower().startswith("n") else 1e3
    if scale == 1.0 and float(number) < MICROMETRES:
        number = number.rpartition(".")[2]
    return float(number) * scale


def of_names(names: Sequence[str]) -> list[float | None]:
    """Return the wavelength in nm in each name, or None for names without a wavelength.

    If no name contains a wavelength with a unit, the last number in each name is assumed to be a wavelength in nm. This
    requires at least two names, each with a number. The numbers must be from 300 to 2600 and differ by at least 2.
    """
    stated = [in_name(name) for name in names]
    if any(stated):
        return stated
    numbers = [re.search(r"(\d+)\D*$", name) for name in names]
    bare = [float(number[1]) for number in numbers if number]
    if (
        len(bare) < max(2, len(names))
        or not SHORTEST <= min(bare) <= max(bare) <= LONGEST
        or np.diff(sorted(bare)).min() < 2
    ):
        return stated
    return list(bare)


def is_named(name: str, names: Sequence[str] = NAMES) -> bool:
    """Return whether an array name is in `names`, ignoring letter case, punctuation and a trailing unit."""
    return _plain(name) in names


def unit_in(name: str) -> str:
    """Return the unit at the end of an array name such as "wavelength_um" or "Wavelength (nm)", or "" if there is none."""
    words = [word for word in re.split(r"[\s_()\[\]/]+", name) if word]
    return words[-1] if len(words) > 1 and length_nm(words[-1]) is not None else ""


def _plain(name: str) -> str:
    unit = unit_in(name)
    bare = name[: name.rindex(unit)] if unit else name
    return re.sub(r"[\W_]", "", bare.lower())
