"""The virtual lab: simulates the lab measurements of a known camera, so that calibration can be compared with the truth."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_WAVELENGTHS, CameraModel
from l3cli.artifacts.recipe_source import RecipeSource
from l3cli.frames.measurement import CHART_COLS, CHART_ROWS, PATCHES
from l3cli.physics import spectra
from l3cli.physics.lens import relative_illumination
from l3cli.recipes.faults import Fault, fault, refuse_first
from l3cli.recipes.toml import MAX_COUNT, Count, CountOrNone, NotNegative, Positive, Recipe
from l3cli.simulation.sensor import DefectRecipe, FixedPattern, defects_of, fixed_pattern, read_out

SPECTROMETER_MARGIN = 5.0  # nm; the spectrometer covers this much more than the camera and the slits
MOST_STRAY, MOST_DRIFT = 0.01, 0.2  # highest stray light and lamp drift of a usable lab, as fractions
FOLDERS = ("mono", "chart", "white", "dark", "spectra")  # one folder for each kind of capture, and one for measured spectra
PATCH_SIDE = 0.8  # side of a patch as a fraction of its cell in the chart; the rest of the cell is black mount
BORDER_FRACTION = 0.08  # fraction of the frame's height; width of the border around the chart
MOUNT = 0.03  # reflectance between and around the patches
OVEREXPOSED = 2.0  # signal of the overexposed monochromator steps, relative to full scale
MEMORY = 0.8  # correlation of the lamp's drift from one capture to the next
Nanometres = Annotated[float, msgspec.Meta(gt=0, le=spectra.LONGEST_NM)]
Several = Annotated[tuple[Positive, ...], msgspec.Meta(min_length=1)]
Trials = Annotated[int, msgspec.Meta(ge=2, le=MAX_COUNT)]  # at least two, because noise is measured from pairs of frames
SMALLEST_SENSOR = (64, 96)  # rows, columns; a smaller sensor does not resolve the patches of a chart
Array = NDArray[np.float64]


class MonoRecipe(Recipe):
    """A monochromator that fills the field of view. Its slit function is a triangle plus some stray light."""

    first_nm: Nanometres | None = None  # default: the lowest wavelength at which the slit lies within the camera's range
    last_nm: Nanometres | None = None  # default: the highest such wavelength
    step_nm: Positive = 10.0
    bandwidth_nm: Nanometres = 10.0  # full width at half maximum
    stray_light: Annotated[float, msgspec.Meta(ge=0, lt=MOST_STRAY)] = 0.0005  # fraction of the peak, at every wavelength
    trials: Count = 1  # frames per step
    # number of steps that are repeated with overexposure, never the first or the last step
    overexposed: CountOrNone = 4
    level: Positive = 0.5  # fraction of full scale that the brightest channel reaches
    radiance: Positive = 1e18  # photons/s/sr/m² of every step
    longest_exposure_s: Positive = 2.0  # limits the exposure time at wavelengths to which no channel is sensitive


class ChartRecipe(Recipe):
    """A ColorChecker that fills the field of view."""

    illuminants: tuple[str, ...] = ("D65", "A", "3200K", "FL2")
    trials: Count = 1
    luminance: Positive = 500.0  # cd/m² of a perfect white
    level: Positive = 0.5  # fraction of full scale that the brightest channel reaches in the brightest patch


class WhiteRecipe(Recipe):
    """Uniform light at several exposures."""

    illuminant: str = "D65"
    luminance: Positive = 500.0  # cd/m²
    levels: Several = (0.05, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.6)  # fractions of full scale in the brightest channel
    trials: Trials = 4


class DarkRecipe(Recipe):
    """Frames with the lens cap on."""

    exposures_s: Several = (0.01, 0.5, 1.0, 2.0)
    trials: Trials = 4


class LabRecipe(Recipe):
    """The measurements of the lab. configs/lab/default.toml lists the default of every key."""

    title: ClassVar[str] = "a lab recipe"

    mono: MonoRecipe = msgspec.field(default_factory=MonoRecipe)
    chart: ChartRecipe = msgspec.field(default_factory=ChartRecipe)
    white: WhiteRecipe = msgspec.field(default_factory=WhiteRecipe)
    dark: DarkRecipe = msgspec.field(default_factory=DarkRecipe)
    defects: DefectRecipe = msgspec.field(default_factory=DefectRecipe)
    spectrometer_step_nm: Positive = 1.0  # sampling of the measured spectra
    wavelength_error_nm: NotNegative = 0.1  # standard deviation of the spectrometer's wavelength error, constant per session
    lamp_drift: Annotated[float, msgspec.Meta(ge=0, lt=MOST_DRIFT)] = 0.01  # relative standard deviation of the slow drift
    monitor_error: NotNegative = 0.001  # relative standard deviation of the lamp monitor's readings
    falloff: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.1  # relative loss of light in the corners, for every lamp

    @property
    def lights(self) -> tuple[str, ...]:
        """Return the names of the illuminants of the charts and of the white frames."""
        return tuple(dict.fromkeys((*self.chart.illuminants, self.white.illuminant)))


def lab_faults(recipe: LabRecipe, camera: CameraModel | None) -> Iterator[Fault]:
    """Yield the faults of a lab recipe and, if `camera` is given, the reasons why the lab cannot measure it."""
    mono = recipe.mono
    if mono.bandwidth_nm <= recipe.spectrometer_step_nm:
        yield fault("mono needs bandwidth_nm above spectrometer_step_nm", "mono.bandwidth_nm", "spectrometer_step_nm")
    elif camera is not None:
        yield from _step_faults(recipe, camera)
    if camera is not None and (camera.rows < SMALLEST_SENSOR[0] or camera.cols < SMALLEST_SENSOR[1]):
        least = "×".join(map(str, SMALLEST_SENSOR))
        yield fault(f"a sensor of {camera.rows}×{camera.cols} is too small for a chart; the lab needs {least} pixels")
    if camera is not None and not camera.absolute:
        yield fault("the camera's responsivity is only relative; the lab needs quantum efficiencies")


def _step_faults(recipe: LabRecipe, camera: CameraModel) -> Iterator[Fault]:
    """Yield the faults of the monochromator's and the spectrometer's steps: too many or too few."""
    mono, ends = recipe.mono, ("mono.first_nm", "mono.last_nm")
    first, last = mono.first_nm or camera.wavelength[0], mono.last_nm or camera.wavelength[-1]
    reach = last - first + 2 * (mono.bandwidth_nm + SPECTROMETER_MARGIN)
    if first >= last:
        yield fault("mono: first_nm must be below last_nm", *ends)
        return
    if reach / mono.step_nm > MAX_WAVELENGTHS or reach / recipe.spectrometer_step_nm > MAX_WAVELENGTHS:
        message = f"step_nm and spectrometer_step_nm must not make more than {MAX_WAVELENGTHS} steps"
        yield fault(message, "mono.step_nm", "spectrometer_step_nm")
        return
    centres = slit_centres(camera, mono)
    if centres.size < 3 or centres[0] <= mono.bandwidth_nm:
        message = "mono needs three steps or more from first_nm to last_nm, at visible wavelengths"
        yield fault(message, "mono.step_nm", *ends)


def slit_centres(camera: CameraModel, mono: MonoRecipe) -> Array:
    """Return the wavelengths (step), in nm, to which the monochromator is set."""
    first = camera.wavelength[0] + mono.bandwidth_nm if mono.first_nm is None else mono.first_nm
    last = camera.wavelength[-1] - mono.bandwidth_nm if mono.last_nm is None else mono.last_nm
    return np.arange(first, last + mono.step_nm / 2, mono.step_nm)


@dataclass(frozen=True)
class LabCapture:
    """One planned capture in the lab: the signal on the camera and the spectrum that the spectrometer measures."""

    kind: str  # "mono", "chart", "white", "dark"
    name: str  # file name, with the kind as folder
    light: str  # illuminant or wavelength, as text
    exposure: float  # s
    trials: int
    first: int  # number of the capture's first frame, counted over the whole session
    electrons: Array  # (region, channel) mean photo-electrons; one region, or 24 patches and the mount
    falloff: float  # relative loss of light in the corners
    monitor: float  # reading of the lamp monitor, relative to its reading when the spectrum was measured
    wavelength: Array  # (wavelength) nm, as measured
    radiance: Array  # (spectrum, wavelength) photons/s/sr/m²/nm, as measured; white and dark captures have no spectrum


@dataclass(frozen=True)
class _Response:
    """The camera's response on the wavelength grid of the spectrometer."""

    camera: CameraModel
    wavelength: Array  # (wavelength) nm
    per_radiance: Array  # (channel, wavelength) e-/s for a radiance of 1 photon/s/sr/m²/nm at one sample of the grid

    def electrons(self, radiance: Array) -> Array:
        """Return the photo-electrons (spectrum, channel), in e-/s, for radiance (spectrum, wavelength)."""
        return radiance @ self.per_radiance.T

    def exposure_for(self, level: float, radiance: Array) -> float:
        """Return the exposure time, in s, at which the brightest channel reaches the fraction `level` of full scale.

        It is rounded to three digits, and infinite if no channel responds.
        """
        with np.errstate(divide="ignore"):
            signals = self.electrons(radiance) * self.camera.channel_gains
            return float(f"{level * self.camera.full_scale / signals.max():.3g}")


