"""Cameras described instead of measured: recipes (configs/cameras)."""

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import LONGEST, MAX_CFA, MAX_CHANNELS, MOST_WAVELENGTHS, CameraModel, Noise, Optics
from l3cli.artifacts.store import load
from l3cli.config import CountOrNone, Recipe, Seed, load_recipe, parse_recipe, parse_toml, read_text
from l3cli.curve_file import read_table
from l3cli.errors import RecipeError, suggestion
from l3cli.physics import spectra

PITCHES_UM, LEAST_F_NUMBER, LEAST_FOCAL_MM = (0.1, 1000.0), 0.5, 0.05  # beyond, a length was given in another unit
MOST_PRNU = 0.2  # of any sensor that can be corrected


class SensorRecipe(Recipe):
    rows: int
    cols: int
    pixel_pitch_um: float
    bits: int
    gain_dn_per_e: float
    black_level_dn: float
    white_level_dn: float | None = None  # default: the lower of well and converter
    fixed_pattern_seed: Seed = 0


class CfaRecipe(Recipe):
    channels: list[str]
    pattern: list[str]  # rows of the super-pixel, channel names separated by spaces


class Gaussian(Recipe):
    """One asymmetric Gaussian of a responsivity: peak · exp(−½((λ−centre)/sigma)²), sigma below and above the centre."""

    peak: float
    centre_nm: float
    sigma_nm: float
    sigma_above_nm: float | None = None


class ResponsivityRecipe(Recipe):
    wavelength_nm: tuple[float, float, float]  # first, last, step
    peak_efficiency: float  # quantum efficiency e-/photon at the peak of the whole set, lens and filters included
    gaussians: dict[str, list[Gaussian]] | None = None  # channel → sum of Gaussians
    file: str | None = None  # CSV: wavelength in nm, one column a channel, by name or in the order of cfa.channels
    per_energy: bool = False  # the curves are per watt, not per photon


class NoiseRecipe(Recipe):
    well_capacity_e: float
    read_noise_e: float = 0.0
    dark_current_e_per_s: float = 0.0
    dsnu_e: float = 0.0
    prnu: float = 0.0
    column_noise_e: float = 0.0


class OpticsRecipe(Recipe):
    focal_length_mm: float
    f_number: float
    object_distance_m: float = 0.0


class CameraRecipe(Recipe):
    """A camera described instead of measured (configs/cameras)."""

    title: ClassVar[str] = "a camera recipe"

    name: str
    sensor: SensorRecipe
    cfa: CfaRecipe
    responsivity: ResponsivityRecipe
    noise: NoiseRecipe
    optics: OpticsRecipe


class PhaseRecipe(Recipe):
    """The camera of another recipe, with its array read from another pixel on."""

    title: ClassVar[str] = CameraRecipe.title

    name: str
    base: str  # the other recipe, relative to this one
    phase: tuple[CountOrNone, CountOrNone]  # row and column of the base's array that come first here


def load_camera(path: Path) -> CameraModel:
    """A camera from a camera.h5 or from a camera recipe (.toml)."""
    if path.suffix == ".toml":
        return camera_from_recipe(*read_recipe(path))
    return load(CameraModel, path)


def camera_files(path: Path) -> list[Path]:
    """What `load_camera` reads: the file, the base of a recipe, and the curves that a recipe names."""
    if path.suffix != ".toml":
        return [path]
    recipe, whole = read_recipe(path)
    named = recipe.responsivity.file
    return list(dict.fromkeys([path, whole, *([] if named is None else [whole.parent / named])]))


def read_recipe(path: Path) -> tuple[CameraRecipe, Path]:
    """A camera recipe and the file that holds its figures: `path`, or the base that it names."""
    text, name = read_text(path, CameraRecipe.title), str(path)
    if "base" not in parse_toml(text, name):
        return parse_recipe(text, CameraRecipe, name), path
    variant = parse_recipe(text, PhaseRecipe, name)
    whole = path.parent / variant.base
    base = load_recipe(whole, CameraRecipe)
    period, (row, col) = parse_cfa(base.cfa, str(whole)).shape, variant.phase
    if row >= period[0] or col >= period[1]:
        raise RecipeError(f"{path}: phase is [{row}, {col}], and the array of {whole} is {period[0]}×{period[1]}, from 0")
    lines = [line.split() for line in base.cfa.pattern]
    pattern = [" ".join(line[col:] + line[:col]) for line in lines[row:] + lines[:row]]
    cfa = CfaRecipe(base.cfa.channels, pattern)
    return msgspec.structs.replace(base, name=variant.name, cfa=cfa), whole


