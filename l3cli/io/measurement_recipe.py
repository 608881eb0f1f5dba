"""The keys of a measurement file (docs/own-lab.md, docs/method.md#calibration).

Exactly one of [[mono]], [sweep], [curves], [[band]] and [photo] determines the spectral responsivity, and [[chart]] captures
determine its absolute scale. The sensor's noise and levels are measured in [[dark]] and [[white]] frames, or copied from a
[datasheet]. If the key `base` specifies a camera model or camera recipe, the file contains only [[dark]], [[white]] and
[[polariser]] captures, and all other properties are copied from `base`. File names are relative to the measurement file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_curves import column_faults
from l3cli.artifacts.camera_recipe import (
    Bits,
    CfaRecipe,
    ChannelRecipe,
    MaskedRecipe,
    NoiseRecipe,
    OpticsRecipe,
    cfa_faults,
    channel_faults,
    length_faults,
    masked_faults,
    masked_recipe,
    optics_recipe,
    relative_noise_faults,
    settings_of,
)
from l3cli.physics.mosaic import array_rows
from l3cli.recipes.faults import Fault, fault
from l3cli.recipes.toml import Count, KeyPath, Positive, Recipe, toml_key, toml_value
from l3cli.spectra.file import names_file
from l3cli.system.files import write_whole
from l3cli.system.limits import MEGAPIXELS, most_pixels

EXPOSURES = ("exposure_s", "exposure_ms", "exposure_us")
CAPTURES = ("mono", "band", "chart", "white", "dark", "polariser")  # sections whose entries list frames
# If a lamp monitor has no column of reference readings, its table must contain ratios of two readings. A value that differs
# from 1 by more than this factor is rejected, because it is probably a single reading and not a ratio.
MOST_UNREFERENCED = 2.0
MOST_MONITOR = 10.0  # largest factor by which two lamp readings may differ; a larger factor indicates a different lamp
Below1 = Annotated[float, msgspec.Meta(ge=0, lt=1)]
Names = Annotated[list[str], msgspec.Meta(min_length=1)]
Corners = Annotated[list[tuple[float, float]], msgspec.Meta(min_length=4, max_length=4)]
SITE_PIXELS = 8  # minimum number of CFA periods along each side of a frame, because the noise analysis needs local means


class BodyRecipe(Recipe):
    rows: Count
    cols: Count
    pixel_pitch_um: Positive
    bits: Bits


class MonitorRecipe(Recipe):
    """A table of lamp monitor readings during a sweep, with one row per wavelength."""

    file: str  # table with a column of wavelengths and columns of readings in any unit
    # column of readings taken during the captures: its name, or its number, where 1 is the first column after the wavelength
    column: int | str = 1
    # column of readings taken while the spectra were measured; by default, `column` contains ratios of the two readings
    reference: int | str | None = None


class CaptureRecipe(Recipe, kw_only=True):
    """Frames of the same subject, taken with the same exposure."""

    frames: Names
    exposure_s: Positive | None = None  # exactly one of the three keys for the exposure time must be set
    exposure_ms: Positive | None = None
    exposure_us: Positive | None = None
    # lamp monitor reading during the capture, relative to the reading while the spectrum was measured; [[mono]] captures may
    # refer to a table of readings instead
    monitor: Annotated[float, msgspec.Meta(ge=1 / MOST_MONITOR, le=MOST_MONITOR)] | MonitorRecipe = 1.0

    @property
    def seconds(self) -> float | None:
        """The exposure time in s, or None unless exactly one of the three keys is set."""
        exposures = [(self.exposure_s, 1.0), (self.exposure_ms, 1e3), (self.exposure_us, 1e6)]
        seconds = [value / parts for value, parts in exposures if value is not None]
        return seconds[0] if len(seconds) == 1 else None


class SensorCaptureRecipe(CaptureRecipe, kw_only=True):
    """Dark or white frames taken at one ISO speed. The camera model describes the sensor at the lowest ISO speed."""

    iso: float | None = None  # must be set for all dark and white captures, or for none


class MonoRecipe(CaptureRecipe, kw_only=True):
    """Frames of a uniform field, lit by a monochromator at one wavelength."""

    spectrum: str  # CSV file with the measured spectral radiance of the light
    column: int | str = 1  # name of the radiance column, or its number, where 1 is the first column after the wavelength
    unit: str | None = None  # unit of the radiances, if the CSV file does not state it; default: photons/s/sr/m²/nm


class ChartRecipe(CaptureRecipe, kw_only=True):
    """A ColorChecker under one illuminant.

    In [[band]] captures, the light passes through a filter, and radiances may be relative.
    """

    illuminant: str
    corners: Corners  # (col, row) in pixels: outer corners of patches 1, 6, 24 and 19, clockwise
    radiance: str  # CSV file of measured radiances: 24 columns named after the patches, or in order from dark skin to black
    unit: str | None = None  # unit of the radiances, as in [[mono]]


class PolariserRecipe(CaptureRecipe, kw_only=True):
    """Frames of a uniform light source, taken through a linear polariser at one angle."""

    # reading of the rotator's scale: the angle of the transmission axis, counter-clockwise from horizontal, plus
    # rotator.offset_deg
    angle_deg: Annotated[float, msgspec.Meta(ge=-360, le=360)]


class RotatorRecipe(Recipe):
    """The rotating polariser with which the [[polariser]] captures were taken."""

    extinction: Annotated[float, msgspec.Meta(gt=1)] | None = None  # extinction ratio; default: ideal polariser
    # standard deviation of the error in each angle_deg
    angle_error_deg: Annotated[float, msgspec.Meta(ge=0, le=10)] = 0.1
    # reading of the scale when the transmission axis is horizontal
    offset_deg: Annotated[float, msgspec.Meta(ge=-180, le=180)] = 0.0
    reference: str | None = None  # if the zero of the scale is unknown: channel whose polariser_deg is exact


class CommonRecipe(Recipe):
    """Default values of keys in [[mono]] and [[band]] captures."""

    exposure_s: Positive | None = None  # at most one of the three keys for the exposure time may be set
    exposure_ms: Positive | None = None
    exposure_us: Positive | None = None
    unit: str | None = None  # unit of radiances, if a CSV file does not state it
    monitor: MonitorRecipe | None = None  # lamp monitor readings for [[mono]] captures


class ColumnRecipe(Recipe):
    """One column in a table of spectra."""

    file: str
    column: int | str  # name of the column, or its number, where 1 is the first column after the wavelength


class SweepRecipe(Recipe):
    """A table of mean signals from a monochromator sweep."""

    table: str  # CSV: nm, light r, light g, …, dark r, dark g, … (mean of each channel in DN), diode light, diode dark
    photodiode: str | ColumnRecipe  # CSV: nm, and the photodiode's responsivity per energy, for example in A/W

    @property
    def response(self) -> ColumnRecipe:
        """Table and column of the photodiode's responsivity. Column 0 stands for the only column in the table."""
        return ColumnRecipe(self.photodiode, 0) if isinstance(self.photodiode, str) else self.photodiode


