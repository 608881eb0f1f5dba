"""The camera model: what calibration finds out and simulation needs (METHOD 1)."""

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from l3cli import spectra
from l3cli.artifacts.base import MOST, Artifact, data, group, load
from l3cli.artifacts.fit import Fit
from l3cli.config import LARGEST, Recipe, load_recipe, read_text
from l3cli.errors import InputFileError, RecipeError, suggestion
from l3cli.limits import most_pixels, read_bounded

MAX_CHANNELS = 16  # a saturation code is 16 bits wide
MAX_CFA = 8
MAX_BITS = 16
MOST_CURVE_ROWS = 100_000
MOST_WAVELENGTHS, LONGEST = 10_000, 20_000  # samples of a spectrum; nm


@dataclass(frozen=True)
class Noise:
    """Noise of METHOD 1.2, referred to the photodiode."""

    read_noise: float = data("float64", unit="e-", doc="standard deviation of one reading in the dark")
    dark_current: float = data("float64", unit="e-/s", doc="mean dark current")
    dsnu: float = data("float64", unit="e-", doc="dark signal nonuniformity, standard deviation over pixels")
    prnu: float = data("float64", unit="1", doc="photo response nonuniformity, relative standard deviation over pixels")
    well_capacity: float = data("float64", unit="e-", doc="electrons at which a pixel saturates")
    column_noise: float = data(
        "float64", unit="e-", doc="fixed offset of each column, standard deviation over columns", default=0.0
    )

    def __post_init__(self) -> None:
        figures = (self.read_noise, self.dark_current, self.dsnu, self.prnu, self.column_noise)
        if not (min(figures) >= 0 and self.well_capacity > 0):
            raise ValueError("noise figures must not be negative, and the well capacity must be above zero")


@dataclass(frozen=True)
class Optics:
    """Lens between scene and sensor (METHOD 1.3). Its transmittance is part of the responsivity."""

    focal_length: float = data("float64", unit="m", doc="focal length")
    f_number: float = data("float64", unit="1", doc="focal length / aperture diameter")
    object_distance: float = data("float64", unit="m", doc="distance of the scene; 0: infinity")

    def __post_init__(self) -> None:
        near = self.object_distance != 0 and self.object_distance <= self.focal_length
        if not (self.focal_length > 0 and self.f_number > 0) or near:
            raise ValueError("focal length and f-number must be above zero, the object farther than the focal length")

    @property
    def irradiance_per_radiance(self) -> float:
        """Camera equation, sr: sensor irradiance / scene radiance on the axis, π / (1 + 4 N² (1+|m|)²) (METHOD 1.3)."""
        magnification = self.focal_length / (self.object_distance - self.focal_length) if self.object_distance > 0 else 0.0
        return float(np.pi / (1.0 + 4.0 * self.f_number**2 * (1.0 + magnification) ** 2))


def check_sensor(rows: int, cols: int, bits: int, black: float, white: float) -> None:
    """ValueError if there is no such sensor."""
    if not (rows > 0 and cols > 0 and rows * cols <= most_pixels() and 1 <= bits <= MAX_BITS):
        raise ValueError(f"rows {rows}, cols {cols}, bits {bits}: no sensor has these, or not up to {MAX_BITS} bits")
    if not 0 <= black < white <= 2**bits - 1:
        raise ValueError(f"black {black:g} and white {white:g} do not lie in 0…{2**bits - 1}")


def check_cfa(cfa: NDArray[np.uint8], channels: tuple[str, ...]) -> None:
    """ValueError if a super-pixel is empty, too large, or names channels that do not exist."""
    if not (cfa.size > 0 and max(cfa.shape) <= MAX_CFA and 0 < len(channels) <= MAX_CHANNELS):
        raise ValueError(f"cfa must be at most {MAX_CFA}×{MAX_CFA} of at most {MAX_CHANNELS} channels")
    if cfa.max() >= len(channels):
        raise ValueError(f"cfa names channel {cfa.max()}, but there are {len(channels)}")


