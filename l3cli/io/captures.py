"""A folder of captures as a lab keeps it: which files are raw frames, which are tables of spectra, which are neither."""

import os
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, L3Error
from l3cli.io.frames import raw_content
from l3cli.io.raw.registry import BY_SUFFIX
from l3cli.spectra.file import SUFFIXES, read_table
from l3cli.spectra.table import CurveTable

MOST_FILES, DEEPEST = 20_000, 8  # files and folders below one another that are looked at
DEVELOPED = (".jpg", ".jpeg", ".heic", ".webp", ".bmp", ".gif", ".exr")
PROSE = (".txt", ".asc", ".xml")  # of which most are no tables
FIGURES = re.compile(rb"^\s*[\d.]+[\s,;]+[\d.]", re.MULTILINE)  # a row of a table


@dataclass(frozen=True)
class CaptureFolder:
    """The files of a folder, each path relative to it."""

    folder: Path
    frames: tuple[str, ...]
    tables: tuple[str, ...]
    notes: tuple[str, ...]  # a line for each kind of file that is left out


@dataclass(frozen=True)
class RawFile:
    """A raw frame and what its file states of it."""

    values: NDArray[np.uint16]  # (row, col) DN as stored, never developed
    seconds: float | None
    pattern: NDArray[np.int64] | None  # codes of the array
    black_level: float | None  # DN
    white_level: float | None  # DN


def list_captures(folder: Path) -> CaptureFolder:
    """Return the content of a folder and of those below it; InputFileError if it is none, or holds too many files."""
    if not folder.is_dir():
        raise InputFileError(f"{folder} is no folder; give the folder of a lab's captures")
    frames, tables, notes = [], [], Counter[str]()
    for number, path in enumerate(_files(folder)):
        if number >= MOST_FILES:
            raise InputFileError(f"{folder} holds more than {MOST_FILES} files; give the folder of one camera's captures")
        suffix, name = path.suffix.lower(), path.relative_to(folder).as_posix()
        if not _is_text(name):
            notes[f"{suffix}: their names are no text; left out"] += 1
            continue
        kind = BY_SUFFIX.get(suffix)
        if suffix in SUFFIXES:
            tables.append(name)
        elif suffix in DEVELOPED:
            notes[f"{suffix}: developed pictures, never raw values; left out"] += 1
        elif kind is None:
            continue
        elif kind.wants_geometry:
            notes[f"{suffix}: headerless frames, whose size and packing no file states; save them as TIFF, left out"] += 1
        elif not kind.holds_frame:
            notes[f"{suffix}: sequences or data files, no single frames; left out"] += 1
        else:
            frames.append(name)
    return CaptureFolder(
        folder, tuple(frames), tuple(tables), tuple(f"{count} × {note}" for note, count in sorted(notes.items()))
    )


def _files(folder: Path) -> Iterator[Path]:
    """Regular files, hidden ones and links to folders left out, sorted by name."""
    for place, folders, names in os.walk(folder):
        deep = len(Path(place).relative_to(folder).parts)
        folders[:] = sorted(name for name in folders if not name.startswith(".") and deep < DEEPEST)
        for name in sorted(names):
            path = Path(place) / name
            if not name.startswith(".") and path.is_file():
                yield path


def _is_text(name: str) -> bool:
    """Return whether a name can be written into a measurement file."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def read_capture(path: Path) -> RawFile:
    """Return a raw frame as it stands; InputFileError if the file holds none: a developed picture, several frames, something
    damaged."""
    content = raw_content(path)
    values = content["values"]
    seconds = content.get("exposure")
    return RawFile(
        np.ascontiguousarray(values, np.uint16),
        seconds if seconds is not None and seconds > 0 else None,
        content.get("pattern"),
        content.get("black_level"),
        content.get("white_level"),
    )


def read_spectra(folder: CaptureFolder, notes: list[str]) -> list[tuple[str, CurveTable]]:
    """Return the tables of a folder that hold spectra; `notes` gets a line for each that does not."""
    found = []
    for name in folder.tables:
        try:
            found.append((name, read_table(folder.folder / name)))
        except L3Error as error:
            if Path(name).suffix.lower() in PROSE and not _has_numbers(folder.folder / name):
                continue
            reason = str(error).removeprefix(f"{folder.folder / name}: ").partition(";")[0]
            notes.append(f"{name}: no table of spectra ({reason}); left out")
    return found


def _has_numbers(path: Path) -> bool:
    """Return whether a text has rows of numbers, so that it may be meant for a table."""
    try:
        with open(path, "rb") as stream:
            return len(FIGURES.findall(stream.read(65536))) >= 3
    except OSError:
        return True
