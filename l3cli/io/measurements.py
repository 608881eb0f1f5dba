"""Read a measurement file and all files that it lists (docs/architecture.md#the-path-of-a-measurement).

The keys of the file are read first (measurement_recipe.py), then the tables of spectra, then the photos. All other frames
are read later, one at a time, because lab measurements may not fit into memory.
"""

import contextlib
import functools
import math
import os
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.camera_recipe import (
    camera_files,
    load_camera,
    masked_of,
    noise_of,
    optics_of,
    parse_cfa,
    polarisers_of,
    settings_from,
)
from l3cli.artifacts.schema import Stage
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.measurement import (
    LEAKAGE_NM,
    PATCH_NAMES,
    PATCHES,
    BandCapture,
    Body,
    Capture,
    Chart,
    ChartCapture,
    CurveStatistics,
    FinishedCurves,
    GainCaptures,
    Measurements,
    MonoCapture,
    PolariserCapture,
    Rotator,
    SensorFigures,
    SweepTable,
)
from l3cli.io.chart_photos import Illuminant, Levels, capture_of, chart_of, illuminant_of, recipe_of_photos
from l3cli.io.curves import prior_files, read_cameras, read_finished, read_sweep, shipped_statistics
from l3cli.io.frames import FrameFiles, WholeFrames, raw_content
from l3cli.io.measurement_recipe import (
    MOST_MONITOR,
    MOST_UNREFERENCED,
    CaptureRecipe,
    ChartRecipe,
    CorrectionRecipe,
    DatasheetRecipe,
    MeasurementRecipe,
    MonitorRecipe,
    MonoRecipe,
    RotatorRecipe,
    SensorCaptureRecipe,
    captures_of,
    frames_named,
    key_faults,
    spectrum_names,
)
from l3cli.io.raw import RawContent
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.load import parse_recipe
from l3cli.recipes.toml import KeyPath, parse_toml, read_text
from l3cli.spectra import units
from l3cli.spectra.file import read_table
from l3cli.spectra.table import RELATIVE, CurveTable
from l3cli.system.files import sha256, stamp

Array = NDArray[np.float64]
ReadTable = Callable[[Path], CurveTable]
AnyRecipe = MeasurementRecipe | CorrectionRecipe
At = Callable[..., AbstractContextManager[None]]  # at(*keys) returns a context manager that handles errors about these keys


@dataclass(frozen=True)
class MeasurementFiles:
    """Measurements, and the files from which they were read."""

    measurements: Measurements
    recipe: str  # text of the measurement file; empty for photos without a measurement file
    files: dict[str, list[Path]]  # role, such as "frames" → files
    stamps: dict[Path, tuple[int, ...]]  # file → its state before it was read (see `system.files.stamp`)

    def history(self, options: dict[str, Any]) -> Stage:
        """Return the calibration's history entry: its options, its measurement file, and the SHA-256 digest of every file.

        Raises InputFileError if a file has changed since it was read, because its digest would not match the measurements.
        """
        digests = {role: [sha256(file) for file in files] for role, files in self.files.items()}
        for file, before in self.stamps.items():
            if stamp(file) != before:
                raise InputFileError(
                    f"{file} changed while l3 was running; run the command again when no other program writes to it"
                )
        return Stage("calibrate", options, self.recipe, digests)


def read_measurements(path: Path) -> MeasurementFiles:
    """Read a measurement file and all files that it lists.

    Parameters
    ----------
    path : Path
        The measurement file.

    Returns
    -------
    MeasurementFiles
        The measurements. Frames other than photos are read later, one at a time.

    Raises
    ------
    RecipeError
        If the measurement file is invalid.
    InputFileError
        If a file is missing, or if a table or a photo is damaged.
    """
    before = stamp(path)
    text = read_text(path, MeasurementRecipe.title)
    recipe = parse_measurements(text, path)
    files = {"measurements": [path], **_files_named(recipe, path)}
    stamps = {file: stamp(file) for named in files.values() for file in named} | {path: before}
    return MeasurementFiles(measurements_of(recipe, path), text, files, stamps)