class CurvesRecipe(Recipe):
    """Finished responsivities, for example from another program."""

    file: str  # CSV file with nm and one column per channel, or rawtoaces JSON file
    columns: dict[str, str] = msgspec.field(default_factory=dict)  # channel → column, where the names differ
    per_energy: bool = True  # false if the curves are per photon


class PhotoRecipe(Recipe):
    """Raw photos of a chart under one illuminant."""

    frames: Names  # raw files of the same scene with the same exposure; two or more files also determine the noise
    light: str | None = None  # "D65", "3200K", or a CSV file with the spectrum; default: the illuminant is estimated
    column: int | str = 1  # name or number of the spectrum's column, as in [[mono]]
    unit: str = "relative power"  # unit of the spectrum, if the CSV file does not state it
    chart: str = "classic"  # name of a chart, or CSV file of reflectances with one column per patch, row by row
    layout: tuple[Count, Count] = (4, 6)  # rows and columns of patches
    corners: Corners | None = None  # (col, row), as in [[chart]]; default: l3 searches for the chart
    dark: list[str] = msgspec.field(default_factory=list)  # raw files taken in the dark, with the same exposure
    white: list[str] = msgspec.field(default_factory=list)  # raw files of a uniform white target in place of the chart


class DatasheetRecipe(NoiseRecipe, kw_only=True):
    """Sensor properties from a data sheet."""

    black_level_dn: float
    white_level_dn: float
    gain_dn_per_e: Positive | None = None  # system gain; by default, the full-well capacity corresponds to the white level


