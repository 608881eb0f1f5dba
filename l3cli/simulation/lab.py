"""The virtual lab: simulated laboratory measurements of a known camera.

A calibration from these measurements can be compared with the true camera.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_WAVELENGTHS, CameraModel, Polarisers
from l3cli.artifacts.recipe_source import RecipeSource
from l3cli.frames.measurement import CHART_COLS, CHART_ROWS, PATCHES
from l3cli.physics import spectra
from l3cli.physics.lens import relative_illumination
from l3cli.recipes.faults import Fault, fault, refuse_first
from l3cli.recipes.toml import MAX_COUNT, Count, CountOrNone, NotNegative, Positive, Recipe
from l3cli.simulation.sensor import (
    DefectRecipe,
    FixedPattern,
    SensorDefects,
    defects_of,
    fixed_pattern,
    read_out,
    with_masked,
)

# nm; the spectrometer covers the wavelengths of the camera and the monochromator plus this margin at each end
SPECTROMETER_MARGIN = 5.0
MAX_STRAY_LIGHT, MAX_DRIFT = 0.01, 0.2  # largest permitted stray light and lamp drift, as fractions
FOLDERS = ("mono", "chart", "white", "dark", "polariser", "spectra")  # one for each type of capture, and one for spectra
PATCH_SIDE = 0.8  # side of a patch as a fraction of its cell in the chart; the rest of the cell is black mount
BORDER_FRACTION = 0.08  # width of the border around the chart, as a fraction of the frame height
MOUNT = 0.03  # reflectance between and around the patches
OVEREXPOSURE = 2.0  # signal of the overexposed monochromator captures, relative to full scale
DRIFT_CORRELATION = 0.8  # correlation of the lamp drift between consecutive captures
Nanometres = Annotated[float, msgspec.Meta(gt=0, le=spectra.LONGEST_NM)]
Several = Annotated[tuple[Positive, ...], msgspec.Meta(min_length=1)]
Trials = Annotated[int, msgspec.Meta(ge=2, le=MAX_COUNT)]  # frames; noise is measured from pairs of frames
SMALLEST_SENSOR = (64, 96)  # rows and columns; a smaller sensor does not resolve the patches of a chart
Array = NDArray[np.float64]


class MonoRecipe(Recipe):
    """A monochromator that fills the field of view, with a triangular slit function plus stray light."""

    first_nm: Nanometres | None = None  # default: bandwidth_nm above the shortest wavelength of the camera
    last_nm: Nanometres | None = None  # default: bandwidth_nm below the longest wavelength of the camera
    step_nm: Positive = 10.0
    bandwidth_nm: Nanometres = 10.0  # full width at half maximum
    # stray light at each wavelength, as a fraction of the peak
    stray_light: Annotated[float, msgspec.Meta(ge=0, lt=MAX_STRAY_LIGHT)] = 0.0005
    trials: Count = 1  # number of frames per step
    # number of steps that are captured a second time with overexposure; the first and the last step are never repeated
    overexposed: CountOrNone = 4
    level: Positive = 0.5  # fraction of full scale that the brightest channel reaches
    radiance: Positive = 1e18  # photons/s/sr/m² in each step
    longest_exposure_s: Positive = 2.0  # longest exposure time; used where no channel is sensitive to the wavelength


class ChartRecipe(Recipe):
    """A ColorChecker that fills the field of view."""

    illuminants: tuple[str, ...] = ("D65", "A", "3200K", "FL2")
    trials: Count = 1
    luminance: Positive = 500.0  # cd/m², luminance of a perfect white
    level: Positive = 0.5  # fraction of full scale that the brightest channel reaches in the brightest patch


class WhiteRecipe(Recipe):
    """Captures of uniform light at several exposures."""

    illuminant: str = "D65"
    luminance: Positive = 500.0  # cd/m²
    levels: Several = (0.05, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.6)  # fractions of full scale in the brightest channel
    trials: Trials = 4


class DarkRecipe(Recipe):
    """Frames with the lens cap on."""

    exposures_s: Several = (0.01, 0.5, 1.0, 2.0)
    trials: Trials = 4


class PolariserRecipe(Recipe):
    """Captures of uniform light through a rotating polariser, for cameras with polarisers in front of their pixels."""

    illuminant: str = "D65"
    luminance: Positive = 500.0  # cd/m², before the light passes the polariser
    step_deg: Annotated[float, msgspec.Meta(gt=0, le=60)] = 15.0  # rotation between captures, up to 180° in total
    extinction: Annotated[float, msgspec.Meta(gt=1)] = 10000.0  # extinction ratio of the polariser
    angle_error_deg: NotNegative = 0.02  # standard deviation of each angle's random error
    level: Positive = 0.7  # fraction of full scale that the brightest channel reaches
    trials: Count = 2  # number of frames per angle


class LabRecipe(Recipe):
    """Description of the simulated measurements. configs/lab/default.toml lists all keys with their defaults."""

    title: ClassVar[str] = "a lab recipe"

    mono: MonoRecipe = msgspec.field(default_factory=MonoRecipe)
    chart: ChartRecipe = msgspec.field(default_factory=ChartRecipe)
    white: WhiteRecipe = msgspec.field(default_factory=WhiteRecipe)
    dark: DarkRecipe = msgspec.field(default_factory=DarkRecipe)
    polariser: PolariserRecipe = msgspec.field(default_factory=PolariserRecipe)
    defects: DefectRecipe = msgspec.field(default_factory=DefectRecipe)
    spectrometer_step_nm: Positive = 1.0  # sampling interval of the measured spectra
    wavelength_error_nm: NotNegative = 0.1  # standard deviation of the spectrometer's wavelength error, fixed per session
    lamp_drift: Annotated[float, msgspec.Meta(ge=0, lt=MAX_DRIFT)] = 0.01  # relative standard deviation of the slow drift
    monitor_error: NotNegative = 0.001  # relative standard deviation of the lamp monitor's readings
    falloff: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.1  # relative loss of light in the corners, for all lamps

    @property
    def lights(self) -> tuple[str, ...]:
        """Illuminants of the charts and of the white frames."""
        return tuple(dict.fromkeys((*self.chart.illuminants, self.white.illuminant)))


def lab_faults(recipe: LabRecipe, camera: CameraModel | None) -> Iterator[Fault]:
    """Find the faults in a lab recipe and, if `camera` is known, the reasons why the lab cannot measure it."""
    mono = recipe.mono
    if mono.bandwidth_nm <= recipe.spectrometer_step_nm:
        message = (
            f"mono.bandwidth_nm is {mono.bandwidth_nm:g}, but must be larger than spectrometer_step_nm, which is "
            f"{recipe.spectrometer_step_nm:g}; set a smaller spectrometer_step_nm"
        )
        yield fault(message, "mono.bandwidth_nm", "spectrometer_step_nm")
    elif camera is not None:
        yield from _step_faults(recipe, camera)
    if camera is not None and (camera.rows < SMALLEST_SENSOR[0] or camera.cols < SMALLEST_SENSOR[1]):
        least = "×".join(map(str, SMALLEST_SENSOR))
        message = (
            f"the sensor has {camera.rows}×{camera.cols} pixels, which is too small for a chart; use a sensor with at least "
            f"{least} pixels"
        )
        yield fault(message)
    if camera is not None and not camera.absolute:
        yield fault(
            f"{camera.name} has only relative responsivities, but the lab needs quantum efficiencies; use a camera with "
            "quantum efficiencies"
        )


def _step_faults(recipe: LabRecipe, camera: CameraModel) -> Iterator[Fault]:
    """Find settings with which the monochromator or the spectrometer would take too many or too few steps."""
    mono, ends = recipe.mono, ("mono.first_nm", "mono.last_nm")
    first, last = mono.first_nm or camera.wavelength[0], mono.last_nm or camera.wavelength[-1]
    reach = last - first + 2 * (mono.bandwidth_nm + SPECTROMETER_MARGIN)
    if first >= last:
        message = (
            f"mono.first_nm is {first:g}, but must be less than mono.last_nm, which is {last:g}; set a smaller first_nm"
        )
        yield fault(message, *ends)
        return
    if reach / mono.step_nm > MAX_WAVELENGTHS or reach / recipe.spectrometer_step_nm > MAX_WAVELENGTHS:
        message = f"mono.step_nm or spectrometer_step_nm results in more than {MAX_WAVELENGTHS} steps; set a larger value"
        yield fault(message, "mono.step_nm", "spectrometer_step_nm")
        return
    centres = slit_centres(camera, mono)
    if centres.size < 3 or centres[0] <= mono.bandwidth_nm:
        message = (
            f"mono has {centres.size} steps from first_nm to last_nm, but the lab needs at least 3 steps at visible "
            "wavelengths; change first_nm, last_nm or step_nm"
        )
        yield fault(message, "mono.step_nm", *ends)


def slit_centres(camera: CameraModel, mono: MonoRecipe) -> Array:
    """Return the wavelength of each step of the monochromator, in nm."""
    first = camera.wavelength[0] + mono.bandwidth_nm if mono.first_nm is None else mono.first_nm
    last = camera.wavelength[-1] - mono.bandwidth_nm if mono.last_nm is None else mono.last_nm
    return np.arange(first, last + mono.step_nm / 2, mono.step_nm)


@dataclass(frozen=True)
class LabCapture:
    """A planned capture: its settings, the camera's mean signals, and the spectra that the spectrometer measures."""

    kind: str  # "mono", "chart", "white", "dark" or "polariser"
    name: str  # file name, in a folder named after the kind
    light: str  # illuminant, wavelength or polariser angle, as text
    exposure: float  # s
    trials: int  # number of frames
    first: int  # number of the capture's first frame, counted over the whole session
    electrons: Array  # (region, channel), mean photo-electrons; the regions of a chart are 24 patches and the mount
    falloff: float  # relative loss of light in the corners
    monitor: float  # lamp monitor reading, relative to the reading when the spectrum was measured
    wavelength: Array  # (wavelength,), measured wavelengths in nm
    radiance: Array  # (spectrum, wavelength), measured photons/s/sr/m²/nm; only mono and chart captures have spectra
    angle: float = 0.0  # angle of the rotating polariser on its scale, in degrees
    # (2, region, channel), electrons along and across the polarisers' axes, in unpolarised light of the same radiance
    unpolarised: Array | None = None
    stokes: tuple[float, float] = (0.0, 0.0)  # S1/S0 and S2/S0 of the light