def read_photos(photos: Sequence[Path], light: str | None, levels: Levels | None = None) -> MeasurementFiles:
    """Read raw photos of a chart under one illuminant, without a measurement file.

    Parameters
    ----------
    photos : sequence of Path
        The raw files.
    light : str or None
        Name of the illuminant, or None to estimate it.
    levels : mapping, optional
        Levels for raw files that do not contain them (see chart_photos.Levels). [default: none]

    Raises
    ------
    InputFileError
        If a file is not a raw file with a CFA, if its levels are unknown, or if it cannot be read.
    RecipeError
        If the illuminant is unknown.
    """
    levels = levels or {}
    stamps = {file: stamp(file) for file in photos}
    first = raw_content(photos[0], levels)

    def read(path: Path, known: Levels) -> RawContent:
        return first if path == photos[0].absolute() else raw_content(path, known)

    recipe = recipe_of_photos(photos, first, light, levels)
    measurements = _assembled(recipe, photos[0], read_contents(recipe, photos[0]), levels, read)
    return MeasurementFiles(measurements, "", {"frames": list(photos)}, stamps)


def parse_measurements(text: str, path: Path) -> AnyRecipe:
    """Parse the text of the measurement file `path`. Raises RecipeError if it contains a fault."""
    name, based = str(path), "base" in parse_toml(text, str(path))
    recipe = parse_recipe(text, CorrectionRecipe, name) if based else parse_recipe(text, MeasurementRecipe, name)
    refuse_first(key_faults(recipe), path)
    return recipe


def measurements_of(recipe: AnyRecipe, path: Path) -> Measurements:
    """Read all files that a measurement file lists.

    Parameters
    ----------
    recipe : MeasurementRecipe or CorrectionRecipe
        Content of the measurement file, from `parse_measurements`.
    path : Path
        Path of the measurement file, which is not read again. File names are relative to its folder.

    Returns
    -------
    Measurements
        The measurements. Frames other than photos are read later, one at a time.

    Raises
    ------
    RecipeError
        If the measurement file refers to an unknown name or to a missing column.
    InputFileError
        If a file is missing, or if a table or a photo is damaged.
    """
    return _assembled(recipe, path, read_contents(recipe, path), None, raw_content)


def _files_named(recipe: AnyRecipe, path: Path) -> dict[str, list[Path]]:
    """Return the files that a measurement file lists, by role."""
    folder = path.parent
    if isinstance(recipe, CorrectionRecipe):
        frames = [folder / name for _, _, capture in captures_of(recipe) for name in capture.frames]
        return {"frames": frames, "camera": camera_files(folder / recipe.base)}
    frames = [folder / name for _, name in frames_named(recipe)]
    priors = [] if recipe.prior is None else prior_files(folder / recipe.prior)
    return {"frames": frames, "spectra": [folder / name for name in spectrum_names(recipe)] + priors}


# ------------------------------------------------------------------------------ tables that a measurement file lists


class MonoLight(NamedTuple):
    """Measured light of one monochromator step."""

    wavelength: Array  # (wavelength,) nm
    radiance: Array  # (wavelength,) photons/s/sr/m²/nm
    absolute: bool  # whether the absolute scale of the radiance is known
    monitor: float  # lamp output during the capture, relative to the output while the spectrum was measured


class PatchRadiances(NamedTuple):
    """Measured radiances of a chart's patches."""

    wavelength: Array  # (wavelength,) nm
    radiance: Array  # (24, wavelength) photons/s/sr/m²/nm


@dataclass(frozen=True)
class Contents:
    """Contents of all files that a measurement file lists, except frames.

    The elements of each tuple are in the order of the measurement file.
    """

    base: CameraModel | None = None
    mono: tuple[MonoLight, ...] = ()
    charts: tuple[PatchRadiances, ...] = ()
    bands: tuple[PatchRadiances, ...] = ()
    curve: SweepTable | FinishedCurves | None = None
    cameras: CurveStatistics | tuple[FinishedCurves, ...] | None = None
    photos: tuple[tuple[Illuminant, Chart], ...] = ()


