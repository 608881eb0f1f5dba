"""Read and write tags of TIFF 6, TIFF/EP, Exif and DNG 1.7, by their names in tifffile.

All these formats use the same tags for the camera's make and model and for the shot settings.
"""

import re
import struct
from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError
from l3cli.frames.frame import Shot

BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 10, 12  # codes of data types
FRACTIONS = (RATIONAL, SRATIONAL)
COLOUR_FILTER_ARRAY, LINEAR_RAW = 32803, 34892  # values of PhotometricInterpretation
REDUCED, ONE_OF_MANY = 1, 2  # bits of NewSubfileType: reduced-resolution copy of another image, one page of several
RECTANGULAR = 1  # value of CFALayout
UNSIGNED = 1  # value of SampleFormat
UPRIGHT = 1  # value of Orientation
LIBRAW_FLIP = (0, 0, 1, 3, 2, 4, 6, 7, 5)  # LibRaw's flip code for each value 0…8 of Orientation
# Exceptions that damaged tags can cause.
BROKEN = (ValueError, TypeError, KeyError, IndexError, AttributeError, ZeroDivisionError, OverflowError, struct.error)
LONGEST_NAME = 80  # camera names are cut to this length
MAX_DENOMINATOR = 10**9
MAX_INTEGER = 2**31 - 1  # maximum numerator
Entry = tuple[int, int, int, object, bool]  # tag for tifffile: code, type, count, value, only on first page


def flip_of(path: Path, orientation: object) -> int:
    """Convert a value of the tag Orientation to LibRaw's flip code.

    The value 0 counts as upright. Raises InputFileError for other values that TIFF does not define.
    """
    if not (isinstance(orientation, int | np.integer) and 0 <= orientation < len(LIBRAW_FLIP)):
        raise InputFileError(
            f"{path}: the tag Orientation is {orientation}, but TIFF defines only 1…{len(LIBRAW_FLIP) - 1}; "
            "set the tag to 1 if the picture is upright"
        )
    return LIBRAW_FLIP[orientation]


# ------------------------------------------------------------------------------------------------------- reading


def numbers(page: Any, name: str, default: Any) -> Any:
    """Return the numbers in a tag as a list, or `default` if the tag is missing. Fractions become floats.

    Raises an exception in BROKEN if the tag is damaged, for example if a denominator is 0.
    """
    tag = page.tags.get(name)
    if tag is None:
        return default
    values = list(tag.value) if isinstance(tag.value, tuple | bytes) else [tag.value]
    if tag.dtype in FRACTIONS:
        return [above / below for above, below in zip(values[::2], values[1::2], strict=True)]
    return values


def number(value: Any) -> float | None:
    """Convert an Exif value to a float, or return None if it is not a number.

    Two numbers are interpreted as a fraction. If the denominator is 0, or if there are more than two numbers, the first
    number is returned.
    """
    if isinstance(value, tuple | list | np.ndarray) and len(value):
        value = value[0] / value[1] if len(value) == 2 and value[1] else value[0]
    return float(value) if isinstance(value, int | float | np.number) else None


def exif_of(page: Any) -> dict[str, Any]:
    """Return the tags in a page's Exif directory by name, or {} if the page has no Exif directory."""
    exif = page.tags.valueof("ExifTag")
    return exif if isinstance(exif, dict) else {}


def exposure_time(page: Any) -> float | None:
    """Return the exposure time in s from the first page of a TIFF or DNG file, or None if it is missing or invalid.

    The TIFF/EP tag takes precedence over the Exif tag.
    """
    seconds = page.tags.valueof("ExposureTime") or exif_of(page).get("ExposureTime")
    if not (isinstance(seconds, tuple) and len(seconds) == 2 and seconds[1]):
        return None
    return float(seconds[0] / seconds[1])


def camera_names(page: Any) -> list[str]:
    """Return the camera's make, model and other names from the first page of a TIFF or DNG file.

    The make may be "". The list is empty if the page does not contain the model.
    """
    texts = [page.tags.valueof(tag) for tag in ("Model", "Make", "UniqueCameraModel", "LocalizedCameraModel")]
    written = [text.decode("utf-8", "replace") if isinstance(text, bytes) else text for text in texts]
    model, make, *others = [text.strip("\0 ")[:LONGEST_NAME] if isinstance(text, str) else "" for text in written]
    return [make, model, *filter(None, others)] if model else []


# ------------------------------------------------------------------------------------------------------- writing


