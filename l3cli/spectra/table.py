"""Columns of spectra over their wavelengths, as CSV files hold them: by their names, in the units that are asked for."""

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

DIMMEST, BRIGHTEST = 1e6, 1e24  # photons/s/sr/m²/nm: no pixel sees less, no lamp gives more
RELATIVE = ("relative", "relative photons", "relative power")  # units of radiances whose scale is not known
AMPERES_PER_WATT = {"A": 1, "J": -1, "s": 1}
VISIBLE = 400.0, 700.0  # nm
DARK, DARK_OUTSIDE = 0.01, 0.05  # of its peak: a curve below it is dark, within the visible and outside
NOISE = 0.01  # of a curve's peak: so far below zero lies the dark noise of spectrometers at most
COLOURS = {"r": "red", "g": "green", "b": "blue", "c": "cyan", "m": "magenta", "y": "yellow", "w": "white"}
OTHER_NAMES = COLOURS | {name: letter for letter, name in COLOURS.items()}  # of channels
ELECTRONVOLT_NM = spectra.PLANCK * spectra.LIGHT_SPEED / 1.602176634e-19 * 1e9  # eV nm: energy of a photon × wavelength
Array = NDArray[np.float64]


@dataclass(frozen=True)
class CurveTable:
    """The content of a CSV file of spectra."""

    path: Path
    wavelength: Array  # (wavelength) nm
    values: Array  # (column, wavelength)
    names: tuple[str, ...] | None  # of the columns, without units; None: there is no heading
    units: tuple[str | None, ...]  # of the columns, as the heading states them
    left_out: tuple[str, ...] = ()  # the names of further columns of the file

    @property
    def note(self) -> str | None:
        """Return a line on columns that are left out, if there are any."""
        return f"{self.path}: left out are the columns {', '.join(self.left_out)}" if self.left_out else None

    def counted(self, columns: int) -> "CurveTable":
        """Return the table itself; InputFileError unless it has so many columns."""
        if len(self.values) != columns:
            comma = "; with decimal commas separate columns by semicolons" if len(self.values) == 2 * columns else ""
            raise InputFileError(f"{self.path}: holds {len(self.values)} curves, {columns} are wanted{comma}")
        return self

    def ordered(self, wanted: Sequence[str], known_as: Callable[[str], str] | None = None) -> "CurveTable":
        """Return the columns in the order of `wanted`, by their names if there are any; `known_as` gives the name that a
        heading means. Capitals count where names differ in nothing else. InputFileError unless names are `wanted`."""
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
        """Return the columns of `channels` in their order, each by its name or by that which `columns` gives it; others are
        left out. Without names as many columns as channels, in their order. InputFileError if a channel has none."""
        columns = {known_as(channel, channels): name for channel, name in (columns or {}).items()}
        if self.names is None and columns:
            raise InputFileError(f"{self.path}: columns are named, and there is no heading; leave `columns` out")
        if self.names is None or (len(self.values) == len(channels) == 1 and not columns):
            return self.counted(len(channels))
        names = [_plain(name) for name in self.names]
        asked = [_plain(columns.get(channel, channel)) for channel in channels]
        if len(names) < len(asked) and not columns:
            return self.counted(len(asked))  # an error
        order = [_place(name, names) for name in asked]
        left_out = [name for number, name in enumerate(self.names) if number not in order]
        for channel, name, place in zip(channels, asked, order, strict=True):
            if place is None:
                if names.count(name) > 1:
                    raise InputFileError(f'{self.path}: two columns are called "{name}"; name each once')
                wrong = f'no column is called "{name}"; {suggestion(name, names)}'
                if len(names) == len(asked) and not columns:
                    wrong = _difference(names, asked)
                example = f"{{{channel} = {json.dumps(left_out[0], ensure_ascii=False)}}}" if left_out else ""
                raise InputFileError(f"{self.path}: {wrong}{'; name it, columns = ' if example else ''}{example}")
        chosen = [place for place in order if place is not None]
        units = tuple(self.units[place] for place in chosen)
        return CurveTable(self.path, self.wavelength, self.values[chosen], tuple(channels), units, tuple(left_out))

    def column(self, which: int | str) -> "CurveTable":
        """Return one column, by its number from 1 or its name; InputFileError if there is none."""
        if isinstance(which, str):
            names = [_plain(name) for name in self.names or ()]
            if names.count(_plain(which)) != 1:
                there = suggestion(which, names) if names else "there is no heading that names columns"
                raise InputFileError(f'{self.path}: no column is called "{which}"; {there}')
            which = names.index(_plain(which)) + 1
        if not 1 <= which <= len(self.values):
            raise InputFileError(f"{self.path}: column {which} is none of its 1…{len(self.values)}")
        one = slice(which - 1, which)
        return CurveTable(self.path, self.wavelength, self.values[one], self.names and self.names[one], self.units[one])

    def photons(self, unit: str | None, absolute: bool = True) -> Array:
        """Return the columns as radiances in photons/s/sr/m²/nm, whichever unit `unit` or the heading states; by default
        they are.

        InputFileError if the two differ, if a unit is none of radiance, or if the values cannot be in it (`absolute`)."""
        rows = []
        for values, heading in zip(self.values, self.units, strict=True):
            if heading is not None and unit is not None and _conversion(heading) != _conversion(unit):
                raise InputFileError(
                    f'{self.path}: its heading says "{heading}", the measurement file "{unit}"; correct one'
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
                f'{self.path}: "{unit}" is of light that falls or flows, and no unit of spectral radiance; measure what the '
                "camera sees"
            )
        conversion = conversion or other
        if conversion is None:
            raise InputFileError(
                f'{self.path}: "{unit}" is not a unit of spectral radiance; give "{units.PHOTON_RADIANCE}", '
                f'"{units.POWER_RADIANCE}", multiples of them, or "relative photons", "relative power"'
            )
        of, scale = conversion
        scaled = values * scale
        photons = spectra.photons_from_energy(self.wavelength, scaled) if of == "J" else scaled
        return np.asarray(photons, dtype=np.float64)

    def _check_level(self, photons: Array, stated: bool) -> None:
        """Raise InputFileError if what ought to be photons/s/sr/m²/nm is none by its size."""
        peaks = photons.max(axis=1)
        peak = float(peaks[peaks > 0].min(initial=np.inf))
        if peak >= DIMMEST and peaks.max() <= BRIGHTEST:
            return
        peak = peak if peak < DIMMEST else float(peaks.max())
        if not np.isfinite(peak):
            return  # dark, which is refused where it is asked for
        cure = "correct the unit that is stated" if stated else f'if they are watts, give unit = "{units.POWER_RADIANCE}"'
        raise InputFileError(
            f"{self.path}: a radiance peaks at {peak:.3g} {units.PHOTON_RADIANCE}, as no light does "
            f"({DIMMEST:.0e} to {BRIGHTEST:.0e}); {cure}"
        )

    def powers(self) -> Array:
        """Return the columns per power, in any unit: those that the heading gives in photons become power."""
        rows = []
        for values, heading in zip(self.values, self.units, strict=True):
            unit = units.parse(heading) if heading is not None else None
            if heading is not None and heading not in units.PLAIN and not _is_power(unit):
                raw = units.RAW.fullmatch(heading) is not None
                why = ", it holds the response of the instrument" if raw else ""
                raise InputFileError(f'{self.path}: "{heading}" is not a unit of power per nm{why}; give "W/nm", or photons')
            photons = unit is not None and "photon" in unit.powers
            rows.append(values / self.wavelength if photons else values)
        return without_noise(np.array(rows))

    def shares(self) -> Array:
        """Return the columns as shares, 0…1; InputFileError if they are none, which a heading "(%)" converts. Values that
        noise brings beyond 0 or 1 are cut off."""
        for heading in filter(None, self.units):
            unit = units.parse(heading)
            if heading not in (*units.PLAIN, *units.SHARES) and (unit is None or unit.powers):
                raise InputFileError(
                    f'{self.path}: "{heading}" is not a fraction of light; give fractions, or percent as "(%)"'
                )
        shares = self.values * np.array([[_share(heading)] for heading in self.units])
        shares = np.where((shares >= -NOISE) & (shares <= 1 + NOISE), shares.clip(0, 1), shares)
        if shares.min() < 0 or shares.max() > 1:
            percent = '; if they are percent, write "(%)" after the column\'s name' if 1 < shares.max() <= 100 else ""
            raise InputFileError(
                f"{self.path}: values of {shares.min():g}…{shares.max():g} are not shares of light{percent}"
            )
        return shares

    def responses(self, per_energy: bool, key: str) -> Array:
        """Return the columns as responsivities per energy or per photon, as the recipe's `key` says; InputFileError if the
        heading says otherwise."""
        for heading in filter(None, self.units):
            unit = units.parse(heading)
            if heading in units.PLAIN or (unit is not None and not unit.powers):
                continue
            by_energy = None if unit is None else _energy_response(unit)
            if by_energy is None:
                raise InputFileError(
                    f'{self.path}: "{heading}" is not a unit of responsivity; give "A/W", "e-/photon" or "%"'
                )
            if by_energy != per_energy:
                wanted = str(by_energy).lower()
                raise InputFileError(f'{self.path}: its heading says "{heading}", which is {key} = {wanted}; correct one')
        return self.values * np.array([[_share(heading)] for heading in self.units])

    def efficiencies(self, per_energy: bool) -> Array:
        """Return the columns as quantum efficiencies, e-/photon, in the unit that the heading states and otherwise as they
        are; InputFileError if they are relative, or not what the recipe's `per_energy` says."""
        rows = []
        for values, heading in zip(self.responses(per_energy, "per_energy"), self.units, strict=True):
            unit = units.parse(heading) if heading is not None else None
            if heading in units.PLAIN or (per_energy and unit is None):
                what = f'"{heading}"' if heading else "per energy without a unit"
                raise InputFileError(
                    f'{self.path}: {what} is not a quantum efficiency; write "(A/W)" or "(e-/photon)" after the names of '
                    "the columns, or give responsivity.peak_efficiency"
                )
            if per_energy:
                if unit is None or unit.powers != AMPERES_PER_WATT:
                    raise InputFileError(f'{self.path}: "{heading}" is not "A/W"; give responsivity.peak_efficiency')
                values = values * unit.scale * ELECTRONVOLT_NM / self.wavelength
            rows.append(values)
        return np.array(rows)

    def per_energy(self) -> Array:
        """Return the columns as responses per energy, in any unit: those that the heading gives per photon are divided."""
        rows = []
        for values, heading in zip(self.values, self.units, strict=True):
            unit = units.parse(heading) if heading is not None else None
            rows.append(values * self.wavelength if unit is not None and _energy_response(unit) is False else values)
        return np.array(rows)