@dataclass(frozen=True)
class _Response:
    """Response of a camera at the spectrometer's wavelengths."""

    camera: CameraModel
    wavelength: Array  # (wavelength,), nm
    per_radiance: Array  # (channel, wavelength), e-/s per photon/s/sr/m²/nm at each wavelength
    per_polarised: Array  # (2, channel, wavelength), additional e-/s for 1 photon/s/sr/m²/nm of S1 or S2

    def electrons(self, radiance: Array, polarisation: float = 0.0, angle: float = 0.0) -> Array:
        """Return the photo-electron rates of a pixel in e-/s, (spectrum, channel).

        Parameters
        ----------
        radiance : ndarray, (spectrum, wavelength)
            Radiance of the light.
        polarisation : float
            Degree of linear polarisation of the light.
        angle : float
            Angle of linear polarisation in degrees.
        """
        weights, twice = self.per_radiance, 2.0 * np.radians(angle)
        if polarisation:
            weights = weights + polarisation * np.tensordot([np.cos(twice), np.sin(twice)], self.per_polarised, 1)
        return radiance @ weights.T

    def along_and_across(self, radiance: Array) -> Array:
        """Split the rates in unpolarised light, (2, spectrum, channel), into parts along and across the polarisers' axes."""
        difference = np.hypot(*self.per_polarised)
        return np.stack(
            [radiance @ part.T / 2.0 for part in (self.per_radiance + difference, self.per_radiance - difference)]
        )

    def exposure_for(self, level: float, radiance: Array) -> float:
        """Return the exposure time in s at which the brightest channel reaches the fraction `level` of full scale.

        The time is rounded to three significant digits. It is infinite if no channel responds to the radiance.
        """
        with np.errstate(divide="ignore"):
            signals = self.electrons(radiance) * self.camera.channel_gains
            return float(f"{level * self.camera.full_scale / signals.max():.3g}")


