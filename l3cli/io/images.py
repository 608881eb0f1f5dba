"""Read pictures in any format that OpenImageIO supports, including pictures with linear values."""

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

EXPOSURE_TIME = "ExposureTime"  # name of the Exif tag in OpenImageIO
USE_PICTURE, USE_RAW = "use a TIFF, PNG or OpenEXR file", "use a TIFF or PNG file"  # ends of messages about unreadable files


@isolated("OpenImageIO")
def read_image(path: Path, cure: str = USE_PICTURE) -> tuple[NDArray, tuple[str, ...]]:
    """Read the pixels (row, col, channel) of a picture in the stored data type, and the names of its channels.

    Raises InputFileError if the file cannot be read, is too large, or contains several pictures. If the file is not a
    picture, the message ends with `cure`.
    """
    with opened(path, cure) as (source, spec):
        return pixels_of(path, source, spec), tuple(spec.channelnames)


@isolated("OpenImageIO")
def picture_flip(path: Path) -> int:
    """Read the orientation of a picture, and return the LibRaw flip code that makes the stored pixels upright."""
    with opened(path) as (_, spec):
        return flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))


@isolated("OpenImageIO")
def picture_size(path: Path) -> tuple[int, int]:
    """Read the numbers of rows and columns from the header of a picture. Raises InputFileError if the header is invalid."""
    with opened(path, USE_PICTURE) as (_, spec):
        return spec.height, spec.width


def mono_of(path: Path, source: Any, spec: Any) -> tuple[NDArray[Any], float | None]:
    """Return the stored values (row, col) of a single-channel picture, and its exposure time in s.

    Values with up to 16 bits are returned as uint16. The exposure time is None if the file does not state it. Raises
    InputFileError if the picture has several channels.
    """
    if spec.nchannels != 1:
        raise InputFileError(
            f"{path} has {spec.nchannels} channels of {spec.format}, but a raw image has one channel; use a raw file"
        )
    values = pixels_of(path, source, spec)[..., 0]
    if values.dtype not in (np.uint8, np.uint16):
        return values, spec.get_float_attribute(EXPOSURE_TIME, 0.0) or None
    # OpenImageIO scales 12-bit values, for example, to 16 bits. The upper 12 bits are then the stored value.
    depth = 8 * values.dtype.itemsize
    unused = np.uint16(depth - spec.get_int_attribute("oiio:BitsPerSample", depth))
    return values.astype(np.uint16) >> unused, spec.get_float_attribute(EXPOSURE_TIME, 0.0) or None


@contextlib.contextmanager
def opened(path: Path, cure: str = USE_RAW) -> Iterator[tuple[Any, Any]]:
    """Open a picture with OpenImageIO, and yield its ImageInput and ImageSpec. The file is closed after the block.

    Raises InputFileError if OpenImageIO cannot read the file, or if the file contains several pictures or a picture that is
    too large. If the file is not a picture, the message ends with `cure`.
    """
    with contextlib.closing(open_image(path, cure)) as source:
        spec = source.spec()
        require_bearable(path, spec)
        require_whole_stack(path, spec, 1)
        if source.seek_subimage(1, 0):
            what = "page" if source.format_name() == "tiff" else "part"
            raise InputFileError(
                f"{path} has more than one {what}; use files with one picture, or specify this file as the only input"
            )
        source.geterror()  # clears the error that the file has no second picture
        source.seek_subimage(0, 0)
        yield source, spec


def open_image(path: Path, cure: str = USE_RAW) -> Any:
    """Return the OpenImageIO ImageInput of a file.

    Raises InputFileError, with a message that ends with `cure`, if OpenImageIO cannot read the file.
    """
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputFileError(f"{path} is not a picture that l3 can read ({_reason(oiio.geterror(), str(path))}); {cure}")
    return source


def require_bearable(path: Path, spec: Any) -> None:
    """Raise InputFileError if a picture is too large, is a volume, or has deep samples.

    `spec` is the ImageSpec of the picture.
    """
    require_picture(str(path), spec.height, spec.width, spec.nchannels * max(spec.format.size() // VALUE_BYTES, 1))
    if spec.deep or spec.depth != 1:
        raise InputFileError(
            f"{path} is a volume or has deep samples; use a two-dimensional picture with one value per pixel and channel"
        )


def require_whole_stack(path: Path, spec: Any, pages: int) -> None:
    """Raise InputFileError if the description of a TIFF file states more frames than the file has pages.

    ImageJ and tifffile may store only the first frame of a stack as a page, and append the other frames without page
    headers.
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
        raise InputFileError(
            f"{path} has only {have}, but its description states {frames} frames; save each frame as a separate page"
        )


def pixels_of(path: Path, source: Any, spec: Any) -> NDArray:
    """Read the pixels (row, col, channel) of an open picture in the stored data type.

    Raises InputFileError if the file is truncated or damaged.
    """
    pixels = source.read_image(spec.format)
    if pixels is None:
        raise InputFileError(
            f"{path} is truncated or damaged ({_reason(source.geterror(), str(path))}); copy the file again"
        )
    return pixels.reshape(spec.height, spec.width, spec.nchannels)


def _reason(message: str, name: str) -> str:
    """Return the first line of an OpenImageIO error message, without the file name at the beginning."""
    line = message.strip().splitlines()[0] if message.strip() else "unknown format"
    return line.removeprefix(f"{name}: ")