class UncertaintyRecipe(Recipe):
    """Uncertainties of the light (one standard deviation), which widen the confidence bands."""

    lamp_drift: Below1 = 0.0  # relative drift of the lamp spectrum that the monitor does not correct
    photodiode: Below1 = 0.0  # relative error of the photodiode's responsivity in [sweep], at each wavelength
    # error of the wavelength scale of the spectrometer or monochromator
    wavelength_nm: Annotated[float, msgspec.Meta(ge=0, lt=100)] = 0.0


class MeasurementRecipe(Recipe):
    """A measurement file, usually MEASUREMENTS.toml."""

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
    prior: str | None = None  # for photos: folder of measured camera responsivities; default: the built-in cameras
    band: list[ChartRecipe] = msgspec.field(default_factory=list)
    chart: list[ChartRecipe] = msgspec.field(default_factory=list)
    white: list[SensorCaptureRecipe] = msgspec.field(default_factory=list)
    dark: list[SensorCaptureRecipe] = msgspec.field(default_factory=list)
    polariser: list[PolariserRecipe] = msgspec.field(default_factory=list)
    rotator: RotatorRecipe | None = None
    datasheet: DatasheetRecipe | None = None
    # exposures or gains that differ between channels, and each channel's polariser angle
    channel: dict[str, ChannelRecipe] = msgspec.field(default_factory=dict)
    uncertainty: UncertaintyRecipe = msgspec.field(default_factory=UncertaintyRecipe)
    masked: MaskedRecipe | None = None  # optically black pixels around the light-sensitive pixels, as in a camera recipe
    # whether to search for blinking pixels, and add them to the defects; requires 32 dark frames with the same exposure
    blinking_defects: bool = False

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
        """The entries of [[photo]], or the single entry [photo], as a list."""
        return self.photo if isinstance(self.photo, list) else [self.photo]

    def photo_key(self, number: int) -> KeyPath:
        """Return the key path of the photo at index `number`."""
        return ("photo", number) if isinstance(self.photo, list) else ("photo",)


class CorrectionRecipe(Recipe):
    """A measurement file that adds defects and a flat field, or measured polarisers, to a known camera."""

    title: ClassVar[str] = MeasurementRecipe.title

    base: str  # camera model or camera recipe, relative to this file
    # captures with the lens cap on, at one or more exposures
    dark: Annotated[list[CaptureRecipe], msgspec.Meta(min_length=1)]
    # captures of a uniform white target, neither clipped nor too dark, from which defects and flat field are determined
    white: list[CaptureRecipe] = msgspec.field(default_factory=list)
    # captures behind a rotating polariser, from which the channels' polarisers are determined
    polariser: list[PolariserRecipe] = msgspec.field(default_factory=list)
    rotator: RotatorRecipe | None = None
    blinking_defects: bool = False  # as in a measurement file without `base`


def captures_of(recipe: MeasurementRecipe | CorrectionRecipe) -> Iterator[tuple[str, int, CaptureRecipe]]:
    """Yield (section name, index in the section, capture) for every capture."""
    for section in CAPTURES:
        for number, capture in enumerate(getattr(recipe, section, [])):
            yield section, number, capture


# -------------------------------------------------------------------------------------------------------- faults


def key_faults(recipe: MeasurementRecipe | CorrectionRecipe) -> Iterator[Fault]:
    """Yield the faults in a measurement file that can be found without reading other files."""
    if isinstance(recipe, MeasurementRecipe):
        yield from _sensor_faults(recipe)
        yield from _source_faults(recipe)
    elif not recipe.white and not recipe.polariser:
        yield fault(
            "[[dark]] captures alone are not enough for a correction; add [[white]] or [[polariser]] captures", ("dark",)
        )
    for section, number, capture in captures_of(recipe):
        yield from _capture_faults(capture, (section, number))
    yield from _polariser_faults(recipe)
    if isinstance(recipe, MeasurementRecipe):
        yield from _section_faults(recipe)