def _raised(*keys: KeyPath) -> AbstractContextManager[None]:
    """Return a context manager that does not handle errors, so that the first error is raised."""
    return contextlib.nullcontext()


def read_contents(recipe: AnyRecipe, path: Path, at: At = _raised) -> Contents:
    """Read the files that a measurement file lists, except frames, and check that the frames exist.

    Parameters
    ----------
    recipe : MeasurementRecipe or CorrectionRecipe
        Content of the measurement file.
    path : Path
        Path of the measurement file. File names are relative to its folder.
    at : callable
        Function that takes the keys of an entry and returns a context manager, which handles errors about this entry. For
        example, `l3 check` collects the errors, and the entries are then missing from the result. [default: errors are
        raised]

    Raises
    ------
    RecipeError
        If the measurement file refers to an unknown name or to a missing column.
    InputFileError
        If a file is missing, or if its content is unsuitable.
    """
    folder, read = path.parent, functools.cache(read_table)  # many captures share a table
    for key, name in frames_named(recipe):
        with at(key):
            if not os.path.isfile(folder / name):
                raise InputFileError(
                    f"{folder / name} does not exist; copy the frame to this folder, or correct its file name"
                )
    if isinstance(recipe, CorrectionRecipe):
        with at(("base",)):
            return Contents(base=load_camera(folder / recipe.base))
        return Contents()
    curve: SweepTable | FinishedCurves | None = None
    cameras: CurveStatistics | tuple[FinishedCurves, ...] | None = None
    with at(("sweep", "table") if recipe.sweep is not None else ("curves", "file")):
        curve = _curve(recipe, folder)
    with at(("prior",)):
        cameras = _cameras(recipe, folder)
    photos = []
    for number, photo in enumerate(recipe.photos):
        key, lights = recipe.photo_key(number), list[Illuminant]()
        with at((*key, "light")):
            lights.append(illuminant_of(photo, path))
        with at((*key, "chart"), (*key, "layout")):
            chart = chart_of(photo, path)
            photos += [(illuminant, chart) for illuminant in lights]
    return Contents(
        mono=_mono_lights(recipe.mono, path, read, at),
        charts=_patch_radiances("chart", recipe.chart, folder, read, at),
        bands=_patch_radiances("band", recipe.band, folder, read, at),
        curve=curve,
        cameras=cameras,
        photos=tuple(photos),
    )


def _mono_lights(steps: Sequence[MonoRecipe], path: Path, read: ReadTable, at: At) -> tuple[MonoLight, ...]:
    """Read the measured light of each monochromator step.

    Raises RecipeError if a column does not exist, and InputFileError if a spectrum is unsuitable.
    """
    lights = []
    for number, step in enumerate(steps):
        with at(("mono", number, "spectrum"), ("mono", number, "column")):
            table = read(path.parent / step.spectrum)
            if isinstance(step.column, int) and not 1 <= step.column <= len(table.values):
                raise RecipeError(
                    f"{path}: {step.spectrum} has no column {step.column}; set a column from 1 to {len(table.values)}"
                )
            light = table.column(step.column)
            radiance = light.photons(step.unit)[0]
            if radiance.max() <= 0:
                raise InputFileError(
                    f"{table.path}: column {step.column} contains no positive value; measure the spectrum again"
                )
            monitor, nm = step.monitor, float(light.wavelength[radiance.argmax()])
            with at(("mono", number, "monitor")):
                ratio = monitor_at(monitor, nm, path.parent, read) if isinstance(monitor, MonitorRecipe) else monitor
                absolute = not {step.unit, *light.units} & set(RELATIVE)
                lights.append(MonoLight(light.wavelength, radiance, absolute, ratio))
    return tuple(lights)


