"""DNG files, CinemaDNG too: what their tags say about the mosaic (Adobe DNG 1.7, TIFF/EP).

LibRaw unpacks the pixels, of whatever packing and compression it knows, and applies the linearisation table; but it takes
any CFA for 2 × 2 or 6 × 6 and black levels for four numbers. So all that pixels mean is read here, from the tags.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frame import with_one_black_level
from l3cli.io.apart import apart
from l3cli.io.raw.cfa_codes import LETTERS
from l3cli.io.raw.content import RawContent, Request
from l3cli.io.raw.libraw import opened
from l3cli.io.raw.opcodes import Opcodes, bad_pixels, gain_of_pixels, read_opcodes
from l3cli.io.raw.shot import shot_of_page
from l3cli.io.raw.tiff_tags import (
    BROKEN,
    COLOUR_FILTER_ARRAY,
    FRACTIONS,
    LIBRAW_FLIP,
    LINEAR_RAW,
    RECTANGULAR,
    REDUCED,
    UNSIGNED,
    UPRIGHT,
    TiffTag,
    camera_names,
)
from l3cli.io.video import storable_rate
from l3cli.mending import plan_mending

WHITE_CODE = LETTERS.index("W")
FRAME_RATE = 51044  # the tag of CinemaDNG


@dataclass(frozen=True)
class Mosaic:
    """What the tags say of the raw image."""

    orientation: int  # LibRaw's flip code
    pattern: NDArray[np.int64]  # (row, col) colour codes, from the upper left corner of the active area
    active: tuple[int, int, int, int]  # top, left, bottom, right of the pixels that see light
    crop: tuple[int, int, int, int]  # row, column within the active area, rows, columns: what is to be shown
    black_level: NDArray[np.float64]  # (row, col) DN, repeating from the corner of the active area
    black_of_row: NDArray[np.float64]  # (active row), DN added
    black_of_col: NDArray[np.float64]  # (active col), DN added
    white_level: float  # DN
    exposure: float | None  # s
    neutral: NDArray[np.float64] | None  # (colour, 2) code and what a grey gives
    camera: list[str]  # make, model and other names
    shot: dict[str, str | float]
    opcodes: Opcodes
    planes: tuple[int, ...]  # colour code of each plane


def read(path: Path, _: Request) -> RawContent:
    """What a DNG holds within its default crop."""
    return _read(path)


@apart
def _read(path: Path) -> RawContent:
    with opened(path) as raw:
        return described(path, raw.raw_image)


def described(path: Path, stored: NDArray[np.uint16]) -> RawContent:
    """A DNG's linear pixels, `stored` (row, col) by LibRaw, as its tags describe them: the default crop of the active area,
    at one black level. InputFileError if the tags are broken or contradict the pixels.
    """
    mosaic = read_tags(path, stored.shape)
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
        notes=mosaic.opcodes.notes,
    )
    return content if gain is None else content | {"gain": gain}


def _changed(
    path: Path, mosaic: Mosaic, pixels: NDArray[np.uint16], bad: NDArray[np.bool_]
) -> tuple[NDArray[np.uint16], NDArray[np.float32] | None]:
    """The active area as the file's opcodes want it, bad pixels mended, and the gain that they want of it."""
    if bad.any():
        pixels = plan_mending(bad, mosaic.pattern).mended(pixels)
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
    """Frames a second of a CinemaDNG file."""
    fraction = _rate(path)
    return storable_rate(Fraction(*fraction)) if fraction else None


@apart
def _rate(path: Path) -> tuple[int, int] | None:
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            tag = file.pages[0].tags.get(FRAME_RATE)
            rate = Fraction(*tag.value) if tag else Fraction(0)
    except (tifffile.TiffFileError, TypeError, ValueError, IndexError, ZeroDivisionError, OSError):
        return None  # reading the frame raises what is wrong with it
    return (rate.numerator, rate.denominator) if rate > 0 else None


# ------------------------------------------------------------------------------------------------------------- tags


def read_tags(path: Path, shape: tuple[int, ...]) -> Mosaic:
    """What the tags say of the file's raw image, of `shape` with its masked borders.

    InputFileError if they are broken, describe no mosaic or one of another shape.
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            return _mosaic(path, file.pages[0], _raw_page(path, file), shape)
    except (*BROKEN, tifffile.TiffFileError) as error:
        raise InputFileError(f"{path}: its tags are damaged ({error}); copy it again") from error


def _raw_page(path: Path, file: Any) -> Any:
    """The full-size raw image among the file's pages and those below them."""
    pages = [each for page in file.pages for each in (page, *(page.pages or ()))]
    kinds = (COLOUR_FILTER_ARRAY, LINEAR_RAW)
    raw = [page for page in pages if page.tags.valueof(TiffTag.PHOTOMETRIC_INTERPRETATION) in kinds]
    full = [page for page in raw if not page.tags.valueof(TiffTag.NEW_SUBFILE_TYPE, 0) & REDUCED]
    if not full:
        raise InputFileError(f"{path} holds no raw image; give a DNG with the mosaic of a camera")
    return max(full, key=lambda page: page.imagelength * page.imagewidth)