def _polariser_faults(recipe: MeasurementRecipe | CorrectionRecipe) -> Iterator[Fault]:
    """Yield the faults in [rotator] and in the combination of [[polariser]] with other sections."""
    if recipe.rotator is not None and not recipe.polariser:
        yield fault(
            "[rotator] applies only to [[polariser]] captures; add [[polariser]] captures, or remove [rotator]", "rotator"
        )
    elif recipe.rotator is not None and recipe.rotator.reference is not None:
        name = recipe.rotator.reference
        if recipe.rotator.offset_deg:
            message = '"rotator.reference" already sets the zero of the scale; remove it or "rotator.offset_deg"'
            yield fault(message, "rotator.offset_deg")
        if isinstance(recipe, MeasurementRecipe):
            stated = {channel for channel, one in recipe.channel.items() if one.polariser_deg is not None}
            if name not in stated:
                message = f'"rotator.reference" is channel "{name}", which has no angle; set channel.{name}.polariser_deg'
                yield fault(message, "rotator.reference")
    if isinstance(recipe, MeasurementRecipe) and recipe.polariser and not (recipe.dark or recipe.datasheet or recipe.photos):
        yield fault(
            "[[polariser]] captures need [[dark]] captures or a [datasheet]; add [[dark]] captures or a [datasheet]",
            "polariser",
        )


