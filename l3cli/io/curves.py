"""Read and write spectral curves (CSV), and read wavelength sweeps and rawtoaces JSON files.

The module also reads the prior for calibration from photos: the built-in statistics of camera responsivities, or a folder of
measured responsivities from which such statistics can be computed (docs/method.md#charts-in-photographs).
"""

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
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import MAX_NUMBER, Recipe
from l3cli.spectra.file import other_unit, read_table
from l3cli.spectra.table import CurveTable, without_noise
from l3cli.system.files import write_whole
from l3cli.system.limits import read_bounded

Array = NDArray[np.float64]


def write_curves(path: Path, wavelength: NDArray, columns: NDArray, names: Sequence[str], unit: str = "") -> None:
    """Write curves to a CSV file, replacing an existing file.

    Parameters
    ----------
    path : Path
        The file.
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.
    columns : ndarray, (column, wavelength)
        The curves.
    names : sequence of str
        Column names.
    unit : str
        Unit of all columns, which is appended to their names in parentheses. [default: none]
    """
    write_whole(path, curve_text(wavelength, columns, names, unit))


def curve_text(wavelength: NDArray, columns: NDArray, names: Sequence[str], unit: str = "") -> str:
    """Return the CSV text that `write_curves` writes, with eight significant digits."""
    heading = io.StringIO()  # written by the csv module, which quotes names that contain a comma
    csv.writer(heading, lineterminator="").writerow(
        ["wavelength_nm", *(f"{name} ({unit})" if unit else name for name in names)]
    )
    lines = [heading.getvalue()]
    lines += [",".join(f"{value:.8g}" for value in row) for row in np.vstack([wavelength, columns]).T]
    return "\n".join(lines) + "\n"


def read_sweep(path: Path, photodiode: Path, channels: Sequence[str], column: int | str = 0) -> SweepTable:
    """Read a wavelength sweep that was measured with a camera and a calibrated photodiode.

    Parameters
    ----------
    path : Path
        Table with the columns "wavelength_nm", "light CHANNEL" for each channel (mean with light, in DN), "dark CHANNEL" for
        each channel (mean in the dark, in DN), "diode light" and "diode dark". A table without a heading must have its
        columns in this order.
    photodiode : Path
        Table with the photodiode's spectral responsivity. Values without a unit are relative responses per energy.
    channels : sequence of str
        Channel names.
    column : int or str
        Name or number, counted from 1, of the responsivity column in `photodiode`. 0 selects the only column.

    Raises
    ------
    InputFileError
        If a table is invalid, if `column` is 0 and `photodiode` contains several curves, if the responsivity does not cover
        the wavelengths of the sweep, or if the sweep has fewer than three wavelengths.
    """
    count = len(channels)
    wanted = [f"{kind} {channel}" for kind in ("light", "dark") for channel in channels] + ["diode light", "diode dark"]
    sweep = read_table(path).ordered(wanted, lambda name: DIODE.get(name.casefold(), name))
    wavelength, table = sweep.wavelength, sweep.values
    diodes = read_table(photodiode)
    if not column and len(diodes.values) > 1:
        raise InputFileError(
            f"{photodiode} contains {len(diodes.values)} curves; select one of them, for example with photodiode = "
            f'{{file = "{photodiode.name}", column = 1}}'
        )
    grid, response = diodes.wavelength, diodes.column(column or 1).per_energy()
    if grid[0] > wavelength[0] or grid[-1] < wavelength[-1]:
        raise InputFileError(
            f"{photodiode} covers {grid[0]:g}…{grid[-1]:g} nm, but the sweep covers "
            f"{wavelength[0]:g}…{wavelength[-1]:g} nm; use a responsivity that covers the whole sweep"
        )
    # Linear interpolation suffices, because the responsivity is smooth and the light of each step is narrow-band.
    diode = np.interp(wavelength, grid, response[0])
    if wavelength.size < 3 or diode.min() <= 0:
        raise InputFileError(
            f"{path}: the sweep has fewer than three wavelengths, or a wavelength to which the photodiode does not respond; "
            "use at least three wavelengths within the photodiode's range"
        )
    return SweepTable(wavelength, table[:count], table[count : 2 * count], table[-2], table[-1], diode)