@dataclass
class _Session:
    """A lab session: the captures planned so far, and the current errors of lamps and spectrometer."""

    recipe: LabRecipe
    response: _Response
    rng: np.random.Generator
    captures: list[LabCapture] = field(default_factory=list)
    shift: float = field(init=False)  # nm, wavelength error of the spectrometer
    drift: float = field(init=False)  # current relative deviation of the lamps from their measured spectra

    def __post_init__(self) -> None:
        self.shift = round(self.recipe.wavelength_error_nm * self.rng.standard_normal(), 4)
        self.drift = self.recipe.lamp_drift * self.rng.standard_normal()

    def add(
        self,
        kind: str,
        light: str,
        exposure: float,
        trials: int,
        radiance: Array,
        polarisation: float = 0.0,
        angle: float = 0.0,
    ) -> None:
        """Plan a capture of one or more radiance spectra, with optional linear polarisation.

        The signals include random lamp drift and a random error of the polariser angle. Captures of charts and of the
        monochromator also contain the measured spectra.
        """
        last = self.captures[-1] if self.captures else None
        name = f"{kind}/{len(self.captures):03d}_{re.sub(r'[^A-Za-z0-9.]+', '-', light)}"
        lamp, reading = self._next_light()
        turned = angle + self.recipe.polariser.angle_error_deg * self.rng.standard_normal() if polarisation else angle
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
                electrons=self.response.electrons(radiance, polarisation, turned) * exposure * lamp,
                falloff=self.recipe.falloff,
                monitor=1.0 if kind == "dark" else reading,
                wavelength=self.response.wavelength + self.shift,
                radiance=seen,
                angle=angle,
                unpolarised=self.response.along_and_across(radiance) * exposure * lamp,
                stokes=(polarisation * np.cos(2.0 * np.radians(turned)), polarisation * np.sin(2.0 * np.radians(turned))),
            )
        )

    def _next_light(self) -> tuple[float, float]:
        """Return the lamp's next output, relative to its measured spectrum, and the lamp monitor's reading."""
        fresh = self.recipe.lamp_drift * np.sqrt(1.0 - DRIFT_CORRELATION**2) * self.rng.standard_normal()
        self.drift = DRIFT_CORRELATION * self.drift + fresh
        light = 1.0 + self.drift
        reading = light * (1.0 + self.recipe.monitor_error * self.rng.standard_normal())
        return light, round(float(reading), 6)


