"""Select columns from tables of spectra, and convert them to the required units."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, suggestion
from l3cli.physics import spectra
from l3cli.spectra import units

# Plausible peak radiances in photons/s/sr/m²/nm, from the smallest that a pixel detects to the largest that a lamp emits.
DIMMEST, BRIGHTEST = 1e6, 1e24
RELATIVE = ("relative", "relative photons", "relative power")  # values of "units" for radiances without an absolute scale
AMPERES_PER_WATT = {"A": 1, "J": -1, "s": 1}  # exponents of the base units in A/W
VISIBLE = 400.0, 700.0  # visible range in nm
# A curve is dark below DARK_FRACTION of its peak in the visible range, and below DARK_FRACTION_OUTSIDE outside.
DARK_FRACTION, DARK_FRACTION_OUTSIDE = 0.01, 0.05
NOISE = 0.01  # fraction of the peak by which values may be negative because of spectrometer noise
COLOURS = {"r": "red", "g": "green", "b": "blue", "c": "cyan", "m": "magenta", "y": "yellow", "w": "white"}
OTHER_NAMES = COLOURS | {name: letter for letter, name in COLOURS.items()}  # "r" → "red", "red" → "r", …
ELECTRONVOLT_NM = spectra.PLANCK * spectra.LIGHT_SPEED / 1.602176634e-19 * 1e9  # photon energy × wavelength, in eV nm
Array = NDArray[np.float64]


@dataclass(frozen=True)
class CurveTable:
    """The columns of a file of spectra."""

    path: Path
    wavelength: Array  # (wavelength,) nm
    values: Array  # (column, wavelength)
    names: tuple[str, ...] | None  # column names without units, or None without a heading
    units: tuple[str | None, ...]  # unit of each column, or None if it is unknown
    left_out: tuple[str, ...] = ()  # names of columns in the file that are omitted from this table

    @property
    def note(self) -> str | None:
        """Message that lists omitted columns of the file, or None if there are none."""
        return f"{self.path}: columns that are not used: {', '.join(self.left_out)}" if self.left_out else None

    def counted(self, columns: int) -> "CurveTable":
        """Check the number of columns, and return the table unchanged. Raises InputFileError if the number is wrong."""
        if len(self.values) != columns:
            has_commas = len(self.values) == 2 * columns
            cure = "if commas are decimal points, separate columns by semicolons" if has_commas else "add or remove columns"
            raise InputFileError(f"{self.path} contains {len(self.values)} curves instead of {columns}; {cure}")
        return self

    def ordered(self, wanted: Sequence[str], known_as: Callable[[str], str] | None = None) -> "CurveTable":
        """Sort the columns by name into the order of `wanted`.

        If the file has no heading, or if `wanted` contains a single name, the table is returned unchanged.

        Parameters
        ----------
        wanted : sequence of str
            Names of all columns. Case is ignored, unless two names differ only in case.
        known_as : callable, optional
            Function that translates a name in the heading to a name in `wanted`.

        Raises
        ------
        InputFileError
            If the number of columns or their names differ from `wanted`.
        """
        self.counted(len(wanted))
        if self.names is None or len(wanted) == 1:
            return self
        given = [known_as(name) if known_as else name for name in map(_plain, self.names)]
        asked = [_plain(name) for name in wanted]
        if set(given) != set(asked):
            folded, lower = [name.casefold() for name in given], [name.casefold() for name in asked]
            if set(folded) != set(lower) or len(set(lower)) != len(lower):
                raise InputFileError(f"{self.path}: {_difference(given, asked)}")
            given, asked = folded, lower
        order = [given.index(name) for name in asked]
        return CurveTable(self.path, self.wavelength, self.values[order], tuple(wanted), tuple(self.units[i] for i in order))

    def channel_columns(self, channels: Sequence[str], columns: Mapping[str, str] | None = None) -> "CurveTable":
        """Select one column per channel, in the order of `channels`.

        Parameters
        ----------
        channels : sequence of str
            Names of the channels.
        columns : mapping, optional
            Column names by channel, for columns that are not named after their channel.

        Returns
        -------
        CurveTable
            The selected columns. A file without a heading must contain one column per channel, in the order of `channels`.
            If there is only one channel and one column, the column name is ignored.

        Raises
        ------
        InputFileError
            Unless exactly one column matches each channel, or if `columns` is set for a file without a heading.
        """
        columns = {known_as(channel, channels): name for channel, name in (columns or {}).items()}
        if self.names is None and columns:
            raise InputFileError(f'{self.path} has no heading with column names; add a heading, or remove the key "columns"')
        if self.names is None or (len(self.values) == len(channels) == 1 and not columns):
            return self.counted(len(channels))
        names = [_plain(name) for name in self.names]
        asked = [_plain(columns.get(channel, channel)) for channel in channels]
        if len(names) < len(asked) and not columns:
            return self.counted(len(asked))  # raises InputFileError
        order = [_place(name, names) for name in asked]
        left_out = [name for number, name in enumerate(self.names) if number not in order]
        for channel, name, place in zip(channels, asked, order, strict=True):
            if place is None:
                if names.count(name) > 1:
                    raise InputFileError(f'{self.path}: two columns are called "{name}"; give each column a different name')
                wrong = f'no column is called "{name}"; {suggestion(name, names)}'
                if len(names) == len(asked) and not columns:
                    wrong = _difference(names, asked)
                example = f"{{{channel} = {json.dumps(left_out[0], ensure_ascii=False)}}}" if left_out else ""
                raise InputFileError(f"{self.path}: {wrong}{'; or select one with columns = ' if example else ''}{example}")
        chosen = [place for place in order if place is not None]
        units = tuple(self.units[place] for place in chosen)
        return CurveTable(self.path, self.wavelength, self.values[chosen], tuple(channels), units, tuple(left_out))

    def column(self, which: int | str) -> "CurveTable":
        """Select a single column by its name, or by its number. The first column has the number 1.

        Raises InputFileError if the name does not occur exactly once, or if the number is out of range.
        """
        if isinstance(which, str):
            names = [_plain(name) for name in self.names or ()]
            if names.count(_plain(which)) != 1:
                there = suggestion(which, names) if names else "the file has no heading with column names"
                raise InputFileError(f'{self.path}: no column is called "{which}"; {there}')
            which = names.index(_plain(which)) + 1
        if not 1 <= which <= len(self.values):
            raise InputFileError(f"{self.path}: column {which} does not exist; use a number from 1 to {len(self.values)}")
        one = slice(which - 1, which)
        return CurveTable(self.path, self.wavelength, self.values[one], self.names and self.names[one], self.units[one])

    def photons(self, unit: str | None, absolute: bool = True) -> Array:
        """Convert the columns to radiances in photons/s/sr/m²/nm.

        Parameters
        ----------
        unit : str or None
            Unit of columns without a unit in the heading. None means photons/s/sr/m²/nm.
        absolute : bool
            Whether the absolute scale matters. If not, units of irradiance and flux are also permitted, and the magnitude of
            the values is not checked.

        Returns
        -------
        ndarray, (column, wavelength)
            Radiances.

        Raises
        ------
        InputFileError
            If a heading contradicts `unit`, a unit is not permitted, or the magnitude of the values is implausible.
        """
        rows = []
        for values, heading in zip(self.values, self.units, strict=True):
            if heading is not None and unit is not None and _conversion(heading) != _conversion(unit):
                raise InputFileError(
                    f'{self.path}: the heading states "{heading}", but the measurement file states "{unit}"; correct the '
                    "wrong unit"
                )
            rows.append(self._to_photons(values, heading or unit or units.PHOTON_RADIANCE, absolute))
        photons = np.array(rows)
        if absolute and not {unit, *self.units} & set(RELATIVE):
            self._check_level(photons, unit is not None or any(self.units))
        return photons

    def _to_photons(self, values: Array, unit: str, absolute: bool) -> Array:
        conversion = _conversion(unit)
        other = _without_angle(unit) if conversion is None else None
        if other is not None and absolute:
            raise InputFileError(
                f'{self.path}: "{unit}" is a unit of irradiance or flux, not of spectral radiance; measure the radiance '
                "that the camera records"
            )
        conversion = conversion or other
        if conversion is None:
            raise InputFileError(
                f'{self.path}: "{unit}" is not a unit of spectral radiance; use "{units.PHOTON_RADIANCE}", '
                f'"{units.POWER_RADIANCE}", multiples of these units, "relative photons" or "relative power"'
            )
        of, scale = conversion
        scaled = values * scale
        photons = spectra.photons_from_energy(self.wavelength, scaled) if of == "J" else scaled
        return np.asarray(photons, dtype=np.float64)

    def _check_level(self, photons: Array, stated: bool) -> None:
        """Raise InputFileError if a column's peak is implausible as a radiance in photons/s/sr/m²/nm.

        `stated` indicates whether the file or the user specified the unit.
        """
        peaks = photons.max(axis=1)
        peak = float(peaks[peaks > 0].min(initial=np.inf))
        if peak >= DIMMEST and peaks.max() <= BRIGHTEST:
            return
        peak = peak if peak < DIMMEST else float(peaks.max())
        if not np.isfinite(peak):
            return  # all values are zero, which callers check themselves if they cannot use a dark spectrum
        cure = "correct the stated unit" if stated else f'if the values are watts, set unit = "{units.POWER_RADIANCE}"'
        raise InputFileError(
            f"{self.path}: a radiance of {peak:.3g} {units.PHOTON_RADIANCE} is outside the plausible range of "
            f"{DIMMEST:.0e} to {BRIGHTEST:.0e}; {cure}"
        )

    def powers(self) -> Array:
        """Convert the columns (column, wavelength) to relative power per nm.

        Columns in photons are divided by the wavelength. Columns without a unit are assumed to be power. Small negative
        values are set to zero (see `without_noise`). Raises InputFileError for units that are neither power nor photons.
        """
        rows = []
        for values, heading in zip(self.values, self.units, strict=True):
            unit = units.parse(heading) if heading is not None else None
            if heading is not None and heading not in units.RELATIVE_UNITS and not _is_power(unit):
                raw = units.RAW.fullmatch(heading) is not None
                why = ", because it includes the response of the instrument" if raw else ""
                raise InputFileError(
                    f'{self.path}: "{heading}" is not a unit of power per nm{why}; use "W/nm" or a photon unit'
                )
            photons = unit is not None and "photon" in unit.powers
            rows.append(values / self.wavelength if photons else values)
        return without_noise(np.array(rows))

    def shares(self) -> Array:
        """Convert the columns (column, wavelength) to transmittances or reflectances, as fractions from 0 to 1.

        Columns in percent are divided by 100. Values up to NOISE outside 0…1 are clipped. Raises InputFileError for values
        further outside, and for units other than percent and fractions.
        """
        for heading in filter(None, self.units):
            unit = units.parse(heading)
            if heading not in (*units.RELATIVE_UNITS, *units.FRACTION_UNITS) and (unit is None or unit.powers):
                raise InputFileError(
                    f'{self.path}: "{heading}" is not a unit of transmittance or reflectance; use fractions without a unit, '
                    'or "(%)"'
                )
        shares = self.values * np.array([[_share(heading)] for heading in self.units])
        shares = np.where((shares >= -NOISE) & (shares <= 1 + NOISE), shares.clip(0, 1), shares)
        if shares.min() < 0 or shares.max() > 1:
            percent = (
                'append "(%)" to the column names if the values are percentages'
                if 1 < shares.max() <= 100
                else "correct the values"
            )
            raise InputFileError(
                f"{self.path} contains values from {shares.min():g} to {shares.max():g}, which are not fractions; {percent}"
            )
        return shares

    def responses(self, per_energy: bool, key: str) -> Array:
        """Check the units of responsivities, and return the columns.

        Parameters
        ----------
        per_energy : bool
            Whether the responsivities are relative to energy (for example in A/W) instead of photons.
        key : str
            Key in the recipe that sets `per_energy`. Error messages name it.

        Returns
        -------
        ndarray, (column, wavelength)
            Values of the file, with percentages converted to fractions.

        Raises
        ------
        InputFileError
            If a column's unit is not a unit of responsivity, or contradicts `per_energy`.
        """
        for heading in filter(None, self.units):
            unit = units.parse(heading)
            if heading in units.RELATIVE_UNITS or (unit is not None and not unit.powers):
                continue
            by_energy = None if unit is None else _energy_response(unit)
            if by_energy is None:
                raise InputFileError(
                    f'{self.path}: "{heading}" is not a unit of responsivity; use "A/W", "e-/photon" or "%"'
                )
            if by_energy != per_energy:
                wanted = str(by_energy).lower()
                raise InputFileError(
                    f'{self.path}: the heading states "{heading}", which requires {key} = {wanted}; correct the unit or '
                    "the key"
                )
        return self.values * np.array([[_share(heading)] for heading in self.units])

    def efficiencies(self, per_energy: bool) -> Array:
        """Convert the columns (column, wavelength) to quantum efficiencies in e-/photon.

        If `per_energy` is true, the unit must be A/W. Otherwise, columns without a unit are assumed to be quantum
        efficiencies. Raises InputFileError if a column is relative, or if its unit contradicts `per_energy`.
        """
        rows = []
        for values, heading in zip(self.responses(per_energy, "per_energy"), self.units, strict=True):
            unit = units.parse(heading) if heading is not None else None
            if heading in units.RELATIVE_UNITS or (per_energy and unit is None):
                what = f'"{heading}"' if heading else "a responsivity per energy without a unit"
                raise InputFileError(
                    f'{self.path}: {what} does not determine a quantum efficiency; append "(A/W)" or "(e-/photon)" to the '
                    "column names, or set responsivity.peak_efficiency"
                )
            if per_energy:
                if unit is None or unit.powers != AMPERES_PER_WATT:
                    raise InputFileError(
                        f'{self.path}: the unit is "{heading}" instead of "A/W"; write the curves in A/W, or set '
                        "responsivity.peak_efficiency"
                    )
                values = values * unit.scale * ELECTRONVOLT_NM / self.wavelength
            rows.append(values)
        return np.array(rows)

    def per_energy(self) -> Array:
        """Convert the columns (column, wavelength) to relative responses per energy.

        Columns with a unit per photon are multiplied by the wavelength. All other columns are unchanged.
        """
        rows = []
        for values, heading in zip(self.values, self.units, strict=True):
            unit = units.parse(heading) if heading is not None else None
            rows.append(values * self.wavelength if unit is not None and _energy_response(unit) is False else values)
        return np.array(rows)


def without_noise(curves: Array) -> Array:
    """Set small negative values, which are probably spectrometer noise, to zero.

    Parameters
    ----------
    curves : ndarray, (curve, wavelength)
        Spectra or responses that cannot be negative.

    Returns
    -------
    ndarray, (curve, wavelength)
        Curves in which negative values down to −NOISE times the peak are zero. Lower values are unchanged, so that the
        caller can reject the curve.
    """
    least = -NOISE * curves.max(axis=1, keepdims=True)
    return np.where((curves < 0) & (curves >= least), 0.0, curves)


def gaps(wavelength: NDArray[np.floating], curves: NDArray[np.floating], widest: float) -> list[tuple[float, float]]:
    """Find steps between wavelengths that are too wide for interpolation.

    A step is ignored if all curves are dark at both ends. Dark means below 1 % of the peak or, outside 400…700 nm, below
    5 %.

    Parameters
    ----------
    wavelength : ndarray, (wavelength,)
        Increasing wavelengths in nm.
    curves : ndarray, (curve, wavelength)
        Spectra or responses.
    widest : float
        Largest step, in nm, that may be interpolated.

    Returns
    -------
    list of (float, float)
        First and last wavelength of each gap, in nm.
    """
    peaks = curves.max(axis=1, keepdims=True)
    relative = (curves / np.where(peaks > 0, peaks, 1.0)).max(axis=0)
    visible = (wavelength[1:] > VISIBLE[0]) & (wavelength[:-1] < VISIBLE[1])
    lit = np.maximum(relative[1:], relative[:-1]) > np.where(visible, DARK_FRACTION, DARK_FRACTION_OUTSIDE)
    at = np.flatnonzero((np.diff(wavelength) > widest) & lit)
    return [(float(wavelength[place]), float(wavelength[place + 1])) for place in at]


def _is_power(unit: units.Unit | None) -> bool:
    """Whether a unit is proportional to power or photons. Percentages count as relative power."""
    return unit is not None and (not unit.powers or unit.powers.get("J") == 1 or unit.powers.get("photon") == 1)


def _share(heading: str | None) -> float:
    """Return the factor that converts a column to fractions: 0.01 for percentages, otherwise 1."""
    unit = units.parse(heading) if heading is not None else None
    return unit.scale if unit is not None and not unit.powers else 1.0


def _energy_response(unit: units.Unit) -> bool | None:
    """Return True for a unit of responsivity per energy, False for one per photon, and None for any other unit."""
    powers = unit.powers
    if powers in ({}, {"electron": 1, "photon": -1}):
        return False
    return True if powers.get("J", 0) < 0 else None


def _conversion(unit: str) -> tuple[str, float] | None:
    """Parse a unit of spectral radiance.

    Return ("J", factor to W/(sr m² nm)), or ("photon", factor to photons/s/sr/m²/nm), or None for any other unit.
    """
    if unit in RELATIVE:
        return ("J" if unit == "relative power" else "photon", 1.0)
    for text in filter(None, (unit, units.below_one_slash(unit))):
        if found := _quantity_per(units.parse(text), {"s": -1, "sr": -1, "m": -3}):
            return found
    return None


def _quantity_per(parsed: units.Unit | None, below: dict[str, int]) -> tuple[str, float] | None:
    """Return ("J" or "photon", factor from the unit `parsed` to the same unit per nm).

    Return None unless `parsed` is J or photon times the base units with the exponents `below`.
    """
    for of in ("J", "photon"):
        if parsed is not None and parsed.powers == {of: 1, **below}:
            return of, float(f"{parsed.scale * 1e-9:.9g}")
    return None


def _without_angle(unit: str) -> tuple[str, float] | None:
    """Parse a unit of spectral irradiance or flux, such as µW/cm²/nm, as `_conversion` does for radiance."""
    parsed = units.parse(unit)
    return _quantity_per(parsed, {"s": -1, "m": -3}) or _quantity_per(parsed, {"s": -1, "m": -1})


def _plain(name: str) -> str:
    return re.sub(r"[\s_]+", " ", name).strip()


def _place(name: str, names: Sequence[str]) -> int | None:
    """Return the index of the column `name`, or None unless exactly one column has this name.

    "red" and "r" count as the same name. Case is ignored, unless two names differ only in case.
    """
    folded = [each.casefold() for each in names]
    other = OTHER_NAMES.get(name.casefold(), name.casefold())
    for asked, given in ((name, names), (name.casefold(), folded), (other, folded)):
        if given.count(asked) == 1:
            return given.index(asked)
    return None


def known_as(name: str, channels: Sequence[str]) -> str:
    """Translate the name of a colour to the name of a channel.

    For example, "red" becomes "r" if the camera has a channel "r" but no channel "red". Other names are unchanged.
    """
    other = OTHER_NAMES.get(name.casefold(), name)
    return other if name not in channels and other in channels else name


def _difference(given: Sequence[str], asked: Sequence[str]) -> str:
    """Describe the first unexpected or repeated name in a heading, and how to correct it."""
    odd = next((name for name in given if name not in asked), None)
    if odd is None:
        twice = next(name for name in given if given.count(name) > 1)
        return f'two columns are called "{twice}"; give each column a different name'
    return f'column "{odd[:40]}" is not expected; {suggestion(odd, asked)} (or remove the heading)'
