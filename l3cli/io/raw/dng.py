"""DNG files, CinemaDNG too (Adobe DNG 1.7, TIFF/EP).

LibRaw unpacks the pixels, of whatever packing and compression it knows, and applies the linearisation table; but it takes
any CFA for 2 × 2 or 6 × 6 and black levels for four numbers. So all that pixels mean is read from the tags (dng_tags).
"""

from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.correction import plan_correction
from l3cli.frames.frame import with_one_black_level
from l3cli.io.isolated import isolated
from l3cli.io.raw.content import RawContent, Request
from l3cli.io.raw.dng_tags import Mosaic, read_tags
from l3cli.io.raw.libraw import opened
from l3cli.io.raw.opcodes import bad_pixels, gain_of_pixels
from l3cli.io.video import storable_rate

FRAME_RATE = 51044  # the tag of CinemaDNG


def read(path: Path, _: Request) -> RawContent:
    """Return the frame of a DNG within its default crop."""
    return _read(path)


@isolated("rawpy", "tifffile")
def _read(path: Path) -> RawContent:
    mosaic = read_tags(path)  # first: LibRaw says less of what is wrong with them
    with opened(path) as raw:
        if raw.raw_image.shape != mosaic.shape:
            rows, cols = mosaic.shape
            raise InputFileError(f"{path}: its tags say {rows}×{cols} pixels, it holds {raw.raw_image.shape}; it is damaged")
        return _described(path, mosaic, _in_order(raw.raw_image, mosaic.fields))


def _in_order(stored: NDArray[np.uint16], fields: tuple[int, int]) -> NDArray[np.uint16]:
    """Return the pixels (row, col) of an image whose rows and columns are stored in `fields`: n fields of rows are rows 0,
    n, 2n…, then 1, n + 1…, and so on (RowInterleaveFactor, ColumnInterleaveFactor)."""
    if fields == (1, 1):
        return stored
    rows, cols = (
        np.argsort(np.argsort(np.arange(length) % count, kind="stable"))
        for length, count in zip(stored.shape, fields, strict=True)
    )
    return stored[np.ix_(rows, cols)]


def _described(path: Path, mosaic: Mosaic, stored: NDArray[np.uint16]) -> RawContent:
    """Return the default crop of the active area at one black level, of linear pixels `stored` (row, col).
    InputFileError if the tags contradict the pixels.
    """
    top, left, bottom, right = mosaic.active
    row, col, rows, cols = mosaic.crop
    shown = np.s_[row : row + rows, col : col + cols]
    black_level = _black_levels(mosaic, (bottom - top, right - left))
    black_level = black_level if black_level.size == 1 else black_level[shown]
    if not (black_level.min() >= 0 and (black_level < mosaic.white_level).all()):
        raise InputFileError(f"{path}: its black levels are not below its white level {mosaic.white_level:g}; it is damaged")
    pixels = stored[top:bottom, left:right].copy()  # LibRaw takes its memory back
    gain = None
    if mosaic.opcodes:
        pixels, gain = _changed(path, mosaic, pixels, bad_pixels(mosaic.opcodes, stored, mosaic.active))
    pixels, gain = pixels[shown], None if gain is None else gain[shown]
    values, common, white_level = with_one_black_level(pixels, black_level, np.array(mosaic.white_level))
    pattern = np.roll(mosaic.pattern, (-row, -col), axis=(0, 1))
    content = RawContent(
        values=values,
        black_level=common,
        white_level=white_level,
        pattern=pattern,
        orientation=mosaic.orientation,
        exposure=mosaic.exposure,
        neutral=mosaic.neutral,
        camera=mosaic.camera,
        shot=mosaic.shot,
        notes=mosaic.notes + mosaic.opcodes.notes,
    )
    return content if gain is None else content | {"gain": gain}


def _changed(
    path: Path, mosaic: Mosaic, pixels: NDArray[np.uint16], bad: NDArray[np.bool_]
) -> tuple[NDArray[np.uint16], NDArray[np.float32] | None]:
    """Return the active area as the file's opcodes want it, bad pixels corrected, and the gain that they want of it."""
    if bad.any():
        pixels = plan_correction(bad, mosaic.pattern).corrected(pixels)
    if not mosaic.opcodes.gains:
        return pixels, None
    try:
        rows, cols = pixels.shape
        return pixels, gain_of_pixels(mosaic.opcodes, mosaic.pattern, mosaic.planes, (rows, cols))
    except ValueError as error:
        raise InputFileError(f"{path}: its tags are damaged ({error}); copy it again") from error


def _black_levels(mosaic: Mosaic, shape: tuple[int, int]) -> NDArray[np.float64]:
    """(row, col) of the active area, or (1, 1) where all pixels have the same."""
    if np.ptp(mosaic.black_level) == 0 and not mosaic.black_of_row.any() and not mosaic.black_of_col.any():
        return mosaic.black_level[:1, :1]
    repeats = [-(-length // period) for length, period in zip(shape, mosaic.black_level.shape, strict=True)]
    tiled = np.tile(mosaic.black_level, repeats)[: shape[0], : shape[1]]
    return tiled + mosaic.black_of_row[:, None] + mosaic.black_of_col


def rate(path: Path) -> Fraction | None:
    """Return the frames a second of a CinemaDNG file."""
    fraction = _rate(path)
    return storable_rate(Fraction(*fraction)) if fraction else None


@isolated("tifffile")
def _rate(path: Path) -> tuple[int, int] | None:
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            tag = file.pages[0].tags.get(FRAME_RATE)
            rate = Fraction(*tag.value) if tag else Fraction(0)
    except (tifffile.TiffFileError, TypeError, ValueError, IndexError, ZeroDivisionError, OSError):
        return None  # reading the frame raises what is wrong with it
    return (rate.numerator, rate.denominator) if rate > 0 else None
