"""The virtual lab: what a lab would measure of a camera, so that calibration can be tried where the truth is known."""

import re
from dataclasses import dataclass, field
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import LONGEST, MOST_WAVELENGTHS, CameraModel
from l3cli.config import Count, CountOrNone, Positive, Recipe
from l3cli.errors import RecipeError
from l3cli.measurement import CHART_COLS, CHART_ROWS, PATCHES
from l3cli.physics import spectra
from l3cli.physics.lens import relative_illumination
from l3cli.simulation.flaws import FlawRecipe, check_flaws, flaws_of
from l3cli.simulation.sensor import FixedPattern, fixed_pattern, read_out

FOLDERS = ("mono", "chart", "white", "dark", "spectra")  # of captures by kind, and of what the spectrometer saw
PATCH_SIDE = 0.8  # of a chart cell; the rest is black mount
MARGIN = 0.08  # of the frame's height around the chart
MOUNT = 0.03  # reflectance between and around the patches
OVEREXPOSED = 2.0  # full scales that a step taken again reaches
SPARE = 5.0  # nm that the spectrometer sees beyond camera and slits
MOST_STRAY, MOST_DRIFT = 0.01, 0.2  # beyond, a slit is no slit and a lamp no lamp
MEMORY = 0.8  # correlation of the lamp's drift from one capture to the next
Array = NDArray[np.float64]


class MonoRecipe(Recipe):
    """A monochromator that fills the field; its slit function is a triangle above some stray light."""

    first_nm: float | None = None  # default: the first slit that lies within the camera's responsivities
    last_nm: float | None = None  # default: the last one
    step_nm: float = 10.0
    bandwidth_nm: float = 10.0  # full width at half maximum
    stray_light: float = 0.0005  # share of the peak at every wavelength
    trials: Count = 1  # frames a step
    overexposed: CountOrNone = (
        4  # steps between the first and the last, as far as there are, that are taken again far too long
    )
    level: float = 0.5  # share of full scale that the brightest channel reaches
    radiance: Positive = 1e18  # photons/s/sr/m² of every step
    longest_exposure_s: Positive = 2.0  # a step that no channel sees well stays darker


class ChartRecipe(Recipe):
    """A ColorChecker that fills the field."""

    illuminants: tuple[str, ...] = ("D65", "A", "3200K", "FL2")
    trials: Count = 1
    luminance: Positive = 500.0  # cd/m² of a perfect white
    level: float = 0.5  # share of full scale that the brightest channel reaches in the brightest patch


class WhiteRecipe(Recipe):
    """Even light at several exposures."""

    illuminant: str = "D65"
    luminance: Positive = 500.0  # cd/m²
    levels: tuple[float, ...] = (0.05, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.6)  # of full scale, in the brightest channel
    trials: Count = 4


class DarkRecipe(Recipe):
    """Lens-cap frames."""

    exposures_s: tuple[float, ...] = (0.01, 0.5, 1.0, 2.0)
    trials: Count = 4


class LabRecipe(Recipe):
    """What the lab measures; every key has the default that configs/lab/default.toml spells out."""

    title: ClassVar[str] = "a lab recipe"

    mono: MonoRecipe = msgspec.field(default_factory=MonoRecipe)
    chart: ChartRecipe = msgspec.field(default_factory=ChartRecipe)
    white: WhiteRecipe = msgspec.field(default_factory=WhiteRecipe)
    dark: DarkRecipe = msgspec.field(default_factory=DarkRecipe)
    flaws: FlawRecipe = msgspec.field(default_factory=FlawRecipe)
    spectrometer_step_nm: float = 1.0  # sampling of the measured spectra
    wavelength_error_nm: float = 0.1  # standard deviation of the spectrometer's scale, one error a session
    lamp_drift: float = 0.01  # relative standard deviation of the lamps, slow
    monitor_error: float = 0.001  # relative standard deviation of the reading that follows them
    falloff: float = 0.1  # share of every lamp's light missing in the corners


@dataclass(frozen=True)
class LabCapture:
    """One exposure of the lab: what is seen, and what the spectrometer says of it."""

    kind: str  # "mono", "chart", "white", "dark"
    name: str  # of its files, kind as folder
    light: str  # what lights it
    exposure: float  # s
    trials: int
    first: int  # number of its first frame among all
    electrons: Array  # (region, channel) mean photo-electrons; one region, or 24 patches and the mount
    falloff: float  # share of the lamp's light missing in the corners
    monitor: float  # reading of the lamp over that when its spectrum was measured
    wavelength: Array  # (wavelength) nm as measured
    radiance: Array  # (spectrum, wavelength) photons/s/sr/m²/nm as measured; no spectrum of white and dark


