"""The measurement file and its keys (docs/own-lab.md, docs/method.md#calibration).

It states one source of responsivity ([[mono]], [sweep], [curves], [[band]] or [photo]), [[chart]] captures for its scale,
and [[dark]] and [[white]] frames or a [datasheet] for the sensor. A file with [[dark]] and [[white]] frames only takes
everything else from a camera model or recipe, its `base`. File names are relative to its folder.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_curves import column_faults
from l3cli.artifacts.camera_recipe import (
    MAX_PRNU,
    Bits,
    CfaRecipe,
    ChannelRecipe,
    NoiseRecipe,
    OpticsRecipe,
    cfa_faults,
    channel_faults,
    length_faults,
    optics_recipe,
    settings_of,
    share_faults,
)
from l3cli.physics.mosaic import array_rows
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Count, KeyPath, Positive, Recipe, toml_key, toml_value
from l3cli.spectra.file import names_file
from l3cli.system.files import write_whole
from l3cli.system.limits import MEGAPIXELS, most_pixels

EXPOSURES = ("exposure_s", "exposure_ms", "exposure_us")
CAPTURES = ("mono", "band", "chart", "white", "dark")  # lists of tables that name frames
MOST_UNREFERENCED = 2.0  # largest reading, or its inverse, that counts as a ratio if there is no reference
MOST_MONITOR = 10.0  # largest ratio of lamp readings, or its inverse; a larger change indicates another lamp
Below1 = Annotated[float, msgspec.Meta(ge=0, lt=1)]
Names = Annotated[list[str], msgspec.Meta(min_length=1)]
Corners = Annotated[list[tuple[float, float]], msgspec.Meta(min_length=4, max_length=4)]
SITE_PIXELS = 8  # smallest number of super-pixels in rows and columns, needed for local means


class BodyRecipe(Recipe):
    rows: Count
    cols: Count
    pixel_pitch_um: Positive
    bits: Bits


class MonitorRecipe(Recipe):
    """Readings of the lamp during a sweep, one row per wavelength."""

    file: str  # wavelength, and readings in any unit
    column: int | str = 1  # readings during the captures, by name or by number from 1 without counting the wavelength
    reference: int | str | None = None  # readings when the spectra were measured; default: `column` is the ratio of both


class CaptureRecipe(Recipe, kw_only=True):
    """Dark or white frames of one exposure."""

    frames: Names
    exposure_s: Positive | None = None  # exactly one of these three
    exposure_ms: Positive | None = None
    exposure_us: Positive | None = None
    # reading of the lamp during the capture, relative to the reading when its spectrum was measured;
    # for [[mono]], also a table of readings
    monitor: Annotated[float, msgspec.Meta(ge=1 / MOST_MONITOR, le=MOST_MONITOR)] | MonitorRecipe = 1.0

    @property
    def seconds(self) -> float | None:
        """The exposure in seconds, or None unless exactly one key gives it."""
        exposures = [(self.exposure_s, 1.0), (self.exposure_ms, 1e3), (self.exposure_us, 1e6)]
        given = [value / parts for value, parts in exposures if value is not None]
        return given[0] if len(given) == 1 else None


class SensorCaptureRecipe(CaptureRecipe, kw_only=True):
    """Dark or white frames at an ISO speed. The lowest speed gives the camera's gain, others give further gains."""

    iso: float | None = None  # stated for all such captures, or for none


class MonoRecipe(CaptureRecipe, kw_only=True):
    """An even field under the light of one monochromator step."""

    spectrum: str  # CSV of measured radiances, bandwidth and stray light included
    column: int | str = 1  # column, by name or by number from 1 without counting the wavelength
    unit: str | None = None  # unit of the radiances, if the heading states none; default: photons/s/sr/m²/nm


class ChartRecipe(CaptureRecipe, kw_only=True):
    """A ColorChecker under one light. As [[band]], it is behind one filter, and radiances may be relative."""

    illuminant: str
    corners: Corners  # col, row in pixels of the outer corners of patches 1, 6, 24, 19 (clockwise)
    radiance: str  # CSV of measured radiances, 24 columns, named by patch or row by row from dark skin to black
    unit: str | None = None  # as in [[mono]]


class CommonRecipe(Recipe):
    """Keys that apply to all [[mono]] and [[band]] captures that do not state them."""

    exposure_s: Positive | None = None  # one of these three
    exposure_ms: Positive | None = None
    exposure_us: Positive | None = None
    unit: str | None = None  # unit of radiances, if the heading states none
    monitor: MonitorRecipe | None = None  # for [[mono]]