def read_finished(
    path: Path, channels: Sequence[str], per_energy: bool, columns: Mapping[str, str] | None = None
) -> FinishedCurves:
    """Read finished responsivity curves from a table of spectra or from a rawtoaces JSON file.

    Parameters
    ----------
    path : Path
        Table with one column per channel, or JSON file.
    channels : sequence of str
        Channel names.
    per_energy : bool
        Whether the curves are per energy instead of per photon.
    columns : mapping, optional
        Channel → column name, for channels whose columns have a different name.

    Returns
    -------
    FinishedCurves
        The curves per photon. Negative values as small as noise are set to zero.

    Raises
    ------
    InputFileError
        If a channel has no column, if a curve contains negative values or no positive value, or if the file contains fewer
        than three wavelengths.
    """
    table = (_read_json(path) if path.suffix.lower() == ".json" else read_table(path)).channel_columns(channels, columns)
    grid, curves = table.wavelength, without_noise(table.responses(per_energy, "per_energy"))
    if grid.size < 3 or grid[0] <= 0 or curves.min() < 0 or (curves.max(axis=1) <= 0).any():
        raise InputFileError(
            f"{path}: curves must have at least three wavelengths, no negative values, and a positive value in every "
            "channel; correct the file"
        )
    return FinishedCurves(grid, curves / grid if per_energy else curves, table.note)


def _read_json(path: Path) -> CurveTable:
    """Read the curves in a rawtoaces JSON file.

    The curves are named only if the file's index contains one name per curve. Raises InputFileError if the file is not
    structured like a rawtoaces file, or if the wavelengths are not in nm.
    """
    try:
        content = json.loads(read_bounded(path, "use curves in CSV or rawtoaces JSON"))["spectral_data"]
        rows, names = content["data"]["main"], content.get("index", {}).get("main")
        table = np.array([[float(key), *map(float, values)] for key, values in rows.items()])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputFileError(
            f'{path} is not a rawtoaces JSON file: "spectral_data.data.main" is missing or does not contain numbers; '
            "export the file from rawtoaces again"
        ) from error
    if table.ndim != 2 or table.shape[1] < 2:
        raise InputFileError(f"{path} contains no curves; use a rawtoaces JSON file with curves")
    table = table[np.argsort(table[:, 0])]
    if not (np.abs(table) <= MAX_NUMBER).all() or (np.diff(table[:, 0]) <= 0).any():
        raise InputFileError(
            f"{path}: a wavelength occurs twice, or a value is not a number within ±{MAX_NUMBER:g}; correct the file"
        )
    if other := other_unit(float(table[0, 0]), float(table[-1, 0])):
        raise InputFileError(f"{path}: {other[0]}; convert the wavelengths to nm")
    values = table[:, 1:].T
    named = isinstance(names, list) and len(names) == len(values) and all(isinstance(name, str) for name in names)
    return CurveTable(path, table[:, 0], values, tuple(names) if named else None, (None,) * len(values))


# ---------------------------------------------------------------------------------- statistics of measured curves

ROLES = ("r", "g", "b")  # channels in the built-in statistics and in folders of measured responsivities
CURVE_FILES = (".csv", ".json")
MIN_CAMERAS = 8  # minimum number of cameras in a folder, because fewer cameras do not show how much responsivities vary
MAX_CAMERAS = 2000  # maximum number of cameras in a folder


class PriorRecipe(Recipe):
    """Statistics of the responsivities measured for many cameras."""

    title: ClassVar[str] = "a table of curve statistics"

    source: str  # cameras, author and licence of the measurements
    wavelength_nm: list[float]
    mean: dict[str, list[float]]  # channel → value at each wavelength
    # principal components of the variation, each times its standard deviation: channel → value at each wavelength
    modes: list[dict[str, list[float]]]
    log_peak: list[float]
    log_peak_covariance: list[list[float]]


def shipped_statistics() -> CurveStatistics:
    """Return the built-in statistics of r, g and b responsivities."""
    recipe = load_recipe(recipe_folder() / "priors" / "rgb.toml", PriorRecipe)
    return CurveStatistics(
        np.array(recipe.wavelength_nm),
        np.array([recipe.mean[role] for role in ROLES]),
        np.array([[mode[role] for role in ROLES] for mode in recipe.modes]),
        np.array(recipe.log_peak),
        np.array(recipe.log_peak_covariance),
    )


def prior_files(folder: Path) -> list[Path]:
    """Return a folder's curve files (.csv and .json) in alphabetical order.

    Raises InputFileError if there are fewer than MIN_CAMERAS or more than MAX_CAMERAS files.
    """
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in CURVE_FILES) if folder.is_dir() else []
    if not MIN_CAMERAS <= len(files) <= MAX_CAMERAS:
        raise InputFileError(
            f"{folder} contains {len(files)} curve files (CSV or rawtoaces JSON); use a folder with the curves of "
            f"{MIN_CAMERAS} to {MAX_CAMERAS} cameras"
        )
    return files


def read_cameras(files: Sequence[Path]) -> tuple[FinishedCurves, ...]:
    """Read measured r, g and b responsivities per energy, from one file per camera.

    Raises InputFileError if a file is invalid.
    """
    return tuple(read_finished(path, ROLES, per_energy=True) for path in files)