@dataclass
class _Session:
    """What a lab's lamps and spectrometer do from capture to capture."""

    recipe: LabRecipe
    rng: np.random.Generator
    shift: float = field(init=False)  # nm, error of the spectrometer's scale
    drift: float = field(init=False)  # relative, of the lamps now

    def __post_init__(self) -> None:
        self.shift = round(self.recipe.wavelength_error_nm * self.rng.standard_normal(), 4)
        self.drift = self.recipe.lamp_drift * self.rng.standard_normal()

    def next_light(self) -> tuple[float, float]:
        """The lamp's light over that of its measured spectrum, and what the monitor says of it."""
        fresh = self.recipe.lamp_drift * np.sqrt(1.0 - MEMORY**2) * self.rng.standard_normal()
        self.drift = MEMORY * self.drift + fresh
        light = 1.0 + self.drift
        reading = light * (1.0 + self.recipe.monitor_error * self.rng.standard_normal())
        return light, round(float(reading), 6)


@dataclass(frozen=True)
class _Look:
    """The lab's camera as light meets it."""

    camera: CameraModel
    wavelength: Array  # (wavelength) nm
    per_radiance: Array  # (channel, wavelength) e-/s for a radiance of 1 photon/s/sr/m²/nm in one sample

    def electrons(self, radiance: Array) -> Array:
        """(spectrum, channel) e-/s of radiance (spectrum, wavelength)."""
        return radiance @ self.per_radiance.T

    def exposure_for(self, level: float, radiance: Array) -> float:
        """Seconds, to three digits, in which the brightest channel and spectrum reach `level` of full scale; may be inf."""
        with np.errstate(divide="ignore"):
            return float(f"{level * self.camera.full_scale / self.electrons(radiance).max():.3g}")


def plan(camera: CameraModel, recipe: LabRecipe, seed: int) -> tuple[LabCapture, ...]:
    """Every capture the lab takes of `camera`, in order; RecipeError if the recipe cannot be carried out."""
    _check(recipe, camera)
    look = _looked_at(camera, recipe.mono, recipe.spectrometer_step_nm)
    session = _Session(recipe, np.random.default_rng([seed, 0]))
    patch_light = falloff_at_patches(camera, recipe.falloff)
    captures: list[LabCapture] = []

    def add(kind: str, light: str, exposure: float, trials: int, radiance: Array) -> None:
        first = captures[-1].first + captures[-1].trials if captures else 0
        name = f"{kind}/{len(captures):03d}_{re.sub(r'[^A-Za-z0-9.]+', '-', light)}"
        lamp, reading = session.next_light()
        electrons = look.electrons(radiance) * exposure * lamp
        seen = radiance[:PATCHES] if kind in ("mono", "chart") else radiance[:0]
        measured = seen * patch_light[:, None] if kind == "chart" else seen
        wavelength = look.wavelength + session.shift
        monitor = 1.0 if kind == "dark" else reading
        captures.append(
            LabCapture(kind, name, light, exposure, trials, first, electrons, recipe.falloff, monitor, wavelength, measured)
        )

    mono, chart, white, dark = recipe.mono, recipe.chart, recipe.white, recipe.dark
    centres = slit_centres(camera, mono)
    again = centres[np.linspace(0, centres.size - 1, min(mono.overexposed, centres.size - 2) + 2).astype(int)[1:-1]]
    for centre in centres:
        radiance = _slit(look.wavelength, centre, mono)[None]
        exposure = min(mono.longest_exposure_s, look.exposure_for(mono.level, radiance))
        add("mono", f"{centre:g}nm", exposure, mono.trials, radiance)
        if centre in again:
            too_long = min(mono.longest_exposure_s, look.exposure_for(OVEREXPOSED, radiance))
            add("mono", f"{centre:g}nm too long", too_long, 1, radiance)
    _, reflectance = spectra.colorchecker(look.wavelength)
    surfaces = np.concatenate([reflectance, np.full((1, look.wavelength.size), MOUNT)])
    for light in chart.illuminants:
        radiance = surfaces * _light(light, look.wavelength, chart.luminance)
        add("chart", light, look.exposure_for(chart.level, radiance), chart.trials, radiance)
    even = _light(white.illuminant, look.wavelength, white.luminance)[None]
    for level in white.levels:
        add("white", white.illuminant, look.exposure_for(level, even), white.trials, even)
    for exposure in dark.exposures_s:
        add("dark", "cap", exposure, dark.trials, 0.0 * even)
    return tuple(captures)


