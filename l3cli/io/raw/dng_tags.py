"""Tags of a DNG that describe its mosaic (Adobe DNG 1.7, TIFF/EP). Those that change pixels and are not read are refused, or
noted for a warning (docs/raw-files.md#tags-of-a-dng).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.raw.cfa_codes import LETTERS
from l3cli.io.raw.opcodes import Opcodes, read_opcodes
from l3cli.io.raw.shot import shot_of_page
from l3cli.io.raw.tiff_tags import (
    BROKEN,
    COLOUR_FILTER_ARRAY,
    FRACTIONS,
    LINEAR_RAW,
    ONE_OF_MANY,
    RECTANGULAR,
    UNSIGNED,
    UPRIGHT,
    TiffTag,
    camera_names,
    flip_of,
)
from l3cli.system.limits import require_picture

WHITE_CODE = LETTERS.index("W")
LATEST = (1, 7)  # DNG that is read
UNREAD = {8: "Deflate", 34892: "lossy JPEG", 52546: "JPEG XL"}  # compressions that LibRaw does not unpack mosaics of
WHOLE = (0, 0, 1, 1)  # value of DEFAULT_USER_CROP
ONLY = {  # tags of which one value is read, and the complaint about any other
    TiffTag.CFA_LAYOUT: (RECTANGULAR, "is of a sensor with staggered pixels, which no table is made for"),
    TiffTag.SAMPLE_FORMAT: (UNSIGNED, "holds floating-point values; give the raw file the camera wrote"),
    TiffTag.FILL_ORDER: (1, "stores bits in reverse (FillOrder), which is not read; convert the camera's own file to DNG"),
    TiffTag.PREDICTOR: (1, "stores differences (Predictor), which are not read; convert the camera's own file to DNG"),
    TiffTag.SUB_TILE_BLOCK_SIZE: (
        1,
        "stores pixels in blocks (SubTileBlockSize), which are not read; convert the camera's own file to DNG",
    ),
    TiffTag.COLORIMETRIC_REFERENCE: (
        0,
        "holds a picture's values, not a scene's (ColorimetricReference); give the raw file",
    ),
}


@dataclass(frozen=True)
class Mosaic:
    """The raw image as tags describe it."""

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
    shape: tuple[int, int]  # rows, columns with masked borders
    fields: tuple[int, int]  # number of fields in which rows, and columns, are stored
    notes: tuple[str, ...]  # on tags that are not carried out


def read_tags(path: Path) -> Mosaic:
    """Return the mosaic that a file's tags describe. InputFileError if they are broken, describe none, or one stored or
    meant in a way that is not read."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            first, raw = file.pages[0], _raw_page(path, file)
            _refuse_others(path, first, raw)
            return _mosaic(path, first, raw)
    except tifffile.TiffFileError as error:
        raise InputFileError(f"{path} is damaged or no DNG file; give the raw file the camera wrote") from error
    except BROKEN as error:
        raise InputFileError(f"{path}: its tags are damaged ({error}); copy it again") from error


def _raw_page(path: Path, file: Any) -> Any:
    """Return the full-size raw image, neither preview, mask nor enhanced, among the file's pages and those below them."""
    pages = [each for page in file.pages for each in (page, *(page.pages or ()))]
    kinds = (COLOUR_FILTER_ARRAY, LINEAR_RAW)
    raw = [page for page in pages if page.tags.valueof(TiffTag.PHOTOMETRIC_INTERPRETATION) in kinds]
    full = [page for page in raw if not page.tags.valueof(TiffTag.NEW_SUBFILE_TYPE, 0) & ~ONE_OF_MANY]
    if not full:
        raise InputFileError(f"{path} holds no raw image; give a DNG with the mosaic of a camera")
    return max(full, key=lambda page: page.imagelength * page.imagewidth)