def without_noise(curves: Array) -> Array:
    """Set values below zero to zero where they are within the NOISE of a spectrometer.

    Parameters
    ----------
    curves : ndarray, (curve, wavelength)
        Spectra or responses that cannot be negative.

    Returns
    -------
    ndarray, (curve, wavelength)
        The same; values that are further below zero stay, for the caller to refuse.
    """
    least = -NOISE * curves.max(axis=1, keepdims=True)
    return np.where((curves < 0) & (curves >= least), 0.0, curves)


def gaps(wavelength: NDArray[np.floating], curves: NDArray[np.floating], widest: float) -> list[tuple[float, float]]:
    """Return the steps in which a curve is not known: wider than `widest` (nm), unless all curves are dark at both ends.

    Dark is below 1 % of the peak, and below 5 % where the step lies outside of 400 to 700 nm.

    Parameters
    ----------
    wavelength : ndarray, (wavelength)
        In nm, rising.
    curves : ndarray, (curve, wavelength)
        Spectra or responses over them.
    widest : float
        Widest step in nm over which a curve may be interpolated.

    Returns
    -------
    list of (float, float)
        First and last wavelength of each gap, in nm.
    """
    peaks = curves.max(axis=1, keepdims=True)
    relative = (curves / np.where(peaks > 0, peaks, 1.0)).max(axis=0)
    visible = (wavelength[1:] > VISIBLE[0]) & (wavelength[:-1] < VISIBLE[1])
    lit = np.maximum(relative[1:], relative[:-1]) > np.where(visible, DARK, DARK_OUTSIDE)
    at = np.flatnonzero((np.diff(wavelength) > widest) & lit)
    return [(float(wavelength[place]), float(wavelength[place + 1])) for place in at]