def _section_faults(recipe: MeasurementRecipe) -> Iterator[Fault]:
    """Yield a fault for each section that is missing or that cannot be combined with another section."""
    sources = [name for name in ("mono", "sweep", "curves", "band", "photo") if getattr(recipe, name)]
    rules = (
        (
            len(sources) != 1,
            f"the file contains {' and '.join(sources) or 'no section for the responsivity'}; specify exactly one of "
            "[[mono]], [sweep], [curves], [[band]] and [photo]",
        ),
        (recipe.prior and not recipe.photos, 'the key "prior" applies only to [photo]; remove this key'),
        (
            bool(recipe.white) == (recipe.datasheet is not None) and (recipe.white or not recipe.photos),
            "the sensor must be described either by [[white]] captures or by a [datasheet]; specify exactly one of the two",
        ),
        (recipe.white and not recipe.dark, "[[white]] captures need [[dark]] captures; add [[dark]] captures"),
        (
            {each.iso for each in recipe.white} != {each.iso for each in recipe.dark} and recipe.white,
            "[[dark]] and [[white]] captures must have the same ISO speeds; add the missing captures",
        ),
        (
            None in (speeds := {each.iso for each in recipe.dark}) and len(speeds) > 1,
            'only some [[dark]] and [[white]] captures contain the key "iso"; set "iso" for all of these captures, or for '
            "none",
        ),
        (
            recipe.mono and recipe.datasheet,
            "[[mono]] captures cannot be combined with a [datasheet]; replace [datasheet] with [[white]] and [[dark]] "
            "captures",
        ),
        (
            recipe.band and recipe.white,
            "[[band]] captures cannot be combined with [[white]] captures; replace the [[white]] captures with a "
            "[datasheet]",
        ),
        (
            recipe.chart and not recipe.white,
            "[[chart]] captures need [[white]] and [[dark]] captures; add these captures or remove the charts",
        ),
        (
            len(recipe.chart) == 1 or (recipe.mono and not recipe.chart),
            "fewer than two [[chart]] captures cannot separate the gain from the light; add charts under two illuminants",
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
        yield fault(
            f"a sensor with {sensor.rows}×{sensor.cols} pixels exceeds the maximum size of inputs; increase the environment "
            f"variable {MEGAPIXELS}",
            *size,
        )
    elif not array:
        rows, cols = len(recipe.cfa.pattern), len(recipe.cfa.pattern[0].split())
        if sensor.rows < SITE_PIXELS * rows or sensor.cols < SITE_PIXELS * cols:
            yield fault(
                f'{sensor.rows}×{sensor.cols} pixels are too few to measure noise; correct "sensor.rows" and "sensor.cols"',
                *size,
            )
    yield from channel_faults(recipe.channel, recipe.cfa.channels)
    yield from masked_faults(recipe.masked, recipe.channel)
    if recipe.datasheet is not None:
        yield from _datasheet_faults(recipe.datasheet, 2**sensor.bits - 1)


def _datasheet_faults(declared: DatasheetRecipe, most: int) -> Iterator[Fault]:
    """Yield the faults in [datasheet]. `most` is the largest raw value in DN."""
    if not 0 <= declared.black_level_dn < declared.white_level_dn <= most:
        yield fault(
            f"[datasheet] must satisfy 0 ≤ black_level_dn < white_level_dn ≤ {most}; correct these keys", "datasheet"
        )
    yield from relative_noise_faults(declared, "datasheet")


def _source_faults(recipe: MeasurementRecipe) -> Iterator[Fault]:
    """Yield the faults in [uncertainty] and in the columns of [curves]."""
    if recipe.uncertainty.photodiode and recipe.sweep is None:
        yield fault('"uncertainty.photodiode" applies only to a [sweep]; remove this key', "uncertainty.photodiode")
    if recipe.curves is not None:
        yield from column_faults(recipe.curves.columns, recipe.cfa.channels, "curves.columns")


def _capture_faults(capture: CaptureRecipe, key: KeyPath) -> Iterator[Fault]:
    """Yield the faults in a capture's exposure time and monitor. `key` is the capture's path in the recipe."""
    if isinstance(capture.monitor, MonitorRecipe) and not isinstance(capture, MonoRecipe):
        message = (
            f'"monitor" may be a table only for [[mono]] captures; set "monitor" of this [[{key[0]}]] capture to a number'
        )
        yield fault(message, (*key, "monitor"))
    if capture.seconds is None:
        message = f'a [[{key[0]}]] capture needs exactly one of the keys "exposure_s", "exposure_ms" and "exposure_us"'
        yield fault(message, *((*key, name) for name in EXPOSURES))


# ----------------------------------------------------------------------------------- files that the recipe refers to


def frames_named(recipe: MeasurementRecipe | CorrectionRecipe) -> list[tuple[KeyPath, str]]:
    """Return (key path, file name) for every frame in a measurement file, in order."""
    lists: list[tuple[KeyPath, list[str]]] = [
        ((section, number, "frames"), capture.frames) for section, number, capture in captures_of(recipe)
    ]
    if isinstance(recipe, MeasurementRecipe):
        for number, photo in enumerate(recipe.photos):
            key = recipe.photo_key(number)
            lists += [((*key, "frames"), photo.frames), ((*key, "dark"), photo.dark), ((*key, "white"), photo.white)]
    return [((*key, position), name) for key, names in lists for position, name in enumerate(names)]


def spectrum_names(recipe: MeasurementRecipe) -> list[str]:
    """Return the names of all spectrum, table and curve files that a measurement file lists, without duplicates."""
    names = [step.spectrum for step in recipe.mono] + [chart.radiance for chart in [*recipe.band, *recipe.chart]]
    names += [step.monitor.file for step in recipe.mono if isinstance(step.monitor, MonitorRecipe)]
    names += [recipe.sweep.table, recipe.sweep.response.file] if recipe.sweep else []
    names += [recipe.curves.file] if recipe.curves else []
    names += [name for photo in recipe.photos for name in (photo.light, photo.chart) if name and names_file(name)]
    return list(dict.fromkeys(names))


def describe(camera: CameraModel, uncertainty: UncertaintyRecipe, **captures: Any) -> MeasurementRecipe:
    """Create a measurement file for captures taken with a known camera.

    Parameters
    ----------
    camera : CameraModel
        The camera.
    uncertainty : UncertaintyRecipe
        Uncertainties of the light.
    **captures
        Lists of captures, by section: `mono`, `chart`, `white`, `dark` and `polariser`.

    Returns
    -------
    MeasurementRecipe
        Content of the measurement file. It describes the camera's geometry, but not its responsivities and noise.
    """
    return MeasurementRecipe(
        name=camera.name,
        sensor=BodyRecipe(camera.rows, camera.cols, round(camera.pixel_pitch * 1e6, 9), camera.bits),
        cfa=CfaRecipe(list(camera.channels), array_rows(camera.channels, camera.cfa)),
        optics=optics_recipe(camera.optics),
        uncertainty=uncertainty,
        channel=_channels(camera),
        masked=masked_recipe(camera.masked),
        **captures,
    )


def _channels(camera: CameraModel) -> dict[str, ChannelRecipe]:
    """Return the sections [channel.NAME] with the readout settings, and with polariser angles rounded to whole degrees."""
    sections = settings_of(camera.readout, camera.channels)
    if camera.polarisers is not None:
        stated = zip(camera.channels, camera.polarisers.polariser_deg, camera.polarisers.present, strict=True)
        for name, angle in ((name, round(angle) % 180) for name, angle, present in stated if present):
            sections[name] = msgspec.structs.replace(sections.get(name, ChannelRecipe()), polariser_deg=float(angle))
    return sections


def write_measurements(recipe: MeasurementRecipe, path: Path) -> None:
    """Write a measurement file, replacing an existing file."""
    write_whole(path, _toml(msgspec.to_builtins(recipe)))


def _toml(table: dict[str, Any], prefix: str = "") -> str:
    """Convert a table to TOML text. Keys with the value None or [] are omitted.

    `prefix` is the table's key, followed by a period.
    """

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
