"""The picture formats that l3 writes: their suffixes, contents and modules.

To add a format, write a module with a function `encode` in this folder, and add a line to FORMATS. The module is imported
when the first picture is written. The bytes of a file must not depend on time or place.
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
    """Metadata for the file of a rendered frame: settings of the shot, and the files from which the picture was made."""

    shot: Shot = Shot()
    exposure: float | None = None  # s
    table: str = ""  # SHA-256 of the transform table's file
    frame: str = ""  # identity of the frame: `file_identity` or `values_identity`

    @property
    def software(self) -> str:
        return f"l3cli {__version__}" if self.table else ""

    @property
    def description(self) -> str:
        return f"transform table SHA-256 {self.table}, {self.frame}" if self.table else ""


NOTHING = Label()


def file_identity(digest: str) -> str:
    """Describe the only frame of a raw file by the SHA-256 of the file."""
    return f"raw file SHA-256 {digest}"


def values_identity(digest: str) -> str:
    """Describe a frame of a stack or stream by the SHA-256 of its values (16 bits, little-endian, row by row)."""
    return f"raw values SHA-256 {digest}"


@dataclass(frozen=True)
class Picture:
    """Contents of a picture file, in upright orientation."""

    pixels: NDArray[Any]  # (row, col, value): codes (uint8, uint16) or linear values (float32); or a mosaic (row, col) in DN
    space: Space | None = SRGB  # colour space of the values; None if they are not colours
    label: Label = NOTHING
    names: tuple[str, ...] = ()  # names of linear values
    exposure_scale: float = 1.0  # factor that scales a raw picture for display, with white at 1


@dataclass(frozen=True)
class PictureFormat:
    """A picture format that l3 writes."""

    suffixes: tuple[str, ...]  # in lower case
    module: str  # module in this folder
    bits: tuple[int, ...] = ()  # possible bits per code; includes FLOAT_BITS if linear values are also possible
    holds: str = "codes"  # or "linear" for linear values only, or "raw" for DN for raw converters

    def encode(self, path: Path, picture: Picture) -> bytes:
        """Return the bytes of a file. Raises L3Error if the picture cannot be encoded."""
        content: bytes = self._writer.encode(path, picture)
        return content

    def make_ready(self) -> None:
        """Import the module that writes files."""
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
    """Return the suffixes of files with the given contents: "codes", "linear" or "raw"."""
    return tuple(suffix for suffix, each in BY_SUFFIX.items() if each.holds == holds)


def format_of(path: Path, bits: int) -> PictureFormat:
    """Return the format for a file name. Raises RecipeError if it does not exist or does not support `bits`."""
    kind = BY_SUFFIX.get(path.suffix.lower())
    if kind is None:
        codes, linear, raw = (", ".join(suffixes(holds)) for holds in ("codes", "linear", "raw"))
        raise RecipeError(f"{path}: pictures are written as {codes}, linear outputs as {linear}, raw ones as {raw}")
    if kind.holds == "raw" and bits == FLOAT_BITS:
        raise RecipeError(f"{path}: a {path.suffix[1:].upper()} file has 16 bits per value; leave ‹bits› out")
    if kind.holds == "codes" and bits not in kind.bits:
        held, cure = " or ".join(map(str, kind.bits)), ".tif or .exr" if bits == FLOAT_BITS else ".png or .tif"
        raise RecipeError(f"{path}: {path.suffix} has {held} bits per value, not {bits}; use {cure}")
    return kind


def holds_linear(path: Path, bits: int = 8) -> bool:
    """Whether a file with this name and bit depth contains linear values rather than codes."""
    return bits == FLOAT_BITS or path.suffix.lower() in suffixes("linear")


def holds_raw(path: Path) -> bool:
    """Whether a file with this name is for raw converters."""
    return path.suffix.lower() in suffixes("raw")


def picture_file(path: Path, picture: Picture) -> bytes:
    """Return the bytes of the file of a picture, in the format that belongs to the suffix."""
    dtype = picture.pixels.dtype
    return format_of(path, FLOAT_BITS if dtype.kind == "f" else 8 * dtype.itemsize).encode(path, picture)


def write_picture(path: Path, pixels: NDArray[Any], names: tuple[str, ...] = ()) -> None:
    """Write a picture to a file, in the format that belongs to the suffix.

    Parameters
    ----------
    path : Path
        The file.
    pixels : ndarray
        sRGB codes (row, col, 3), uint8 or uint16, or linear values (row, col, value), float32.
    names : tuple of str
        Names of linear values.
    """
    space = None if pixels.dtype.kind == "f" else SRGB
    write_whole(path, picture_file(path, Picture(pixels, XYZ_AS_IT_IS if names == ("X", "Y", "Z") else space, names=names)))