def check_wavelengths(wavelength: NDArray[np.float64]) -> None:
    """ValueError unless wavelengths increase and are light's."""
    if not (1 < wavelength.size <= MOST_WAVELENGTHS and (np.diff(wavelength) > 0).all()):
        raise ValueError(f"wavelength must increase and be 2 to {MOST_WAVELENGTHS} values")
    if not (wavelength[0] > 0 and wavelength[-1] <= LONGEST):
        raise ValueError(f"wavelength must lie in 0…{LONGEST} nm")


@dataclass(frozen=True)
class CameraModel(Artifact):
    """A camera: geometry, colour filter array, responsivities, analog chain, noise, optics."""

    kind: ClassVar[str] = "camera model"
    version: ClassVar[int] = 2
    made_by: ClassVar[str] = '"l3 calibrate"'

    name: str = data("str", doc="what the camera is called")
    rows: int = data("int64", unit="pixel", doc="height of the sensor")
    cols: int = data("int64", unit="pixel", doc="width of the sensor")
    pixel_pitch: float = data("float64", unit="m", doc="distance of pixel centres")
    bits: int = data("int64", unit="bit", doc="depth of the analog-digital converter")
    channels: tuple[str, ...] = data("str", "channel", doc="names of the spectral channels")
    cfa: NDArray[np.uint8] = data("uint8", "cfa_row", "cfa_col", doc="channel of each site of the super-pixel")
    wavelength: NDArray[np.float64] = data("float64", "wavelength", unit="nm", doc="grid of the responsivities")
    responsivity: NDArray[np.float64] = data(
        "float64",
        "channel",
        "wavelength",
        unit="e-/photon",
        doc="quantum efficiency with lens, filters and fill factor folded in; relative (peak 1) unless absolute",
    )
    responsivity_band: NDArray[np.float64] = data(
        "float64", "channel", "wavelength", unit="e-/photon", doc="half width of the 95 % band; 0: not measured"
    )
    absolute: bool = data("bool", doc="whether responsivity is a quantum efficiency or only relative")
    gain: float = data("float64", unit="DN/e-", doc="conversion gain K")
    black: float = data("float64", unit="DN", doc="mean value in the dark at zero exposure")
    white: float = data("float64", unit="DN", doc="value at which a pixel saturates: well or converter")
    fixed_pattern_seed: int = data("int64", doc="seed of this camera's PRNU and DSNU maps")
    noise: Noise = group()
    optics: Optics = group()
    declared: tuple[str, ...] = data(
        "str", "declared", doc="quantities that calibration took from a data sheet instead of measuring them", default=()
    )
    fit: Fit | None = group(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sensor(self.rows, self.cols, self.bits, self.black, self.white)
        check_cfa(self.cfa, self.channels)
        check_wavelengths(self.wavelength)
        if not (self.pixel_pitch > 0 and self.gain > 0 and self.responsivity.max() > 0 and self.fixed_pattern_seed >= 0):
            raise ValueError("pixel_pitch, gain and the peak of the responsivity must be above zero, the seed not below")

    @property
    def full_scale(self) -> float:
        """Electrons between black and white."""
        return (self.white - self.black) / self.gain

    @property
    def electron_weights(self) -> NDArray[np.float64]:
        """W (channel, wavelength): mean photo-electrons a second = W @ scene radiance (photons/s/sr/m²/nm) (METHOD 1.2)."""
        photons = self.optics.irradiance_per_radiance * self.pixel_pitch**2 * spectra.bin_widths(self.wavelength)
        return self.responsivity * photons

    @functools.cached_property
    def white_dose(self) -> float:
        """cd s/m²: scene luminance × exposure time at which a perfect white under D65 just fills the brightest channel.

        InputFileError if the camera collects next to nothing of that light.
        """
        white = spectra.at_luminance(spectra.illuminant("D65", self.wavelength), self.wavelength, 1.0)
        electrons = float((self.electron_weights @ white).max())
        dose = self.full_scale / electrons if electrons > 0 else np.inf
        if not dose <= MOST:
            raise InputFileError(
                f"camera {self.name}: {dose:.3g} cd s/m² of daylight fill a pixel; check responsivity, pitch, f-number"
            )
        return dose

    def noise_variance(self, signal: NDArray[np.floating]) -> NDArray[np.floating]:
        """Variance in DN² of a pixel whose mean lies `signal` DN above black (METHOD 1.3, with quantisation)."""
        constant, linear, quadratic = self.noise_terms
        signal = np.maximum(signal, 0.0)
        return constant + (linear + quadratic * signal) * signal

    @property
    def noise_terms(self) -> tuple[float, float, float]:
        """The noise variance's constant (DN²), linear (DN) and quadratic term over the signal above black."""
        noise = self.noise
        constant = self.gain**2 * (noise.read_noise**2 + noise.dsnu**2 + noise.column_noise**2) + 1.0 / 12.0
        return constant, self.gain, noise.prnu**2


# ----------------------------------------------------------------------------------------------------- recipes


class SensorRecipe(Recipe):
    rows: int
    cols: int
    pixel_pitch_um: float
    bits: int
    gain_dn_per_e: float
    black_dn: float
    white_dn: float | None = None  # default: the lower of well and converter
    fixed_pattern_seed: int = 0


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
    file: str | None = None  # CSV: wavelength in nm, then one column a channel in the order of cfa.channels
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


def load_camera(path: Path) -> CameraModel:
    """A camera from a camera.h5 or from a camera recipe (.toml)."""
    if path.suffix == ".toml":
        return camera_from_recipe(load_recipe(path, CameraRecipe), path)
    return load(CameraModel, path)


def camera_from_recipe(recipe: CameraRecipe, path: Path) -> CameraModel:
    """The model a recipe describes; `path` places relative file names and names the culprit in errors."""
    _check_figures(recipe, path)
    sensor, noise = recipe.sensor, recipe.noise
    converter = 2**sensor.bits - 1
    white = sensor.white_dn
    if white is None:
        white = min(converter, np.floor(sensor.black_dn + sensor.gain_dn_per_e * noise.well_capacity_e))
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
            black=sensor.black_dn,
            white=float(white),
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
    for key, value in (*spreads, ("sensor.fixed_pattern_seed", sensor.fixed_pattern_seed)):
        if not 0 <= value < float("inf"):
            raise RecipeError(f"{path}: {key} is {value:g}, and must not be negative")


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
        grid, table = read_curves(path.parent / declared.file, len(recipe.cfa.channels))
        curves = spectra.resample(table, grid, wavelength)
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


def read_curves(path: Path, columns: int | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spectra from a CSV file: (wavelength) in nm and (column, wavelength). Lines that begin with # and one header line
    are skipped; InputFileError if the rest is not numbers, not increasing, or not `columns` columns."""
    try:
        lines = [line for line in read_bounded(path).decode("utf-8-sig").splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputFileError(f"{path}: {reason}; give a CSV file of spectra") from error
    lines = [line for line in lines if not line.startswith("#")]
    rows = []
    for number, line in enumerate(lines):
        try:
            rows.append([float(cell) for cell in line.replace(";", ",").split(",")])
        except ValueError:
            if number:  # the first line may be a header
                raise InputFileError(f'{path}: "{line[:40]}" is not a row of numbers') from None
    if not rows or len({len(row) for row in rows}) != 1 or len(rows[0]) < 2:
        raise InputFileError(f"{path}: rows must be a wavelength in nm and equally many values each")
    table = np.array(rows)
    if not (np.abs(table) <= LARGEST).all() or (np.diff(table[:, 0]) <= 0).any():
        raise InputFileError(f"{path}: wavelengths must increase and every value be a number within ±{LARGEST:g}")
    if len(table) > MOST_CURVE_ROWS or not (table[0, 0] > 0 and table[-1, 0] <= LONGEST):
        raise InputFileError(f"{path}: give {MOST_CURVE_ROWS} wavelengths at most, within 0…{LONGEST} nm")
    if columns is not None and table.shape[1] != columns + 1:
        raise InputFileError(f"{path}: holds {table.shape[1] - 1} curves, {columns} are wanted")
    return table[:, 0], table[:, 1:].T


def recipe_text(path: Path) -> str:
    """The recipe's text for the history, or nothing for an artifact."""
    return read_text(path) if path.suffix == ".toml" else ""