def camera_from_recipe(recipe: CameraRecipe, path: Path) -> CameraModel:
    """The model a recipe describes; `path` places relative file names and names the culprit in errors."""
    _check_figures(recipe, path)
    sensor, noise = recipe.sensor, recipe.noise
    converter = 2**sensor.bits - 1
    white_level = sensor.white_level_dn
    if white_level is None:
        white_level = min(converter, np.floor(sensor.black_level_dn + sensor.gain_dn_per_e * noise.well_capacity_e))
    wavelength, responsivity = _responsivity(recipe, path)
    try:
        return CameraModel(
            name=recipe.name,
            rows=sensor.rows,
            cols=sensor.cols,
            pixel_pitch=sensor.pixel_pitch_um * 1e-6,
            bits=sensor.bits,
            channels=tuple(recipe.cfa.channels),
            cfa=parse_cfa(recipe.cfa, str(path)),
            wavelength=wavelength,
            responsivity=responsivity,
            responsivity_band=np.zeros_like(responsivity),
            absolute=True,
            gain=sensor.gain_dn_per_e,
            black_level=sensor.black_level_dn,
            white_level=float(white_level),
            fixed_pattern_seed=sensor.fixed_pattern_seed,
            noise=Noise(
                read_noise=noise.read_noise_e,
                dark_current=noise.dark_current_e_per_s,
                dsnu=noise.dsnu_e,
                prnu=noise.prnu,
                well_capacity=noise.well_capacity_e,
                column_noise=noise.column_noise_e,
            ),
            optics=Optics(recipe.optics.focal_length_mm * 1e-3, recipe.optics.f_number, recipe.optics.object_distance_m),
        )
    except ValueError as error:
        raise RecipeError(f"{path}: {error}") from error


def _check_figures(recipe: CameraRecipe, path: Path) -> None:
    """RecipeError if a number of the recipe cannot be."""
    sensor, noise, optics = recipe.sensor, recipe.noise, recipe.optics
    if not 1 <= sensor.bits <= 16:
        raise RecipeError(f"{path}: sensor.bits is {sensor.bits}; a raw value has 1 to 16 bits")
    positive = [
        ("sensor.rows", sensor.rows),
        ("sensor.cols", sensor.cols),
        ("sensor.pixel_pitch_um", sensor.pixel_pitch_um),
        ("sensor.gain_dn_per_e", sensor.gain_dn_per_e),
        ("responsivity.peak_efficiency", recipe.responsivity.peak_efficiency),
        ("noise.well_capacity_e", noise.well_capacity_e),
        ("optics.focal_length_mm", optics.focal_length_mm),
        ("optics.f_number", optics.f_number),
    ]
    for channel, terms in (recipe.responsivity.gaussians or {}).items():
        for term in terms:
            widths = (term.sigma_nm, term.sigma_nm if term.sigma_above_nm is None else term.sigma_above_nm)
            positive.append((f"a sigma of the Gaussians of {channel}", min(widths)))
    spreads = [(f"noise.{key}", getattr(noise, key)) for key in noise.__struct_fields__ if key != "well_capacity_e"]
    for key, value in positive:
        if not 0 < value < float("inf"):
            raise RecipeError(f"{path}: {key} is {value:g}, and must be above zero")
    for key, value in spreads:
        if not 0 <= value < float("inf"):
            raise RecipeError(f"{path}: {key} is {value:g}, and must not be negative")
    check_share(recipe.responsivity.peak_efficiency, "responsivity.peak_efficiency", 1.0, path)
    check_share(noise.prnu, "noise.prnu", MOST_PRNU, path)
    check_lengths(sensor.pixel_pitch_um, optics, path)


def check_share(value: float, key: str, most: float, path: Path) -> None:
    """RecipeError if a share that cannot be more than `most` is."""
    if value > most:
        percent = f"; {value:g} % is {value / 100:g}" if value <= 100 * most else ""
        raise RecipeError(f"{path}: {key} is {value:g}, and a share of {most:g} at most{percent}")