def _is_power(unit: units.Unit | None) -> bool:
    """Whether values in a unit are proportional to power or to photons, or a relative power in percent."""
    return unit is not None and (not unit.powers or unit.powers.get("J") == 1 or unit.powers.get("photon") == 1)


def _share(heading: str | None) -> float:
    """Return the factor of a column of shares: 0.01 of percent."""
    unit = units.parse(heading) if heading is not None else None
    return unit.scale if unit is not None and not unit.powers else 1.0


def _energy_response(unit: units.Unit) -> bool | None:
    """Return whether a responsivity in `unit` is per energy (True), per photon (False), or no responsivity at all (None)."""
    powers = unit.powers
    if powers in ({}, {"electron": 1, "photon": -1}):
        return False
    return True if powers.get("J", 0) < 0 else None


def _conversion(unit: str) -> tuple[str, float] | None:
    """Return the quantity of a spectral radiance, "J" or "photon", and its size in photons/s/sr/m²/nm or W/(sr m² nm)."""
    if unit in RELATIVE:
        return ("J" if unit == "relative power" else "photon", 1.0)
    for text in filter(None, (unit, units.below_one_slash(unit))):
        if found := _quantity_per(units.parse(text), {"s": -1, "sr": -1, "m": -3}):
            return found
    return None


