"""Read photos of colour charts, with their illuminants and reflectances (docs/method.md#charts-in-photographs)."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import MAX_BITS, MAX_CFA
from l3cli.artifacts.camera_recipe import F_NUMBER, FOCAL_MM, PITCH_UM, CfaRecipe, OpticsRecipe
from l3cli.errors import InputFileError, RecipeError, raised_as
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import Body, Chart, PhotoCapture
from l3cli.io.frames import phase_of, raw_content
from l3cli.io.measurement_recipe import BodyRecipe, MeasurementRecipe, PhotoRecipe, key_faults
from l3cli.io.raw import RawContent
from l3cli.io.raw.cfa_codes import FREE_CODE, LETTERS, neutral_of_channels
from l3cli.physics import charts, spectra
from l3cli.physics.mosaic import least_period
from l3cli.recipes.faults import refuse_first
from l3cli.spectra.file import names_file, read_table
from l3cli.spectra.table import without_noise

COVERED_NM = (400.0, 700.0)  # range in nm that a measured illuminant spectrum must cover
GRID = np.arange(380.0, 781.0, 5.0)  # wavelengths in nm at which built-in illuminants and charts are sampled
Array = NDArray[np.float64]
# Settings for reading raw files. "black_level" and "white_level" are in DN, and apply to files that do not contain them.
# If "opcodes" is "leave", l3 ignores unsupported DNG opcodes.
Levels = Mapping[str, Any]


class Illuminant(NamedTuple):
    """Spectrum of the light in a photo."""

    wavelength: Array  # (wavelength,) nm
    radiance: Array  # (wavelength,) relative photon radiance


def illuminant_of(photo: PhotoRecipe, path: Path) -> Illuminant:
    """Return the illuminant that the measurement file `path` specifies for a photo.

    If no illuminant is specified, the result is a constant spectrum as a placeholder, because the illuminant is estimated
    later. Raises RecipeError if the illuminant's name is unknown, and InputFileError if its spectrum file is unusable.
    """
    if photo.light is None:
        return Illuminant(GRID, np.ones_like(GRID))
    if not names_file(photo.light):
        with raised_as(RecipeError, path, RecipeError):
            return Illuminant(GRID, np.asarray(spectra.illuminant(photo.light, GRID), np.float64))
    file = path.parent / photo.light
    table = read_table(file).column(photo.column)
    unit = None if any(table.units) else photo.unit
    radiance = without_noise(table.photons(unit, absolute=False))[0]
    if radiance.min() < 0:
        raise InputFileError(
            f"{file}: the spectrum contains negative values too large to be noise; subtract the dark spectrum again"
        )
    if table.wavelength[0] > COVERED_NM[0] or table.wavelength[-1] < COVERED_NM[1]:
        raise InputFileError(
            f"{file} covers only {table.wavelength[0]:g}…{table.wavelength[-1]:g} nm; measure the spectrum from "
            f"{COVERED_NM[0]:g} to {COVERED_NM[1]:g} nm"
        )
    if radiance.max() <= 0:
        raise InputFileError(f"{file}: the spectrum contains no positive value; measure the spectrum again")
    return Illuminant(table.wavelength, radiance)


def chart_of(photo: PhotoRecipe, path: Path) -> Chart:
    """Return the chart that the measurement file `path` specifies for a photo.

    Raises RecipeError if the chart's name is unknown, or if its layout does not match the number of patches. Raises
    InputFileError if its reflectance file is unusable.
    """
    if names_file(photo.chart):
        table = read_table(path.parent / photo.chart)
        name, wavelength, reflectance = Path(photo.chart).stem, table.wavelength, table.shares()
    else:
        name, wavelength = photo.chart, GRID
        with raised_as(RecipeError, path, RecipeError):
            reflectance = np.asarray(charts.chart(photo.chart, GRID)[1], np.float64)
    with raised_as(RecipeError, path):
        return Chart(name, photo.layout, wavelength, reflectance)


def capture_of(
    photo: PhotoRecipe,
    illuminant: Illuminant,
    chart: Chart,
    body: Body,
    levels: Levels,
    path: Path,
    read: Callable[[Path, Levels], RawContent] = raw_content,
) -> PhotoCapture:
    """Read a photo's chart frames, dark frames and white frames.

    Parameters
    ----------
    photo : PhotoRecipe
        Entry of the photo in the measurement file.
    illuminant : Illuminant
        Spectrum of the light in the photo.
    chart : Chart
        The chart in the photo.
    body : Body
        The camera.
    levels : mapping
        Levels for raw files that do not contain them (see Levels). No black level is needed if the photo has dark frames.
    path : Path
        The measurement file. File names are relative to its folder.
    read : callable
        Function that takes a path and levels, and reads a raw file.

    Raises
    ------
    InputFileError
        If a file is not a raw file from this camera, if its black level is unknown, or if the files differ in size or
        phase.
    """
    known = {"black_level": 0.0, **levels} if photo.dark else levels  # placeholder; the dark frames determine the level
    frames, darks, whites = (
        tuple(_frame(path.parent / name, read(path.parent / name, known), body, known) for name in names)
        for names in (photo.frames, photo.dark, photo.white)
    )
    corners = None if photo.corners is None else np.array(photo.corners, dtype=np.float64)
    with raised_as(InputFileError, path):
        return PhotoCapture(Path(photo.frames[0]).name, frames, chart, photo.light, *illuminant, corners, darks, whites)


def _frame(path: Path, stated: RawContent, body: Body, levels: Levels) -> RawFrame:
    """Convert the content of a raw file to a frame. Levels in the file take precedence over `levels`.

    Raises InputFileError if the black level is unknown, or if the frame does not fit the sensor.
    """
    content: Mapping[str, Any] = {**levels, **stated}
    if "black_level" not in content:
        raise InputFileError(
            f'{path} does not contain the black level; add a "dark" frame or a [datasheet] to the measurement file'
        )
    pattern = content.get("pattern")
    phase = (0, 0) if pattern is None else phase_of(path, pattern, body)
    values, white = np.ascontiguousarray(content["values"], np.uint16), content.get("white_level", 2**body.bits - 1)
    try:
        neutral = neutral_of_channels(content.get("neutral"), pattern, phase, body)
        return RawFrame(str(path), values, float(content["black_level"]), float(white), phase, neutral=neutral)
    except ValueError as error:
        raise InputFileError(str(error)) from error


# -------------------------------------------------------------------------- a raw file without a measurement file


def recipe_of_photos(paths: Sequence[Path], first: RawContent, light: str | None, levels: Levels) -> MeasurementRecipe:
    """Create a measurement file's content for raw photos of a chart, with one [[photo]] entry per photo.

    All photos must have been taken with the same camera and under the same illuminant. The pixel pitch and the optics are
    placeholders, because the responsivities do not depend on them.

    Parameters
    ----------
    paths : sequence of Path
        The raw files.
    first : RawContent
        Content of the first raw file, which must include the colour filter array.
    light : str or None
        Name of the illuminant, or None to estimate it.
    levels : mapping
        Levels for raw files that do not contain them (see Levels).

    Raises
    ------
    InputFileError
        If the colour filter array or a level is unknown, or if the array is too large.
    RecipeError
        If the first file contains properties that no camera can have.
    """
    content = {**levels, **first}
    stated, white = content.get("pattern"), content.get("white_level")
    if stated is None or white is None or "black_level" not in content:
        raise InputFileError(
            f"{paths[0]} does not contain its colour filter array and levels; write a measurement file with [[photo]] "
            '(see "Measure your camera" in the documentation)'
        )
    cfa = array_of(stated)
    if max(len(cfa.pattern), len(cfa.pattern[0].split())) > MAX_CFA:
        raise InputFileError(
            f"{paths[0]} has a colour filter array larger than {MAX_CFA}×{MAX_CFA} sites; use files from another camera"
        )
    rows, cols = content["values"].shape
    recipe = MeasurementRecipe(
        name=paths[0].stem,
        sensor=BodyRecipe(rows, cols, PITCH_UM, bits_of(white)),
        cfa=cfa,
        optics=OpticsRecipe(FOCAL_MM, F_NUMBER),
        photo=[PhotoRecipe(frames=[str(path.absolute())], light=light) for path in paths],
    )
    refuse_first(key_faults(recipe), paths[0])
    return recipe


def bits_of(white_level: float) -> int:
    """Return the smallest bit depth that can represent a white level in DN, at most MAX_BITS."""
    return min(int(np.ceil(np.log2(white_level + 1))), MAX_BITS)


def array_of(codes: NDArray[np.integer]) -> CfaRecipe:
    """Convert a raw file's colour codes, (row, col), to a colour filter array with the smallest possible period.

    Channels with TIFF/EP codes are named by letters such as "r". Other channels are named "c" followed by the code.
    """
    pattern = least_period(codes)
    names = {int(code): LETTERS[code].lower() if code < FREE_CODE else f"c{code}" for code in np.unique(pattern)}
    return CfaRecipe(list(names.values()), [" ".join(names[int(code)] for code in row) for row in pattern])
