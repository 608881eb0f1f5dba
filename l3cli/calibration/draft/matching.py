"""Tables of spectra → captures: by wavelength, by light, or in the order of their names."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.draft.names import Name, read_name
from l3cli.calibration.draft.sorting import Group, Scale
from l3cli.frames.measurement import PATCHES
from l3cli.spectra.table import BRIGHTEST, DIMMEST, CurveTable

NARROW_NM = 40.0  # between the first and the last half of its peak: a line
NEAR_NM = 5.0  # of a step's name and the peak of its spectrum
Array = NDArray[np.floating]


@dataclass(frozen=True)
class Spectra:
    """A table of spectra in the folder."""

    path: str  # as the measurement file will name it
    name: Name  # what its path within the folder says
    table: CurveTable

    @property
    def narrow(self) -> bool:
        """Return whether most columns are lines, as steps of a monochromator are."""
        return float(np.mean([_narrow(self.table.wavelength, curve) for curve in self.table.values])) > 0.5

    @property
    def has_patches(self) -> bool:
        """Return whether there is a column for each patch of a ColorChecker."""
        return len(self.table.values) == PATCHES and not self.narrow


@dataclass(frozen=True)
class Column:
    """One spectrum of a table."""

    spectra: Spectra
    number: int  # from 1
    name: str | None
    nm: float  # what its heading says, or else its peak

    @property
    def key(self) -> int | str:
        """Return the name by which a measurement file refers to it."""
        names = self.spectra.table.names or ()
        return self.name if self.name and names.count(self.name) == 1 else self.number


def columns_of(tables: Sequence[Spectra]) -> list[Column]:
    """Return every line spectrum of the tables, in their order."""
    columns = []
    for spectra in tables:
        if not spectra.narrow:
            continue
        names = spectra.table.names or (None,) * len(spectra.table.values)
        for number, (name, curve) in enumerate(zip(names, spectra.table.values, strict=True), 1):
            stated = read_name(f"{name}.csv").nm if name else None
            stated = stated if stated is not None or len(names) > 1 else spectra.name.nm
            peak = float(spectra.table.wavelength[int(np.argmax(curve))])
            columns.append(Column(spectra, number, name, peak if stated is None else stated))
    return columns


def match_steps(steps: Sequence[Group], columns: Sequence[Column], scale: Scale, notes: list[str]) -> list[Column | None]:
    """Return the spectrum of each monochromatic capture: by wavelength where its name says it, else in order."""
    if not columns or not steps:
        return [None] * len(steps)
    found = [_by_wavelength(step.first.name, columns) for step in steps]
    unnamed = [number for number, step in enumerate(steps) if step.first.name.nm is None]
    if unnamed:
        rest = [column for column in columns if all(column is not each for each in found)]
        given = _in_order([steps[number] for number in unnamed], rest, scale, notes)
        for number, column in zip(unnamed, given, strict=True):
            found[number] = column
    return found


def _in_order(
    steps: Sequence[Group], columns: Sequence[Column], scale: Scale, notes: list[str]
) -> Sequence[Column] | list[None]:
    """Return the spectra of captures whose names state no wavelength, if they are as many; none otherwise."""
    numbers = list(range(len(steps))) if len(steps) == len(columns) else _steps_in_order(steps, scale)
    if numbers[-1] + 1 != len(columns):
        notes.append(
            f"{len(steps)} monochromatic captures and {len(columns)} spectra: which belong together is not known; write the "
            "wavelength into the names (mono_450nm.tif), or name spectrum and column of each"
        )
        return [None] * len(steps)
    notes.append(
        f"spectra given to {len(steps)} monochromatic captures in the order of their names, {columns[0].nm:g} to "
        f"{columns[-1].nm:g} nm"
    )
    return [columns[number] for number in numbers]


def _steps_in_order(steps: Sequence[Group], scale: Scale) -> list[int]:
    """Return the number of each capture's step, where one that is taken again too long follows its step."""
    numbers = [0]
    for before, step in itertools.pairwise(steps):
        again = scale.clipped(step) and not scale.clipped(before)
        numbers.append(numbers[-1] + (0 if again else 1))
    return numbers


def _by_wavelength(name: Name, columns: Sequence[Column]) -> Column | None:
    if name.nm is None:
        return None
    wanted = name.nm
    nearest = min(abs(column.nm - wanted) for column in columns)
    if nearest > NEAR_NM:
        return None
    nearest_columns = [column for column in columns if abs(column.nm - wanted) == nearest]

    def unlike(column: Column) -> tuple[int, int]:
        words = read_name(f"{column.name}.csv").words if column.name else column.spectra.name.words
        return len(words ^ name.words), column.number

    return min(nearest_columns, key=unlike)


def match_charts(charts: Sequence[Group], tables: Sequence[Spectra], notes: list[str]) -> list[Spectra | None]:
    """Return the table of radiances of each chart: by the light that both names say, else in order."""
    patches = [table for table in tables if table.has_patches]
    lights = [table.name.light for table in patches]
    found: list[Spectra | None] = []
    for chart in charts:
        light = chart.first.name.light
        found.append(patches[lights.index(light)] if light is not None and lights.count(light) == 1 else None)
    if None in found and len(patches) == len(charts):
        notes.append(f"radiances given to {len(charts)} charts in the order of their names: check them")
        return list(patches)
    return found


def match_light(chart: Group, tables: Sequence[Spectra]) -> tuple[Spectra | None, bool]:
    """Return the measured light of a photo of a chart: the broad spectrum that its light or its file is called by, or else
    the only one there is; and whether names say so."""
    broad = [table for table in tables if len(table.table.values) == 1 and not table.narrow]
    same = [table for table in broad if table.name.light is not None and table.name.light == chart.first.name.light]
    if len(same) == 1:
        return same[0], True
    stem = PurePath(chart.first.name.path).stem.lower()
    named = [table for table in broad if PurePath(table.name.path).stem.lower() in stem]
    if len(named) == 1:
        return named[0], True
    return (broad[0], False) if len(broad) == 1 and broad[0].name.light is None else (None, False)


def radiances(table: CurveTable, column: int | None) -> Array:
    """Return the values of one column (from 0), or of all of a table."""
    return table.values if column is None else table.values[column : column + 1]


def unknown_unit(table: CurveTable, column: int | None) -> bool:
    """Return whether radiances have no unit in their heading, and are not as large as radiances in photons are."""
    return not any(table.units) and not DIMMEST <= radiances(table, column).max() <= BRIGHTEST


def note_unused(columns: Sequence[Column], matched: Sequence[Column | None], notes: list[str]) -> None:
    """Add to `notes` which line spectra belong to no capture."""
    unused = [column for column in columns if all(column is not each for each in matched)]
    if unused and any(matched):
        where = ", ".join(f"{column.nm:g} nm" for column in unused[:6])
        notes.append(f"{len(unused)} spectra belong to no monochromatic capture: {where}{' …' if len(unused) > 6 else ''}")


def _narrow(wavelength: Array, curve: Array) -> bool:
    base = float(np.median(curve))
    above = wavelength[curve - base > 0.5 * (curve.max() - base)]
    return bool(above.size) and bool(np.ptp(above) <= NARROW_NM)