def entry(name: str, kind: int, values: Iterable[float]) -> Entry:
    """Create a numeric tag for tifffile. `kind` is the code of its data type. Fractions are rounded (see `_fraction`)."""
    if kind == DOUBLE:
        parts: list[float] = [float(value) for value in values]
    elif kind in FRACTIONS:
        fractions = [_fraction(float(value)) for value in values]
        parts = [part for fraction in fractions for part in (fraction.numerator, fraction.denominator)]
    else:
        parts = [int(value) for value in values]
    count = len(parts) // (2 if kind in FRACTIONS else 1)
    return _code(name), kind, count, tuple(parts) if len(parts) > 1 else parts[0], True


def _fraction(value: float) -> Fraction:
    """Approximate a number by a fraction with a numerator and a denominator that fit into 32 bits."""
    return Fraction(value).limit_denominator(min(MAX_DENOMINATOR, int(MAX_INTEGER / max(1.0, abs(value)))))


def text_entry(name: str, text: str) -> Entry:
    """Create a text tag for tifffile. Non-ASCII characters become question marks."""
    return _code(name), ASCII, 0, text.encode("ascii", "replace").decode(), True


def _code(name: str) -> int:
    import tifffile

    return int(tifffile.TIFF.TAGS[name])


# ------------------------------------------------------------------------------------------------ shot settings

LONGEST_TEXT = 100  # texts are cut to this number of characters
MAX_BELIEVABLE = 1e7  # largest plausible number; the highest ISO speeds of cameras are about 4 million
DATE = re.compile(r"\d{4}:\d\d:\d\d \d\d:\d\d:\d\d", re.ASCII)
SHOT = {  # field of Shot → (tag name in tifffile, attribute name in OpenImageIO)
    "f_number": ("FNumber", "FNumber"),
    "focal_length": ("FocalLength", "Exif:FocalLength"),
    "make": ("Make", "Make"),
    "model": ("Model", "Model"),
    "lens": ("LensModel", "Exif:LensModel"),
    "date": ("DateTimeOriginal", "Exif:DateTimeOriginal"),
    "iso": ("ISOSpeedRatings", "Exif:PhotographicSensitivity"),
}


def believable_shot(stated: Mapping[str, Any]) -> Shot:
    """Create a Shot from the settings in a file, with default values in place of invalid or implausible settings.

    The keys of `stated` are field names of `Shot`. Other keys are ignored. Unprintable characters are removed from texts,
    and long texts are cut. A date is invalid unless it has the Exif format. A number is implausible if it is not positive or
    exceeds MAX_BELIEVABLE.
    """
    usual, fields = Shot(), dict[str, Any]()
    for name in stated.keys() & SHOT.keys():
        wanted, value = type(getattr(usual, name)), stated[name]
        if wanted is str and isinstance(value, str):
            text = "".join(letter for letter in value if letter.isprintable()).strip()[:LONGEST_TEXT]
            fields[name] = text if name != "date" or DATE.fullmatch(text) else ""
        elif wanted is float and isinstance(value, int | float) and 0 < value <= MAX_BELIEVABLE:
            fields[name] = float(value)
    return Shot(**fields)


def shot_of_page(page: Any) -> dict[str, str | float]:
    """Read the shot settings from the tags or the Exif directory of a tifffile page.

    The keys of the result are field names of `Shot`. Missing settings are omitted.
    """
    exif = exif_of(page)
    stated = {name: page.tags.valueof(tag, exif.get(tag)) for name, (tag, _) in SHOT.items()}
    plain = {name: value if isinstance(value, str) else number(value) for name, value in stated.items()}
    return {name: value for name, value in plain.items() if value is not None}


def shot_of_spec(spec: Any) -> dict[str, str | float]:
    """Read the shot settings from an OpenImageIO ImageSpec. The result is as in `shot_of_page`."""
    stated = {name: spec.getattribute(other) for name, (_, other) in SHOT.items()}
    return {name: value for name, value in stated.items() if isinstance(value, str | float | int)}


def shot_entries(shot: Shot, exposure: float | None) -> list[Entry]:
    """Create the TIFF/EP tags for known shot settings and the exposure time in s.

    ISO speeds above 65535 are stored as 65535, the largest value that the tag supports.
    """
    entries = [entry("ExposureTime", RATIONAL, [exposure])] if exposure else []
    for name, (tag, _) in SHOT.items():
        value = getattr(shot, name)
        if value and isinstance(value, str):
            entries.append(text_entry(tag, value))
        elif value and name == "iso":
            entries.append(entry(tag, SHORT, [min(round(value), 65535)]))
        elif value:
            entries.append(entry(tag, RATIONAL, [value]))
    return entries