class ColumnRecipe(Recipe):
    """One column of a table with several."""

    file: str
    column: int | str  # by name, or by number from 1 without counting the wavelength


class SweepRecipe(Recipe):
    """A monochromator sweep as a table of means."""

    table: str  # CSV: nm, light r, light g, …, dark r, dark g, … (means of each channel in DN), diode light, diode dark
    photodiode: str | ColumnRecipe  # CSV: nm, response of the photodiode per energy, such as A/W

    @property
    def response(self) -> ColumnRecipe:
        """The photodiode's table and column; column 0 is the only one."""
        return ColumnRecipe(self.photodiode, 0) if isinstance(self.photodiode, str) else self.photodiode


class CurvesRecipe(Recipe):
    """Finished responsivities from another source."""

    file: str  # CSV with nm and one column per channel, or JSON of rawtoaces
    columns: dict[str, str] = msgspec.field(default_factory=dict)  # channel → name of its column, if different
    per_energy: bool = True  # false if the curves are per photon


class PhotoRecipe(Recipe):
    """Raw files of a chart under one light."""

    frames: Names  # one scene at one exposure; the differences between two or more frames give the noise
    light: str | None = None  # "D65", "3200K", or a CSV file of its spectrum; without it, l3 guesses the light
    column: int | str = 1  # column of the light's CSV, as in [[mono]]
    unit: str = "relative power"  # unit of the light's CSV, if the heading states none
    chart: str = "classic"  # name of a chart, or CSV of reflectances with one column per patch, row by row
    layout: tuple[Count, Count] = (4, 6)  # rows, columns of patches
    corners: Corners | None = None  # col, row as in [[chart]]; without them, l3 searches the chart
    dark: list[str] = msgspec.field(default_factory=list)  # raw files without light, at the same exposure
    white: list[str] = msgspec.field(default_factory=list)  # raw files of an even white in the chart's place


class DatasheetRecipe(NoiseRecipe, kw_only=True):
    """Figures of the sensor from its data sheet."""

    black_level_dn: float
    white_level_dn: float
    gain_dn_per_e: Positive | None = None  # default: the full well is at the white level


class UncertaintyRecipe(Recipe):
    """Uncertainty of the lights (one standard deviation), which widens the confidence band."""

    lamp_drift: Below1 = 0.0  # relative drift of a light from its measured spectrum, after correction by the monitor
    photodiode: Below1 = 0.0  # relative error of the response of a [sweep]'s photodiode at each wavelength
    wavelength_nm: Annotated[float, msgspec.Meta(ge=0, lt=100)] = 0.0  # wavelength error of spectrometer or monochromator


class MeasurementRecipe(Recipe):
    """The measurement file MEASUREMENTS.toml."""

    title: ClassVar[str] = "a measurement file"

    name: str
    sensor: BodyRecipe
    cfa: CfaRecipe
    optics: OpticsRecipe
    common: CommonRecipe | None = None
    mono: list[MonoRecipe] = msgspec.field(default_factory=list)
    sweep: SweepRecipe | None = None
    curves: CurvesRecipe | None = None
    photo: PhotoRecipe | list[PhotoRecipe] = msgspec.field(default_factory=list)
    prior: str | None = None  # folder of measured curves of r g b cameras, for photos; default: the included table
    band: list[ChartRecipe] = msgspec.field(default_factory=list)
    chart: list[ChartRecipe] = msgspec.field(default_factory=list)
    white: list[SensorCaptureRecipe] = msgspec.field(default_factory=list)
    dark: list[SensorCaptureRecipe] = msgspec.field(default_factory=list)
    datasheet: DatasheetRecipe | None = None
    channel: dict[str, ChannelRecipe] = msgspec.field(default_factory=dict)  # exposures, gains that differ by channel
    uncertainty: UncertaintyRecipe = msgspec.field(default_factory=UncertaintyRecipe)

    def __post_init__(self) -> None:
        common, captures = self.common or CommonRecipe(), list[MonoRecipe | ChartRecipe]([*self.mono, *self.band])
        for capture in captures:
            capture.unit = common.unit if capture.unit is None else capture.unit
            if isinstance(capture, MonoRecipe) and common.monitor is not None and capture.monitor == 1.0:
                capture.monitor = common.monitor
            if all(getattr(capture, key) is None for key in EXPOSURES):
                for key in EXPOSURES:
                    setattr(capture, key, getattr(common, key))

    @property
    def photos(self) -> list[PhotoRecipe]:
        """The entries of [photo] or [[photo]]."""
        return self.photo if isinstance(self.photo, list) else [self.photo]

    def photo_key(self, number: int) -> KeyPath:
        """Return the key of a photo."""
        return ("photo", number) if isinstance(self.photo, list) else ("photo",)


