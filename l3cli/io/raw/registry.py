"""The raw formats: which suffixes there are, what reads them, and what must be known before. A new one is a module of this
folder and a line here.

A format's module has `read`, and `stack` and `rate` where its line says so; it is imported when the first file is read.
"""

import importlib
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from l3cli.io.raw.content import MultiFrameFile, RawContent, Request
from l3cli.io.raw.packed import PACKED


@dataclass(frozen=True)
class RawFormat:
    """Reader of files of some suffixes."""

    suffixes: tuple[str, ...]  # in lower case
    module: str  # of this folder
    holds_frame: bool = True  # False: such a file is a sequence, never a frame
    stackable: bool = False  # may hold several frames
    isolated: bool = True  # decoded in an isolated process
    has_plain: bool = False  # its module's `is_plain` excepts files that are simple enough to be read here
    wants_geometry: bool = False  # Request.layout
    wants_dataset: bool = False  # Request.dataset
    has_rate: bool = False  # a file of one frame may state the frames a second of its sequence

    def read(self, path: Path, request: Request) -> RawContent:
        """Return the frame of a file that holds one; InputFileError if it does not."""
        content: RawContent = self._reader.read(path, request)
        return content

    def stack(self, path: Path, request: Request) -> MultiFrameFile | None:
        """Return the frames of a file that holds several; None if it holds one, which may be broken."""
        return self._reader.stack(path, request) if self.stackable else None

    def rate(self, path: Path) -> Fraction | None:
        """Return the frames a second that a file of one frame states."""
        return self._reader.rate(path) if self.has_rate else None

    def is_plain(self, path: Path) -> bool:
        """Return whether a file is simple enough to be read in this process."""
        return self.has_plain and self._reader.is_plain(path)

    @property
    def _reader(self) -> Any:
        return importlib.import_module(f"l3cli.io.raw.{self.module}")


CAMERA_RAW = RawFormat(
    tuple(
        "." + name for name in ("3fr", "ari", "arw", "cr2", "cr3", "dcr", "erf", "fff", "iiq", "kdc", "mos", "mrw")
        + ("nef", "nrw", "orf", "pef", "raf", "rw2", "rwl", "srw", "x3f")
    ),
    "libraw",
)  # fmt: skip
HEADERLESS = (".raw", ".bin", *("." + packing for packing in PACKED))
FORMATS = (
    RawFormat((".tif", ".tiff"), "tiff", stackable=True, has_plain=True),
    RawFormat((".png",), "tiff"),
    RawFormat((".pgm",), "pgm", isolated=False),
    RawFormat((".npy",), "npy", stackable=True, isolated=False),
    RawFormat(HEADERLESS, "headerless", stackable=True, isolated=False, wants_geometry=True),
    RawFormat((".fits", ".fit", ".fts"), "fits", stackable=True),
    RawFormat((".h5", ".hdf5", ".hdf"), "hdf5", holds_frame=False, stackable=True, wants_dataset=True),
    RawFormat((".mkv", ".mov", ".mp4", ".avi"), "video", holds_frame=False, stackable=True),
    RawFormat((".dng",), "dng", has_rate=True),
    CAMERA_RAW,
)
PHOTOS = (".dng", *CAMERA_RAW.suffixes)
BY_SUFFIX = {suffix: each for each in FORMATS for suffix in each.suffixes}


def format_of(path: Path) -> RawFormat:
    """Return the format that a file's suffix names; of other suffixes that of camera raws, which LibRaw knows by their
    content."""
    return BY_SUFFIX.get(path.suffix.lower(), CAMERA_RAW)


def is_frame(path: Path) -> bool:
    """Return whether a folder's file of this name is taken for a raw frame."""
    return path.suffix.lower() in BY_SUFFIX and format_of(path).holds_frame


def is_photo(path: Path) -> bool:
    """Return True for a name of a DNG or of a camera's own raw file, which say which camera took them."""
    return path.suffix.lower() in PHOTOS


def needs_isolation(path: Path) -> bool:
    """Return whether a file is decoded in an isolated process; a name without suffix, of a folder or of stdin, does not
    tell."""
    kind = format_of(path)
    return bool(path.suffix) and kind.isolated and not kind.is_plain(path)
