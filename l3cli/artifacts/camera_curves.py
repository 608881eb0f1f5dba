"""Responsivities of camera recipes: sums of Gaussians, or a CSV file with relative curves or quantum efficiencies."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_WAVELENGTHS, ROUNDING
from l3cli.errors import InputFileError, suggestion
from l3cli.physics import spectra
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Positive, Recipe
from l3cli.spectra.file import read_table
from l3cli.spectra.table import CurveTable, gaps, known_as, without_noise

WIDEST_GAP = 20.0  # nm; largest distance between neighbouring samples of measured curves
CUT_OFF = 0.05  # if a curve ends within the VISIBLE range, its last value may be at most this fraction of its peak
VISIBLE = 420.0, 680.0  # nm
RELATIVE_PEAK = 1e-3  # curves without a unit count as relative if their peak differs from 1 by less than this
MIN_PEAK = 1e-3  # lowest plausible peak quantum efficiency of a camera
Array = NDArray[np.float64]


class Gaussian(Recipe):
    """An asymmetric Gaussian, peak · exp(−½((λ−centre)/sigma)²), as one term of a responsivity.

    `sigma_nm` applies below the centre, and `sigma_above_nm` from the centre upwards. Without `sigma_above_nm`, the Gaussian
    is symmetric.
    """

    peak: float
    centre_nm: float
    sigma_nm: Positive
    sigma_above_nm: Positive | None = None


class ResponsivityRecipe(Recipe):
    # First wavelength, last wavelength and step. Default: the wavelengths in the file
    wavelength_nm: tuple[float, float, float] | None = None
    # Peak quantum efficiency of the most sensitive channel in e-/photon, including lens and filters. Default: the curves in
    # the file are quantum efficiencies already
    peak_efficiency: Positive | None = None
    gaussians: dict[str, list[Gaussian]] | None = None  # Gaussians that add up to the curve of each channel
    # CSV file with the wavelength in nm and one column per channel. Columns are found by name, or are in the order of
    # cfa.channels.
    file: str | None = None
    # column names by channel, for channels whose column has another name
    columns: dict[str, str] = msgspec.field(default_factory=dict)
    per_energy: bool = False  # whether the curves are per watt instead of per photon


def curve_faults(declared: ResponsivityRecipe, channels: Sequence[str]) -> Iterator[Fault]:
    """Find the faults in the [responsivity] section.

    The peak efficiency and the content of files are checked elsewhere.
    """
    if (declared.gaussians is None) == (declared.file is None):
        yield fault(
            "set either responsivity.gaussians or responsivity.file",
            *(f"responsivity.{key}" for key in ("gaussians", "file") if getattr(declared, key) is not None),
            "responsivity",
        )
    if declared.wavelength_nm is not None:
        first, last, step = declared.wavelength_nm
        key = "responsivity.wavelength_nm"
        if not (0 < first < last and step > 0):
            message = (
                f"{key} is [{first:g}, {last:g}, {step:g}]; write [first, last, step] with 0 < first < last and step > 0"
            )
            yield fault(message, key)
        elif (last - first) / step >= MAX_WAVELENGTHS or last > spectra.LONGEST_NM:
            yield fault(
                f"{key} is [{first:g}, {last:g}, {step:g}]; use at most {MAX_WAVELENGTHS} wavelengths, up to "
                f"{spectra.LONGEST_NM} nm",
                key,
            )
    yield from column_faults(declared.columns, channels, "responsivity.columns")
    if declared.gaussians is None:
        return
    if declared.columns:
        yield fault("responsivity.columns applies only to responsivity.file; remove it", "responsivity.columns")
    for key in ("wavelength_nm", "peak_efficiency"):
        if getattr(declared, key) is None:
            message = f"missing key `{key}` in [responsivity], which responsivity.gaussians requires; add it"
            yield fault(message, f"responsivity.{key}")
    if set(channels) != set(declared.gaussians):
        difference = differences(declared.gaussians, channels)
        message = f"responsivity.gaussians must have the same channels as cfa.channels: {difference}"
        yield fault(message, "responsivity.gaussians", "cfa.channels")


def column_faults(columns: Mapping[str, str], channels: Sequence[str], key: str) -> Iterator[Fault]:
    """Find unknown channels in the recipe key `key`, which maps channel names to column names."""
    if odd := sorted({known_as(name, channels) for name in columns} - set(channels)):
        yield fault(f'{key}: "{odd[0]}" is not a channel; {suggestion(odd[0], channels)}', key)


def differences(names: Iterable[str], channels: Sequence[str]) -> str:
    """Describe for an error message how two different sets of names, `names` and `channels`, differ."""
    odd = sorted(set(names) - set(channels))
    if odd:
        return f'"{odd[0]}" is not a channel; {suggestion(odd[0], channels)}'
    return f"{', '.join(sorted(set(channels) - set(names)))} is missing"


def responsivity(declared: ResponsivityRecipe, channels: Sequence[str], folder: Path) -> tuple[Array, Array]:
    """Compute the quantum efficiencies that a camera recipe describes.

    Parameters
    ----------
    declared : ResponsivityRecipe
        A [responsivity] section that has passed `curve_faults`.
    channels : sequence of str
        Names of the channels.
    folder : Path
        Folder of the recipe. The path of the CSV file is relative to this folder.

    Returns
    -------
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.
    efficiency : ndarray, (channel, wavelength)
        Quantum efficiency in e-/photon.

    Raises
    ------
    InputFileError
        If the file lacks the curve of a channel, or contains implausible curves.
    """
    if declared.gaussians is not None:
        wavelength = _grid(declared)
        assert wavelength is not None
        curves = np.array([_sum_of_gaussians(wavelength, declared.gaussians[channel]) for channel in channels])
        relative = curves / wavelength if declared.per_energy else curves
    else:
        table = curve_table(declared, channels, folder)
        wavelength = _grid(declared)
        _check_grid(table, wavelength, channels)
        if wavelength is None:
            wavelength = table.wavelength
        if declared.peak_efficiency is None:
            return wavelength, _efficiencies(table, wavelength, declared.per_energy)
        curves = spectra.average(table.responses(declared.per_energy, "per_energy"), table.wavelength, wavelength)
        relative = curves / wavelength if declared.per_energy else curves
    return wavelength, (declared.peak_efficiency or 0.0) * relative / relative.max()


def curve_table(declared: ResponsivityRecipe, channels: Sequence[str], folder: Path) -> CurveTable:
    """Read the channels' curves from the CSV file of a recipe.

    Small negative values are measurement noise and are set to 0. Raises InputFileError if the curve of a channel is missing.
    """
    assert declared.file is not None
    table = read_table(folder / declared.file).channel_columns(channels, declared.columns)
    return replace(table, values=without_noise(table.values))


def _grid(declared: ResponsivityRecipe) -> Array | None:
    if declared.wavelength_nm is None:
        return None
    first, last, step = declared.wavelength_nm
    return np.arange(first, last + step / 2, step)


def _check_grid(table: CurveTable, wavelength: Array | None, channels: Sequence[str]) -> None:
    """Raise InputFileError unless the curves cover the visible range and `wavelength` without gaps or negative values."""
    grid, curves = table.wavelength, table.values
    missing = gaps(grid, curves, WIDEST_GAP)
    if grid.size < 2 or missing:
        where = " between {:g} and {:g} nm".format(*missing[0]) if missing else ""
        raise InputFileError(f"{table.path} has a gap{where}; add samples, at least one every {WIDEST_GAP:g} nm")
    if wavelength is not None and (wavelength[0] >= grid[-1] or wavelength[-1] <= grid[0]):
        raise InputFileError(
            f"{table.path} covers {grid[0]:g}…{grid[-1]:g} nm, but responsivity.wavelength_nm is "
            f"{wavelength[0]:g}…{wavelength[-1]:g} nm; correct the file or the key"
        )
    for name, curve in zip(channels, curves, strict=True):
        if curve.min() < 0 or curve.max() <= 0:
            fault = "contains negative values" if curve.min() < 0 else "is zero at all wavelengths"
            raise InputFileError(f"{table.path}: the curve of channel {name} {fault}; correct the file")
        for end, cut in ((0, grid[0] > VISIBLE[0]), (-1, grid[-1] < VISIBLE[1])):
            if cut and curve[end] > CUT_OFF * curve.max():
                raise InputFileError(
                    f"{table.path} ends at {grid[end]:g} nm, where the curve of channel {name} is still at "
                    f"{curve[end] / curve.max():.0%} of its peak; add data for 400–700 nm"
                )


def _efficiencies(table: CurveTable, wavelength: Array, per_energy: bool) -> Array:
    """Resample the quantum efficiencies in a file to a wavelength grid, by averaging around each wavelength.

    Raises InputFileError if the values are implausible, for example because they are percentages or relative.
    """
    efficiency = table.efficiencies(per_energy)
    peak = float(efficiency.max())
    if peak > 1 + ROUNDING and 1 < peak <= 100 and not any(table.units):
        raise InputFileError(
            f'{table.path}: the peak quantum efficiency is {peak:.4g}, but cannot exceed 1; add "(%)" to the column names '
            "if the values are percentages, or set responsivity.peak_efficiency if they are relative"
        )
    if abs(peak - 1) < RELATIVE_PEAK and not any(table.units):
        raise InputFileError(
            f"{table.path} seems to contain relative curves, because the highest peak is 1; set "
            'responsivity.peak_efficiency, or add the unit "(e-/photon)" to the column names'
        )
    if not MIN_PEAK <= peak <= 1 + ROUNDING:
        raise InputFileError(
            f"{table.path}: the peak quantum efficiency is {peak:.4g}, which is implausible; correct the unit in the column "
            "names, or set responsivity.peak_efficiency"
        )
    return np.asarray(spectra.average(efficiency, table.wavelength, wavelength), np.float64)


def _sum_of_gaussians(wavelength: Array, terms: list[Gaussian]) -> Array:
    total = np.zeros_like(wavelength)
    for term in terms:
        above = term.sigma_nm if term.sigma_above_nm is None else term.sigma_above_nm
        sigma = np.where(wavelength < term.centre_nm, term.sigma_nm, above)
        total += term.peak * np.exp(-0.5 * ((wavelength - term.centre_nm) / sigma) ** 2)
    return total


def full_width(wavelength: Array, curve: Array) -> float | None:
    """Return the full width at half maximum of a curve in nm, or None if one side does not fall below half maximum."""
    peak, half = int(curve.argmax()), curve.max() / 2
    below, above = np.flatnonzero(curve[:peak] < half), np.flatnonzero(curve[peak:] < half)
    if not (below.size and above.size):
        return None
    low, high = int(below[-1]), peak + int(above[0])
    left = np.interp(half, curve[low : low + 2], wavelength[low : low + 2])
    right = np.interp(-half, -curve[high - 1 : high + 1], wavelength[high - 1 : high + 1])
    return float(right - left)