def plan(camera: CameraModel, recipe: LabRecipe, seed: int) -> tuple[LabCapture, ...]:
    """Plan all captures that the lab takes with a camera, in chronological order.

    Raises
    ------
    RecipeError
        If the recipe has faults, or if the lab cannot measure the camera.
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
            too_long = min(mono.longest_exposure_s, response.exposure_for(OVEREXPOSURE, radiance))
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
    if camera.polarisers is not None:
        _plan_polariser(session, recipe.polariser)
    return tuple(session.captures)


def _plan_polariser(session: _Session, recipe: PolariserRecipe) -> None:
    """Plan the captures through a rotating polariser.

    They are planned last, so that they do not change the noise of the other frames.
    """
    wavelength = session.response.wavelength
    leakage = 1.0 / recipe.extinction
    light = _light(recipe.illuminant, wavelength, recipe.luminance)[None] * (1.0 + leakage) / 2.0
    polarisation = (1.0 - leakage) / (1.0 + leakage)
    # A channel with a polariser parallel to the rotating one receives nearly twice its signal in unpolarised light.
    exposure = float(f"{session.response.exposure_for(recipe.level, light) / 2.0:.3g}")
    for angle in np.arange(0.0, 180.0, recipe.step_deg).tolist():
        session.add("polariser", f"{angle:g}deg", exposure, recipe.trials, light, polarisation, angle)


def _response_of(camera: CameraModel, mono: MonoRecipe, step: float) -> _Response:
    """Compute a camera's response at the wavelengths of a spectrometer that covers the camera and the monochromator."""
    centres = slit_centres(camera, mono)
    first = min(camera.wavelength[0], centres[0] - mono.bandwidth_nm) - SPECTROMETER_MARGIN
    last = max(camera.wavelength[-1], centres[-1] + mono.bandwidth_nm) + SPECTROMETER_MARGIN
    wavelength = np.arange(first, last + step / 2, step)
    # As in the simulation of frames, each responsivity sample has triangular weights. The outermost triangles extend half a
    # step beyond the ends.
    sampling = spectra.sampling_matrix(wavelength, camera.wavelength)
    return _Response(camera, wavelength, camera.electron_weights @ sampling, camera.stokes_weights[1:] @ sampling)


