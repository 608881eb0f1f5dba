"""The picture formats that l3 writes, with their suffixes, contents and modules.

To add a format, write a module with a function `encode` in this folder, and add a line to FORMATS. l3 imports the module
when it writes the first picture in this format. The bytes of a file must not depend on the time or on its folder.
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

UNADAPTED_XYZ = replace(XYZ, title="CIE XYZ", neutral=None)


@dataclass(frozen=True)
class Label:
    """Metadata of a rendered frame: the camera settings, and which transform table and raw frame it was rendered from."""

    shot: Shot = Shot()
    exposure: float | None = None  # exposure time in s; None if unknown
    table: str = ""  # SHA-256 digest of the transform table's file
    frame: str = ""  # identity of the raw frame: the result of `file_identity` or `values_identity`

    @property
    def software(self) -> str:
        return f"l3cli {__version__}" if self.table else ""

    @property
    def description(self) -> str:
        return f"transform table SHA-256 {self.table}, {self.frame}" if self.table else ""


NOTHING = Label()


def file_identity(digest: str) -> str:
    """Return text that identifies the frame in a single-frame raw file by the file's SHA-256 digest."""
    return f"raw file SHA-256 {digest}"


def values_identity(digest: str) -> str:
    """Return text that identifies a frame in a stack or stream by the SHA-256 digest of its pixel values.

    The digest is computed from the values as little-endian 16-bit integers in row-major order.
    """
    return f"raw values SHA-256 {digest}"


@dataclass(frozen=True)
class Picture:
    """Content of a picture file, in upright orientation."""

    # (row, col, value): codes (uint8 or uint16) or linear values (float32), or a mosaic, (row, col), in DN
    pixels: NDArray[Any]
    space: Space | None = SRGB  # colour space of the values; None if the values are not colours
    label: Label = NOTHING
    names: tuple[str, ...] = ()  # names of the linear values of a pixel, such as X, Y and Z
    exposure_scale: float = 1.0  # factor that converts linear values in a raw file to display values, where 1 is white


@dataclass(frozen=True)
class PictureFormat:
    """A picture format that l3 writes."""

    suffixes: tuple[str, ...]  # file suffixes in lower case
    module: str  # module in this folder that encodes files
    bits: tuple[int, ...] = ()  # supported bits per value; FLOAT_BITS means that the format also supports linear values
    holds: str = "codes"  # content of the files: "codes", "linear" (linear values only) or "raw" (DN for raw converters)

    def encode(self, path: Path, picture: Picture) -> bytes:
        """Encode a picture for the file `path`. Raises L3Error if the picture cannot be encoded."""
        content: bytes = self._writer.encode(path, picture)
        return content

    def make_ready(self) -> None:
        """Import the encoder in advance, so that the import does not delay the first picture."""
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
    """Return the suffixes of all formats for one type of content: "codes", "linear" or "raw"."""
    return tuple(suffix for suffix, each in BY_SUFFIX.items() if each.holds == holds)


def format_of(path: Path, bits: int) -> PictureFormat:
    """Return the picture format for a file suffix.

    Raises RecipeError if the suffix is unknown, or if the format does not support this number of bits per value.
    """
    kind = BY_SUFFIX.get(path.suffix.lower())
    if kind is None:
        codes, linear, raw = (", ".join(suffixes(holds)) for holds in ("codes", "linear", "raw"))
        raise RecipeError(
            f'{path} has the unsupported suffix "{path.suffix}"; use {codes} for pictures, {linear} for linear outputs, '
            f"or {raw} for raw converters"
        )
    if kind.holds == "raw" and bits == FLOAT_BITS:
        raise RecipeError(f"{path}: a {path.suffix[1:].upper()} file always has 16 bits per value; remove ‹bits›")
    if kind.holds == "codes" and bits not in kind.bits:
        depths, cure = " or ".join(map(str, kind.bits)), ".tif or .exr" if bits == FLOAT_BITS else ".png or .tif"
        raise RecipeError(f"{path}: {path.suffix} files have {depths} bits per value, not {bits}; use {cure}")
    return kind


def holds_linear(path: Path, bits: int = 8) -> bool:
    """Return whether a file with this suffix and this number of bits per value contains linear values instead of codes."""
    return bits == FLOAT_BITS or path.suffix.lower() in suffixes("linear")


def holds_raw(path: Path) -> bool:
    """Return whether a file suffix selects a format for raw converters."""
    return path.suffix.lower() in suffixes("raw")


def picture_file(path: Path, picture: Picture) -> bytes:
    """Encode a picture in the format that the suffix of `path` selects.

    Raises RecipeError if the format does not support the data type, and L3Error if the picture cannot be encoded.
    """
    dtype = picture.pixels.dtype
    return format_of(path, FLOAT_BITS if dtype.kind == "f" else 8 * dtype.itemsize).encode(path, picture)


def write_picture(path: Path, pixels: NDArray[Any], names: tuple[str, ...] = ()) -> None:
    """Write a picture without metadata, replacing an existing file.

    Parameters
    ----------
    path : Path
        The file, whose suffix selects the format.
    pixels : ndarray
        sRGB codes, (row, col, 3), as uint8 or uint16, or linear values, (row, col, value), as float32.
    names : tuple of str
        Names of the linear values of a pixel, such as X, Y and Z.
    """
    space = UNADAPTED_XYZ if names == ("X", "Y", "Z") else None if pixels.dtype.kind == "f" else SRGB
    write_whole(path, picture_file(path, Picture(pixels, space, names=names)))
