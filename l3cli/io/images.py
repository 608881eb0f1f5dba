"""Read pictures and linear values in any format that OpenImageIO supports."""

import contextlib
import re
from collections.abc import Iterator
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.isolated import isolated
from l3cli.io.tags import UPRIGHT, flip_of
from l3cli.system.limits import VALUE_BYTES, require_picture

EXPOSURE_TIME = "ExposureTime"  # OpenImageIO's name of the Exif tag


@isolated("OpenImageIO")
def read_image(path: Path) -> tuple[NDArray, tuple[str, ...]]:
    """Read the pixels (row, col, channel) as stored, and the names of the channels.

    Raises InputFileError if the file cannot be read.
    """
    with opened(path) as (source, spec):
        return pixels_of(path, source, spec), tuple(spec.channelnames)


@isolated("OpenImageIO")
def picture_flip(path: Path) -> int:
    """Return LibRaw's flip code that makes the stored pixels upright, from the tag Orientation."""
    with opened(path) as (_, spec):
        return flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))


@isolated("OpenImageIO")
def picture_size(path: Path) -> tuple[int, int]:
    """Return rows and columns of a picture from its header. Raises InputFileError if it has none."""
    with opened(path) as (_, spec):
        return spec.height, spec.width


def mono_of(path: Path, source: Any, spec: Any) -> tuple[NDArray[Any], float | None]:
    """Return the stored values (row, col) of a single-channel picture, 8 or 16 bits as uint16, and its exposure time (s)."""
    if spec.nchannels != 1:
        raise InputFileError(f"{path} has {spec.nchannels} channels of {spec.format}; a raw image has one channel")
    values = pixels_of(path, source, spec)[..., 0]
    if values.dtype not in (np.uint8, np.uint16):
        return values, spec.get_float_attribute(EXPOSURE_TIME, 0.0) or None
    # OpenImageIO scales depths such as 12 bits up to 16. The stored value is in the upper bits.
    depth = 8 * values.dtype.itemsize
    unused = np.uint16(depth - spec.get_int_attribute("oiio:BitsPerSample", depth))
    return values.astype(np.uint16) >> unused, spec.get_float_attribute(EXPOSURE_TIME, 0.0) or None


@contextlib.contextmanager
def opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a file with OpenImageIO, and yield its input and specification. Refuse several pictures, and too large ones."""
    with contextlib.closing(open_image(path)) as source:
        spec = source.spec()
        require_bearable(path, spec)
        require_whole_stack(path, spec, 1)
        if source.seek_subimage(1, 0):
            what = "page" if source.format_name() == "tiff" else "part"
            raise InputFileError(f"{path} has more than one {what}; give a file with one picture, or render it alone")
        source.geterror()  # clears the error that there is no second picture
        source.seek_subimage(0, 0)
        yield source, spec


def open_image(path: Path) -> Any:
    """Open a file with OpenImageIO."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputFileError(f"{path} is not an image that can be read ({_reason(oiio.geterror(), str(path))})")
    return source


def require_bearable(path: Path, spec: Any) -> None:
    """Raise InputFileError unless a picture is flat and not too large."""
    require_picture(str(path), spec.height, spec.width, spec.nchannels * max(spec.format.size() // VALUE_BYTES, 1))
    if spec.deep or spec.depth != 1:
        raise InputFileError(f"{path} is a volume or has deep samples; give a flat picture")


def require_whole_stack(path: Path, spec: Any, pages: int) -> None:
    """Raise InputFileError if a picture's description states more frames than the file has pages.

    ImageJ and tifffile may store a stack as a single page, with the other frames somewhere after it.
    """
    text = spec.get_string_attribute("ImageDescription")
    count = re.search(r"^images=([0-9]{1,9})$", text, re.MULTILINE) if text.startswith("ImageJ=") else None
    shape = re.match(r"""\{.*"shape": \[([0-9, ]{1,99})\]""", text)
    frames = int(count[1]) if count else 0
    if shape:
        lengths = [int(length) for length in shape[1].split(",") if length.strip()]
        frames = prod(lengths[:-2]) if lengths[-2:] == [spec.height, spec.width] else 0
    if frames > pages * spec.nchannels:
        have = f"{pages} page{'s' if pages > 1 else ''}"
        raise InputFileError(f"{path} describes {frames} frames but has {have}; save it with a page for each frame")


def pixels_of(path: Path, source: Any, spec: Any) -> NDArray:
    """Read the pixels (row, col, channel) of an open picture."""
    pixels = source.read_image(spec.format)
    if pixels is None:
        raise InputFileError(f"{path} is truncated or damaged ({_reason(source.geterror(), str(path))}); give a whole image")
    return pixels.reshape(spec.height, spec.width, spec.nchannels)


def _reason(message: str, name: str) -> str:
    """Return OpenImageIO's message in one line, without the file name at its beginning."""
    line = message.strip().splitlines()[0] if message.strip() else "unknown format"
    return line.removeprefix(f"{name}: ")
