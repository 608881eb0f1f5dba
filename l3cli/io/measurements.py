"""Load the measurements that a measurement file names: captures with frames, spectra and figures
(docs/method.md#calibration).

Also photographs of charts, and measurements from raw files that state everything that is needed
(docs/method.md#charts-in-photographs).
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_BITS, MAX_CFA, Optics
from l3cli.artifacts.camera_recipe import (
    F_NUMBER,
    FOCAL_MM,
    PITCH_UM,
    CfaRecipe,
    OpticsRecipe,
    camera_files,
    load_camera,
    noise_of,
    parse_cfa,
    settings_from,
)
from l3cli.artifacts.schema import Stage
from l3cli.errors import InputFileError, RecipeError, raised_as
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import (
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
    PhotoCapture,
    SensorFigures,
    SweepTable,
)
from l3cli.io.curves import prior_files, read_cameras, read_finished, read_sweep, shipped_statistics
from l3cli.io.frames import FrameFiles, WholeFrames, phase_of, raw_content
from l3cli.io.measurement_recipe import (
    MOST_MONITOR,
    MOST_UNREFERENCED,
    BodyRecipe,
    CaptureRecipe,
    ChartRecipe,
    CorrectionRecipe,
    DatasheetRecipe,
    MeasurementRecipe,
    MonitorRecipe,
    MonoRecipe,
    PhotoRecipe,
    SensorCaptureRecipe,
    frame_names,
    key_faults,
    spectrum_names,
)
from l3cli.io.raw.cfa_codes import FREE_CODE, LETTERS, neutral_of_channels
from l3cli.physics import charts, spectra
from l3cli.physics.mosaic import least_period
from l3cli.recipes.faults import refuse_first
from l3cli.recipes.toml import parse_recipe, parse_toml, read_text
from l3cli.spectra import units
from l3cli.spectra.file import names_file, read_table
from l3cli.spectra.table import RELATIVE, CurveTable, without_noise
from l3cli.system.files import sha256, stamp

SEEN = (400.0, 700.0)  # nm, range that a measured light must cover
GRID = np.arange(380.0, 781.0, 5.0)  # nm, grid of named lights and charts
Array = NDArray[np.float64]


# Facts about raw files that do not state them: "black_level" and "white_level" in DN. "opcodes": "leave" ignores the opcodes
# of a DNG that l3 does not support.
Levels = Mapping[str, Any]


def load_photos(photos: Sequence[PhotoRecipe], body: Body, levels: Levels, path: Path) -> tuple[PhotoCapture, ...]:
    """Load the photos of a measurement file.

    Raises RecipeError for invalid requests, and InputFileError if a file is not a raw file of this camera, a light or a
    chart.
    """
    captures = []
    for photo in photos:
        wavelength, radiance = _light(photo, path)
        known = {"black_level": 0.0, **levels} if photo.dark else levels  # dark frames will give the black level
        frames, darks, whites = (
            tuple(_frame(path.parent / name, body, known) for name in names)
            for names in (photo.frames, photo.dark, photo.white)
        )
        _check_alike(frames, darks, whites)
        corners = None if photo.corners is None else np.array(photo.corners, dtype=np.float64)
        chart = _chart_of_photo(photo, path)
        captures.append(
            PhotoCapture(
                Path(photo.frames[0]).name, frames, chart, photo.light, wavelength, radiance, corners, darks, whites
            )
        )
    return tuple(captures)


def _check_alike(frames: Sequence[RawFrame], darks: Sequence[RawFrame], whites: Sequence[RawFrame]) -> None:
    """Raise InputFileError unless all frames of a photo have the same size and phase."""
    first = frames[0]
    for frame in (*frames, *darks, *whites):
        if frame.values.shape != first.values.shape or frame.phase != first.phase:
            raise InputFileError(f"{frame.name} has another size or phase than {first.name}; give frames of one camera")


def _frame(path: Path, body: Body, levels: Levels) -> RawFrame:
    """Read a raw file as it is, with its own levels."""
    content: Mapping[str, Any] = {**levels, **raw_content(path, levels)}
    if "black_level" not in content:
        raise InputFileError(f"{path} states no black level; name a dark frame, as dark, or give a [datasheet]")
    pattern = content.get("pattern")
    phase = (0, 0) if pattern is None else phase_of(path, pattern, body)
    values, white = np.ascontiguousarray(content["values"], np.uint16), content.get("white_level", 2**body.bits - 1)
    try:
        neutral = neutral_of_channels(content.get("neutral"), pattern, phase, body)
        return RawFrame(str(path), values, float(content["black_level"]), float(white), phase, neutral=neutral)
    except ValueError as error:
        raise InputFileError(str(error)) from error


def _light(photo: PhotoRecipe, path: Path) -> tuple[Array, Array]:
    """Return wavelength (nm) and relative photon radiance of the light. A light that is to be guessed is equal-energy for
    now.
    """
    if photo.light is None:
        return GRID, np.ones_like(GRID)
    if not names_file(photo.light):
        with raised_as(RecipeError, path, RecipeError):
            return GRID, np.asarray(spectra.illuminant(photo.light, GRID), np.float64)
    file = path.parent / photo.light
    table = read_table(file).column(photo.column)
    unit = None if any(table.units) else photo.unit
    radiance = without_noise(table.photons(unit, absolute=False))[0]
    if radiance.min() < 0:
        raise InputFileError(f"{file}: the light is negative by more than noise; subtract the dark spectrum again")
    if table.wavelength[0] > SEEN[0] or table.wavelength[-1] < SEEN[1]:
        raise InputFileError(
            f"{file}: its {table.wavelength[0]:g}…{table.wavelength[-1]:g} nm do not cover {SEEN[0]:g}…{SEEN[1]:g} nm; "
            "measure the light over what a camera sees"
        )
    if radiance.max() <= 0:
        raise InputFileError(f"{file}: the light is dark; measure it again")
    return table.wavelength, radiance


def _chart_of_photo(photo: PhotoRecipe, path: Path) -> Chart:
    rows, cols = photo.layout
    if names_file(photo.chart):
        table = read_table(path.parent / photo.chart)
        shares = table.shares()
        wavelength, name = table.wavelength, Path(photo.chart).stem
    else:
        name, wavelength = photo.chart, GRID
        with raised_as(RecipeError, path, RecipeError):
            shares = np.asarray(charts.chart(photo.chart, GRID)[1], np.float64)
    if len(shares) != rows * cols:
        raise RecipeError(f"{path}: {photo.chart} has {len(shares)} patches, layout = [{rows}, {cols}] {rows * cols}")
    return Chart(name, (rows, cols), wavelength, shares)


# -------------------------------------------------------------------------- a raw file without a measurement file


def recipe_of_photos(paths: Sequence[Path], light: str | None, levels: Levels | None = None) -> MeasurementRecipe:
    """Return a measurement file for raw files that state their array, levels and size.

    All files are from one camera under one light, and each is a photo. Pixel pitch and optics are placeholders, because
    responsivities do not depend on them. Raises InputFileError if a file does not state enough.
    """
    levels = levels or {}
    content = {**levels, **raw_content(paths[0], levels)}
    stated, white = content.get("pattern"), content.get("white_level")
    if stated is None or white is None or "black_level" not in content:
        raise InputFileError(
            f"{paths[0]} does not state its colour filter array and levels; write a measurement file with [[photo]] "
            '(documentation, "A camera from one photo of a chart")'
        )
    cfa = array_of(stated)
    if max(len(cfa.pattern), len(cfa.pattern[0].split())) > MAX_CFA:
        raise InputFileError(f"{paths[0]}: its colour filter array is larger than {MAX_CFA}×{MAX_CFA}")
    rows, cols = content["values"].shape
    return MeasurementRecipe(
        name=paths[0].stem,
        sensor=BodyRecipe(rows, cols, PITCH_UM, bits_of(white)),
        cfa=cfa,
        optics=OpticsRecipe(FOCAL_MM, F_NUMBER),
        photo=[PhotoRecipe(frames=[str(path.absolute())], light=light) for path in paths],
    )


def bits_of(white_level: float) -> int:
    """Return the bits of a sensor with a given white level (DN)."""
    return min(int(np.ceil(np.log2(white_level + 1))), MAX_BITS)


def array_of(codes: NDArray[np.integer]) -> CfaRecipe:
    """Return the colour filter array from the codes (row, col) in a raw file. Channels are named by letters."""
    pattern = least_period(codes)
    names = {int(code): LETTERS[code].lower() if code < FREE_CODE else f"c{code}" for code in np.unique(pattern)}
    return CfaRecipe(list(names.values()), [" ".join(names[int(code)] for code in row) for row in pattern])


def load_measurements(path: Path) -> Measurements:
    """Load the measurements that a measurement file names. Frames are read later, one by one.

    Parameters
    ----------
    path : Path
        The measurement file.

    Raises
    ------
    RecipeError
        If the file is invalid.
    InputFileError
        If a spectrum or a frame is missing or damaged.
    """
    recipe = _load(path)
    return _corrections(recipe, path) if isinstance(recipe, CorrectionRecipe) else measurements_of(recipe, path)


def _load(path: Path) -> MeasurementRecipe | CorrectionRecipe:
    text = read_text(path, MeasurementRecipe.title)
    if "base" in parse_toml(text, str(path)):
        return parse_recipe(text, CorrectionRecipe, str(path))
    return parse_recipe(text, MeasurementRecipe, str(path))


def _corrections(recipe: CorrectionRecipe, path: Path) -> Measurements:
    """Return the dark and white frames of a known camera."""
    refuse_first(key_faults(recipe), path)
    camera = load_camera(path.parent / recipe.base)
    body = Body(
        camera.name, camera.rows, camera.cols, camera.pixel_pitch, camera.bits, camera.channels, camera.cfa, camera.optics
    )

    def captures(listed: list[CaptureRecipe]) -> tuple[Capture, ...]:
        files = [WholeFrames(tuple(path.parent / name for name in each.frames), camera) for each in listed]
        return tuple(Capture(each.frames[0], each.seconds or 0.0, of) for each, of in zip(listed, files, strict=True))

    return Measurements(body=body, darks=captures(recipe.dark), whites=captures(recipe.white), base=camera)


def measurements_of(recipe: MeasurementRecipe, path: Path, levels: Levels | None = None) -> Measurements:
    """Load the measurements of a recipe.

    Parameters
    ----------
    recipe : MeasurementRecipe
        Contents of the measurement file.
    path : Path
        Its path. The file need not exist, but file names are relative to its folder.
    levels : mapping, optional
        Levels of photos that state none. [default: from [datasheet]]

    Raises
    ------
    RecipeError, InputFileError
        As in `load_measurements`.
    """
    refuse_first(key_faults(recipe), path)
    body = _body(recipe, path)
    for name in frame_names(recipe):
        if not (path.parent / name).is_file():
            raise InputFileError(f"{path.parent / name} does not exist; {path.name} names it as a frame")
    stated = sorted({each.iso for each in recipe.dark if each.iso})
    darks, whites = (_by_speed(each, body, path) for each in (recipe.dark, recipe.white))
    lowest = stated[0] if stated else None
    return Measurements(
        body=body,
        mono=_mono(recipe, body, path),
        charts=tuple(ChartCapture(**_chart(chart, "chart", body, path)) for chart in recipe.chart),
        darks=darks.get(lowest, ()),
        whites=whites.get(lowest, ()),
        iso=lowest,
        gains=tuple(GainCaptures(iso, darks[iso], whites.get(iso, ())) for iso in stated[1:]),
        bands=tuple(BandCapture(**_chart(band, "band", body, path)) for band in recipe.band),
        curve=curve_of(recipe, path),
        photos=load_photos(recipe.photos, body, _levels(recipe) if levels is None else levels, path),
        cameras=_cameras(recipe, path),
        datasheet=None if recipe.datasheet is None else _figures(recipe.datasheet),
        lamp_drift=math.hypot(recipe.uncertainty.lamp_drift, recipe.uncertainty.photodiode),
        wavelength_uncertainty=recipe.uncertainty.wavelength_nm,
    )


def _by_speed(recipes: Sequence[SensorCaptureRecipe], body: Body, path: Path) -> dict[float | None, tuple[Capture, ...]]:
    """Return the captures by ISO speed; None if not stated."""
    found: dict[float | None, tuple[Capture, ...]] = {}
    for each in recipes:
        found[each.iso] = (*found.get(each.iso, ()), Capture(**_common(each, body, path)))
    return found


def _common(capture: CaptureRecipe, body: Body, path: Path) -> dict[str, Any]:
    """Return the keyword arguments that are common to all captures."""
    files = FrameFiles(tuple(path.parent / name for name in capture.frames), (body.rows, body.cols), body.bits, body)
    # A table of readings is read together with the spectrum.
    monitor = 1.0 if isinstance(capture.monitor, MonitorRecipe) else capture.monitor
    return {"name": capture.frames[0], "exposure": capture.seconds, "frames": files, "monitor": monitor}


def _mono(recipe: MeasurementRecipe, body: Body, path: Path) -> tuple[MonoCapture, ...]:
    tables = {name: read_table(path.parent / name) for name in {step.spectrum for step in recipe.mono}}
    mono = []
    for step in recipe.mono:
        light, radiance = step_radiance(tables[step.spectrum], step, path)
        common = _common(step, body, path)
        if isinstance(step.monitor, MonitorRecipe):
            common["monitor"] = monitor_at(step.monitor, float(light.wavelength[radiance.argmax()]), path)
        absolute = not {step.unit, *light.units} & set(RELATIVE)
        mono.append(MonoCapture(**common, wavelength=light.wavelength, radiance=radiance, absolute=absolute))
    return tuple(mono)


def monitor_at(monitor: MonitorRecipe, nm: float, path: Path) -> float:
    """Read what the lamp gave during a capture over what it gave when its spectrum was measured.

    Parameters
    ----------
    monitor : MonitorRecipe
        The table of readings.
    nm : float
        Wavelength in nm at which the spectrum of the capture peaks.
    path : Path
        The measurement file, which the table is named relative to.

    Returns
    -------
    float
        Ratio of the readings, interpolated at the wavelength.

    Raises
    ------
    InputFileError
        If the table does not reach the wavelength, the ratio is that of another lamp, or a column without reference holds
        readings instead of ratios.
    """
    table = read_table(path.parent / monitor.file)
    first, last = table.wavelength[0], table.wavelength[-1]
    if not first - 1 <= nm <= last + 1:
        raise InputFileError(f"{table.path} holds {first:g}…{last:g} nm, and a capture is at {nm:g} nm; add its reading")
    reading, unit = _reading(table, monitor.column, nm)
    if monitor.reference is None:
        if unit or not 1 / MOST_UNREFERENCED <= reading <= MOST_UNREFERENCED:
            raise InputFileError(
                f"{table.path}: {reading:.4g} at {nm:g} nm{' has a unit and' if unit else ''} is no ratio near 1 of "
                "readings during the capture and before; as reference name the column of those before"
            )
        return reading
    before, other = _reading(table, monitor.reference, nm)
    if unit != other:
        raise InputFileError(
            f"{table.path}: the columns of monitor have different units; name two columns of one detector's readings"
        )
    ratio = reading / before if before > 0 else math.inf
    if not 1 / MOST_MONITOR <= ratio <= MOST_MONITOR:
        raise InputFileError(
            f"{table.path}: at {nm:g} nm the reading is {reading:.4g} and its reference {before:.4g}, which is not within "
            f"{1 / MOST_MONITOR:g}…{MOST_MONITOR:g} of it; name the column of the readings when the spectra were measured"
        )
    return ratio


def _reading(table: CurveTable, column: int | str, nm: float) -> tuple[float, dict[str, int]]:
    """Return a column's value at a wavelength, in SI units where the heading states its unit, and these units' powers."""
    found = table.column(column)
    unit = None if found.units[0] is None else units.parse(found.units[0])
    value = float(np.interp(nm, found.wavelength, found.values[0]))
    return (value, {}) if unit is None else (value * unit.scale, unit.powers)


def step_radiance(table: CurveTable, step: MonoRecipe, path: Path) -> tuple[CurveTable, NDArray[np.float64]]:
    """Return the column of a table that a monochromatic step names, and its radiance (wavelength).

    `path` is the recipe, for messages. Raises RecipeError if the column number does not exist, and InputFileError if the
    name does not exist or if the light is dark.
    """
    if isinstance(step.column, int) and not 1 <= step.column <= len(table.values):
        raise RecipeError(f"{path}: column {step.column} of {step.spectrum} is none of its 1…{len(table.values)}")
    light = table.column(step.column)
    radiance = light.photons(step.unit)
    if radiance.max() <= 0:
        raise InputFileError(f"{table.path}: column {step.column} is dark; measure the light again")
    return light, radiance[0]


def _chart(chart: ChartRecipe, table: str, body: Body, path: Path) -> dict[str, Any]:
    """Return a chart capture as keyword arguments."""
    measured, radiance = chart_radiance(path.parent / chart.radiance, chart, table)
    return {
        **_common(chart, body, path),
        "illuminant": chart.illuminant,
        "corners": np.array(chart.corners, dtype=np.float64),
        "wavelength": measured.wavelength,
        "radiance": radiance,
    }


def chart_radiance(file: Path, chart: ChartRecipe, table: str) -> tuple[CurveTable, NDArray[np.float64]]:
    """Return the patches of a [[chart]] or [[band]] in order, and their radiances (patch, wavelength).

    Raises InputFileError if the table does not contain radiances of the patches.
    """
    measured = read_table(file).ordered(PATCH_NAMES, patch_name)
    if table == "chart" and {chart.unit, *measured.units} & set(RELATIVE):
        raise InputFileError(f"{file}: radiances of a [[chart]] give the scale and cannot be relative; measure them")
    radiance = measured.photons(chart.unit, absolute=table == "chart")
    if radiance.max(axis=1).min() <= 0:
        raise InputFileError(f"{file}: a patch without light; measure the chart again")
    return measured, radiance


def patch_name(heading: str) -> str:
    """Return the patch that a heading means: "patch 13", "13", "blue", "white 9.5 (.05 D)". Other headings are unchanged."""
    number = re.fullmatch(r"(?:patch|p|no|#)?[ ._-]*0*(\d{1,2})", heading.strip(), re.IGNORECASE)
    if number and 1 <= int(number[1]) <= PATCHES:
        return PATCH_NAMES[int(number[1]) - 1]
    return re.sub(r"\s*\(.*\)$", "", heading).strip().lower()


def curve_of(recipe: MeasurementRecipe, path: Path) -> SweepTable | FinishedCurves | None:
    """Return the [sweep] or the [curves] of a measurement file. Raises InputFileError if the files do not contain them."""
    if recipe.sweep is not None:
        sweep = recipe.sweep
        response = sweep.response
        paths = path.parent / sweep.table, path.parent / response.file
        return read_sweep(*paths, recipe.cfa.channels, response.column)
    if recipe.curves is not None:
        curves = recipe.curves
        return read_finished(path.parent / curves.file, recipe.cfa.channels, curves.per_energy, curves.columns)
    return None


def _levels(recipe: MeasurementRecipe) -> Levels:
    declared = recipe.datasheet
    return {} if declared is None else {"black_level": declared.black_level_dn, "white_level": declared.white_level_dn}


def _cameras(recipe: MeasurementRecipe, path: Path) -> CurveStatistics | tuple[FinishedCurves, ...] | None:
    """Return the prior knowledge about curves for photos."""
    if not recipe.photos:
        return None
    return shipped_statistics() if recipe.prior is None else read_cameras(prior_files(path.parent / recipe.prior))


def _figures(declared: DatasheetRecipe) -> SensorFigures:
    black_level, white_level, gain = declared.black_level_dn, declared.white_level_dn, declared.gain_dn_per_e
    gain = (white_level - black_level) / declared.well_capacity_e if gain is None else gain
    return SensorFigures(gain, black_level, white_level, noise_of(declared))


def _body(recipe: MeasurementRecipe, path: Path) -> Body:
    sensor, optics = recipe.sensor, recipe.optics
    return Body(
        name=recipe.name,
        rows=sensor.rows,
        cols=sensor.cols,
        pixel_pitch=sensor.pixel_pitch_um * 1e-6,
        bits=sensor.bits,
        channels=tuple(recipe.cfa.channels),
        cfa=parse_cfa(recipe.cfa, str(path)),
        optics=Optics(optics.focal_length_mm * 1e-3, optics.f_number, optics.object_distance_m),
        readout=settings_from(recipe.channel, recipe.cfa.channels, path),
    )


@dataclass(frozen=True)
class Inputs:
    """The files of a calibration, with their state before any of them was read."""

    recipe: str  # text of the measurement file
    files: dict[str, list[Path]]  # role → its files
    stamps: dict[Path, tuple[int, ...]]  # size, times and inode of each file

    def history(self, options: dict[str, Any]) -> Stage:
        """Return the history stage of a calibration: options, measurement file and the SHA-256 of all its files.

        Raises InputFileError if a file has changed since, so that the digests always describe what was read.
        """
        digests = {role: [sha256(file) for file in files] for role, files in self.files.items()}
        for file, before in self.stamps.items():
            if stamp(file) != before:
                raise InputFileError(f"{file} has changed while it was read; run again when nothing writes to it")
        return Stage("calibrate", options, self.recipe, digests)


def inputs_of(path: Path) -> Inputs:
    """Return the measurement file and all files that it names. Call this before reading them."""
    first, recipe = stamp(path), _load(path)
    if isinstance(recipe, CorrectionRecipe):
        refuse_first(key_faults(recipe), path)
        frames = [name for capture in [*recipe.dark, *recipe.white] for name in capture.frames]
        others = {"camera": camera_files(path.parent / recipe.base)}
    else:
        frames, priors = frame_names(recipe), [] if recipe.prior is None else prior_files(path.parent / recipe.prior)
        others = {"spectra": [path.parent / name for name in spectrum_names(recipe)] + priors}
    files = {"measurements": [path], "frames": [path.parent / name for name in frames]} | others
    stamps = {file: stamp(file) for named in files.values() for file in named} | {path: first}
    return Inputs(read_text(path), files, stamps)


def inputs_of_photos(photos: Sequence[Path]) -> Inputs:
    """Return the raw files of a calibration without a measurement file. Call this before reading them."""
    return Inputs("", {"frames": list(photos)}, {file: stamp(file) for file in photos})


def photo_measurements(photos: Sequence[Path], light: str | None, levels: Levels | None = None) -> Measurements:
    """Return the measurements of raw files of a chart under one light, without a measurement file.

    Parameters
    ----------
    photos : sequence of Path
        The raw files.
    light : str or None
        Name of the light, or None to estimate it.
    levels : mapping, optional
        Levels that the files do not state.

    Raises
    ------
    InputFileError
        If neither the files nor `levels` state everything that is needed.
    """
    return measurements_of(recipe_of_photos(photos, light, levels), photos[0], levels or {})
