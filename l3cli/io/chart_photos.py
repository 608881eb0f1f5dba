"""Read photos of charts, each with its illuminant and its chart (docs/method.md#charts-in-photographs)."""

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

COVERED_NM = (400.0, 700.0)  # range in nm that the spectrum of a measured illuminant must cover
GRID = np.arange(380.0, 781.0, 5.0)  # wavelengths in nm of named illuminants and charts
Array = NDArray[np.float64]
# Settings for raw files. "black_level" and "white_level" are levels in DN, for files that do not state their levels.
# "opcodes" has the value "leave" if l3 must ignore unsupported opcodes of DNG files.
Levels = Mapping[str, Any]


class Illuminant(NamedTuple):
    """The illuminant of a photo."""

    wavelength: Array  # (wavelength,) nm
    radiance: Array  # (wavelength,) relative photon radiance


def illuminant_of(photo: PhotoRecipe, path: Path) -> Illuminant:
    """Return the illuminant of a photo in the measurement file `path`.

    If the measurement file specifies no illuminant, the result is a placeholder with a constant spectrum, because the
    illuminant is estimated later. Raises RecipeError if the name of the illuminant is unknown, and InputFileError if the
    file with the spectrum is unusable.
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
            f"{file}: the spectrum contains negative values that are larger than noise; subtract the dark spectrum again"
        )
    if table.wavelength[0] > COVERED_NM[0] or table.wavelength[-1] < COVERED_NM[1]:
        raise InputFileError(
            f"{file} covers only {table.wavelength[0]:g}…{table.wavelength[-1]:g} nm; measure the spectrum from "
            f"{COVERED_NM[0]:g} to {COVERED_NM[1]:g} nm"
        )
    if radiance.max() <= 0:
        raise InputFileError(f"{file}: the spectrum has no positive value; measure the spectrum again")
    return Illuminant(table.wavelength, radiance)


def chart_of(photo: PhotoRecipe, path: Path) -> Chart:
    """Return the chart of a photo in the measurement file `path`.

    Raises RecipeError if the name of the chart is unknown, or if the layout does not match the number of patches. Raises
    InputFileError if the file with the reflectances is unusable.
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
    """Read the raw files of a photo: its frames, its dark frames and its white frames.

    Parameters
    ----------
    photo : PhotoRecipe
        The photo in a measurement file.
    illuminant : Illuminant
        The illuminant of the photo.
    chart : Chart
        The chart in the photo.
    body : Body
        The camera.
    levels : mapping
        Levels for raw files that state no levels (see Levels). If the photo has dark frames, the black level is optional.
    path : Path
        The measurement file. File names are relative to its folder.
    read : callable
        Function that reads a raw file with `levels`.

    Raises
    ------
    InputFileError
        If a file is not a raw file of this camera, if its black level is unknown, or if the files differ in size or phase.
    """
    known = {"black_level": 0.0, **levels} if photo.dark else levels  # the dark frames will determine the black level
    frames, darks, whites = (
        tuple(_frame(path.parent / name, read(path.parent / name, known), body, known) for name in names)
        for names in (photo.frames, photo.dark, photo.white)
    )
    corners = None if photo.corners is None else np.array(photo.corners, dtype=np.float64)
    with raised_as(InputFileError, path):
        return PhotoCapture(Path(photo.frames[0]).name, frames, chart, photo.light, *illuminant, corners, darks, whites)


def _frame(path: Path, stated: RawContent, body: Body, levels: Levels) -> RawFrame:
    """Convert the content of a raw file to a frame. Levels that the file states have precedence over `levels`.

    Raises InputFileError if the black level is unknown, or if the frame does not fit the sensor.
    """
    content: Mapping[str, Any] = {**levels, **stated}
    if "black_level" not in content:
        raise InputFileError(f'{path} states no black level; add a "dark" frame or a [datasheet] to the measurement file')
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
    """Create a measurement file for raw files that state their colour filter array and their levels.

    All files must be from the same camera and under the same illuminant. Each file becomes a separate photo. The pixel pitch
    and the optics are placeholders, because the responsivities do not depend on them.

    Parameters
    ----------
    paths : sequence of Path
        The raw files.
    first : RawContent
        Content of the first raw file.
    light : str or None
        Name of the illuminant, or None to estimate it.
    levels : mapping
        Levels for raw files that state no levels (see Levels).

    Raises
    ------
    InputFileError
        If the first file does not state its colour filter array and its levels, or if the array is too large.
    RecipeError
        If the properties that the first file states are invalid for a camera.
    """
    content = {**levels, **first}
    stated, white = content.get("pattern"), content.get("white_level")
    if stated is None or white is None or "black_level" not in content:
        raise InputFileError(
            f"{paths[0]} does not state its colour filter array and its levels; write a measurement file with [[photo]] "
            '(documentation, "Measure your camera")'
        )
    cfa = array_of(stated)
    if max(len(cfa.pattern), len(cfa.pattern[0].split())) > MAX_CFA:
        raise InputFileError(
            f"{paths[0]} has a colour filter array larger than {MAX_CFA}×{MAX_CFA} sites; use files of another camera"
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
    """Return the bit depth of a sensor with this white level in DN, limited to MAX_BITS."""
    return min(int(np.ceil(np.log2(white_level + 1))), MAX_BITS)


def array_of(codes: NDArray[np.integer]) -> CfaRecipe:
    """Convert the colour codes (row, col) in a raw file to a colour filter array with the smallest period.

    For TIFF/EP codes, the channel names are letters such as "r". For other codes, the names are "c" followed by the code.
    """
    pattern = least_period(codes)
    names = {int(code): LETTERS[code].lower() if code < FREE_CODE else f"c{code}" for code in np.unique(pattern)}
    return CfaRecipe(list(names.values()), [" ".join(names[int(code)] for code in row) for row in pattern])