def _check(recipe: LabRecipe, camera: CameraModel) -> None:
    mono = recipe.mono
    if not (mono.step_nm > 0 and mono.bandwidth_nm > recipe.spectrometer_step_nm > 0):
        raise RecipeError("mono needs step_nm above 0, bandwidth_nm above spectrometer_step_nm, and that above 0")
    _check_grids(recipe, camera)
    centres = slit_centres(camera, mono)
    if centres.size < 3 or centres[0] <= mono.bandwidth_nm:
        raise RecipeError("mono needs three steps or more from first_nm to last_nm, at visible wavelengths")
    shares = (mono.level, recipe.chart.level, *recipe.white.levels, *recipe.dark.exposures_s)
    if min(shares) <= 0 or not recipe.white.levels or not recipe.dark.exposures_s:
        raise RecipeError("levels and exposures must be given and above 0")
    if min(recipe.white.trials, recipe.dark.trials) < 2:
        raise RecipeError("white and dark need two trials or more, for noise is measured on pairs of frames")
    if not (0 <= mono.stray_light < MOST_STRAY and 0 <= recipe.falloff < 1 and 0 <= recipe.lamp_drift < MOST_DRIFT):
        raise RecipeError(f"stray_light must lie in 0…{MOST_STRAY}, falloff in 0…1, lamp_drift in 0…{MOST_DRIFT}")
    if min(recipe.monitor_error, recipe.wavelength_error_nm, *msgspec.structs.astuple(recipe.flaws)) < 0:
        raise RecipeError("monitor_error, wavelength_error_nm and the figures of flaws must not be negative")
    check_flaws(recipe.flaws)
    if camera.rows < 64 or camera.cols < 96:
        raise RecipeError(f"a sensor of {camera.rows}×{camera.cols} is too small for a chart; the lab needs 64×96 pixels")
    if not camera.absolute:
        raise RecipeError("the camera's responsivity is only relative; the lab needs quantum efficiencies")


def _check_grids(recipe: LabRecipe, camera: CameraModel) -> None:
    """RecipeError if the monochromator or the spectrometer is to take more steps than any does."""
    mono = recipe.mono
    first, last = mono.first_nm or camera.wavelength[0], mono.last_nm or camera.wavelength[-1]
    reach = last - first + 2 * (mono.bandwidth_nm + SPARE)
    if not (0 < first < last <= LONGEST and mono.bandwidth_nm <= LONGEST):
        raise RecipeError(f"mono: first_nm and last_nm must lie in 0…{LONGEST}, and bandwidth_nm below")
    if reach / mono.step_nm > MOST_WAVELENGTHS or reach / recipe.spectrometer_step_nm > MOST_WAVELENGTHS:
        raise RecipeError(f"step_nm and spectrometer_step_nm must not make more than {MOST_WAVELENGTHS} steps")


def _looked_at(camera: CameraModel, mono: MonoRecipe, step: float) -> _Look:
    """The camera on the spectrometer's grid, which reaches over the responsivity and every slit."""
    centres = slit_centres(camera, mono)
    first = min(camera.wavelength[0], centres[0] - mono.bandwidth_nm) - SPARE
    last = max(camera.wavelength[-1], centres[-1] + mono.bandwidth_nm) + SPARE
    wavelength = np.arange(first, last + step / 2, step)
    area = camera.optics.irradiance_per_radiance * camera.pixel_pitch**2
    responsivity = spectra.average(camera.responsivity, camera.wavelength, wavelength)
    return _Look(camera, wavelength, responsivity * area * spectra.bin_widths(wavelength))


def slit_centres(camera: CameraModel, mono: MonoRecipe) -> Array:
    """Wavelengths (step) nm that the monochromator is set to."""
    first = camera.wavelength[0] + mono.bandwidth_nm if mono.first_nm is None else mono.first_nm
    last = camera.wavelength[-1] - mono.bandwidth_nm if mono.last_nm is None else mono.last_nm
    return np.arange(first, last + mono.step_nm / 2, mono.step_nm)


