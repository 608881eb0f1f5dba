"""Photographs of charts: the raw files, lights and charts that a measurement file names, and the measurement file of a raw
file that says all that is needed itself (docs/method.md#charts-in-photographs)."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_BITS, MAX_CFA, CameraModel
from l3cli.artifacts.camera_recipe import F_NUMBER, FOCAL_MM, PITCH_UM, CfaRecipe, OpticsRecipe
from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.frame import RawFrame, shifted_cfa
from l3cli.frames.measurement import Body, Chart, PhotoCapture
from l3cli.io.frames import phase_of, raw_content
from l3cli.io.measurement_recipe import BodyRecipe, MeasurementRecipe, PhotoRecipe, is_table
from l3cli.io.raw.cfa_codes import FREE_CODE, LETTERS
from l3cli.physics import charts, spectra
from l3cli.spectra.file import read_table
from l3cli.system.files import write_whole

SEEN = (400.0, 700.0)  # nm: what a measured light must cover
GRID = np.arange(380.0, 781.0, 5.0)  # nm, of named lights and charts
MOST = 65535  # DN
Array = NDArray[np.float64]


class Levels(NamedTuple):
    """Black and white level in DN where the file states none; None: unknown."""

    black: float | None
    white: float | None


def load_photos(photos: Sequence[PhotoRecipe], body: Body, levels: Levels, path: Path) -> tuple[PhotoCapture, ...]:
    """Return the photos of a measurement file. RecipeError if it asks for what cannot be, InputFileError if a file is no raw
    file of this camera, no light or no chart."""
    captures = []
    for photo in photos:
        wavelength, radiance = _light(photo, path)
        if photo.dark:  # measures the black level
            levels = levels._replace(black=levels.black or 0.0)
        frames, darks, whites = (
            tuple(_frame(path.parent / name, body, levels) for name in names)
            for names in (photo.frames, photo.dark, photo.white)
        )
        _check_alike(frames, darks, whites)
        corners = None if photo.corners is None else np.array(photo.corners, dtype=np.float64)
        chart = _chart(photo, path)
        captures.append(
            PhotoCapture(
                Path(photo.frames[0]).name, frames, chart, photo.light, wavelength, radiance, corners, darks, whites
            )
        )
    return tuple(captures)


def _check_alike(frames: Sequence[RawFrame], darks: Sequence[RawFrame], whites: Sequence[RawFrame]) -> None:
    """Raise InputFileError unless all frames of a photo have one size and phase."""
    first = frames[0]
    for frame in (*frames, *darks, *whites):
        if frame.values.shape != first.values.shape or frame.phase != first.phase:
            raise InputFileError(f"{frame.name} has another size or phase than {first.name}; give frames of one camera")


def _frame(path: Path, body: Body, levels: Levels) -> RawFrame:
    """Return a raw file as it stands, at its own levels."""
    content = raw_content(path)
    black, white = content.get("black_level", levels.black), content.get("white_level", levels.white)
    if black is None:
        raise InputFileError(f"{path} states no black level; name a dark frame, as dark, or give a [datasheet]")
    pattern = content.get("pattern")
    phase = (0, 0) if pattern is None else phase_of(path, pattern, body)
    values = np.ascontiguousarray(content["values"], np.uint16)
    try:
        return RawFrame(str(path), values, float(black), float(2**body.bits - 1 if white is None else white), phase)
    except ValueError as error:
        raise InputFileError(str(error)) from error


def _light(photo: PhotoRecipe, path: Path) -> tuple[Array, Array]:
    """Return wavelength (nm) and relative photon radiance of the light; of one that is to be guessed an equal one."""
    if photo.light is None:
        return GRID, np.ones_like(GRID)
    if not is_table(photo.light):
        try:
            return GRID, np.asarray(spectra.illuminant(photo.light, GRID), np.float64)
        except RecipeError as error:
            raise RecipeError(f"{path}: {error}") from error
    file = path.parent / photo.light
    table = read_table(file).column(photo.column)
    unit = None if any(table.units) else photo.unit
    radiance = table.photons(unit, absolute=False)[0]
    if table.wavelength[0] > SEEN[0] or table.wavelength[-1] < SEEN[1]:
        raise InputFileError(
            f"{file}: its {table.wavelength[0]:g}…{table.wavelength[-1]:g} nm do not cover {SEEN[0]:g}…{SEEN[1]:g} nm; "
            "measure the light over what a camera sees"
        )
    if radiance.max() <= 0:
        raise InputFileError(f"{file}: the light is dark; measure it again")
    return table.wavelength, radiance


def _chart(photo: PhotoRecipe, path: Path) -> Chart:
    rows, cols = photo.layout
    if is_table(photo.chart):
        table = read_table(path.parent / photo.chart)
        shares = table.shares()
        wavelength, name = table.wavelength, Path(photo.chart).stem
    else:
        name, wavelength = photo.chart, GRID
        try:
            shares = np.asarray(charts.chart(photo.chart, GRID)[1], np.float64)
        except RecipeError as error:
            raise RecipeError(f"{path}: {error}") from error
    if len(shares) != rows * cols:
        raise RecipeError(f"{path}: {photo.chart} has {len(shares)} patches, layout = [{rows}, {cols}] {rows * cols}")
    return Chart(name, (rows, cols), wavelength, shares)


# -------------------------------------------------------------------------- a raw file without a measurement file


def recipe_of_photos(paths: Sequence[Path], light: str | None) -> MeasurementRecipe:
    """Return the measurement file of raw files that state their own array, levels and size: one camera, a photo each, under
    one light. Pixel pitch and optics, which no responsivity depends on, are declared. InputFileError if a file does not."""
    content = raw_content(paths[0])
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
    bits = min(int(np.ceil(np.log2(white + 1))), MAX_BITS)
    return MeasurementRecipe(
        name=paths[0].stem,
        sensor=BodyRecipe(rows, cols, PITCH_UM, bits),
        cfa=cfa,
        optics=OpticsRecipe(FOCAL_MM, F_NUMBER),
        photo=[PhotoRecipe(frames=[str(path.absolute())], light=light) for path in paths],
    )


def array_of(codes: NDArray[np.integer]) -> CfaRecipe:
    """Return the colour filter array of the codes (row, col) that a raw file states, its channels called by their
    letters."""
    pattern = _shortest(codes)
    names = {int(code): LETTERS[code].lower() if code < FREE_CODE else f"c{code}" for code in np.unique(pattern)}
    return CfaRecipe(list(names.values()), [" ".join(names[int(code)] for code in row) for row in pattern])


# ------------------------------------------------------------------------------------------- what glare adds to a photo


def offset_paths(folder: Path, photos: Sequence[PhotoCapture]) -> list[Path]:
    """Return the file of each photo that `export_offsets` writes."""
    numbers = [""] if len(photos) == 1 else [f"_{number + 1}" for number in range(len(photos))]
    return [folder / f"{Path(photo.name).stem}{each}_offsets.tif" for photo, each in zip(photos, numbers, strict=True)]


def export_offsets(camera: CameraModel, photos: Sequence[PhotoCapture], folder: Path) -> None:
    """Write what each photo of a chart shows without light from the scene, black level and glare of each channel, as a dark
    frame for rendering it: two equal pages, whose difference says that they have no noise."""
    import tifffile

    assert camera.fit is not None
    assert camera.fit.photo is not None
    for path, photo, glare in zip(offset_paths(folder, photos), photos, camera.fit.photo.glare, strict=True):
        frame = photo.frames[0]
        cfa = shifted_cfa(camera.cfa, frame.phase)
        repeats = [-(-length // period) for length, period in zip(frame.values.shape, cfa.shape, strict=True)]
        sites = np.tile(cfa, repeats)[: frame.values.shape[0], : frame.values.shape[1]]
        values = np.clip(np.rint(camera.black_level + glare), 0, MOST).astype(np.uint16)[sites]
        content = io.BytesIO()
        with tifffile.TiffWriter(content) as file:
            for _ in range(2):
                file.write(values, compression="zlib", photometric="minisblack", metadata=None, software=None)
        write_whole(path, content.getbuffer())


def _shortest(pattern: NDArray[np.integer]) -> NDArray[np.integer]:
    """Return the smallest array that repeats to a pattern."""
    rows, cols = pattern.shape
    row = next(n for n in range(1, rows + 1) if rows % n == 0 and (pattern == np.roll(pattern, n, axis=0)).all())
    col = next(n for n in range(1, cols + 1) if cols % n == 0 and (pattern == np.roll(pattern, n, axis=1)).all())
    return pattern[:row, :col]
