"""The recipe of the virtual lab, and whether a lab can carry it out."""

from collections.abc import Iterator
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import LONGEST, MOST_WAVELENGTHS, CameraModel
from l3cli.recipes.faults import Fault, fault, refuse_first
from l3cli.recipes.toml import Count, CountOrNone, Positive, Recipe
from l3cli.simulation.sensor import DefectRecipe, defect_faults

SPECTROMETER_MARGIN = 5.0  # nm that the spectrometer sees beyond camera and slits
MOST_STRAY, MOST_DRIFT = 0.01, 0.2  # beyond, a slit is no slit and a lamp no lamp
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
    """Measurements of the lab; every key has the default that configs/lab/default.toml spells out."""

    title: ClassVar[str] = "a lab recipe"

    mono: MonoRecipe = msgspec.field(default_factory=MonoRecipe)
    chart: ChartRecipe = msgspec.field(default_factory=ChartRecipe)
    white: WhiteRecipe = msgspec.field(default_factory=WhiteRecipe)
    dark: DarkRecipe = msgspec.field(default_factory=DarkRecipe)
    defects: DefectRecipe = msgspec.field(default_factory=DefectRecipe)
    spectrometer_step_nm: float = 1.0  # sampling of the measured spectra
    wavelength_error_nm: float = 0.1  # standard deviation of the spectrometer's scale, one error a session
    lamp_drift: float = 0.01  # relative standard deviation of the lamps, slow
    monitor_error: float = 0.001  # relative standard deviation of the reading that follows them
    falloff: float = 0.1  # share of every lamp's light missing in the corners


def check(recipe: LabRecipe, camera: CameraModel) -> None:
    """Raise RecipeError if a lab cannot measure `camera` so."""
    refuse_first(lab_faults(recipe, camera))


def lab_faults(recipe: LabRecipe, camera: CameraModel | None) -> Iterator[Fault]:
    """Yield all that a lab cannot do, of `camera` if there is one."""
    mono = recipe.mono
    steps = mono.step_nm > 0 and mono.bandwidth_nm > recipe.spectrometer_step_nm > 0
    if not steps:
        message = "mono needs step_nm above 0, bandwidth_nm above spectrometer_step_nm, and that above 0"
        yield fault(message, "mono.bandwidth_nm", "mono.step_nm", "spectrometer_step_nm")
    elif camera is not None:
        yield from _step_faults(recipe, camera)
    lists = {"white.levels": recipe.white.levels, "dark.exposures_s": recipe.dark.exposures_s}
    shares = {"mono.level": (mono.level,), "chart.level": (recipe.chart.level,)} | lists
    if wrong := [key for key, values in shares.items() if not values or min(values) <= 0]:
        yield fault("levels and exposures must be given and above 0", *wrong)
    if few := [key for key in ("white", "dark") if getattr(recipe, key).trials < 2]:
        message = "white and dark need two trials or more, for noise is measured on pairs of frames"
        yield fault(message, *(f"{key}.trials" for key in few))
    most = {"mono.stray_light": MOST_STRAY, "falloff": 1, "lamp_drift": MOST_DRIFT}
    values = (mono.stray_light, recipe.falloff, recipe.lamp_drift)
    if wrong := [key for (key, limit), value in zip(most.items(), values, strict=True) if not 0 <= value < limit]:
        message = f"stray_light must lie in 0…{MOST_STRAY}, falloff in 0…1, lamp_drift in 0…{MOST_DRIFT}"
        yield fault(message, *wrong)
    figures = {f"defects.{key}": getattr(recipe.defects, key) for key in recipe.defects.__struct_fields__}
    figures |= {"monitor_error": recipe.monitor_error, "wavelength_error_nm": recipe.wavelength_error_nm}
    if wrong := [key for key, value in figures.items() if value < 0]:
        yield fault("monitor_error, wavelength_error_nm and the figures of defects must not be negative", *wrong)
    yield from defect_faults(recipe.defects)
    if camera is not None and (camera.rows < 64 or camera.cols < 96):
        yield fault(f"a sensor of {camera.rows}×{camera.cols} is too small for a chart; the lab needs 64×96 pixels")
    if camera is not None and not camera.absolute:
        yield fault("the camera's responsivity is only relative; the lab needs quantum efficiencies")


def _step_faults(recipe: LabRecipe, camera: CameraModel) -> Iterator[Fault]:
    """Yield the faults of a monochromator or spectrometer with more steps than any takes, or too few."""
    mono, ends = recipe.mono, ("mono.first_nm", "mono.last_nm")
    first, last = mono.first_nm or camera.wavelength[0], mono.last_nm or camera.wavelength[-1]
    reach = last - first + 2 * (mono.bandwidth_nm + SPECTROMETER_MARGIN)
    if not (0 < first < last <= LONGEST and mono.bandwidth_nm <= LONGEST):
        message = f"mono: first_nm and last_nm must lie in 0…{LONGEST}, and bandwidth_nm below"
        yield fault(message, *ends, "mono.bandwidth_nm")
        return
    if reach / mono.step_nm > MOST_WAVELENGTHS or reach / recipe.spectrometer_step_nm > MOST_WAVELENGTHS:
        message = f"step_nm and spectrometer_step_nm must not make more than {MOST_WAVELENGTHS} steps"
        yield fault(message, "mono.step_nm", "spectrometer_step_nm")
        return
    centres = slit_centres(camera, mono)
    if centres.size < 3 or centres[0] <= mono.bandwidth_nm:
        message = "mono needs three steps or more from first_nm to last_nm, at visible wavelengths"
        yield fault(message, "mono.step_nm", *ends)


def slit_centres(camera: CameraModel, mono: MonoRecipe) -> Array:
    """Return the wavelengths (step) nm that the monochromator is set to."""
    first = camera.wavelength[0] + mono.bandwidth_nm if mono.first_nm is None else mono.first_nm
    last = camera.wavelength[-1] - mono.bandwidth_nm if mono.last_nm is None else mono.last_nm
    return np.arange(first, last + mono.step_nm / 2, mono.step_nm)