def _mosaic(path: Path, first: Any, raw: Any, shape: tuple[int, ...]) -> Mosaic:
    if raw.samplesperpixel != 1:
        raise InputFileError(f"{path} is already demosaicked (linear); give the raw file the camera wrote")
    if raw.tags.valueof(TiffTag.CFA_LAYOUT, RECTANGULAR) != RECTANGULAR:
        raise InputFileError(f"{path} is of a sensor with staggered pixels, which no table is made for")
    if raw.tags.valueof(TiffTag.SAMPLE_FORMAT, UNSIGNED) not in (UNSIGNED, (UNSIGNED,)):
        raise InputFileError(f"{path} holds floating-point values; give the raw file the camera wrote")
    if raw.compression == 1 and not raw.is_tiled and not _contiguous(raw.dataoffsets, raw.databytecounts):
        raise InputFileError(f"{path}: its strips do not follow one another, as LibRaw takes them; save it in one strip")
    if shape != (raw.imagelength, raw.imagewidth):
        raise InputFileError(
            f"{path}: its tags say {raw.imagelength}×{raw.imagewidth} pixels, it holds {shape}; it is damaged"
        )
    top, left, bottom, right = (int(edge) for edge in _numbers(raw, TiffTag.ACTIVE_AREA, (0, 0, *shape)))
    if not (0 <= top < bottom <= shape[0] and 0 <= left < right <= shape[1]):
        raise InputFileError(
            f"{path}: its active area {top, left, bottom, right} is not within its {shape[0]}×{shape[1]} pixels"
        )
    rows, cols = bottom - top, right - left
    origin, size = _numbers(raw, TiffTag.DEFAULT_CROP_ORIGIN, (0, 0)), _numbers(raw, TiffTag.DEFAULT_CROP_SIZE, (cols, rows))
    crop = tuple(round(value) for value in (origin[1], origin[0], size[1], size[0]))
    if not (min(crop[:2]) >= 0 and min(crop[2:]) >= 1 and crop[0] + crop[2] <= rows and crop[1] + crop[3] <= cols):
        raise InputFileError(f"{path}: its crop {crop} is not within its active area of {rows}×{cols} pixels")
    black_shape = raw.tags.valueof(TiffTag.BLACK_LEVEL_REPEAT_DIM, (1, 1))
    return Mosaic(
        orientation=LIBRAW_FLIP[int(_numbers(first, TiffTag.ORIENTATION, (UPRIGHT,))[0])],
        pattern=_pattern(path, raw),
        active=(top, left, bottom, right),
        crop=crop,
        black_level=_repeating(_numbers(raw, TiffTag.BLACK_LEVEL, (0,)), black_shape).astype(np.float64),
        black_of_row=_of_length(raw, TiffTag.BLACK_LEVEL_DELTA_V, rows),
        black_of_col=_of_length(raw, TiffTag.BLACK_LEVEL_DELTA_H, cols),
        white_level=float(_numbers(raw, TiffTag.WHITE_LEVEL, (2**raw.bitspersample - 1,))[0]),
        exposure=exposure_time(first),
        neutral=_neutral(first, raw),
        camera=camera_names(first),
        shot=shot_of_page(first),
        opcodes=read_opcodes(path, raw),
        planes=tuple(raw.tags.valueof(TiffTag.CFA_PLANE_COLOR) or (0, 1, 2)),
    )


def _neutral(first: Any, raw: Any) -> NDArray[np.float64] | None:
    """Codes of the colour planes and the signals that the camera took for those of a grey; None where they are not stated,
    or are none."""
    try:
        codes = _numbers(raw, TiffTag.CFA_PLANE_COLOR, (0, 1, 2))
        signals = np.asarray(_numbers(first, TiffTag.AS_SHOT_NEUTRAL, ()), np.float64)
    except BROKEN:  # pixels need none of it
        return None
    if len(signals) != len(codes) or not (np.isfinite(signals).all() and signals.min() > 0):
        return None
    return np.stack([np.asarray(codes, np.float64), signals], axis=1)


def exposure_time(page: Any) -> float | None:
    """Exposure time (s) of the first page of a TIFF file or DNG, by its tags (TIFF/EP) or by its Exif tags."""
    seconds = page.tags.valueof(TiffTag.EXPOSURE_TIME) or (page.tags.valueof(TiffTag.EXIF) or {}).get("ExposureTime")
    if not (isinstance(seconds, tuple) and len(seconds) == 2 and seconds[1]):
        return None  # not stated, or no time
    return float(seconds[0] / seconds[1])


def _contiguous(offsets: Sequence[int], lengths: Sequence[int]) -> bool:
    return all(offset + length == after for offset, length, after in zip(offsets, lengths, offsets[1:], strict=False))


def _pattern(path: Path, raw: Any) -> NDArray[np.int64]:
    if raw.tags.valueof(TiffTag.PHOTOMETRIC_INTERPRETATION) == LINEAR_RAW:  # of one sample: no filters at all
        return np.array([[WHITE_CODE]])
    codes, shape = raw.tags.valueof(TiffTag.CFA_PATTERN), raw.tags.valueof(TiffTag.CFA_REPEAT_PATTERN_DIM)
    if codes is None or shape is None:
        raise InputFileError(f"{path} does not state its colour filter array; convert the camera's own file to DNG again")
    return _repeating(list(codes), shape).astype(np.int64)


def _repeating(values: Sequence[float], shape: Sequence[int]) -> NDArray:
    """(row, col) of what repeats over the mosaic."""
    if min(shape) < 1:
        raise ValueError(f"a pattern of {shape}")
    return np.reshape(values, tuple(shape))


def _of_length(page: Any, code: int, length: int) -> NDArray[np.float64]:
    values = _numbers(page, code, np.zeros(length))
    if len(values) != length:
        raise ValueError(f"tag {code} has {len(values)} values instead of {length}")
    return np.asarray(values, np.float64)


def _numbers(page: Any, code: int, default: Any) -> Any:
    """The numbers of a tag, fractions divided out."""
    tag = page.tags.get(code)
    if tag is None:
        return default
    values = list(tag.value) if isinstance(tag.value, tuple | bytes) else [tag.value]
    if tag.dtype in FRACTIONS:
        return [above / below for above, below in zip(values[::2], values[1::2], strict=True)]
    return values
