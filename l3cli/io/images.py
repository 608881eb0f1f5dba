"""Read pictures in any format that OpenImageIO supports."""

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
    """Read a picture's pixels, (row, col, channel), in the stored data type, and its channel names.

    Raises InputFileError if the file cannot be read, is too large, or contains several pictures. If the file is not a
    picture, the message ends with `cure`, the suggested correction.
    """
    with opened(path, cure) as (source, spec):
        return pixels_of(path, source, spec), tuple(spec.channelnames)


@isolated("OpenImageIO")
def picture_flip(path: Path) -> int:
    """Return the LibRaw flip code that turns a picture's stored pixels upright."""
    with opened(path) as (_, spec):
        return flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))


@isolated("OpenImageIO")
def picture_size(path: Path) -> tuple[int, int]:
    """Return the number of rows and columns in a picture's header. Raises InputFileError if the header is invalid."""
    with opened(path, USE_PICTURE) as (_, spec):
        return spec.height, spec.width


def mono_of(path: Path, source: Any, spec: Any) -> tuple[NDArray[Any], float | None]:
    """Return the stored values, (row, col), and the exposure time in s of a single-channel picture.

    Integers of up to 16 bits are returned as uint16. The exposure time is None if the file does not contain it. Raises
    InputFileError if the picture has several channels.
    """
    if spec.nchannels != 1:
        raise InputFileError(
            f"{path} has {spec.nchannels} channels of {spec.format}, but a raw image has one channel; use a raw file"
        )
    values = pixels_of(path, source, spec)[..., 0]
    if values.dtype not in (np.uint8, np.uint16):
        return values, spec.get_float_attribute(EXPOSURE_TIME, 0.0) or None
    # OpenImageIO scales, for example, 12-bit values to 16 bits. The upper 12 bits are the stored value.
    depth = 8 * values.dtype.itemsize
    unused = np.uint16(depth - spec.get_int_attribute("oiio:BitsPerSample", depth))
    return values.astype(np.uint16) >> unused, spec.get_float_attribute(EXPOSURE_TIME, 0.0) or None


@contextlib.contextmanager
def opened(path: Path, cure: str = USE_RAW) -> Iterator[tuple[Any, Any]]:
    """Context manager that opens a picture with OpenImageIO and yields its ImageInput and ImageSpec.

    Raises InputFileError if OpenImageIO cannot read the file, if the picture is too large, or if the file contains several
    pictures. If the file is not a picture, the message ends with `cure`, the suggested correction.
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
        source.geterror()  # clear the error about the missing second picture
        source.seek_subimage(0, 0)
        yield source, spec


def open_image(path: Path, cure: str = USE_RAW) -> Any:
    """Open a file with OpenImageIO, and return its ImageInput.

    If this fails, raises InputFileError with a message that ends with `cure`, the suggested correction.
    """
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise InputFileError(f"{path} is not a picture that l3 can read ({_reason(oiio.geterror(), str(path))}); {cure}")
    return source


def require_bearable(path: Path, spec: Any) -> None:
    """Raise InputFileError if the picture with the ImageSpec `spec` is too large, is a volume, or has deep samples."""
    require_picture(str(path), spec.height, spec.width, spec.nchannels * max(spec.format.size() // VALUE_BYTES, 1))
    if spec.deep or spec.depth != 1:
        raise InputFileError(
            f"{path} is a volume or has deep samples; use a two-dimensional picture with one value per pixel and channel"
        )


def require_whole_stack(path: Path, spec: Any, pages: int) -> None:
    """Raise InputFileError if a TIFF file has fewer pages than the number of frames in its description.

    ImageJ and tifffile may store only the first frame of a stack as a page, and append all other frames without page
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
            f"{path} has only {have}, but {frames} frames according to its description; save each frame as a separate page"
        )


def pixels_of(path: Path, source: Any, spec: Any) -> NDArray:
    """Read an open picture's pixels, (row, col, channel), in the stored data type.

    Raises InputFileError if the file is truncated or damaged.
    """
    pixels = source.read_image(spec.format)
    if pixels is None:
        raise InputFileError(
            f"{path} is truncated or damaged ({_reason(source.geterror(), str(path))}); copy the file again"
        )
    return pixels.reshape(spec.height, spec.width, spec.nchannels)


def _reason(message: str, name: str) -> str:
    """Return the first line of an OpenImageIO error message, without the leading file name."""
    line = message.strip().splitlines()[0] if message.strip() else "unknown format"
    return line.removeprefix(f"{name}: ")
