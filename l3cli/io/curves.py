"""Files of curves: CSV spectra, tables of sweeps, the JSON of rawtoaces (camera spectral sensitivities per energy); and the
statistics of measured cameras' curves, those that come with l3 or of a folder (docs/method.md#charts-in-photographs)."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.measurement import DIODE, CurveStatistics, FinishedCurves, SweepTable
from l3cli.recipes.builtin import recipe_folder
from l3cli.recipes.toml import LARGEST, Recipe, load_recipe
from l3cli.spectra.file import other_unit, read_table
from l3cli.spectra.table import CurveTable, without_noise
from l3cli.system.files import write_whole
from l3cli.system.limits import read_bounded

Array = NDArray[np.float64]


def write_curves(path: Path, wavelength: NDArray, columns: NDArray, names: Sequence[str], unit: str = "") -> None:
    """Write columns (column, wavelength) as CSV below a heading with the `unit` of all columns, if there is one."""
    write_whole(path, curve_text(wavelength, columns, names, unit))


def curve_text(wavelength: NDArray, columns: NDArray, names: Sequence[str], unit: str = "") -> str:
    """Return columns (column, wavelength) as `write_curves` writes them."""
    heading = io.StringIO()  # a name may hold what ends a cell
    csv.writer(heading, lineterminator="").writerow(
        ["wavelength_nm", *(f"{name} ({unit})" if unit else name for name in names)]
    )
    lines = [heading.getvalue()]
    lines += [",".join(f"{value:.8g}" for value in row) for row in np.vstack([wavelength, columns]).T]
    return "\n".join(lines) + "\n"


def read_sweep(path: Path, photodiode: Path, channels: Sequence[str], column: int | str = 0) -> SweepTable:
    """Return the table of a sweep: wavelength, light mean of each channel, dark mean of each channel, light and dark reading
    of the photodiode, in this order or by name; and the response of that photodiode, per energy, in a `column` of its table,
    by name or by number from 1, 0 for the only one. InputFileError if it does not cover the sweep."""
    count = len(channels)
    wanted = [f"{kind} {channel}" for kind in ("light", "dark") for channel in channels] + ["diode light", "diode dark"]
    sweep = read_table(path).ordered(wanted, lambda name: DIODE.get(name.casefold(), name))
    wavelength, table = sweep.wavelength, sweep.values
    diodes = read_table(photodiode)
    if not column and len(diodes.values) > 1:
        raise InputFileError(
            f"{photodiode}: holds {len(diodes.values)} curves; name one, photodiode = "
            f'{{file = "{photodiode.name}", column = 1}}'
        )
    grid, response = diodes.wavelength, diodes.column(column or 1).per_energy()
    if grid[0] > wavelength[0] or grid[-1] < wavelength[-1]:
        raise InputFileError(
            f"{photodiode}: its {grid[0]:g}…{grid[-1]:g} nm do not cover the sweep's "
            f"{wavelength[0]:g}…{wavelength[-1]:g} nm; give the response over the whole sweep"
        )
    diode = np.interp(wavelength, grid, response[0])  # at points: smooth, and each step is one line
    if wavelength.size < 3 or diode.min() <= 0:
        raise InputFileError(f"{path}: a sweep needs three wavelengths or more that the photodiode responds to")
    return SweepTable(wavelength, table[:count], table[count : 2 * count], table[-2], table[-1], diode)


def read_finished(
    path: Path, channels: Sequence[str], per_energy: bool, columns: Mapping[str, str] | None = None
) -> FinishedCurves:
    """Return finished responsivities from CSV (wavelength in nm, one column a channel, by the name that `columns` gives
    it) or from rawtoaces' JSON."""
    table = (_read_json(path) if path.suffix.lower() == ".json" else read_table(path)).channel_columns(channels, columns)
    grid, curves = table.wavelength, without_noise(table.responses(per_energy, "per_energy"))
    if grid.size < 3 or grid[0] <= 0 or curves.min() < 0 or (curves.max(axis=1) <= 0).any():
        raise InputFileError(f"{path}: curves need three wavelengths or more, no negative value, and light in every channel")
    return FinishedCurves(grid, curves / grid if per_energy else curves, table.note)


def _read_json(path: Path) -> CurveTable:
    """Return the curves of a rawtoaces file, by the names of its index."""
    try:
        content = json.loads(read_bounded(path, "give curves as CSV or rawtoaces JSON"))["spectral_data"]
        rows, names = content["data"]["main"], content.get("index", {}).get("main")
        table = np.array([[float(key), *map(float, values)] for key, values in rows.items()])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputFileError(f"{path} is not a rawtoaces JSON: spectral_data.data.main is missing or not numbers") from error
    if table.ndim != 2 or table.shape[1] < 2:
        raise InputFileError(f"{path} is not a rawtoaces JSON: it holds no curves")
    table = table[np.argsort(table[:, 0])]
    if not (np.abs(table) <= LARGEST).all() or (np.diff(table[:, 0]) <= 0).any():
        raise InputFileError(f"{path}: wavelengths must differ and every value be a number within ±{LARGEST:g}")
    if other := other_unit(float(table[0, 0]), float(table[-1, 0])):
        raise InputFileError(f"{path}: {other[0]}; give them in nm")
    values = table[:, 1:].T
    named = isinstance(names, list) and len(names) == len(values) and all(isinstance(name, str) for name in names)
    return CurveTable(path, table[:, 0], values, tuple(names) if named else None, (None,) * len(values))


# ---------------------------------------------------------------------------------- statistics of measured curves

ROLES = ("r", "g", "b")  # channels of the table that comes with l3, and of the cameras of a folder
CURVE_FILES = (".csv", ".json")
LEAST = 8  # cameras of a folder: fewer say nothing of how curves vary
MOST = 2000


class PriorRecipe(Recipe):
    """Statistics of measured curves."""

    title: ClassVar[str] = "a table of curve statistics"

    source: str  # whose curves, by whom, under which licence
    wavelength_nm: list[float]
    mean: dict[str, list[float]]  # channel → wavelength
    modes: list[dict[str, list[float]]]  # channel → wavelength, each mode by its standard deviation
    log_peak: list[float]
    log_peak_covariance: list[list[float]]


def shipped_statistics() -> CurveStatistics:
    """Return the statistics that come with l3, of r, g and b."""
    recipe = load_recipe(recipe_folder() / "priors" / "rgb.toml", PriorRecipe)
    return CurveStatistics(
        np.array(recipe.wavelength_nm),
        np.array([recipe.mean[role] for role in ROLES]),
        np.array([[mode[role] for role in ROLES] for mode in recipe.modes]),
        np.array(recipe.log_peak),
        np.array(recipe.log_peak_covariance),
    )


def prior_files(folder: Path) -> list[Path]:
    """Return the files of curves in a folder; InputFileError if there are too few."""
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in CURVE_FILES) if folder.is_dir() else []
    if not LEAST <= len(files) <= MOST:
        raise InputFileError(
            f"{folder} holds {len(files)} files of curves (CSV or rawtoaces JSON); a prior needs {LEAST} cameras or more"
        )
    return files


def read_cameras(files: Sequence[Path]) -> tuple[FinishedCurves, ...]:
    """Return the curves of measured cameras, r g b, per energy in the files; InputFileError names one that holds none."""
    return tuple(read_finished(path, ROLES, per_energy=True) for path in files)
