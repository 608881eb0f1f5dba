"""Picture formats that are written: which suffixes there are, what they hold and what writes them. A new one is a module of
this folder and a line here.

A format's module has `encode`; it is imported when the first picture is written. Nothing in a file depends on when or where
it was made.
"""

import importlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from l3cli import __version__
from l3cli.errors import RecipeError
from l3cli.frames.frame import Shot
from l3cli.physics.display import FLOAT_BITS
from l3cli.physics.spaces import SRGB, XYZ, Space
from l3cli.system.files import write_whole

XYZ_AS_IT_IS = replace(XYZ, title="CIE XYZ", neutral=None)


@dataclass(frozen=True)
class Label:
    """Metadata of a rendered frame's file: settings of the shot, and the files that its picture was made from."""

    shot: Shot = Shot()
    exposure: float | None = None  # s
    table: str = ""  # SHA-256 of the transform table's file
    frame: str = ""  # SHA-256 of what: see `file_identity`, `values_identity`

    @property
    def software(self) -> str:
        return f"l3cli {__version__}" if self.table else ""

    @property
    def description(self) -> str:
        return f"transform table SHA-256 {self.table}, {self.frame}" if self.table else ""


NOTHING = Label()


def file_identity(digest: str) -> str:
    """Return the frame that a raw file holds alone, by the file's SHA-256."""
    return f"raw file SHA-256 {digest}"


def values_identity(digest: str) -> str:
    """Return a frame of a stack or stream, by the SHA-256 of its values, row by row, 16 bits, lower byte first."""
    return f"raw values SHA-256 {digest}"


@dataclass(frozen=True)
class Picture:
    """Content of a picture's file, upright."""

    pixels: NDArray[Any]  # (row, col, value): codes, uint8 or uint16; linear values, float32; of a raw mosaic (row, col) DN
    space: Space | None = SRGB  # of the values; None: they are no colours
    label: Label = NOTHING
    names: tuple[str, ...] = ()  # of linear values
    exposure_scale: float = 1.0  # factor of a raw picture's values for what should be shown with 1 as white


@dataclass(frozen=True)
class PictureFormat:
    """Writer of files of some suffixes."""

    suffixes: tuple[str, ...]  # in lower case
    module: str  # of this folder
    bits: tuple[int, ...] = ()  # that a code may have; FLOAT_BITS: it may hold linear values, too
    holds: str = "codes"  # "linear": always linear values; "raw": DN of a linear mosaic or picture, for raw developers

    def encode(self, path: Path, picture: Picture) -> bytes:
        """Return the bytes of a file; L3Error if the picture cannot be encoded."""
        content: bytes = self._writer.encode(path, picture)
        return content

    def make_ready(self) -> None:
        """Import what writes files."""
        self._writer  # noqa: B018

    @property
    def _writer(self) -> Any:
        return importlib.import_module(f"l3cli.io.pictures.{self.module}")


FORMATS = (
    PictureFormat((".png",), "openimageio", (8, 16)),
    PictureFormat((".tif", ".tiff"), "openimageio", (8, 16, FLOAT_BITS)),
    PictureFormat((".jpg", ".jpeg"), "openimageio", (8,)),
    PictureFormat((".jxl",), "openimageio", (8, 16)),
    PictureFormat((".exr",), "openimageio", holds="linear"),
    PictureFormat((".dng",), "dng", holds="raw"),
)
BY_SUFFIX = {suffix: each for each in FORMATS for suffix in each.suffixes}


def suffixes(holds: str) -> tuple[str, ...]:
    """Return the suffixes of files that hold "codes", "linear" values or "raw" ones."""
    return tuple(suffix for suffix, each in BY_SUFFIX.items() if each.holds == holds)


def format_of(path: Path, bits: int) -> PictureFormat:
    """Return the format of a file of this name; RecipeError if none can be written, or not with `bits` bits a value."""
    kind = BY_SUFFIX.get(path.suffix.lower())
    if kind is None:
        codes, linear, raw = (", ".join(suffixes(holds)) for holds in ("codes", "linear", "raw"))
        raise RecipeError(f"{path}: pictures are written as {codes}, linear outputs as {linear}, raw ones as {raw}")
    if kind.holds == "raw" and bits == FLOAT_BITS:
        raise RecipeError(f"{path}: a {path.suffix[1:].upper()} file holds 16 bits a value; leave ‹bits› out")
    if kind.holds == "codes" and bits not in kind.bits:
        held, cure = " or ".join(map(str, kind.bits)), ".tif or .exr" if bits == FLOAT_BITS else ".png or .tif"
        raise RecipeError(f"{path}: {path.suffix} holds {held} bits a value, not {bits}; use {cure}")
    return kind


def holds_linear(path: Path, bits: int = 8) -> bool:
    """Return whether a file of this name and depth holds linear values rather than the codes of a picture."""
    return bits == FLOAT_BITS or path.suffix.lower() in suffixes("linear")


def holds_raw(path: Path) -> bool:
    """Return whether a file of this name is for raw developers."""
    return path.suffix.lower() in suffixes("raw")


def picture_file(path: Path, picture: Picture) -> bytes:
    """Return the bytes of a picture's file, of the format of its suffix."""
    dtype = picture.pixels.dtype
    return format_of(path, FLOAT_BITS if dtype.kind == "f" else 8 * dtype.itemsize).encode(path, picture)


def write_picture(path: Path, pixels: NDArray[Any], names: tuple[str, ...] = ()) -> None:
    """Write codes of sRGB (row, col, 3), uint8 or uint16, to a file of the format of its suffix; or linear values (row, col,
    value), float32, that are called `names`."""
    space = None if pixels.dtype.kind == "f" else SRGB
    write_whole(path, picture_file(path, Picture(pixels, XYZ_AS_IT_IS if names == ("X", "Y", "Z") else space, names=names)))
