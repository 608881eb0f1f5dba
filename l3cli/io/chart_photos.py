"""Read photos of charts: raw files, their illuminant and their chart (docs/method.md#charts-in-photographs)."""

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

SEEN = (400.0, 700.0)  # nm, range that a measured illuminant must cover
GRID = np.arange(380.0, 781.0, 5.0)  # nm, grid of named illuminants and charts
Array = NDArray[np.float64]
# Facts about raw files that do not state them: "black_level" and "white_level" in DN. "opcodes": "leave" ignores the opcodes
# of a DNG that l3 does not support.
Levels = Mapping[str, Any]


class Illuminant(NamedTuple):
    """Illuminant of a photo."""

    wavelength: Array  # (wavelength) nm
    radiance: Array  # (wavelength) relative photon radiance


def illuminant_of(photo: PhotoRecipe, path: Path) -> Illuminant:
    """Return the illuminant that a measurement file at `path` states for a photo.

    An illuminant that is to be estimated is equal-energy for now. Raises RecipeError for an unknown name, and InputFileError
    if the file of a measured illuminant cannot be used.
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
        raise InputFileError(f"{file}: the light is negative by more than noise; subtract the dark spectrum again")
    if table.wavelength[0] > SEEN[0] or table.wavelength[-1] < SEEN[1]:
        raise InputFileError(
            f"{file}: its {table.wavelength[0]:g}…{table.wavelength[-1]:g} nm do not cover {SEEN[0]:g}…{SEEN[1]:g} nm; "
            "measure the light over what a camera sees"
        )
    if radiance.max() <= 0:
        raise InputFileError(f"{file}: the light is dark; measure it again")
    return Illuminant(table.wavelength, radiance)


def chart_of(photo: PhotoRecipe, path: Path) -> Chart:
    """Return the chart that a measurement file at `path` states for a photo.

    Raises RecipeError for an unknown name or a wrong layout, and InputFileError if the file of reflectances cannot be used.
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
    """Read the raw files of a photo.

    Parameters
    ----------
    photo : PhotoRecipe
        The photo in a measurement file.
    illuminant, chart
        What is in the photo.
    body : Body
        The camera.
    levels : mapping
        Levels that the files do not state.
    path : Path
        The measurement file, which files are named relative to.
    read : callable
        Reads a raw file, given the names of the levels that it need not state.

    Raises
    ------
    InputFileError
        If a file is not a raw file of this camera, or differs from the others in size or phase.
    """
    known = {"black_level": 0.0, **levels} if photo.dark else levels  # dark frames will give the black level
    frames, darks, whites = (
        tuple(_frame(path.parent / name, read(path.parent / name, known), body, known) for name in names)
        for names in (photo.frames, photo.dark, photo.white)
    )
    corners = None if photo.corners is None else np.array(photo.corners, dtype=np.float64)
    with raised_as(InputFileError, path):
        return PhotoCapture(Path(photo.frames[0]).name, frames, chart, photo.light, *illuminant, corners, darks, whites)


def _frame(path: Path, stated: RawContent, body: Body, levels: Levels) -> RawFrame:
    """Return a raw file's frame as it is, with its own levels."""
    content: Mapping[str, Any] = {**levels, **stated}
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


# -------------------------------------------------------------------------- a raw file without a measurement file


def recipe_of_photos(paths: Sequence[Path], first: RawContent, light: str | None, levels: Levels) -> MeasurementRecipe:
    """Return a measurement file for raw files that state their array, levels and size.

    All files are from one camera under one illuminant, and each is a photo. Pixel pitch and optics are placeholders, because
    responsivities do not depend on them.

    Parameters
    ----------
    paths : sequence of Path
        The raw files.
    first : RawContent
        Content of the first one.
    light : str or None
        Name of the illuminant, or None to estimate it.
    levels : mapping
        Levels that the files do not state.

    Raises
    ------
    InputFileError
        If the first file does not state enough.
    RecipeError
        If no camera can have what it states.
    """
    content = {**levels, **first}
    stated, white = content.get("pattern"), content.get("white_level")
    if stated is None or white is None or "black_level" not in content:
        raise InputFileError(
            f"{paths[0]} does not state its colour filter array and levels; write a measurement file with [[photo]] "
            '(documentation, "Measure your camera")'
        )
    cfa = array_of(stated)
    if max(len(cfa.pattern), len(cfa.pattern[0].split())) > MAX_CFA:
        raise InputFileError(f"{paths[0]}: its colour filter array is larger than {MAX_CFA}×{MAX_CFA}")
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
    """Return the bits of a sensor with a given white level (DN)."""
    return min(int(np.ceil(np.log2(white_level + 1))), MAX_BITS)


def array_of(codes: NDArray[np.integer]) -> CfaRecipe:
    """Return the colour filter array from the codes (row, col) in a raw file. Channels are named by letters."""
    pattern = least_period(codes)
    names = {int(code): LETTERS[code].lower() if code < FREE_CODE else f"c{code}" for code in np.unique(pattern)}
    return CfaRecipe(list(names.values()), [" ".join(names[int(code)] for code in row) for row in pattern])
