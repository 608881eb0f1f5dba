"""The measurement file and what lies around it: MEASUREMENTS.toml, 16-bit frames, CSV spectra (METHOD 1.4).

    MEASUREMENTS.toml   sensor, cfa, optics, and one table a capture: [[mono]] [[chart]] [[white]] [[dark]]
    frames              single-channel 16-bit pictures (TIFF, PNG, PGM) of the whole sensor, raw DN, CFA phase (0, 0)
    spectra             CSV: wavelength in nm, then radiances in photons/s/sr/m²/nm, one column a light or a patch

Names of files are relative to the folder of the measurement file.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.base import Stage
from l3cli.artifacts.camera import CameraModel, CfaRecipe, Optics, OpticsRecipe, parse_cfa, read_curves
from l3cli.config import Recipe, load_recipe, read_text
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.files import atomic_output, sha256
from l3cli.measurement import PATCHES, Body, Capture, ChartCapture, Measurements, MonoCapture

SITE_PIXELS = 8  # rows and columns of super-pixels from which a local mean can be taken
EPOCH = "1970:01:01 00:00:00"  # in every frame written: OpenImageIO would put the clock there


class BodyRecipe(Recipe):
    rows: int
    cols: int
    pixel_pitch_um: float
    bits: int


class CaptureRecipe(Recipe):
    """Lens-cap or white frames of one exposure."""

    frames: list[str]
    exposure_s: float


class MonoRecipe(CaptureRecipe):
    """An even field lit by one monochromator step."""

    spectrum: str  # CSV of measured radiances, bandwidth and stray light included
    column: int = 1  # which of its columns, counted from 1 after the wavelength


class ChartRecipe(CaptureRecipe):
    """A ColorChecker under one light."""

    illuminant: str
    corners: list[tuple[float, float]]  # col, row in pixels: outer corners of patches 1, 6, 24, 19 (clockwise)
    radiance: str  # CSV of measured radiances, 24 columns, row by row from dark skin to black


class UncertaintyRecipe(Recipe):
    """How well the lights were known, one standard deviation; it widens the confidence band."""

    lamp_drift: float = 0.0  # relative, between a light and its measured spectrum
    wavelength_nm: float = 0.0  # of the spectrometer's scale


class MeasurementRecipe(Recipe):
    """MEASUREMENTS.toml."""

    name: str
    sensor: BodyRecipe
    cfa: CfaRecipe
    optics: OpticsRecipe
    mono: list[MonoRecipe]
    chart: list[ChartRecipe]
    white: list[CaptureRecipe]
    dark: list[CaptureRecipe]
    uncertainty: UncertaintyRecipe = msgspec.field(default_factory=UncertaintyRecipe)


# ------------------------------------------------------------------------------------------------------- reading


@dataclass(frozen=True)
class FrameFiles:
    """Frames read one by one each time they are gone through."""

    paths: tuple[Path, ...]
    shape: tuple[int, int]
    bits: int

    def __iter__(self) -> Iterator[NDArray[np.uint16]]:
        for path in self.paths:
            yield read_frame(path, self.shape, self.bits)


def load_measurements(path: Path) -> Measurements:
    """The measurements that a measurement file names; frames are read later, one by one.

    RecipeError if the file asks for what cannot be, InputFileError if a spectrum or a frame is missing or broken.
    """
    recipe = load_recipe(path, MeasurementRecipe)
    body = _body(recipe, path)
    for kind in ("mono", "white", "dark"):
        if not getattr(recipe, kind):
            raise RecipeError(f"{path}: there is no [[{kind}]] capture; add some")
    if len(recipe.chart) < 2:
        raise RecipeError(f"{path}: one [[chart]] cannot tell gain from light; give charts under two illuminants or more")
    curves = {name: read_curves(path.parent / name) for name in {mono.spectrum for mono in recipe.mono}}
    for name in frame_names(recipe):
        if not (path.parent / name).is_file():
            raise InputFileError(f"{path.parent / name} does not exist; {path.name} names it as a frame")

    def common(capture: CaptureRecipe, table: str) -> dict[str, Any]:
        if not capture.frames or not capture.exposure_s > 0:
            raise RecipeError(f"{path}: a [[{table}]] capture needs frames and a positive exposure_s")
        files = FrameFiles(tuple(path.parent / name for name in capture.frames), (body.rows, body.cols), body.bits)
        return {"name": str(files.paths[0]), "exposure": capture.exposure_s, "frames": files}

    mono = []
    for step in recipe.mono:
        wavelength, columns = curves[step.spectrum]
        if not 1 <= step.column <= len(columns):
            raise RecipeError(f"{path}: column {step.column} of {step.spectrum} is none of its 1…{len(columns)}")
        if columns[step.column - 1].max() <= 0:
            raise InputFileError(f"{path.parent / step.spectrum}: column {step.column} is dark; measure the light again")
        mono.append(MonoCapture(**common(step, "mono"), wavelength=wavelength, radiance=columns[step.column - 1]))
    charts = []
    for chart in recipe.chart:
        if len(chart.corners) != 4:
            raise RecipeError(f"{path}: a [[chart]] has {len(chart.corners)} corners; give col, row of patches 1, 6, 24, 19")
        wavelength, radiance = read_curves(path.parent / chart.radiance, PATCHES)
        charts.append(
            ChartCapture(
                **common(chart, "chart"),
                illuminant=chart.illuminant,
                corners=np.array(chart.corners),
                wavelength=wavelength,
                radiance=radiance,
            )
        )
    return Measurements(
        body=body,
        mono=tuple(mono),
        charts=tuple(charts),
        darks=tuple(Capture(**common(capture, "dark")) for capture in recipe.dark),
        whites=tuple(Capture(**common(capture, "white")) for capture in recipe.white),
        lamp_drift=recipe.uncertainty.lamp_drift,
        wavelength_uncertainty=recipe.uncertainty.wavelength_nm,
    )


def _body(recipe: MeasurementRecipe, path: Path) -> Body:
    sensor, optics = recipe.sensor, recipe.optics
    if not (sensor.rows > 0 and sensor.cols > 0 and sensor.pixel_pitch_um > 0 and 1 <= sensor.bits <= 16):
        raise RecipeError(f"{path}: sensor needs rows, cols and pixel_pitch_um above 0 and 1 to 16 bits")
    if not (optics.focal_length_mm > 0 and optics.f_number > 0):
        raise RecipeError(f"{path}: optics needs focal_length_mm and f_number above 0")
    if 0 < optics.object_distance_m <= optics.focal_length_mm * 1e-3:
        raise RecipeError(f"{path}: optics.object_distance_m is nearer than the focal length; give 0 for infinity")
    cfa = parse_cfa(recipe.cfa, str(path))
    if sensor.rows < SITE_PIXELS * cfa.shape[0] or sensor.cols < SITE_PIXELS * cfa.shape[1]:
        raise RecipeError(f"{path}: {sensor.rows}×{sensor.cols} pixels are too few to measure noise; check sensor")
    return Body(
        name=recipe.name,
        rows=sensor.rows,
        cols=sensor.cols,
        pixel_pitch=sensor.pixel_pitch_um * 1e-6,
        bits=sensor.bits,
        channels=tuple(recipe.cfa.channels),
        cfa=cfa,
        optics=Optics(optics.focal_length_mm * 1e-3, optics.f_number, optics.object_distance_m),
    )


def frame_names(recipe: MeasurementRecipe) -> list[str]:
    """Every frame a measurement file names, in order."""
    captures: list[CaptureRecipe] = [*recipe.mono, *recipe.chart, *recipe.white, *recipe.dark]
    return [name for capture in captures for name in capture.frames]


def spectrum_names(recipe: MeasurementRecipe) -> list[str]:
    """Every file of spectra a measurement file names, each once, in order."""
    return list(dict.fromkeys([mono.spectrum for mono in recipe.mono] + [chart.radiance for chart in recipe.chart]))


def history(path: Path) -> Stage:
    """What calibration leaves in the history: the measurement file and the SHA-256 of all that it names."""
    recipe = load_recipe(path, MeasurementRecipe)
    inputs = {
        "measurements": [sha256(path)],
        "frames": [sha256(path.parent / name) for name in frame_names(recipe)],
        "spectra": [sha256(path.parent / name) for name in spectrum_names(recipe)],
    }
    return Stage("calibrate", {}, read_text(path), inputs)


def read_frame(path: Path, shape: tuple[int, int], bits: int) -> NDArray[np.uint16]:
    """A single-channel 16-bit picture (row, col) in DN; InputFileError if it is none, not of `shape`, or beyond `bits`."""
    import OpenImageIO

    picture = OpenImageIO.ImageInput.open(str(path))
    if picture is None:
        reason = " ".join(str(OpenImageIO.geterror()).split()).removeprefix(f"{path}: ")
        raise InputFileError(f"{path} cannot be read: {reason or 'unknown format'}; give 16-bit TIFF frames")
    try:
        spec = picture.spec()
        if str(spec.format) != "uint16" or spec.nchannels != 1:
            raise InputFileError(
                f"{path} holds {spec.nchannels} channels of {spec.format}; give raw frames of one channel and 16 bits"
            )
        if (spec.height, spec.width) != shape:
            raise InputFileError(
                f"{path} has {spec.height}×{spec.width} pixels, the sensor {shape[0]}×{shape[1]}; give whole raw frames"
            )
        values = picture.read_image("uint16")
        if values is None:
            raise InputFileError(f"{path} is truncated or damaged; copy or take it again")
    finally:
        picture.close()
    frame = values.reshape(shape)
    if frame.max() >= 2**bits:
        raise InputFileError(f"{path} holds {frame.max()} DN, more than {bits} bits; check sensor.bits")
    return frame


# ------------------------------------------------------------------------------------------------------- writing


def write_frame(path: Path, values: NDArray[np.uint16]) -> None:
    """Write (row, col) DN as an uncompressed single-channel 16-bit TIFF; the same values give the same bytes."""
    import OpenImageIO

    rows, cols = values.shape
    spec = OpenImageIO.ImageSpec(cols, rows, 1, "uint16")
    spec.attribute("compression", "none")
    spec.attribute("DateTime", EPOCH)
    with atomic_output(path) as temporary:
        picture = OpenImageIO.ImageOutput.create(str(temporary))
        # OpenImageIO 3.2 crashes on arrays without a channel axis.
        written = (
            picture and picture.open(str(temporary), spec) and picture.write_image(np.ascontiguousarray(values)[..., None])
        )
        if not (picture and written and picture.close()):
            reason = " ".join(str(picture.geterror() if picture else OpenImageIO.geterror()).split())
            raise L3Error(f"{path} cannot be written: {reason}; name a .tif file in a folder that can be written to")


def write_curves(path: Path, wavelength: NDArray, columns: NDArray, names: Sequence[str]) -> None:
    """Write columns (column, wavelength) as CSV below a header line."""
    lines = [",".join(["wavelength_nm", *names])]
    lines += [",".join(f"{value:.8g}" for value in row) for row in np.vstack([wavelength, columns]).T]
    with atomic_output(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def describe(camera: CameraModel, uncertainty: UncertaintyRecipe, **captures: Any) -> MeasurementRecipe:
    """The measurement file of captures of a known camera; `captures` are the lists mono, chart, white and dark."""
    optics = camera.optics
    return MeasurementRecipe(
        name=camera.name,
        sensor=BodyRecipe(camera.rows, camera.cols, round(camera.pixel_pitch * 1e6, 9), camera.bits),
        cfa=CfaRecipe(list(camera.channels), [" ".join(camera.channels[site] for site in row) for row in camera.cfa]),
        optics=OpticsRecipe(round(optics.focal_length * 1e3, 9), optics.f_number, optics.object_distance),
        uncertainty=uncertainty,
        **captures,
    )


def write_measurements(recipe: MeasurementRecipe, path: Path) -> None:
    """Write a measurement file."""
    with atomic_output(path) as temporary:
        temporary.write_text(_toml(msgspec.to_builtins(recipe)), encoding="utf-8")


def _toml(table: dict[str, Any], prefix: str = "") -> str:
    """A table of numbers, texts, lists, tables and lists of tables as TOML; JSON writes the plain values alike."""

    def is_table(value: Any) -> bool:
        return isinstance(value, dict) or (isinstance(value, list) and bool(value) and isinstance(value[0], dict))

    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items() if not is_table(value)]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += ["", f"[{prefix}{key}]", _toml(value, f"{prefix}{key}.").rstrip()]
        elif is_table(value):
            for item in value:
                lines += ["", f"[[{prefix}{key}]]", _toml(item, f"{prefix}{key}.").rstrip()]
    return "\n".join(lines) + "\n"