def _slit(wavelength: Array, centre: float, mono: MonoRecipe) -> Array:
    """Return the monochromator's spectral radiance: a triangle plus stray light, with the integral `mono.radiance`."""
    shape = np.maximum(0.0, 1.0 - np.abs(wavelength - centre) / mono.bandwidth_nm) + mono.stray_light
    return np.asarray(shape * (mono.radiance / (shape @ spectra.bin_widths(wavelength))), dtype=np.float64)


def _light(name: str, wavelength: Array, luminance: float) -> Array:
    light = spectra.at_luminance(spectra.illuminant(name, wavelength), wavelength, luminance)
    return np.asarray(light, dtype=np.float64)


def chart_corners(camera: CameraModel) -> list[tuple[float, float]]:
    """Return the chart's corners, the outer corners of patches 1, 6, 24 and 19, as (column, row) in pixels."""
    margin = round(BORDER_FRACTION * camera.rows)
    right, bottom = camera.cols - 1.0 - margin, camera.rows - 1.0 - margin
    return [(margin, margin), (right, margin), (right, bottom), (margin, bottom)]


def chart_regions(camera: CameraModel) -> NDArray[np.int64]:
    """Return the chart patch at each pixel (row, col): 0 to 23 for patches, and 24 for the mount."""
    (left, top), _, (right, bottom), _ = chart_corners(camera)
    x = (np.arange(camera.cols) - left) / (right - left) * CHART_COLS
    y = (np.arange(camera.rows) - top) / (bottom - top) * CHART_ROWS
    in_x = (x >= 0) & (x < CHART_COLS) & (np.abs(x % 1 - 0.5) < PATCH_SIDE / 2)
    in_y = (y >= 0) & (y < CHART_ROWS) & (np.abs(y % 1 - 0.5) < PATCH_SIDE / 2)
    index = np.floor(y).astype(np.int64)[:, None] * CHART_COLS + np.floor(x).astype(np.int64)
    return np.where(in_y[:, None] & in_x, index, PATCHES)


def take(camera: CameraModel, capture: LabCapture, trial: int, seed: int, recipe: DefectRecipe) -> NDArray[np.uint16]:
    """Simulate one frame of a capture.

    The noise depends only on the seed and the frame number, not on the order of the calls.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    capture : LabCapture
        The capture.
    trial : int
        Number of the frame in the capture, counted from 0.
    seed : int
        Seed of the noise.
    recipe : DefectRecipe
        Defects of the sensor.

    Returns
    -------
    ndarray of uint16, (row, col)
        Raw values in DN, including the camera's masked pixels.
    """
    rng = np.random.default_rng([seed, 1 + capture.first + trial])
    defects = defects_of(camera, recipe)
    shape = (camera.rows, camera.cols)
    region = chart_regions(camera) if capture.kind == "chart" else 0
    y, x = np.linspace(-1.0, 1.0, camera.rows), np.linspace(-1.0, 1.0, camera.cols)
    light = falloff(y[:, None], x, capture.falloff) * defects.shade
    light *= relative_illumination(camera.optics.image_distance, camera.pixel_pitch, shape).astype(np.float32)
    light[defects.dead[:, 0], defects.dead[:, 1]] = 0.0
    channel = camera.channel_map(shape)
    electrons = capture.electrons[region, channel]
    if camera.polarisers is not None:
        electrons = electrons + _polariser_deviation(camera.polarisers, capture, defects, recipe, region, channel)
    electrons = electrons * light
    electrons[defects.hot[:, 0], defects.hot[:, 1]] += recipe.hot_current_e_per_s * capture.exposure
    pattern = fixed_pattern(camera)
    if defects.steps.size:
        offsets = pattern.dsnu.copy()
        blinks = defects.blinks(np.random.default_rng([seed, 1 + capture.first + trial, 1]))
        np.add.at(offsets, tuple(defects.blinking.T), blinks)
        pattern = FixedPattern(pattern.prnu, offsets)
    pattern, electrons = with_masked(camera, pattern, electrons)
    return read_out(camera, pattern, electrons, capture.exposure, rng)