def _refuse_others(path: Path, first: Any, raw: Any) -> None:
    """Raise InputFileError if the file needs a later reader, or a tag changes pixels in a way that is not read."""
    version = tuple(first.tags.valueof(TiffTag.DNG_BACKWARD_VERSION) or LATEST)[:2]
    if version > LATEST:
        raise InputFileError(
            f"{path} is for readers of DNG {version[0]}.{version[1]}, this is one of {LATEST[0]}.{LATEST[1]}; "
            "convert the camera's own file to DNG for earlier ones"
        )
    if raw.samplesperpixel != 1:
        raise InputFileError(f"{path} is already demosaicked (linear); give the raw file the camera wrote")
    if raw.compression in UNREAD:
        raise InputFileError(
            f"{path} is compressed by {UNREAD[raw.compression]}, which is not read; convert it to lossless JPEG or none"
        )
    for tag, (only, what) in ONLY.items():
        page = first if tag == TiffTag.COLORIMETRIC_REFERENCE else raw
        if set(np.ravel(page.tags.valueof(tag, only)).tolist()) != {only}:
            raise InputFileError(f"{path} {what}")
    if raw.compression == 1 and not raw.is_tiled and not _contiguous(raw.dataoffsets, raw.databytecounts):
        raise InputFileError(f"{path}: its strips do not follow one another, as LibRaw takes them; save it in one strip")
    one_tile = raw.compression != 1 or raw.tilelength >= raw.imagelength
    if raw.is_tiled and raw.tilewidth > raw.imagewidth and one_tile:
        raise InputFileError(f"{path}: its tiles are wider than the image, as LibRaw does not take them; save it in strips")


def _mosaic(path: Path, first: Any, raw: Any) -> Mosaic:
    shape = (int(raw.imagelength), int(raw.imagewidth))
    require_picture(str(path), *shape)
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
        orientation=flip_of(path, first.tags.valueof(TiffTag.ORIENTATION, UPRIGHT)),
        pattern=_pattern(path, raw),
        active=(top, left, bottom, right),
        crop=crop,
        black_level=_repeating(_numbers(raw, TiffTag.BLACK_LEVEL, (0,)), black_shape).astype(np.float64),
        black_of_row=_numbers_of_length(raw, TiffTag.BLACK_LEVEL_DELTA_V, rows),
        black_of_col=_numbers_of_length(raw, TiffTag.BLACK_LEVEL_DELTA_H, cols),
        white_level=float(_numbers(raw, TiffTag.WHITE_LEVEL, (2**raw.bitspersample - 1,))[0]),
        exposure=exposure_time(first),
        neutral=_neutral(first, raw),
        camera=camera_names(first),
        shot=shot_of_page(first),
        opcodes=read_opcodes(path, raw),
        planes=tuple(raw.tags.valueof(TiffTag.CFA_PLANE_COLOR) or (0, 1, 2)),
        shape=shape,
        fields=_fields(raw),
        notes=tuple(_notes(raw)),
    )


def _fields(raw: Any) -> tuple[int, int]:
    """Return the number of fields that rows, and columns, are stored in."""
    rows, cols = (
        int(_numbers(raw, tag, (1,))[0]) for tag in (TiffTag.ROW_INTERLEAVE_FACTOR, TiffTag.COLUMN_INTERLEAVE_FACTOR)
    )
    if min(rows, cols) < 1:
        raise ValueError(f"{rows}×{cols} fields")
    return rows, cols


def _notes(raw: Any) -> Iterator[str]:
    """Yield a note for each tag of the picture that is not carried out."""
    across, down = _numbers(raw, TiffTag.DEFAULT_SCALE, (1, 1))
    if across != down:
        yield f"its pixels are not square (DefaultScale {across:g}, {down:g}); the picture is not stretched"
    if tuple(_numbers(raw, TiffTag.DEFAULT_USER_CROP, WHOLE)) != WHOLE:
        yield "the crop that was chosen in the camera (DefaultUserCrop) is not applied"


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
    """Return the exposure time (s) of the first page of a TIFF file or DNG, by its tags (TIFF/EP) or by its Exif tags."""
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


def _numbers_of_length(page: Any, code: int, length: int) -> NDArray[np.float64]:
    values = _numbers(page, code, np.zeros(length))
    if len(values) != length:
        raise ValueError(f"tag {code} has {len(values)} values instead of {length}")
    return np.asarray(values, np.float64)


def _numbers(page: Any, code: int, default: Any) -> Any:
    """Return the numbers of a tag, fractions divided out."""
    tag = page.tags.get(code)
    if tag is None:
        return default
    values = list(tag.value) if isinstance(tag.value, tuple | bytes) else [tag.value]
    if tag.dtype in FRACTIONS:
        return [above / below for above, below in zip(values[::2], values[1::2], strict=True)]
    return values