def _quantity_per(parsed: units.Unit | None, below: dict[str, int]) -> tuple[str, float] | None:
    """Return the quantity of a unit, and its size, if it is one per all that is `below`."""
    for of in ("J", "photon"):
        if parsed is not None and parsed.powers == {of: 1, **below}:
            return of, float(f"{parsed.scale * 1e-9:.9g}")
    return None


def _without_angle(unit: str) -> tuple[str, float] | None:
    """Return `_conversion` of what is no radiance, but an irradiance or a flux per wavelength, such as µW/cm²/nm."""
    parsed = units.parse(unit)
    return _quantity_per(parsed, {"s": -1, "m": -3}) or _quantity_per(parsed, {"s": -1, "m": -1})


def _plain(name: str) -> str:
    return re.sub(r"[\s_]+", " ", name).strip()


def _place(name: str, names: Sequence[str]) -> int | None:
    """Return the place of the column of that name, "red" being "r"; capitals count only between names that differ in nothing
    else. None: nowhere, or in several places."""
    folded = [each.casefold() for each in names]
    other = OTHER_NAMES.get(name.casefold(), name.casefold())
    for asked, given in ((name, names), (name.casefold(), folded), (other, folded)):
        if given.count(asked) == 1:
            return given.index(asked)
    return None


def known_as(name: str, channels: Sequence[str]) -> str:
    """Return the channel that a name means, "red" being "r" where no channel is called red; other names as they are."""
    other = OTHER_NAMES.get(name.casefold(), name)
    return other if name not in channels and other in channels else name


def _difference(given: Sequence[str], asked: Sequence[str]) -> str:
    """Return what is wrong with the names of a heading, and the cure."""
    odd = next((name for name in given if name not in asked), None)
    if odd is None:
        twice = next(name for name in given if given.count(name) > 1)
        return f'two columns are called "{twice}"; name each once'
    return f'column "{odd[:40]}" is none of those wanted; {suggestion(odd, asked)} (or leave the heading out)'
