"""Settings of a shot by the tags of its file (TIFF/EP, Exif), which pictures carry on."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.frames.frame import Shot
from l3cli.io.raw.tiff_tags import RATIONAL, SHORT, Entry, TiffTag, entry, text_entry

LONGEST = 100  # letters of a text
MOST = 1e7  # of a number: ISO speeds go to 4 million
DATE = re.compile(r"\d{4}:\d\d:\d\d \d\d:\d\d:\d\d", re.ASCII)
TAGS: dict[str, tuple[TiffTag, str]] = {  # field of Shot → its tag, and its name in tifffile's Exif directory
    "make": (TiffTag.MAKE, "Make"),
    "model": (TiffTag.MODEL, "Model"),
    "lens": (TiffTag.LENS_MODEL, "LensModel"),
    "date": (TiffTag.DATE_TIME_ORIGINAL, "DateTimeOriginal"),
    "f_number": (TiffTag.F_NUMBER, "FNumber"),
    "focal_length": (TiffTag.FOCAL_LENGTH, "FocalLength"),
    "iso": (TiffTag.ISO_SPEED, "ISOSpeedRatings"),
}


def believable_shot(stated: Mapping[str, Any]) -> Shot:
    """Return the shot that a file states, of untrusted values: short printable texts, dates that are dates, positive
    numbers."""
    usual, fields = Shot(), dict[str, Any]()
    for name in stated.keys() & TAGS.keys():
        wanted, value = type(getattr(usual, name)), stated[name]
        if wanted is str and isinstance(value, str):
            text = "".join(letter for letter in value if letter.isprintable()).strip()[:LONGEST]
            fields[name] = text if name != "date" or DATE.fullmatch(text) else ""
        elif wanted is float and isinstance(value, int | float) and 0 < value <= MOST:
            fields[name] = float(value)
    return Shot(**fields)


def shot_of_page(page: Any) -> dict[str, str | float]:
    """Return the settings stated by tifffile's page, in its tags or in its Exif directory."""
    exif = page.tags.valueof(TiffTag.EXIF)
    exif = exif if isinstance(exif, dict) else {}
    stated = {name: _plain(page.tags.valueof(tag, exif.get(other))) for name, (tag, other) in TAGS.items()}
    return {name: value for name, value in stated.items() if value is not None}


def shot_of_file(path: Path) -> dict[str, str | float]:
    """Return the settings stated by a camera raw; none if it is no TIFF, or a damaged one."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            return shot_of_page(file.pages[0])
    except Exception:  # the frame has been read: a library that stumbles over tags is no reason to refuse it
        return {}


def shot_of_libraw(raw: Any) -> dict[str, str | float]:
    """Return the settings that LibRaw reads from a raw file of any structure; rawpy has it since 0.26."""
    shot, lens = getattr(raw, "other", None), getattr(raw, "lens", None)
    stated = {
        "lens": getattr(lens, "model", None),
        "f_number": getattr(shot, "aperture", None),
        "focal_length": getattr(shot, "focal_length", None),
        "iso": getattr(shot, "iso_speed", None),
    }
    return {name: value for name, value in stated.items() if isinstance(value, str | float | int)}


def shot_of_spec(spec: Any) -> dict[str, str | float]:
    """Return the settings stated by OpenImageIO's description of a picture."""
    names = {
        "make": "Make",
        "model": "Model",
        "lens": "Exif:LensModel",
        "date": "Exif:DateTimeOriginal",
        "f_number": "FNumber",
    }
    names |= {"focal_length": "Exif:FocalLength", "iso": "Exif:PhotographicSensitivity"}
    stated = {name: spec.getattribute(other) for name, other in names.items()}
    return {name: value for name, value in stated.items() if isinstance(value, str | float | int)}


def entries_of(shot: Shot, exposure: float | None) -> list[Entry]:
    """Return the tags (TIFF/EP) that state how a frame was taken, its exposure time in s."""
    entries = [entry(TiffTag.EXPOSURE_TIME, RATIONAL, [exposure])] if exposure else []
    for name, (tag, _) in TAGS.items():
        value = getattr(shot, name)
        if value and isinstance(value, str):
            entries.append(text_entry(tag, value))
        elif value and name == "iso":
            entries.append(entry(tag, SHORT, [min(round(value), 65535)]))
        elif value:
            entries.append(entry(tag, RATIONAL, [value]))
    return entries


def _plain(value: Any) -> str | float | None:
    """Return a text or number; of several numbers the first, of a fraction its quotient."""
    if isinstance(value, tuple | list | np.ndarray) and len(value):
        value = value[0] / value[1] if len(value) == 2 and value[1] else value[0]
    if isinstance(value, str):
        return value
    return float(value) if isinstance(value, int | float | np.number) else None
