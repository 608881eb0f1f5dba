"""Parse wavelengths in scene files. They are in lists, or in the names of bands, pages, files and arrays."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from l3cli.spectra.units import length_nm

NAMES = (
    "wave", "wavelength", "wavelengths", "lambda", "wl", "wvl", "bands", "wlens", "wavelengthlist", "bandwavelengths",
    "centerwavelength", "centerwavelengths", "centrewavelength", "centrewavelengths", "bandcenters", "bandcentres",
)  # fmt: skip
GOOD_NAMES = ("bbl", "goodwavelengths", "goodbands")  # names of lists of 0 (bad band) and 1 (good band)
UNSTATED = ("", "unknown", "none", "n/a")
INVERSE_CM = ("wavenumber", "wavenumbers", "cm-1", "1/cm", "cm^-1", "cm⁻¹")
HERTZ = {"thz": 1e12, "ghz": 1e9, "mhz": 1e6, "khz": 1e3, "hz": 1.0}
METRIC = {"millimeter": 1e6, "millimetre": 1e6, "centimeter": 1e7, "centimetre": 1e7, "meter": 1e9, "metre": 1e9}
LIGHT_SPEED_NM = 299792458e9  # nm/s
MICROMETRES = 100.0  # numbers without a unit are assumed to be in µm if all of them are smaller than this
UNIT_WORDS = "Nanometers, Micrometers, Millimeters, Centimeters, Meters, Angstroms, Wavenumber, GHz, MHz, Index"
SHORTEST, LONGEST = 300.0, 2600.0  # nm; a number without a unit in a name is a wavelength only within this range
IN_NAME = re.compile(r"(\d+(?:[.,]\d+)?)[\s_]*(nm|nanomet\w*|[uµμ]m|micromet\w*|microns?)(?![A-Za-z])", re.IGNORECASE)


def in_nm(values: Sequence[float] | NDArray, unit: str) -> NDArray[np.float64] | None:
    """Convert wavelengths, wavenumbers or frequencies to nm.

    Parameters
    ----------
    values : array, (band)
        Numbers in the unit `unit`.
    unit : str
        Name of the unit in the file. If it is empty, consecutive integers from 0 or 1 are indices of bands. Other numbers
        are in µm if all of them are below 100, and otherwise in nm.

    Returns
    -------
    ndarray, (band), or None
        Wavelengths in nm. None if the numbers are indices of bands.

    Raises
    ------
    ValueError
        If the unit is unknown, or if a number is not positive.
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
    """Return the wavelength in nm that the name of a band or file states, such as "red (650.5 nm)", or None.

    A comma is a decimal point, as in "S0.450,5nm". A period is also a decimal point. However, if the number would then be
    below 100 nm, the period separates the number from the text before it, as in "S0.450nm".
    """
    found = IN_NAME.search(name)
    if found is None:
        return None
    number, scale = found[1].replace(",", "."), 1.0 if found[2].lower().startswith("n") else 1e3
    if scale == 1.0 and float(number) < MICROMETRES:
        number = number.rpartition(".")[2]
    return float(number) * scale


def of_names(names: Sequence[str]) -> list[float | None]:
    """Return the wavelength in nm that each name contains, or None for each name without a wavelength.

    If no name contains a wavelength with a unit, the last number in each name may be a wavelength in nm. This is assumed if
    every name contains a number, all numbers are between 300 and 2600, and no two numbers are closer than 2. Otherwise the
    numbers are taken as band indices.
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
    """Whether the name of an array is one of `names`. Letter case, punctuation and units are ignored."""
    return _plain(name) in names


def unit_in(name: str) -> str:
    """Return the unit in the name of an array, such as "wavelength_um" or "Wavelength (nm)", or "" if there is none."""
    words = [word for word in re.split(r"[\s_()\[\]/]+", name) if word]
    return words[-1] if len(words) > 1 and length_nm(words[-1]) is not None else ""


def _plain(name: str) -> str:
    unit = unit_in(name)
    bare = name[: name.rindex(unit)] if unit else name
    return re.sub(r"[\W_]", "", bare.lower())