def check_lengths(pitch_um: float, optics: OpticsRecipe, path: Path) -> None:
    """RecipeError if pixel pitch, focal length or f-number are none by their size: given in another unit."""
    least, most = PITCHES_UM
    if not least <= pitch_um <= most:
        meant = next(
            (f"; {pitch_um * each:g} is meant?" for each in (1e3, 1e6, 1e-3) if least <= pitch_um * each <= most), ""
        )
        raise RecipeError(f"{path}: sensor.pixel_pitch_um is {pitch_um:g}, and must lie in {least:g}…{most:g} µm{meant}")
    if optics.focal_length_mm < LEAST_FOCAL_MM:
        meant = f"{optics.focal_length_mm * 1000:g}"
        raise RecipeError(f"{path}: optics.focal_length_mm is {optics.focal_length_mm:g} mm; is {meant} meant?")
    if optics.f_number < LEAST_F_NUMBER:
        raise RecipeError(f"{path}: optics.f_number is {optics.f_number:g}; no lens in air is below {LEAST_F_NUMBER}")


def parse_cfa(cfa: CfaRecipe, name: str) -> NDArray[np.uint8]:
    """Channel indices (cfa_row, cfa_col) of the super-pixel; RecipeError if a name is unknown or rows differ in length."""
    rows = [row.split() for row in cfa.pattern]
    if not rows or not rows[0] or any(len(row) != len(rows[0]) for row in rows):
        raise RecipeError(f"{name}: the rows of cfa.pattern must name equally many channels, separated by spaces")
    if len(rows) > MAX_CFA or len(rows[0]) > MAX_CFA:
        raise RecipeError(f"{name}: cfa.pattern is larger than {MAX_CFA}×{MAX_CFA}")
    if len(cfa.channels) > MAX_CHANNELS or len(set(cfa.channels)) != len(cfa.channels):
        raise RecipeError(f"{name}: cfa.channels must be at most {MAX_CHANNELS} different names")
    used = {channel for row in rows for channel in row}
    if used != set(cfa.channels):
        what = _differences(used, cfa.channels)
        raise RecipeError(f"{name}: cfa.channels and cfa.pattern do not name the same channels: {what}")
    return np.array([[cfa.channels.index(channel) for channel in row] for row in rows], dtype=np.uint8)


def _differences(names: Iterable[str], channels: list[str]) -> str:
    """What is wrong with `names`, which ought to be the channels."""
    odd = sorted(set(names) - set(channels))
    if odd:
        return f'"{odd[0]}" is no channel; {suggestion(odd[0], channels)}'
    return f"{', '.join(sorted(set(channels) - set(names)))} is missing"


def _responsivity(recipe: CameraRecipe, path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(wavelength) nm and quantum efficiency (channel, wavelength) e-/photon of a recipe."""
    declared = recipe.responsivity
    first, last, step = declared.wavelength_nm
    if not (0 < first < last and step > 0):
        raise RecipeError(f"{path}: responsivity.wavelength_nm must be first < last with a positive step")
    if (last - first) / step >= MOST_WAVELENGTHS or last > LONGEST:
        raise RecipeError(f"{path}: responsivity.wavelength_nm has {MOST_WAVELENGTHS} values at most, up to {LONGEST} nm")
    wavelength = np.arange(first, last + step / 2, step)
    if (declared.gaussians is None) == (declared.file is None):
        raise RecipeError(f"{path}: give either responsivity.gaussians or responsivity.file")
    if declared.gaussians is not None:
        if set(recipe.cfa.channels) != set(declared.gaussians):
            what = _differences(declared.gaussians, recipe.cfa.channels)
            raise RecipeError(f"{path}: responsivity.gaussians and cfa.channels differ: {what}")
        curves = np.array([_sum_of_gaussians(wavelength, declared.gaussians[c]) for c in recipe.cfa.channels])
    else:
        assert declared.file is not None
        table = read_table(path.parent / declared.file).ordered(recipe.cfa.channels)
        curves = spectra.average(table.responses(declared.per_energy, "per_energy"), table.wavelength, wavelength)
    if declared.per_energy:
        curves = curves / wavelength
    return wavelength, declared.peak_efficiency * curves / curves.max()


def _sum_of_gaussians(wavelength: NDArray[np.float64], terms: list[Gaussian]) -> NDArray[np.float64]:
    total = np.zeros_like(wavelength)
    for term in terms:
        above = term.sigma_nm if term.sigma_above_nm is None else term.sigma_above_nm
        sigma = np.where(wavelength < term.centre_nm, term.sigma_nm, above)
        total += term.peak * np.exp(-0.5 * ((wavelength - term.centre_nm) / sigma) ** 2)
    return total


def recipe_text(path: Path) -> str:
    """The text of a recipe, and of its base below it, for the history; nothing for an artifact."""
    if path.suffix != ".toml":
        return ""
    return "\n".join(read_text(file) for file in dict.fromkeys([path, read_recipe(path)[1]]))