@dataclass
class _Session:
    """The captures so far, and the state of the lamps and of the spectrometer."""

    recipe: LabRecipe
    response: _Response
    rng: np.random.Generator
    captures: list[LabCapture] = field(default_factory=list)
    shift: float = field(init=False)  # nm, error of the spectrometer's scale
    drift: float = field(init=False)  # present deviation of the lamps, relative to their measured spectrum

    def __post_init__(self) -> None:
        self.shift = round(self.recipe.wavelength_error_nm * self.rng.standard_normal(), 4)
        self.drift = self.recipe.lamp_drift * self.rng.standard_normal()

    def add(self, kind: str, light: str, exposure: float, trials: int, radiance: Array) -> None:
        """Plan a capture of radiance (spectrum, wavelength)."""
        last = self.captures[-1] if self.captures else None
        name = f"{kind}/{len(self.captures):03d}_{re.sub(r'[^A-Za-z0-9.]+', '-', light)}"
        lamp, reading = self._next_light()
        seen = radiance[:PATCHES] if kind in ("mono", "chart") else radiance[:0]
        if kind == "chart":
            seen = seen * falloff_at_patches(self.response.camera, self.recipe.falloff)[:, None]
        self.captures.append(
            LabCapture(
                kind=kind,
                name=name,
                light=light,
                exposure=exposure,
                trials=trials,
                first=last.first + last.trials if last else 0,
                electrons=self.response.electrons(radiance) * exposure * lamp,
                falloff=self.recipe.falloff,
                monitor=1.0 if kind == "dark" else reading,
                wavelength=self.response.wavelength + self.shift,
                radiance=seen,
            )
        )

    def _next_light(self) -> tuple[float, float]:
        """Return the lamp's output relative to its measured spectrum, and the reading of the lamp monitor."""
        fresh = self.recipe.lamp_drift * np.sqrt(1.0 - MEMORY**2) * self.rng.standard_normal()
        self.drift = MEMORY * self.drift + fresh
        light = 1.0 + self.drift
        reading = light * (1.0 + self.recipe.monitor_error * self.rng.standard_normal())
        return light, round(float(reading), 6)