def monitor_at(monitor: MonitorRecipe, nm: float, folder: Path, read: ReadTable = read_table) -> float:
    """Return the lamp output during a capture, relative to the output while the spectrum was measured.

    Parameters
    ----------
    monitor : MonitorRecipe
        Table and columns of the monitor readings.
    nm : float
        Peak wavelength of the capture in nm.
    folder : Path
        Folder of the measurement file. The table's file name is relative to this folder.
    read : callable
        Function that reads a table.

    Returns
    -------
    float
        Ratio of the two readings, each interpolated linearly at `nm`.

    Raises
    ------
    InputFileError
        If the table does not cover `nm`, if the two columns have different units, if the ratio is implausible, or if no
        reference is set although the column contains readings instead of ratios.
    """
    table = read(folder / monitor.file)
    first, last = table.wavelength[0], table.wavelength[-1]
    if not first - 1 <= nm <= last + 1:
        raise InputFileError(
            f"{table.path} covers only {first:g}…{last:g} nm, but one capture is at {nm:g} nm; add a reading at this "
            "wavelength"
        )
    reading, unit = _reading(table, monitor.column, nm)
    if monitor.reference is None:
        if unit or not 1 / MOST_UNREFERENCED <= reading <= MOST_UNREFERENCED:
            with_unit = " (with a unit)" if unit else ""
            raise InputFileError(
                f"{table.path}: {reading:.4g}{with_unit} at {nm:g} nm cannot be a relative lamp brightness, which would be "
                'near 1; if the column contains lamp readings, set "reference" to the column of readings taken while the '
                "spectra were measured"
            )
        return reading
    before, other = _reading(table, monitor.reference, nm)
    if unit != other:
        raise InputFileError(
            f'{table.path}: the two columns for "monitor" have different units; specify two columns with readings of the '
            "same detector"
        )
    ratio = reading / before if before > 0 else math.inf
    if not 1 / MOST_MONITOR <= ratio <= MOST_MONITOR:
        raise InputFileError(
            f"{table.path}: at {nm:g} nm, the reading {reading:.4g} differs from the reference {before:.4g} by more than a "
            f'factor of {MOST_MONITOR:g}; set "reference" to the column of readings taken while the spectra were measured'
        )
    return ratio


def _reading(table: CurveTable, column: int | str, nm: float) -> tuple[float, dict[str, int]]:
    """Interpolate a column at the wavelength `nm`. Return the value in base units, and the exponent of each base unit.

    If the heading contains no unit, the value is returned unchanged, and the dictionary of exponents is empty.
    """
    found = table.column(column)
    unit = None if found.units[0] is None else units.parse(found.units[0])
    value = float(np.interp(nm, found.wavelength, found.values[0]))
    return (value, {}) if unit is None else (value * unit.scale, unit.powers)


def _patch_radiances(
    section: str, captures: Sequence[ChartRecipe], folder: Path, read: ReadTable, at: At
) -> tuple[PatchRadiances, ...]:
    """Read the patch radiances for each [[chart]] or [[band]] capture, in the order of the ColorChecker.

    Raises InputFileError if the radiances for a [[chart]] capture are relative, or if a patch has no positive radiance.
    """
    radiances = []
    for number, capture in enumerate(captures):
        with at((section, number, "radiance")):
            file = folder / capture.radiance
            measured = read(file).ordered(PATCH_NAMES, patch_name)
            if section == "chart" and {capture.unit, *measured.units} & set(RELATIVE):
                raise InputFileError(
                    f"{file} contains relative radiances, but [[chart]] captures determine the absolute scale of the "
                    "responsivity; measure absolute radiances"
                )
            radiance = measured.photons(capture.unit, absolute=section == "chart")
            if radiance.max(axis=1).min() <= 0:
                raise InputFileError(f"{file}: a patch has no positive radiance; measure the chart again")
            radiances.append(PatchRadiances(measured.wavelength, radiance))
    return tuple(radiances)