def _slit(wavelength: Array, centre: float, mono: MonoRecipe) -> Array:
    """A triangle of the recipe's full width at half maximum on its stray light, with its integral."""
    shape = np.maximum(0.0, 1.0 - np.abs(wavelength - centre) / mono.bandwidth_nm) + mono.stray_light
    return np.asarray(shape * (mono.radiance / (shape @ spectra.bin_widths(wavelength))), dtype=np.float64)


def _light(name: str, wavelength: Array, luminance: float) -> Array:
    light = spectra.at_luminance(spectra.illuminant(name, wavelength), wavelength, luminance)
    return np.asarray(light, dtype=np.float64)


def chart_corners(camera: CameraModel) -> list[tuple[float, float]]:
    """Col, row in pixels of the outer corners of patches 1, 6, 24, 19."""
    margin = round(MARGIN * camera.rows)
    right, bottom = camera.cols - 1.0 - margin, camera.rows - 1.0 - margin
    return [(margin, margin), (right, margin), (right, bottom), (margin, bottom)]


def chart_regions(camera: CameraModel) -> NDArray[np.int64]:
    """(row, col) patch that each pixel sees, 24 for the mount."""
    (left, top), _, (right, bottom), _ = chart_corners(camera)
    x = (np.arange(camera.cols) - left) / (right - left) * CHART_COLS
    y = (np.arange(camera.rows) - top) / (bottom - top) * CHART_ROWS
    in_x = (x >= 0) & (x < CHART_COLS) & (np.abs(x % 1 - 0.5) < PATCH_SIDE / 2)
    in_y = (y >= 0) & (y < CHART_ROWS) & (np.abs(y % 1 - 0.5) < PATCH_SIDE / 2)
    index = np.floor(y).astype(np.int64)[:, None] * CHART_COLS + np.floor(x).astype(np.int64)
    return np.where(in_y[:, None] & in_x, index, PATCHES)


def take(camera: CameraModel, capture: LabCapture, trial: int, seed: int, recipe: FlawRecipe) -> NDArray[np.uint16]:
    """Frame number `trial` of a capture, (row, col) DN: the same for the same seed whoever takes it."""
    rng = np.random.default_rng([seed, 1 + capture.first + trial])
    flaws, pattern = flaws_of(camera, recipe), fixed_pattern(camera)
    rows, cols = camera.cfa.shape
    channel = camera.cfa[np.ix_(np.arange(camera.rows) % rows, np.arange(camera.cols) % cols)]
    region = chart_regions(camera) if capture.kind == "chart" else 0
    y, x = np.linspace(-1.0, 1.0, camera.rows), np.linspace(-1.0, 1.0, camera.cols)
    light = falloff(y[:, None], x, capture.falloff) * flaws.shade
    shape = (camera.rows, camera.cols)
    light *= relative_illumination(camera.optics.image_distance, camera.pixel_pitch, shape).astype(np.float32)
    light[flaws.dead[:, 0], flaws.dead[:, 1]] = 0.0
    electrons = capture.electrons[region, channel] * light
    electrons[flaws.hot[:, 0], flaws.hot[:, 1]] += recipe.hot_current_e_per_s * capture.exposure
    return read_out(camera, FixedPattern(pattern.prnu, pattern.dsnu + flaws.columns), electrons, capture.exposure, rng)


def falloff(y: Array, x: Array, missing: float) -> Array:
    """Light at y, x from −1 to 1 across the frame over that in its middle, `missing` of it in the corners."""
    return np.asarray(1.0 - missing * (y**2 + x**2) / 2.0, dtype=np.float64)


def falloff_at_patches(camera: CameraModel, missing: float) -> Array:
    """(patch) light in the middle of each chart patch over that in the middle of the frame."""
    (left, top), _, (right, bottom), _ = chart_corners(camera)
    row, col = np.divmod(np.arange(PATCHES), CHART_COLS)
    x = left + (col + 0.5) / CHART_COLS * (right - left)
    y = top + (row + 0.5) / CHART_ROWS * (bottom - top)
    return falloff(2.0 * y / (camera.rows - 1) - 1.0, 2.0 * x / (camera.cols - 1) - 1.0, missing)
