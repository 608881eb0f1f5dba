"""DESIGN.toml: pixel, filters, arrays to try, lights and exposures, and what counts."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import RecipeError, listed, suggestion
from l3cli.physics import spectra
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Count, Positive, Recipe, Share
from l3cli.spectra.file import read_table

MOST_FILTERS, MOST_SIDE = 16, 8
LEAST_EFFICIENCY = 1e-3  # at a filter's peak: less passes nothing
Curves = NDArray[np.float64]  # (filter, wavelength)


class PixelRecipe(Recipe):
    """The pixel behind every filter."""

    camera: str = "bayer"  # camera recipe, its name, or camera.h5: sensor, noise and lens; its array does not count
    # of the bare pixel, lens included: quantum efficiency, or a CSV of it, which filters are laid on
    bare: float | str = 0.6
    pitch_um: Positive | None = None
    well_e: Positive | None = None  # the converter's range goes with it
    read_noise_e: Annotated[float, msgspec.Meta(ge=0)] | None = None
    f_number: Positive | None = None


class FilterRecipe(Recipe):
    """A filter: a Gaussian, a measured curve, two stacked, or a channel of a camera; without any, clear."""

    centre_nm: Positive | None = None
    sigma_nm: Positive | None = None
    peak: Share = 0.9  # transmittance at the centre
    floor: Share = 0.04  # and far from it
    file: str | None = None  # CSV: wavelength in nm, transmittance
    column: str | int = 1  # of the file: its name or its number from 1
    stack: tuple[str, str] | None = None  # names of other filters
    channel: str | None = None  # of the pixel's camera: its quantum efficiency as it is, without `bare`


class PatternRecipe(Recipe):
    """Arrays to try: all of a shape, of so many of each filter, or those of a list."""

    shape: tuple[Count, Count] | None = None  # rows, cols
    filters: list[str] = msgspec.field(default_factory=list)  # that may stand in it; default: all
    counts: dict[str, Count] | None = None  # filter → how many of the sites
    arrays: list[list[str]] = msgspec.field(default_factory=list)  # each as rows of names, separated by spaces
    steps: Count = 1500  # of annealing, where there are too many arrays to try all
    runs: Count = 2  # of it, from random arrays


class LevelRecipe(Recipe):
    """A light and an exposure: automatic by `share`, or `exposure_s` at a luminance or an illuminance."""

    name: str | None = None
    illuminant: str = "D65"  # one of the moments'
    share: Positive | None = None  # of full scale, that white gives the brightest filter of each array
    luminance_cd_m2: Positive | None = None  # of a perfect white
    lux: Positive | None = None  # on it, instead
    exposure_s: Positive | None = None


class OptimiseRecipe(Recipe):
    """Filters that are tuned for one array: centres, widths and, with `peaks`, heights of Gaussians."""

    pattern: list[str]  # rows of names
    filters: list[str] = msgspec.field(default_factory=list)  # default: all Gaussians in it
    peaks: bool = False
    starts: Count = 4  # the first from the filters as given


class TruthRecipe(Recipe):
    """Arrays that are trained and judged on the same unseen scenes, beside their predicted errors."""

    arrays: Count = 10  # the best ones; Bayer's of the library always
    rivals: list[list[str]] = msgspec.field(default_factory=list)  # further arrays, rows of names
    classes: str = "single"  # class recipe, of those that come with l3
    leaves: Count = 24  # training scenes; a tenth as many charts
    patterned: Share = 0.0  # share of leaves with fine patterns


class DesignRecipe(Recipe):
    """Which array is best of a library of filters, on a pixel, at some lights."""

    title: ClassVar[str] = "a design recipe"

    name: str
    filters: dict[str, FilterRecipe]
    pattern: list[PatternRecipe]
    level: list[LevelRecipe]
    pixel: PixelRecipe = msgspec.field(default_factory=PixelRecipe)
    output: Literal["XYZ", "bands", "reflectance"] = "XYZ"
    # of XYZ: "lab" about ΔE00; "scielab" with chroma as coarse as eyes see it; "luminance" alone; "linear" in % of white
    counts: Literal["lab", "scielab", "luminance", "linear"] = "lab"
    optimise: OptimiseRecipe | None = None
    truth: TruthRecipe | None = None

    @property
    def needed(self) -> int:
        """Return the independent outputs that an array needs."""
        if self.output != "XYZ":
            return min(2, len(self.filters))
        return 1 if self.counts == "luminance" else 3


def sites_of(rows: list[str]) -> list[list[str]]:
    """Return the names of filters of an array."""
    return [row.split() for row in rows]


def shown(cfa: NDArray[np.integer], names: Sequence[str]) -> str:
    """Return an array (row, col) of numbers of filters as text, rows of names divided by /."""
    return " / ".join(" ".join(names[site] for site in row) for row in cfa)


def design_faults(recipe: DesignRecipe) -> Iterator[Fault]:
    """Yield all that cannot be of a design recipe, beside the content of files."""
    for key, empty in {"filters": not recipe.filters, "pattern": not recipe.pattern, "level": not recipe.level}.items():
        if empty:
            yield fault(f"{key} must have an entry", key)
    if len(recipe.filters) > MOST_FILTERS:
        yield fault(f"{len(recipe.filters)} filters; a library holds {MOST_FILTERS} at most", "filters")
    for name, one in recipe.filters.items():
        yield from _filter_faults(name, one, recipe.filters)
    for number, pattern in enumerate(recipe.pattern):
        yield from _pattern_faults(pattern, recipe, ("pattern", number))
    for number, level in enumerate(recipe.level):
        yield from _level_faults(level, f"level {number + 1}", ("level", number))
    for number, array in enumerate(recipe.truth.rivals if recipe.truth else []):
        where = ("truth", "rivals", number)
        yield from _array_faults(array, recipe.filters, f"truth.rivals: array {number + 1}", where)
    if recipe.optimise is not None:
        yield from _array_faults(recipe.optimise.pattern, recipe.filters, "optimise.pattern", ("optimise", "pattern"))
        used = {name for row in sites_of(recipe.optimise.pattern) for name in row}
        chosen = tuned_filters(recipe.optimise, recipe.filters)
        for name in chosen:
            if name not in used or name not in recipe.filters or recipe.filters[name].centre_nm is None:
                yield fault(f'optimise.filters: "{name}" is not a Gaussian of optimise.pattern', "optimise.filters")
        if not chosen:
            yield fault("optimise.pattern has no filter with centre_nm, and only Gaussians are tuned", "optimise.pattern")


def tuned_filters(asked: OptimiseRecipe, known: Mapping[str, FilterRecipe]) -> list[str]:
    """Return the names of the filters that are tuned."""
    used = {name for row in sites_of(asked.pattern) for name in row}
    return asked.filters or [name for name, one in known.items() if name in used and one.centre_nm is not None]


def _filter_faults(name: str, one: FilterRecipe, known: Mapping[str, FilterRecipe]) -> Iterator[Fault]:
    key = ("filters", name)
    kinds = [each for each in ("centre_nm", "file", "stack", "channel") if getattr(one, each) is not None]
    if " " in name or "/" in name or not name:
        yield fault(f'filter "{name}": a name has neither blanks nor /', key)
    if len(kinds) > 1:
        yield fault(f"filter {name}: give one of centre_nm, file, stack and channel", (*key, kinds[1]))
    if (one.centre_nm is None) != (one.sigma_nm is None):
        yield fault(f"filter {name}: centre_nm and sigma_nm go together", key)
    if one.floor > one.peak:
        yield fault(f"filter {name}: floor is {one.floor:g}, above peak", (*key, "floor"))
    if one.centre_nm is not None and one.peak < LEAST_EFFICIENCY:
        yield fault(f"filter {name} passes nothing; raise peak, which is {one.peak:g}", (*key, "peak"))
    for other in one.stack or ():
        if other not in known:
            yield fault(f'filter {name}: stack names "{other}"; {suggestion(other, known)}', (*key, "stack"))
        elif known[other].stack is not None or known[other].channel is not None:
            yield fault(f"filter {name}: {other} is not a single filter; stack Gaussians or files", (*key, "stack"))


def _pattern_faults(pattern: PatternRecipe, recipe: DesignRecipe, key: tuple[str | int, ...]) -> Iterator[Fault]:
    where = f"pattern {int(key[1]) + 1}"
    if (pattern.shape is None) == (not pattern.arrays):
        yield fault(f"{where}: give either shape or arrays", key)
    if pattern.shape is not None and max(pattern.shape) > MOST_SIDE:
        yield fault(f"{where}: shape is {pattern.shape[0]}×{pattern.shape[1]}, larger than {MOST_SIDE}×{MOST_SIDE}", key)
    for name in (*pattern.filters, *(pattern.counts or ())):
        if name not in recipe.filters:
            yield fault(f'{where}: "{name}" is not a filter; {suggestion(name, recipe.filters)}', key)
    if pattern.counts is not None and pattern.filters:
        yield fault(f"{where}: counts name the filters; leave filters out", (*key, "filters"))
    if pattern.counts is not None and pattern.shape is not None:
        total, sites = sum(pattern.counts.values()), pattern.shape[0] * pattern.shape[1]
        if total != sites:
            yield fault(f"{where}: counts add up to {total}, and the shape has {sites} sites", (*key, "counts"), key)
    for number, array in enumerate(pattern.arrays):
        yield from _array_faults(array, recipe.filters, f"{where}: array {number + 1}", (*key, "arrays", number))


def _array_faults(
    rows: list[str], known: Mapping[str, FilterRecipe], what: str, key: tuple[str | int, ...]
) -> Iterator[Fault]:
    sites = sites_of(rows)
    if not sites or not sites[0] or any(len(row) != len(sites[0]) for row in sites):
        yield fault(f"{what}: rows must name equally many filters, separated by spaces", key)
    elif max(len(sites), len(sites[0])) > MOST_SIDE:
        yield fault(f"{what} is larger than {MOST_SIDE}×{MOST_SIDE}", key)
    for name in {name for row in sites for name in row} - set(known):
        yield fault(f'{what}: "{name}" is not a filter; {suggestion(name, known)}', key)


def _level_faults(level: LevelRecipe, where: str, key: tuple[str | int, ...]) -> Iterator[Fault]:
    if (level.share is None) == (level.exposure_s is None):
        yield fault(f"{where}: give either share (automatic) or exposure_s", key)
    if level.luminance_cd_m2 is not None and level.lux is not None:
        yield fault(f"{where}: give either luminance_cd_m2 or lux", (*key, "lux"))
    if level.exposure_s is not None and level.luminance_cd_m2 is None and level.lux is None:
        yield fault(f"{where}: exposure_s needs luminance_cd_m2 or lux", (*key, "exposure_s"))


def level_name(level: LevelRecipe) -> str:
    """Return what a level is called."""
    light = "" if level.illuminant == "D65" else f" {level.illuminant}"
    if level.name is not None:
        return level.name
    if level.share is not None:
        return f"white at {level.share:g}{light}"
    brightness = f"{level.lux:g} lx" if level.lux is not None else f"{level.luminance_cd_m2:g} cd/m²"
    return f"{brightness}, {level.exposure_s:g} s{light}"


# ------------------------------------------------------------------------------------------------------- curves


def filter_curves(recipe: DesignRecipe, camera: CameraModel, wavelength: Curves, folder: Path) -> Curves:
    """Return the quantum efficiency (filter, wavelength) of every filter on the pixel; files lie relative to `folder`.
    RecipeError or InputFileError for one that passes nothing or more than all."""
    bare = bare_efficiency(recipe.pixel.bare, wavelength, folder)
    curves = np.array([_curve(name, recipe, camera, bare, wavelength, folder) for name in recipe.filters])
    for name, curve in zip(recipe.filters, curves, strict=True):
        if curve.max() < LEAST_EFFICIENCY:
            span = f"{wavelength[0]:g}…{wavelength[-1]:g} nm"
            raise RecipeError(f"filter {name} passes nothing: its quantum efficiency is {curve.max():.2g} at most in {span}")
    return curves


def bare_efficiency(bare: float | str, wavelength: Curves, folder: Path) -> Curves:
    """Return the quantum efficiency (wavelength) of a pixel without a filter; RecipeError if it cannot be."""
    if isinstance(bare, str):
        table = read_table(folder / bare).counted(1)
        curve = spectra.average(table.efficiencies(False)[0], table.wavelength, wavelength)
    else:
        curve = np.full(wavelength.size, bare)
    if not 0 < curve.max() <= 1 or curve.min() < 0:
        raise RecipeError(f"pixel.bare is {curve.max():g} at its peak; a quantum efficiency lies in 0…1")
    return curve


def _curve(name: str, recipe: DesignRecipe, camera: CameraModel, bare: Curves, wavelength: Curves, folder: Path) -> Curves:
    one = recipe.filters[name]
    if one.channel is not None:
        if one.channel not in camera.channels:
            known = suggestion(one.channel, camera.channels)
            raise RecipeError(f'filter {name}: the pixel\'s camera has no channel "{one.channel}"; {known}')
        channel = camera.responsivity[camera.channels.index(one.channel)]
        return np.asarray(np.interp(wavelength, camera.wavelength, channel, 0.0, 0.0))
    passed = bare
    for part in one.stack or (name,):
        passed = passed * _transmittance(part, recipe.filters[part], wavelength, folder)
    return passed


def _transmittance(name: str, one: FilterRecipe, wavelength: Curves, folder: Path) -> Curves:
    if one.file is not None:
        table = read_table(folder / one.file).column(one.column)
        return spectra.average(table.shares()[0], table.wavelength, wavelength)
    if one.centre_nm is None or one.sigma_nm is None:
        return np.ones(wavelength.size)
    return gaussian(wavelength, one.centre_nm, one.sigma_nm, one.peak, one.floor)


def gaussian(wavelength: Curves, centre: float, sigma: float, peak: float, floor: float) -> Curves:
    """Return the transmittance (wavelength) of a Gaussian filter."""
    return np.asarray(floor + (peak - floor) * np.exp(-0.5 * ((wavelength - centre) / sigma) ** 2))


def require_exposed(names: list[str], clipped: list[bool]) -> None:
    """Raise RecipeError naming the levels that clip every filter in every group of patches."""
    if wrong := [name for name, all_clip in zip(names, clipped, strict=True) if all_clip]:
        raise RecipeError(f"{listed(wrong)}: every filter clips in every part of the scenes; expose less")
