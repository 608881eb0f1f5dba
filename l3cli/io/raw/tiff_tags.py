"""The tags of TIFF 6, TIFF/EP, Exif and DNG 1.7 that the mosaics of cameras are read and written by, and their types."""

import struct
from collections.abc import Iterable
from enum import IntEnum
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError


class TiffTag(IntEnum):
    """Codes, called as their standards call them."""

    NEW_SUBFILE_TYPE = 254
    PHOTOMETRIC_INTERPRETATION = 262
    FILL_ORDER = 266
    IMAGE_DESCRIPTION = 270
    MAKE = 271
    MODEL = 272
    ORIENTATION = 274
    PREDICTOR = 317
    SUB_IFDS = 330
    SAMPLE_FORMAT = 339
    CFA_REPEAT_PATTERN_DIM = 33421
    CFA_PATTERN = 33422
    EXPOSURE_TIME = 33434
    F_NUMBER = 33437
    EXIF = 34665
    ISO_SPEED = 34855
    DATE_TIME_ORIGINAL = 36867
    FOCAL_LENGTH = 37386
    LENS_MODEL = 42036
    DNG_VERSION = 50706
    DNG_BACKWARD_VERSION = 50707
    UNIQUE_CAMERA_MODEL = 50708
    LOCALIZED_CAMERA_MODEL = 50709
    CFA_PLANE_COLOR = 50710
    CFA_LAYOUT = 50711
    LINEARIZATION_TABLE = 50712
    BLACK_LEVEL_REPEAT_DIM = 50713
    BLACK_LEVEL = 50714
    BLACK_LEVEL_DELTA_H = 50715
    BLACK_LEVEL_DELTA_V = 50716
    WHITE_LEVEL = 50717
    DEFAULT_SCALE = 50718
    DEFAULT_CROP_ORIGIN = 50719
    DEFAULT_CROP_SIZE = 50720
    COLOR_MATRIX_1 = 50721
    COLOR_MATRIX_2 = 50722
    AS_SHOT_NEUTRAL = 50728
    BASELINE_EXPOSURE = 50730
    CALIBRATION_ILLUMINANT_1 = 50778
    CALIBRATION_ILLUMINANT_2 = 50779
    ACTIVE_AREA = 50829
    COLORIMETRIC_REFERENCE = 50879
    FORWARD_MATRIX_1 = 50964
    SUB_TILE_BLOCK_SIZE = 50974
    ROW_INTERLEAVE_FACTOR = 50975
    OPCODE_LIST_1 = 51008
    OPCODE_LIST_2 = 51009
    OPCODE_LIST_3 = 51022
    NOISE_PROFILE = 51041
    DEFAULT_USER_CROP = 51125
    COLUMN_INTERLEAVE_FACTOR = 52547


BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 10, 12  # types of values
FRACTIONS = (RATIONAL, SRATIONAL)
COLOUR_FILTER_ARRAY, LINEAR_RAW = 32803, 34892  # values of PHOTOMETRIC_INTERPRETATION
REDUCED, ONE_OF_MANY = 1, 2  # bits of NEW_SUBFILE_TYPE: a smaller copy of another image, a page of several
RECTANGULAR = 1  # value of CFA_LAYOUT
UNSIGNED = 1  # value of SAMPLE_FORMAT
UPRIGHT = 1  # value of ORIENTATION
LIBRAW_FLIP = (0, 0, 1, 3, 2, 4, 6, 7, 5)  # of the values 0…8 of ORIENTATION
# what reading damaged tags raises
BROKEN = (ValueError, TypeError, KeyError, IndexError, AttributeError, ZeroDivisionError, OverflowError, struct.error)
LONGEST_NAME = 80  # characters of a camera's name that are kept
FINE = 10**9  # denominator at most
LARGEST = 2**31 - 1  # of numerator and denominator
Entry = tuple[int, int, int, object, bool]  # of a directory, as tifffile takes it


def camera_names(page: Any) -> list[str]:
    """Make, model and other names of the camera, as the first page of a TIFF file or DNG states them; nothing without a
    model."""
    tags = (TiffTag.MODEL, TiffTag.MAKE, TiffTag.UNIQUE_CAMERA_MODEL, TiffTag.LOCALIZED_CAMERA_MODEL)
    texts = [page.tags.valueof(tag) for tag in tags]
    written = [text.decode("utf-8", "replace") if isinstance(text, bytes) else text for text in texts]
    model, make, *others = [text.strip("\0 ")[:LONGEST_NAME] if isinstance(text, str) else "" for text in written]
    return [make, model, *filter(None, others)] if model else []


def flip_of(path: Path, orientation: object) -> int:
    """Return LibRaw's flip code of a file's ORIENTATION. InputFileError if TIFF does not know its value."""
    if not (isinstance(orientation, int | np.integer) and 0 <= orientation < len(LIBRAW_FLIP)):
        raise InputFileError(
            f"{path}: its orientation is {orientation}, TIFF knows 1…{len(LIBRAW_FLIP) - 1}; "
            "mend the tag Orientation, 1 if it is upright"
        )
    return LIBRAW_FLIP[orientation]


def entry(code: int, kind: int, numbers: Iterable[float]) -> Entry:
    """Return a tag of numbers, as tifffile takes it."""
    if kind == DOUBLE:
        values: list[float] = [float(number) for number in numbers]
    elif kind in FRACTIONS:
        fractions = [_fraction(float(number)) for number in numbers]
        values = [part for fraction in fractions for part in (fraction.numerator, fraction.denominator)]
    else:
        values = [int(number) for number in numbers]
    count = len(values) // (2 if kind in FRACTIONS else 1)
    return code, kind, count, tuple(values) if len(values) > 1 else values[0], True


def _fraction(number: float) -> Fraction:
    """Return the nearest fraction whose parts fit into 32 bits."""
    return Fraction(number).limit_denominator(min(FINE, int(LARGEST / max(1.0, abs(number)))))


def text_entry(code: int, text: str) -> Entry:
    """Return a tag of text in ASCII; other letters become question marks."""
    text = text.encode("ascii", "replace").decode()
    return code, ASCII, 0, text, True
