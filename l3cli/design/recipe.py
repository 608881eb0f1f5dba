"""The design recipe: the pixel, filters, candidate arrays and light levels of a design, and the error to minimise."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import (
    CfaRecipe,
    GainRecipe,
    SensorRecipe,
    camera_files,
    load_camera,
    masked_recipe,
    noise_entries,
    optics_recipe,
)
from l3cli.errors import RecipeError, suggestion
from l3cli.physics import spectra
from l3cli.physics.mosaic import array_rows
from l3cli.recipes.builtin import CURVES, find_recipe
from l3cli.recipes.faults import Fault, fault, inside
from l3cli.recipes.load import load_recipe
from l3cli.recipes.toml import (
    KIND_KEYS,
    Count,
    KeyPath,
    NotNegative,
    Positive,
    Recipe,
    Share,
    parse_toml,
    read_text,
    toml_value,
)
from l3cli.spectra.file import read_table
from l3cli.system.text import printable

MAX_FILTERS = 16  # largest number of filters in a recipe
MAX_SIDE = 8  # largest number of rows or columns of an array
Side = Annotated[int, msgspec.Meta(ge=1, le=MAX_SIDE)]
OPAQUE_EFFICIENCY = 1e-3  # peak quantum efficiency below which filters are rejected
Curves = NDArray[np.float64]  # (filter, wavelength) or (wavelength,)


class PixelRecipe(Recipe):
    """Section [pixel]: the pixel under the filters."""

    camera: str = "bayer"  # file or name of the camera model or camera recipe that supplies the sensor, noise and lens
    # Quantum efficiency of the pixel with the lens but without a filter: a number, or the name of a CSV file. It is
    # multiplied by the transmittance of each filter.
    bare: float | str = 0.6
    pitch_um: Positive | None = None  # this key and the keys below override the camera's values
    well_e: Positive | None = None  # full-well capacity; the gain is scaled so that a full well is at full scale
    read_noise_e: NotNegative | None = None
    f_number: Positive | None = None


class FilterRecipe(Recipe):
    """Section [filters.NAME]: a colour filter.

    A filter is a Gaussian (`centre_nm`), a measured curve (`file`), a stack of two filters (`stack`) or a channel of a
    camera (`channel`). A filter without these keys is clear.
    """

    centre_nm: Positive | None = None
    sigma_nm: Positive | None = None
    peak: Share = 0.9  # transmittance at the centre
    floor: Share = 0.04  # transmittance far from the centre
    file: str | None = None  # CSV file with wavelengths in nm and transmittances
    column: str | int = 1  # name of the column in the file, or its number, counted from 1
    stack: tuple[str, str] | None = None  # names of two filters of the recipe
    channel: str | None = None  # channel of pixel.camera; its quantum efficiency already includes the pixel and the lens


class PatternRecipe(Recipe):
    """Entry [[pattern]]: candidate arrays, either all arrays of a shape or a list of arrays."""

    shape: tuple[Side, Side] | None = None  # rows and columns
    filters: list[str] = msgspec.field(default_factory=list)  # filters that the arrays may contain; default: all filters
    counts: dict[str, Count] | None = None  # number of sites per filter; default: any number
    arrays: list[list[str]] = msgspec.field(default_factory=list)  # arrays as lists of rows, such as ["r g", "g b"]


class LevelRecipe(Recipe):
    """Entry [[level]]: a light level, which is an illuminant and an exposure.

    The exposure is automatic (`share`) or fixed (`exposure_s` with `luminance_cd_m2` or `lux`).
    """

    name: str | None = None
    illuminant: str = "D65"  # an illuminant for which the scene moments were computed
    share: Positive | None = None  # signal of white in the brightest filter of each array, as a fraction of full scale
    luminance_cd_m2: Positive | None = None  # luminance of a perfect white
    lux: Positive | None = None  # illuminance, as an alternative to luminance_cd_m2
    exposure_s: Positive | None = None


class OptimiseRecipe(Recipe):
    """Section [optimise]: describes the filter array for which l3 optimises Gaussian filters."""

    pattern: list[str]  # rows of filter names
    peaks: bool = False  # whether to optimise the peaks in addition to the centres and widths


class DesignRecipe(Recipe):
    """A design recipe: the search for the best array of given filters, for a pixel and light levels."""

    title: ClassVar[str] = "a design recipe"

    name: str
    filters: Annotated[dict[str, FilterRecipe], msgspec.Meta(min_length=1, max_length=MAX_FILTERS)]
    pattern: Annotated[list[PatternRecipe], msgspec.Meta(min_length=1)]
    level: Annotated[list[LevelRecipe], msgspec.Meta(min_length=1)]
    pixel: PixelRecipe = msgspec.field(default_factory=PixelRecipe)
    output: Literal["XYZ", "bands", "reflectance"] = "XYZ"
    # Error metric for XYZ. "lab" approximates ΔE00. "scielab" approximates ΔE00 after blurring the chroma as the eye does.
    # "luminance" ignores chroma. "linear" is a difference in percent of white.
    counts: Literal["lab", "scielab", "luminance", "linear"] = "lab"
    optimise: OptimiseRecipe | None = None
    rivals: list[list[str]] = msgspec.field(default_factory=list)  # other arrays to train with --truth, as lists of rows

    @property
    def needed(self) -> int:
        """Minimum number of independent outputs from the filters of an array."""
        if self.output != "XYZ":
            return min(2, len(self.filters))
        return 1 if self.counts == "luminance" else 3

    @property
    def tuned(self) -> list[str]:
        """Names of the filters to optimise: the Gaussian filters in the array of [optimise]."""
        used = {name for row in (self.optimise.pattern if self.optimise else []) for name in row.split()}
        return [name for name, one in self.filters.items() if name in used and one.centre_nm is not None]


# ------------------------------------------------------------------------------------------------------- faults


def design_faults(recipe: DesignRecipe) -> Iterator[Fault]:
    """Yield all faults in a design recipe, but not the faults in the curve files that it names."""
    for name, one in recipe.filters.items():
        yield from inside(_filter_faults(name, one, recipe.filters), "filters", name)
    arrays: list[tuple[str, KeyPath, list[str]]] = []
    for number, pattern in enumerate(recipe.pattern):
        where, table = f"pattern {number + 1}", ("pattern", number)
        yield from inside(_pattern_faults(where, pattern, recipe.filters), *table)
        arrays += [(f"{where}: array {n + 1}", (*table, "arrays", n), rows) for n, rows in enumerate(pattern.arrays)]
    for number, level in enumerate(recipe.level):
        yield from inside(_level_faults(f"level {number + 1}", level), "level", number)
    arrays += [(f"rivals: array {number + 1}", ("rivals", number), rows) for number, rows in enumerate(recipe.rivals)]
    if recipe.optimise is not None:
        arrays.append(("optimise.pattern", ("optimise", "pattern"), recipe.optimise.pattern))
        if not recipe.tuned:
            yield fault(
                "optimise.pattern contains no Gaussian filter; set centre_nm and sigma_nm for one of its filters",
                "optimise.pattern",
            )
    for where, key, rows in arrays:
        yield from inside(_array_faults(where, rows, recipe.filters), *key)


WHOLE: KeyPath = ()  # path of the TOML table itself, for faults that do not concern a single key


def _filter_faults(name: str, one: FilterRecipe, known: Mapping[str, FilterRecipe]) -> Iterator[Fault]:
    kinds = [each for each in ("centre_nm", "file", "stack", "channel") if getattr(one, each) is not None]
    if name.split() != [name] or "/" in name:
        yield fault(f'filter "{name}": the name contains a blank or a slash; rename the filter', WHOLE)
    if len(kinds) > 1:
        yield fault(f"filter {name}: the keys {kinds[0]} and {kinds[1]} exclude each other; remove one of them", kinds[1])
    if (one.centre_nm is None) != (one.sigma_nm is None):
        yield fault(f"filter {name}: a Gaussian needs two keys; set both centre_nm and sigma_nm", WHOLE)
    if one.floor > one.peak:
        yield fault(f"filter {name}: floor is {one.floor:g}, but must not exceed peak, which is {one.peak:g}", "floor")
    for other in one.stack or ():
        if other not in known:
            yield fault(
                f'filter {name}: stack contains "{other}", which is not a filter; {suggestion(other, known)}', "stack"
            )
        elif known[other].stack is not None or known[other].channel is not None:
            yield fault(
                f"filter {name}: stack contains {other}, which is itself a stack or a channel; use only Gaussian filters "
                "and filters from files in stack",
                "stack",
            )


def _pattern_faults(where: str, pattern: PatternRecipe, known: Mapping[str, FilterRecipe]) -> Iterator[Fault]:
    counts = pattern.counts or {}
    if (pattern.shape is None) == (not pattern.arrays):
        yield fault(f"{where} needs either shape or arrays; set exactly one of these keys", WHOLE)
    for name in sorted({*pattern.filters, *counts} - {*known}):
        yield fault(f'{where}: "{name}" is not a filter; {suggestion(name, known)}', WHOLE)
    if counts and pattern.filters:
        yield fault(f"{where}: the keys counts and filters exclude each other; remove one of them", "filters")
    if pattern.shape is not None:
        (rows, cols), total = pattern.shape, sum(counts.values())
        if counts and total != rows * cols:
            yield fault(
                f"{where}: the counts add up to {total}, but the shape has {rows * cols} sites; change counts or shape",
                "counts",
                WHOLE,
            )


def _array_faults(where: str, rows: list[str], known: Mapping[str, FilterRecipe]) -> Iterator[Fault]:
    lengths = {len(row.split()) for row in rows}
    if len(lengths) != 1 or 0 in lengths:
        yield fault(f"{where}: the rows have different lengths; write the same number of filter names in each row", WHOLE)
    elif max(len(rows), *lengths) > MAX_SIDE:
        yield fault(f"{where} has more than {MAX_SIDE}×{MAX_SIDE} sites; use a smaller array", WHOLE)
    for name in sorted({name for row in rows for name in row.split()} - {*known}):
        yield fault(f'{where}: "{name}" is not a filter; {suggestion(name, known)}', WHOLE)


def _level_faults(where: str, level: LevelRecipe) -> Iterator[Fault]:
    if (level.share is None) == (level.exposure_s is None):
        yield fault(f"{where} needs either share (automatic exposure) or exposure_s; set exactly one of these keys", WHOLE)
    if level.luminance_cd_m2 is not None and level.lux is not None:
        yield fault(f"{where}: luminance_cd_m2 and lux exclude each other; remove one of them", "lux")
    if level.exposure_s is not None and level.luminance_cd_m2 is None and level.lux is None:
        yield fault(f"{where}: exposure_s needs luminance_cd_m2 or lux; add one of them", "exposure_s")


def level_name(level: LevelRecipe) -> str:
    """Return the name of a light level, or a description such as "white at 0.5 A" if it has none."""
    light = "" if level.illuminant == "D65" else f" {level.illuminant}"
    if level.name is not None:
        return level.name
    if level.share is not None:
        return f"white at {level.share:g}{light}"
    brightness = f"{level.lux:g} lx" if level.lux is not None else f"{level.luminance_cd_m2:g} cd/m²"
    return f"{brightness}, {level.exposure_s:g} s{light}"


# ------------------------------------------------------------------------------------------------------- curves


def curve_files(recipe: DesignRecipe, folder: Path) -> list[Path]:
    """List the files with curves that a design recipe names. The names are relative to `folder`."""
    names = (*(one.file for one in recipe.filters.values()), recipe.pixel.bare)
    return [folder / name for name in names if isinstance(name, str)]


def filter_curves(recipe: DesignRecipe, camera: CameraModel, wavelength: Curves, folder: Path) -> Curves:
    """Compute the quantum efficiency of the pixel behind each filter.

    Parameters
    ----------
    recipe : DesignRecipe
        Design recipe with the filters and the pixel.
    camera : CameraModel
        The pixel's camera. Its channels can be used as filters.
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.
    folder : Path
        Folder of the recipe, to which its file names are relative.

    Returns
    -------
    ndarray, (filter, wavelength)
        Quantum efficiencies.

    Raises
    ------
    RecipeError, InputFileError
        If a filter is opaque, a channel is unknown, or a file with curves is unusable.
    """
    bare, curves = bare_efficiency(recipe.pixel.bare, wavelength, folder), []
    for name, one in recipe.filters.items():
        if one.channel is not None:
            if one.channel not in camera.channels:
                known = suggestion(one.channel, camera.channels)
                raise RecipeError(f'filter {name}: channel "{one.channel}" does not exist in pixel.camera; {known}')
            channel = camera.responsivity[camera.channels.index(one.channel)]
            curves.append(np.interp(wavelength, camera.wavelength, channel, 0.0, 0.0))
        else:
            parts = [_transmittance(recipe.filters[part], wavelength, folder) for part in one.stack or (name,)]
            curves.append(np.prod([bare, *parts], axis=0))
        if (peak := curves[-1].max()) < OPAQUE_EFFICIENCY:
            raise RecipeError(
                f"filter {name} is opaque: its highest quantum efficiency between {wavelength[0]:g} and "
                f"{wavelength[-1]:g} nm is {peak:.2g}; change or remove the filter"
            )
    return np.array(curves)


def bare_efficiency(bare: float | str, wavelength: Curves, folder: Path) -> Curves:
    """Return the quantum efficiency (wavelength,) of a pixel without a filter.

    Parameters
    ----------
    bare : float or str
        The recipe key `bare`: a number, or the name of a CSV file in `folder`.
    wavelength : ndarray, (wavelength,)
        Wavelengths in nm.
    folder : Path
        Folder of the recipe.

    Raises
    ------
    RecipeError
        If a value is not between 0 and 1.
    InputFileError
        If the file is unusable.
    """
    if isinstance(bare, str):
        table = read_table(folder / bare).counted(1)
        curve = spectra.average(table.efficiencies(False)[0], table.wavelength, wavelength)
    else:
        curve = np.full(wavelength.size, bare)
    if not 0 < curve.max() <= 1 or curve.min() < 0:
        raise RecipeError(
            f"pixel.bare contains values from {curve.min():g} to {curve.max():g}; use quantum efficiencies between 0 and 1"
        )
    return curve


def _transmittance(one: FilterRecipe, wavelength: Curves, folder: Path) -> Curves:
    if one.file is not None:
        table = read_table(folder / one.file).column(one.column)
        return spectra.average(table.shares()[0], table.wavelength, wavelength)
    if one.centre_nm is None or one.sigma_nm is None:
        return np.ones(wavelength.size)
    return gaussian(wavelength, one.centre_nm, one.sigma_nm, one.peak, one.floor)


def gaussian(wavelength: Curves, centre: float, sigma: float, peak: float, floor: float) -> Curves:
    """Return the transmittance of a Gaussian filter. Wavelengths, `centre` and `sigma` are in nm."""
    return np.asarray(floor + (peak - floor) * np.exp(-0.5 * ((wavelength - centre) / sigma) ** 2))


def is_design(path: Path) -> bool:
    """Whether a file is a design recipe: a TOML file with a top-level key that only design recipes contain."""
    keys = KIND_KEYS[DesignRecipe.title]
    return path.suffix == ".toml" and any(key in parse_toml(read_text(path), str(path)) for key in keys)


def pixel_camera(path: Path) -> tuple[CameraModel, list[Path]]:
    """Read the lens and the pixel from a camera model, a camera recipe or a design recipe.

    Returns
    -------
    CameraModel
        Camera with this lens and pixel. If `path` is a design recipe, its CFA and responsivities are meaningless.
    list of Path
        The files that were read.
    """
    if not is_design(path):
        return dataclasses.replace(load_camera(path), readout=None, polarisers=None), camera_files(path)
    pixel = load_recipe(path, DesignRecipe).pixel
    return pixel_of(pixel, path.parent), [path, *camera_files(base_camera(pixel, path.parent))]


def base_camera(pixel: PixelRecipe, folder: Path) -> Path:
    """Return the path of `pixel.camera`: a file relative to `folder`, or a built-in recipe."""
    own = folder / pixel.camera
    return own if own.is_file() else find_recipe(pixel.camera, "cameras")


def pixel_of(pixel: PixelRecipe, folder: Path) -> CameraModel:
    """Build a camera with the pixel of a design recipe. Its CFA and responsivities are meaningless.

    Raises
    ------
    RecipeError
        If the quantum efficiency of the base camera is unknown.
    """
    base = load_camera(base_camera(pixel, folder))
    if not base.absolute:
        raise RecipeError(
            f"the responsivities of pixel.camera ({base.name}) are only relative; use a camera with known quantum "
            "efficiencies"
        )
    noise, optics, gain = base.noise, base.optics, base.gain
    if pixel.read_noise_e is not None:
        noise = dataclasses.replace(noise, read_noise=pixel.read_noise_e)
    if pixel.well_e is not None:
        noise, gain = dataclasses.replace(noise, well_capacity=pixel.well_e), gain * base.full_scale / pixel.well_e
    if pixel.f_number is not None:
        optics = dataclasses.replace(optics, f_number=pixel.f_number)
    pitch = base.pixel_pitch if pixel.pitch_um is None else pixel.pitch_um * 1e-6
    return dataclasses.replace(
        base, noise=noise, gain=gain, optics=optics, pixel_pitch=pitch, readout=None, polarisers=None, fit=None
    )


def camera_texts(camera: CameraModel, origin: str) -> dict[str, str]:
    """Convert a camera model to a camera recipe and a CSV file with its curves.

    Parameters
    ----------
    camera : CameraModel
        A camera with equal exposure and gain in all channels.
    origin : str
        Comment for the first line of the recipe.

    Returns
    -------
    dict of str to str
        Text of each file, by file name.
    """
    pitch = round(camera.pixel_pitch * 1e6, 6)
    tables: dict[str, Recipe | dict[str, float]] = {
        "sensor": SensorRecipe(
            rows=camera.rows,
            cols=camera.cols,
            pixel_pitch_um=pitch,
            bits=camera.bits,
            black_level_dn=camera.black_level,
            gain_dn_per_e=camera.gain,
            white_level_dn=camera.white_level,
            fixed_pattern_seed=camera.fixed_pattern_seed,
        ),
        "cfa": CfaRecipe(list(camera.channels), array_rows(camera.channels, camera.cfa)),
        "noise": noise_entries(camera.noise),
        "optics": optics_recipe(camera.optics),
    }
    if (gains := camera.gains) is not None:
        tables["gain"] = GainRecipe(gains.iso, tuple(gains.analog_gain.tolist()), tuple(gains.gain_read_noise.tolist()))
    if (masked := masked_recipe(camera.masked)) is not None:
        tables["masked"] = masked
    recipe = [f"# {printable(origin)}", f"name = {toml_value(camera.name)}", f'responsivity = {{ file = "{CURVES}" }}']
    for name, table in tables.items():
        entries = table if isinstance(table, dict) else msgspec.structs.asdict(table)
        known = {key: each for key, each in entries.items() if each is not None}
        recipe += ["", f"[{name}]", *(f"{key} = {toml_value(each)}" for key, each in known.items())]
    curves = [",".join(["wavelength_nm", *(f"{name} (e-/photon)" for name in camera.channels)])]
    for at, row in zip(camera.wavelength, camera.responsivity.T, strict=True):
        curves.append(f"{at:g}," + ",".join(f"{value:.6f}" for value in row))
    return {"camera.toml": "\n".join(recipe) + "\n", CURVES: "\n".join(curves) + "\n"}