def patch_name(heading: str) -> str:
    """Convert a column heading such as "patch 13", "13", "Blue" or "white 9.5 (.05 D)" to the name of a patch.

    A number is replaced by the name of the patch with this number. Other headings are converted to lower case, without any
    trailing text in parentheses.
    """
    number = re.fullmatch(r"(?:patch|p|no|#)?[ ._-]*0*(\d{1,2})", heading.strip(), re.IGNORECASE)
    if number and 1 <= int(number[1]) <= PATCHES:
        return PATCH_NAMES[int(number[1]) - 1]
    return re.sub(r"\s*\(.*\)$", "", heading).strip().lower()


def _curve(recipe: MeasurementRecipe, folder: Path) -> SweepTable | FinishedCurves | None:
    """Read the curves for [sweep] or [curves], or return None if the measurement file has neither section."""
    if recipe.sweep is not None:
        response = recipe.sweep.response
        return read_sweep(folder / recipe.sweep.table, folder / response.file, recipe.cfa.channels, response.column)
    if recipe.curves is not None:
        curves = recipe.curves
        return read_finished(folder / curves.file, recipe.cfa.channels, curves.per_energy, curves.columns)
    return None


def _cameras(recipe: MeasurementRecipe, folder: Path) -> CurveStatistics | tuple[FinishedCurves, ...] | None:
    """Return the prior for photos: responsivities from a folder, or the statistics of the built-in cameras.

    Returns None if the measurement file contains no photos.
    """
    if not recipe.photos:
        return None
    return shipped_statistics() if recipe.prior is None else read_cameras(prior_files(folder / recipe.prior))


# ------------------------------------------------------------------------------------------------- measurements


def _assembled(
    recipe: AnyRecipe,
    path: Path,
    contents: Contents,
    levels: Levels | None,
    read: Callable[[Path, Levels], RawContent],
) -> Measurements:
    """Combine a recipe and the contents of its files into measurements, and read the photos with the function `read`.

    `levels` applies to photos that do not contain levels. If `levels` is None, the levels in [datasheet] apply to them.
    """
    if isinstance(recipe, CorrectionRecipe):
        assert contents.base is not None
        return _corrections(recipe, contents.base, path.parent)
    body = _body(recipe, path)
    speeds = sorted({each.iso for each in recipe.dark if each.iso})
    darks, whites = (_by_speed(each, body, path.parent) for each in (recipe.dark, recipe.white))
    lowest = speeds[0] if speeds else None
    uncertainty = recipe.uncertainty
    known = _levels(recipe.datasheet) if levels is None else levels
    return Measurements(
        body=body,
        mono=tuple(
            MonoCapture(**_frames(step, body, path.parent) | light._asdict())
            for step, light in zip(recipe.mono, contents.mono, strict=True)
        ),
        charts=tuple(
            ChartCapture(**_chart(*each, body, path.parent)) for each in zip(recipe.chart, contents.charts, strict=True)
        ),
        darks=darks.get(lowest, ()),
        whites=whites.get(lowest, ()),
        iso=lowest,
        gains=tuple(GainCaptures(iso, darks[iso], whites.get(iso, ())) for iso in speeds[1:]),
        bands=tuple(
            BandCapture(**_chart(*each, body, path.parent)) for each in zip(recipe.band, contents.bands, strict=True)
        ),
        curve=contents.curve,
        photos=tuple(
            capture_of(photo, *scene, body, known, path, read)
            for photo, scene in zip(recipe.photos, contents.photos, strict=True)
        ),
        **_polarisers(recipe, functools.partial(_frames, body=body, folder=path.parent)),
        cameras=contents.cameras,
        datasheet=None if recipe.datasheet is None else _figures(recipe.datasheet),
        lamp_drift=math.hypot(uncertainty.lamp_drift, uncertainty.photodiode),
        wavelength_uncertainty=uncertainty.wavelength_nm,
        blinking_defects=recipe.blinking_defects,
    )


