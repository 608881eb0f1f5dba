"""The raw formats: which suffixes there are, what reads them, what must be known before, and what a reader returns. A new
one is a module of this folder and a line here.

A format's module has `read`, and `stack`, `rate` and `is_plain` where its line says so; it is imported when the first file
is read.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.video import Stated
from l3cli.system.files import naming

if TYPE_CHECKING:
    from l3cli.io.raw.headerless import Layout


class RawContent(TypedDict):
    """One frame; the table says what its file does not."""

    values: NDArray[np.unsignedinteger]  # (row, col) DN of at most 16 bits, without masked borders
    black_level: NotRequired[float]  # DN
    white_level: NotRequired[float]  # DN
    pattern: NotRequired[NDArray[np.int64]]  # (row, col) colour codes of the CFA, from pixel (0, 0) on
    orientation: NotRequired[int]  # LibRaw's flip code
    exposure: NotRequired[float | None]  # s
    neutral: NotRequired[NDArray[np.float64] | None]  # (colour, 2) code of the CFA and what it gives of a grey, of any scale
    camera: NotRequired[list[str]]  # make and model, and other names of the camera that took it
    shot: NotRequired[dict[str, str | float]]  # fields of Shot, as far as they are stated
    gain: NotRequired[NDArray[np.float32]]  # (row, col) that the file wants its values above black to be multiplied by
    notes: NotRequired[tuple[str, ...]]  # what of the file's wishes is not carried out
    exchangeable: NotRequired[bool]  # whether rows and columns, which the caller says, would fit the file exchanged, too


@dataclass(frozen=True)
class MultiFrameFile:
    """The frames of one file, each read when it is wanted."""

    count: int | None  # None: a stream, read in order until there is no more
    read: Callable[[int], RawContent | None]  # by number, from 0; None: the stream ended before
    unit: str = "frame"  # what messages call one frame
    first: int = 0  # the number that messages give the first frame
    rate: Fraction | None = None  # frames a second, where the file states them
    times: Stated | None = None  # when its frames are shown, where the file states that of each
    numbered: bool = True  # whether a picture's name has the frame's number even where there is one alone

    def name(self, number: int) -> str:
        """Return the name of a frame for messages."""
        return f"{self.unit} {self.first + number}"


class InOrder:
    """Reads a stream frame by frame, each number after the one before it; frames between are passed over."""

    def __init__(self, following: Callable[[], NDArray | None], exchangeable: bool = False) -> None:
        self._following = following  # the next frame's pixels; None at the end
        self._exchangeable = exchangeable
        self._next = 0

    def read(self, number: int) -> RawContent | None:
        pixels: NDArray | None = None
        while self._next <= number:
            self._next += 1  # before reading: a frame that fails has been passed
            try:
                pixels = self._following()
            except InputFileError as error:
                if self._next <= number:
                    continue  # nobody wants it
                raise InputFileError(f"frame {number}: {error}") from error
            if pixels is None:
                return None
        return None if pixels is None else RawContent(values=pixels, exchangeable=self._exchangeable)


@dataclass(frozen=True)
class RawFormat:
    """Reader of files of some suffixes."""

    suffixes: tuple[str, ...]  # in lower case
    module: str  # of this folder
    holds_frame: bool = True  # False: such a file is a sequence, never a frame
    stackable: bool = False  # may hold several frames
    isolated: bool = True  # decoded in an isolated process
    has_plain: bool = False  # its module's `is_plain` excepts files that are simple enough to be read here
    wants_geometry: bool = False  # `read` and `stack` take a layout
    wants_dataset: bool = False  # `stack` takes the name of an array
    has_rate: bool = False  # a file of one frame may state the frames a second of its sequence

    def read(self, path: Path, layout: "Layout | None" = None) -> RawContent:
        """Return the frame of a file that holds one; InputFileError if it does not."""
        with naming(path):
            content: RawContent = self._reader.read(path, *([layout] if self.wants_geometry else []))
            return content

    def stack(self, path: Path, layout: "Layout | None" = None, dataset: str | None = None) -> MultiFrameFile | None:
        """Return the frames of a file that holds several, in an HDF5 file of the array `dataset`, None: the only one; None
        if it holds one frame, which may be broken."""
        wanted = [layout] if self.wants_geometry else [dataset] if self.wants_dataset else []
        with naming(path):
            return self._reader.stack(path, *wanted) if self.stackable else None

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
HEADERLESS = (".raw", ".bin", ".raw10", ".raw12")
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