def plan(camera: CameraModel, recipe: LabRecipe, seed: int) -> tuple[LabCapture, ...]:
    """Plan all captures that the lab takes of a camera, in order.

    Raises
    ------
    RecipeError
        If the recipe cannot be carried out.
    """
    refuse_first(lab_faults(recipe, camera))
    mono, chart, white, dark = recipe.mono, recipe.chart, recipe.white, recipe.dark
    response = _response_of(camera, mono, recipe.spectrometer_step_nm)
    session, wavelength = _Session(recipe, response, np.random.default_rng([seed, 0])), response.wavelength
    centres = slit_centres(camera, mono)
    again = centres[np.linspace(0, centres.size - 1, min(mono.overexposed, centres.size - 2) + 2).astype(int)[1:-1]]
    for centre in centres:
        radiance = _slit(wavelength, centre, mono)[None]
        exposure = min(mono.longest_exposure_s, response.exposure_for(mono.level, radiance))
        session.add("mono", f"{centre:g}nm", exposure, mono.trials, radiance)
        if centre in again:
            too_long = min(mono.longest_exposure_s, response.exposure_for(OVEREXPOSED, radiance))
            session.add("mono", f"{centre:g}nm too long", too_long, 1, radiance)
    _, reflectance = spectra.colorchecker(wavelength)
    surfaces = np.concatenate([reflectance, np.full((1, wavelength.size), MOUNT)])
    for light in chart.illuminants:
        radiance = surfaces * _light(light, wavelength, chart.luminance)
        session.add("chart", light, response.exposure_for(chart.level, radiance), chart.trials, radiance)
    even = _light(white.illuminant, wavelength, white.luminance)[None]
    for level in white.levels:
        session.add("white", white.illuminant, response.exposure_for(level, even), white.trials, even)
    for exposure in dark.exposures_s:
        session.add("dark", "cap", exposure, dark.trials, 0.0 * even)
    return tuple(session.captures)


def _response_of(camera: CameraModel, mono: MonoRecipe, step: float) -> _Response:
    """Return the camera's response on the wavelength grid of the spectrometer, which covers responsivity and slits."""
    centres = slit_centres(camera, mono)
    first = min(camera.wavelength[0], centres[0] - mono.bandwidth_nm) - SPECTROMETER_MARGIN
    last = max(camera.wavelength[-1], centres[-1] + mono.bandwidth_nm) + SPECTROMETER_MARGIN
    wavelength = np.arange(first, last + step / 2, step)
    # Triangular weights around each sample of the responsivity, as in the simulation of frames. The outermost triangles
    # extend half a step beyond the ends.
    return _Response(camera, wavelength, camera.electron_weights @ spectra.sampling_matrix(wavelength, camera.wavelength))