def _corrections(recipe: CorrectionRecipe, camera: CameraModel, folder: Path) -> Measurements:
    """Return the captures of a measurement file in which the key `base` refers to `camera`."""
    geometry = camera.name, camera.rows, camera.cols, camera.pixel_pitch, camera.bits, camera.channels, camera.cfa

    def frames(capture: CaptureRecipe) -> dict[str, Any]:
        files = WholeFrames(tuple(folder / name for name in capture.frames), camera)
        return {"name": capture.frames[0], "exposure": capture.seconds, "frames": files, "monitor": capture.monitor}

    return Measurements(
        body=Body(*geometry, camera.optics, polarisers=camera.polarisers),
        darks=tuple(Capture(**frames(each)) for each in recipe.dark),
        whites=tuple(Capture(**frames(each)) for each in recipe.white),
        base=camera,
        blinking_defects=recipe.blinking_defects,
        **_polarisers(recipe, frames),
    )


def _polarisers(recipe: AnyRecipe, frames: Callable[[CaptureRecipe], dict[str, Any]]) -> dict[str, Any]:
    """Return the arguments of Measurements that describe the captures behind a rotating polariser.

    `frames` is a function that returns the arguments of Capture for an entry in the measurement file.
    """
    stated = recipe.rotator or RotatorRecipe()
    return {
        "polariser": tuple(
            PolariserCapture(**frames(each), angle=each.angle_deg - stated.offset_deg) for each in recipe.polariser
        ),
        "rotator": Rotator(
            leakage=0.0 if stated.extinction is None else 1.0 / stated.extinction,
            angle_error=stated.angle_error_deg,
            reference=stated.reference,
        ),
    }


def _body(recipe: MeasurementRecipe, path: Path) -> Body:
    sensor = recipe.sensor
    return Body(
        name=recipe.name,
        rows=sensor.rows,
        cols=sensor.cols,
        pixel_pitch=sensor.pixel_pitch_um * 1e-6,
        bits=sensor.bits,
        channels=tuple(recipe.cfa.channels),
        cfa=parse_cfa(recipe.cfa, str(path)),
        optics=optics_of(recipe.optics),
        readout=settings_from(recipe.channel, recipe.cfa.channels, path),
        polarisers=polarisers_of(recipe.channel, recipe.cfa.channels, LEAKAGE_NM, path.parent),
        masked=masked_of(recipe.masked),
    )


def _levels(datasheet: DatasheetRecipe | None) -> Levels:
    if datasheet is None:
        return {}
    return {"black_level": datasheet.black_level_dn, "white_level": datasheet.white_level_dn}


def _figures(declared: DatasheetRecipe) -> SensorFigures:
    black_level, white_level, gain = declared.black_level_dn, declared.white_level_dn, declared.gain_dn_per_e
    gain = (white_level - black_level) / declared.well_capacity_e if gain is None else gain
    return SensorFigures(gain, black_level, white_level, noise_of(declared))


def _by_speed(recipes: Sequence[SensorCaptureRecipe], body: Body, folder: Path) -> dict[float | None, tuple[Capture, ...]]:
    """Group captures by ISO speed. Captures without an ISO speed have the key None."""
    found: dict[float | None, tuple[Capture, ...]] = {}
    for each in recipes:
        found[each.iso] = (*found.get(each.iso, ()), Capture(**_frames(each, body, folder)))
    return found


def _frames(capture: CaptureRecipe, body: Body, folder: Path) -> dict[str, Any]:
    """Return the arguments of Capture for an entry in the measurement file. Its frames are read later."""
    paths = tuple(folder / name for name in capture.frames)
    files = FrameFiles(paths, (body.rows, body.cols), body.bits, body, body.masked)
    return {"name": capture.frames[0], "exposure": capture.seconds, "frames": files, "monitor": capture.monitor}


def _chart(chart: ChartRecipe, patches: PatchRadiances, body: Body, folder: Path) -> dict[str, Any]:
    """Return the keyword arguments of ChartCapture or BandCapture for one chart in the measurement file."""
    corners = np.array(chart.corners, dtype=np.float64)
    return {**_frames(chart, body, folder), "illuminant": chart.illuminant, "corners": corners, **patches._asdict()}