def _polariser_deviation(
    polarisers: Polarisers,
    capture: LabCapture,
    defects: SensorDefects,
    recipe: DefectRecipe,
    region: Any,
    channel: NDArray[np.uint8],
) -> Array:
    """Return the difference in photo-electrons, (row, col), between each pixel's polariser and its channel's polariser.

    Let light with S1/S0 = p and S2/S0 = q pass a polariser at the angle θ, and let u = p cos 2θ + q sin 2θ. The light causes
    A (1 + u) + B (1 − u) electrons. A and B are the electrons that unpolarised light causes along and across the axis.

    If the angles of pixels differ, the mean of u over these pixels is smaller than u at their mean angle. u is therefore
    divided by the ratio of the two, so that the mean response of the pixels is the response of the channel.
    """
    (first, second), angle = capture.stokes, polarisers.polariser_deg[channel]
    nominal, actual = 2 * np.radians(angle), 2 * np.radians(angle + defects.turn)
    before, after = (first * np.cos(twice) + second * np.sin(twice) for twice in (nominal, actual))
    after /= np.sinc(recipe.polariser_deg / 90)  # mean of cos 2δ over the deviations δ
    assert capture.unpolarised is not None
    along, across = capture.unpolarised[:, region, channel]
    leakage = np.where(polarisers.present[channel], defects.leakage, 1.0)
    return np.asarray(along * (after - before) + across * (leakage * (1 - after) - (1 - before)))


def falloff(y: Array, x: Array, missing: float) -> Array:
    """Return the illumination at positions (y, x), relative to the centre of the frame.

    The coordinates are −1 and 1 at the edges of the frame. `missing` is the relative loss of light in the corners.
    """
    return np.asarray(1.0 - missing * (y**2 + x**2) / 2.0, dtype=np.float64)


def falloff_at_patches(camera: CameraModel, missing: float) -> Array:
    """Return the illumination at the centre of each chart patch, relative to the centre of the frame."""
    (left, top), _, (right, bottom), _ = chart_corners(camera)
    row, col = np.divmod(np.arange(PATCHES), CHART_COLS)
    x = left + (col + 0.5) / CHART_COLS * (right - left)
    y = top + (row + 0.5) / CHART_ROWS * (bottom - top)
    return falloff(2.0 * y / (camera.rows - 1) - 1.0, 2.0 * x / (camera.cols - 1) - 1.0, missing)


def lab_recipe_faults(recipe: LabRecipe, source: RecipeSource) -> Iterator[Fault]:
    """Find the faults in a lab recipe, including unknown illuminants and reasons why the lab cannot measure the camera."""
    yield from lab_faults(recipe, source.camera)
    yield from source.attempt(("white", "illuminant"), spectra.require_illuminant, recipe.white.illuminant)
    yield from source.attempt(("polariser", "illuminant"), spectra.require_illuminant, recipe.polariser.illuminant)
    for number, name in enumerate(recipe.chart.illuminants):
        yield from source.attempt(("chart", "illuminants", number), spectra.require_illuminant, name)