class CorrectionRecipe(Recipe):
    """A measurement file for a camera that is known except for its defects and flat field."""

    title: ClassVar[str] = MeasurementRecipe.title

    base: str  # camera model or recipe, relative to this file
    dark: Annotated[list[CaptureRecipe], msgspec.Meta(min_length=1)]  # lens cap on, one exposure or several
    white: Annotated[list[CaptureRecipe], msgspec.Meta(min_length=1)]  # an even white, neither clipped nor dark


def captures_of(recipe: MeasurementRecipe | CorrectionRecipe) -> Iterator[tuple[str, int, CaptureRecipe]]:
    """Yield the section, number and contents of every capture."""
    for section in CAPTURES:
        for number, capture in enumerate(getattr(recipe, section, [])):
            yield section, number, capture


# -------------------------------------------------------------------------------------------------------- faults


def key_faults(recipe: MeasurementRecipe | CorrectionRecipe) -> Iterator[Fault]:
    """Yield the faults of numbers and names that do not depend on other files."""
    if isinstance(recipe, MeasurementRecipe):
        yield from _sensor_faults(recipe)
        yield from _source_faults(recipe)
    for section, number, capture in captures_of(recipe):
        yield from _capture_faults(capture, (section, number))
    if isinstance(recipe, MeasurementRecipe):
        yield from _section_faults(recipe)


def _section_faults(recipe: MeasurementRecipe) -> Iterator[Fault]:
    """Yield a fault unless there is one source of responsivity, one source of the sensor's figures, and all that they
    need.
    """
    given = [name for name in ("mono", "sweep", "curves", "band", "photo") if getattr(recipe, name)]
    rules = (
        (
            len(given) != 1,
            "give one source of responsivity, [[mono]] [sweep] [curves] [[band]] or [photo]; "
            f"given: {' and '.join(given) or 'none'}",
        ),
        (recipe.prior and not recipe.photos, "prior is for a [photo], and there is none; leave it out"),
        (
            bool(recipe.white) == (recipe.datasheet is not None) and (recipe.white or not recipe.photos),
            "give either [[white]] frames, and measure the sensor, or its [datasheet]",
        ),
        (recipe.white and not recipe.dark, "there is no [[dark]] capture; add some"),
        (
            {each.iso for each in recipe.white} != {each.iso for each in recipe.dark} and recipe.white,
            "give [[dark]] and [[white]] captures at the same ISO speeds",
        ),
        (
            None in (speeds := {each.iso for each in recipe.dark}) and len(speeds) > 1,
            "some [[dark]] and [[white]] captures state their iso and others do not; give it to all, or to none",
        ),
        (recipe.mono and recipe.datasheet, "[[mono]] frames need [[white]] and [[dark]] frames, not a [datasheet]"),
        (recipe.band and recipe.white, "[[band]] captures need a [datasheet], not [[white]] frames"),
        (
            recipe.chart and not recipe.white,
            "[[chart]] captures need [[white]] and [[dark]] frames; take them or leave the charts out",
        ),
        (
            len(recipe.chart) == 1 or (recipe.mono and not recipe.chart),
            "one [[chart]] does not separate gain from light; give charts under two illuminants",
        ),
    )
    yield from (fault(message, ()) for holds, message in rules if holds)


def _sensor_faults(recipe: MeasurementRecipe) -> Iterator[Fault]:
    sensor = recipe.sensor
    yield from length_faults(sensor.pixel_pitch_um, recipe.optics)
    array = list(cfa_faults(recipe.cfa))
    yield from array
    size = "sensor.rows", "sensor.cols"
    if sensor.rows * sensor.cols > most_pixels():
        yield fault(f"{sensor.rows}×{sensor.cols} pixels are more than inputs may have; raise {MEGAPIXELS}", *size)
    elif not array:
        rows, cols = len(recipe.cfa.pattern), len(recipe.cfa.pattern[0].split())
        if sensor.rows < SITE_PIXELS * rows or sensor.cols < SITE_PIXELS * cols:
            yield fault(f"{sensor.rows}×{sensor.cols} pixels are too few to measure noise; check sensor", *size)
    yield from channel_faults(recipe.channel, recipe.cfa.channels)
    if recipe.datasheet is not None:
        yield from _datasheet_faults(recipe.datasheet, 2**sensor.bits - 1)