def _slit(wavelength: Array, centre: float, mono: MonoRecipe) -> Array:
    """Return the spectral radiance of the monochromator: a triangle plus stray light, with the recipe's total radiance."""
    shape = np.maximum(0.0, 1.0 - np.abs(wavelength - centre) / mono.bandwidth_nm) + mono.stray_light
    return np.asarray(shape * (mono.radiance / (shape @ spectra.bin_widths(wavelength))), dtype=np.float64)


def _light(name: str, wavelength: Array, luminance: float) -> Array:
    light = spectra.at_luminance(spectra.illuminant(name, wavelength), wavelength, luminance)
    return np.asarray(light, dtype=np.float64)


def chart_corners(camera: CameraModel) -> list[tuple[float, float]]:
    """Return the outer corners (column, row), in pixels, of patches 1, 6, 24 and 19."""
    margin = round(BORDER_FRACTION * camera.rows)
    right, bottom = camera.cols - 1.0 - margin, camera.rows - 1.0 - margin
    return [(margin, margin), (right, margin), (right, bottom), (margin, bottom)]


def chart_regions(camera: CameraModel) -> NDArray[np.int64]:
    """Return the index of the patch that each pixel (row, col) sees, from 0 to 23, or 24 for the mount."""
    (left, top), _, (right, bottom), _ = chart_corners(camera)
    x = (np.arange(camera.cols) - left) / (right - left) * CHART_COLS
    y = (np.arange(camera.rows) - top) / (bottom - top) * CHART_ROWS
    in_x = (x >= 0) & (x < CHART_COLS) & (np.abs(x % 1 - 0.5) < PATCH_SIDE / 2)
    in_y = (y >= 0) & (y < CHART_ROWS) & (np.abs(y % 1 - 0.5) < PATCH_SIDE / 2)
    index = np.floor(y).astype(np.int64)[:, None] * CHART_COLS + np.floor(x).astype(np.int64)
    return np.where(in_y[:, None] & in_x, index, PATCHES)


def take(camera: CameraModel, capture: LabCapture, trial: int, seed: int, recipe: DefectRecipe) -> NDArray[np.uint16]:
    """Simulate one frame of a capture.

    Equal seeds give equal frames, whatever the order of the calls.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    capture : LabCapture
        The capture.
    trial : int
        Number of the frame within the capture.
    seed : int
        Seed of the noise.
    recipe : DefectRecipe
        Defects of the sensor.

    Returns
    -------
    ndarray of uint16, (row, col)
        Raw values in DN.
    """
    rng = np.random.default_rng([seed, 1 + capture.first + trial])
    defects, pattern = defects_of(camera, recipe), fixed_pattern(camera)
    shape = (camera.rows, camera.cols)
    region = chart_regions(camera) if capture.kind == "chart" else 0
    y, x = np.linspace(-1.0, 1.0, camera.rows), np.linspace(-1.0, 1.0, camera.cols)
    light = falloff(y[:, None], x, capture.falloff) * defects.shade
    light *= relative_illumination(camera.optics.image_distance, camera.pixel_pitch, shape).astype(np.float32)
    light[defects.dead[:, 0], defects.dead[:, 1]] = 0.0
    electrons = capture.electrons[region, camera.channel_map(shape)] * light
    electrons[defects.hot[:, 0], defects.hot[:, 1]] += recipe.hot_current_e_per_s * capture.exposure
    return read_out(camera, FixedPattern(pattern.prnu, pattern.dsnu + defects.columns), electrons, capture.exposure, rng)


def falloff(y: Array, x: Array, missing: float) -> Array:
    """Return the illumination at (y, x) relative to the centre of the frame.

    Coordinates run from −1 to 1 across the frame. `missing` is the relative loss in the corners.
    """
    return np.asarray(1.0 - missing * (y**2 + x**2) / 2.0, dtype=np.float64)


def falloff_at_patches(camera: CameraModel, missing: float) -> Array:
    """Return the illumination (patch) at the centre of each chart patch, relative to the centre of the frame."""
    (left, top), _, (right, bottom), _ = chart_corners(camera)
    row, col = np.divmod(np.arange(PATCHES), CHART_COLS)
    x = left + (col + 0.5) / CHART_COLS * (right - left)
    y = top + (row + 0.5) / CHART_ROWS * (bottom - top)
    return falloff(2.0 * y / (camera.rows - 1) - 1.0, 2.0 * x / (camera.cols - 1) - 1.0, missing)


def lab_recipe_faults(recipe: LabRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Yield the faults of a lab recipe and, if a camera is given, those that concern this camera."""
    yield from lab_faults(recipe, source.camera)
    yield from source.attempt(("white", "illuminant"), spectra.require_illuminant, recipe.white.illuminant)
    for number, name in enumerate(recipe.chart.illuminants):
        yield from source.attempt(("chart", "illuminants", number), spectra.require_illuminant, name)