def _datasheet_faults(declared: DatasheetRecipe, most: int) -> Iterator[Fault]:
    """Yield the faults of data sheet figures. `most` is the largest DN."""
    if not 0 <= declared.black_level_dn < declared.white_level_dn <= most:
        yield fault(f"datasheet needs 0 ≤ black_level_dn < white_level_dn ≤ {most}", "datasheet")
    yield from share_faults(declared.prnu, "datasheet.prnu", MAX_PRNU)


def _source_faults(recipe: MeasurementRecipe) -> Iterator[Fault]:
    """Yield the faults of [uncertainty] and of the columns in [curves]."""
    if recipe.uncertainty.photodiode and recipe.sweep is None:
        yield fault("uncertainty.photodiode is of the photodiode of a [sweep]; leave it out", "uncertainty.photodiode")
    if recipe.curves is not None:
        yield from column_faults(recipe.curves.columns, recipe.cfa.channels, "curves.columns")


def _capture_faults(capture: CaptureRecipe, key: KeyPath) -> Iterator[Fault]:
    """Yield the faults of the exposure of a capture."""
    if isinstance(capture.monitor, MonitorRecipe) and not isinstance(capture, MonoRecipe):
        message = f"monitor is a table by wavelength for [[mono]] captures alone; give a [[{key[0]}]] capture a number"
        yield fault(message, (*key, "monitor"))
    if capture.seconds is None:
        message = f"a [[{key[0]}]] capture needs one of exposure_s, exposure_ms and exposure_us"
        yield fault(message, *((*key, name) for name in EXPOSURES))


# -------------------------------------------------------------------------------------------- files that are named


def frames_named(recipe: MeasurementRecipe | CorrectionRecipe) -> list[tuple[KeyPath, str]]:
    """Return the key and name of every frame in a measurement file, in order."""
    lists: list[tuple[KeyPath, list[str]]] = [
        ((section, number, "frames"), capture.frames) for section, number, capture in captures_of(recipe)
    ]
    if isinstance(recipe, MeasurementRecipe):
        for number, photo in enumerate(recipe.photos):
            key = recipe.photo_key(number)
            lists += [((*key, "frames"), photo.frames), ((*key, "dark"), photo.dark), ((*key, "white"), photo.white)]
    return [((*key, position), name) for key, names in lists for position, name in enumerate(names)]


def spectrum_names(recipe: MeasurementRecipe) -> list[str]:
    """Return the names of all files of spectra, tables and curves in a measurement file, each once, in order."""
    names = [step.spectrum for step in recipe.mono] + [chart.radiance for chart in [*recipe.band, *recipe.chart]]
    names += [step.monitor.file for step in recipe.mono if isinstance(step.monitor, MonitorRecipe)]
    names += [recipe.sweep.table, recipe.sweep.response.file] if recipe.sweep else []
    names += [recipe.curves.file] if recipe.curves else []
    names += [name for photo in recipe.photos for name in (photo.light, photo.chart) if name and names_file(name)]
    return list(dict.fromkeys(names))


def describe(camera: CameraModel, uncertainty: UncertaintyRecipe, **captures: Any) -> MeasurementRecipe:
    """Return a measurement file for captures of a known camera.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    uncertainty : UncertaintyRecipe
        Uncertainty of the lights.
    **captures
        Lists `mono`, `chart`, `white` and `dark`.
    """
    return MeasurementRecipe(
        name=camera.name,
        sensor=BodyRecipe(camera.rows, camera.cols, round(camera.pixel_pitch * 1e6, 9), camera.bits),
        cfa=CfaRecipe(list(camera.channels), array_rows(camera.channels, camera.cfa)),
        optics=optics_recipe(camera.optics),
        uncertainty=uncertainty,
        channel=settings_of(camera.readout, camera.channels),
        **captures,
    )


def write_measurements(recipe: MeasurementRecipe, path: Path) -> None:
    """Write a measurement file."""
    write_whole(path, _toml(msgspec.to_builtins(recipe)))


def _toml(table: dict[str, Any], prefix: str = "") -> str:
    """Convert a table of numbers, texts, lists, tables and lists of tables to TOML."""

    def is_table(value: Any) -> bool:
        return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))

    table = {key: value for key, value in table.items() if value is not None and value != []}
    lines = [f"{toml_key(key)} = {toml_value(value)}" for key, value in table.items() if not is_table(value)]
    for key, value in ((toml_key(key), value) for key, value in table.items()):
        if isinstance(value, dict):
            lines += ["", f"[{prefix}{key}]", _toml(value, f"{prefix}{key}.").rstrip()]
        elif is_table(value):
            for item in value:
                lines += ["", f"[[{prefix}{key}]]", _toml(item, f"{prefix}{key}.").rstrip()]
    return "\n".join(lines) + "\n"
