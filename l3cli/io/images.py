"""Pictures (PNG, TIFF, JPEG, JPEG XL: codes) and linear values (EXR, TIFF) to files and back, all through OpenImageIO."""

import contextlib
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.io.icc import icc_profile
from l3cli.io.isolated import isolated
from l3cli.io.label import NOTHING, Label
from l3cli.io.names import named_in_utf8
from l3cli.io.raw.tiff_tags import UPRIGHT, flip_of
from l3cli.physics.spaces import SRGB, XYZ, Space
from l3cli.system.files import write_whole
from l3cli.system.limits import VALUE_BYTES, require_picture
from l3cli.system.signals import uninterrupted

PICTURES = {  # bits each may hold; 32: floating point
    ".png": (8, 16),
    ".tif": (8, 16, 32),
    ".tiff": (8, 16, 32),
    ".jpg": (8,),
    ".jpeg": (8,),
    ".jxl": (8, 16),
}
LINEAR = ".exr"
JPEG_XL = ".jxl"
RAW = ".dng"  # raw/developed.py
FLOAT_BITS = 32
# Noise hardly shrinks: what packs tightest takes seven times as long for a tenth of the size.
COMPRESSION: dict[str, dict[str, str | int]] = {
    # Differences to the mean of two neighbours: hardly any of their strings come again, and to look for them takes long.
    ".png": {"compression": "rle", "png:compressionLevel": 1, "png:filter": 64},
    ".tif": {"compression": "none"},
    ".tiff": {"compression": "none"},
    ".jpg": {"Compression": "jpeg:95", "jpeg:subsampling": "4:4:4"},
    ".jpeg": {"Compression": "jpeg:95", "jpeg:subsampling": "4:4:4"},
    ".jxl": {"compression": "lossless", "jpegxl:effort": 1},
}
XYZ_AS_IT_IS = replace(XYZ, title="CIE XYZ", neutral=None)
EXIF_SRGB, EXIF_OTHER = 1, 65535  # values of Exif's ColorSpace
EXPOSURE_TIME = "ExposureTime"  # OpenImageIO's name of the Exif tag


def is_linear(path: Path, bits: int = 8) -> bool:
    """Return whether a file of this name and depth holds linear values rather than the codes of a picture."""
    return path.suffix.lower() == LINEAR or bits == FLOAT_BITS


def check_format(path: Path, bits: int) -> None:
    """Raise RecipeError if no file of this name can be written, or not with `bits` bits a value."""
    if path.suffix.lower() == LINEAR or (path.suffix.lower() == RAW and bits != FLOAT_BITS):
        return
    if path.suffix.lower() == RAW:
        raise RecipeError(f"{path}: a DNG file holds 16 bits a value; leave ‹bits› out")
    depths = PICTURES.get(path.suffix.lower())
    if depths is None:
        raise RecipeError(
            f"{path}: pictures are written as {', '.join(PICTURES)}, linear outputs as {LINEAR}, raw ones as {RAW}"
        )
    if bits not in depths:
        held, cure = " or ".join(map(str, depths)), ".tif or .exr" if bits == FLOAT_BITS else ".png or .tif"
        raise RecipeError(f"{path}: {path.suffix} holds {held} bits a value, not {bits}; use {cure}")


def make_ready(suffix: str) -> None:
    """Import what writes files of a suffix."""
    if suffix.lower() != RAW:
        import OpenImageIO  # noqa: F401


def write_picture(path: Path, picture: NDArray) -> None:
    """Encoded sRGB (row, col, 3), uint8 or uint16, to a file of the format of its suffix, tagged as sRGB."""
    write_whole(path, picture_file(path, picture))


def picture_file(path: Path, picture: NDArray, space: Space = SRGB, label: Label = NOTHING) -> bytes:
    """Return the file of a picture (row, col, 3), uint8 or uint16, encoded in a space, whose profile it carries, and its
    label."""
    import OpenImageIO as oiio

    check_format(path, 8 * picture.dtype.itemsize)
    rows, cols, channels = picture.shape
    spec = oiio.ImageSpec(cols, rows, channels, str(picture.dtype))
    _add_profile(spec, space, with_name=path.suffix.lower() != ".png")  # a PNG file has a profile or a name
    _add_label(spec, label)
    for name, value in COMPRESSION[path.suffix.lower()].items():
        spec.attribute(name, value)
    content = encoded(path.name, spec, picture)
    if path.suffix.lower() == JPEG_XL and label != NOTHING:
        packet = label.xmp.encode()
        content += struct.pack(">I4s", 8 + len(packet), b"xml ") + packet  # a box like the others of the file
    return content


def write_linear(path: Path, pixels: NDArray[np.float32], names: tuple[str, ...]) -> None:
    """Linear outputs (row, col, output) to an EXR file of float channels called `names`."""
    write_whole(path, linear_file(path, pixels, names, XYZ_AS_IT_IS if names == ("X", "Y", "Z") else None))


def linear_file(
    path: Path, pixels: NDArray[np.float32], names: tuple[str, ...], space: Space | None, label: Label = NOTHING
) -> bytes:
    """Return the EXR or TIFF file of linear values (row, col, value) called `names`; `space`: what they say of colours."""
    import OpenImageIO as oiio

    rows, cols, outputs = pixels.shape
    spec = oiio.ImageSpec(cols, rows, outputs, "float")
    spec.channelnames, spec.alpha_channel = names, -1
    spec.attribute("compression", "none")
    _add_label(spec, label)
    if space is not None and path.suffix.lower() != LINEAR:
        _add_profile(spec, space, with_name=False)
    elif space is not None:
        chromaticities = [value for point in (*space.primaries, space.white) for value in point]
        spec.attribute("chromaticities", oiio.TypeDesc("float[8]"), chromaticities)
        if space.neutral:
            spec.attribute("adoptedNeutral", oiio.TypeDesc("float[2]"), space.neutral)
    return encoded(path.name, spec, pixels)


def _add_profile(spec: Any, space: Space, with_name: bool) -> None:
    """The profile of a space; of sRGB also its name, for those who look for that."""
    import OpenImageIO as oiio

    spec.attribute("oiio:ColorSpace", "sRGB" if space == SRGB and with_name else "data")  # else it is taken for sRGB
    spec.attribute("Exif:ColorSpace", EXIF_SRGB if space == SRGB else EXIF_OTHER)
    profile = icc_profile(space)
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, np.uint8))


def _add_label(spec: Any, label: Label) -> None:
    shot = label.shot
    numbers = {EXPOSURE_TIME: label.exposure, "FNumber": shot.f_number, "Exif:FocalLength": shot.focal_length}
    texts = {"Make": shot.make, "Model": shot.model, "Exif:LensModel": shot.lens, "Exif:DateTimeOriginal": shot.date}
    for name, value in {**numbers, **texts, "Software": label.software, "ImageDescription": label.description}.items():
        if value:
            spec.attribute(name, value)
    if shot.iso:
        spec.attribute("Exif:PhotographicSensitivity", min(round(shot.iso), 65535))  # of 16 bits, as Exif has it
        spec.attribute("Exif:ISOSpeed", round(shot.iso))  # OpenImageIO writes the other one into no TIFF


def write_mosaic(path: Path, values: NDArray[np.uint16], exposure: float | None = None) -> None:
    """A raw mosaic (row, col) in DN as an uncompressed 16-bit mono TIFF, with its exposure time (s) if that is known."""
    import OpenImageIO as oiio

    spec = oiio.ImageSpec(values.shape[1], values.shape[0], 1, "uint16")
    spec.attribute("compression", "none")
    if exposure:
        spec.attribute(EXPOSURE_TIME, exposure)
    write_whole(path, encoded(path.name, spec, values[..., None]))


def jpeg(picture: NDArray[np.uint8], quality: int) -> bytes:
    """Return the bytes of a JPEG file of sRGB codes (row, col, 3), `quality` 1…100, colour at full resolution."""
    import OpenImageIO as oiio

    rows, cols, channels = picture.shape
    spec = oiio.ImageSpec(cols, rows, channels, "uint8")
    spec.attribute("oiio:ColorSpace", "sRGB")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    return encoded("picture.jpg", spec, picture)


@uninterrupted
def encoded(name: str, spec: Any, pixels: NDArray) -> bytes:
    """Return the bytes of a file of this name; L3Error if it cannot be encoded.

    They are made in memory: on a full disk the JPEG library ends the whole program, and the PNG library says nothing. Left
    half through by a signal, that one complains on stderr.
    """
    import OpenImageIO as oiio

    spec.attribute("DateTime", "")  # else the clock is written into the file: the same input must give the same bytes
    with open(os.memfd_create("picture"), "rb", buffering=0) as memory:
        sink = oiio.ImageOutput.create(f"picture{Path(name).suffix}")  # names need not be text
        if sink is None:
            raise L3Error(f"{name} cannot be encoded: {oiio.geterror().strip()}")
        written = sink.open(f"/proc/self/fd/{memory.fileno()}", spec) and sink.write_image(np.ascontiguousarray(pixels))
        if not (sink.close() and written):
            raise L3Error(f"{name} cannot be encoded: {sink.geterror().strip()}")
        return memory.read()


# ------------------------------------------------------------------------------------------------------- reading


@isolated("OpenImageIO")
def read_image(path: Path) -> tuple[NDArray, tuple[str, ...]]:
    """Return the pixels (row, col, channel) as stored and the channels' names; InputFileError if the file cannot be read."""
    with opened(path) as (source, spec):
        return pixels_of(path, source, spec), tuple(spec.channelnames)


@isolated("OpenImageIO")
def picture_flip(path: Path) -> int:
    """Return LibRaw's flip code that makes stored pixels upright (tag Orientation). InputFileError if it cannot be read."""
    with opened(path) as (_, spec):
        return flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))


@isolated("OpenImageIO")
def picture_size(path: Path) -> tuple[int, int]:
    """(rows, cols) of a picture by its header; InputFileError if it has none."""
    with opened(path) as (_, spec):
        return spec.height, spec.width


def mono_of(path: Path, source: Any, spec: Any) -> tuple[NDArray[np.uint16], float | None]:
    """Return the values as stored (row, col) of the single-channel picture that an input is at, and its exposure time
    (s)."""
    stored = str(spec.format)
    if spec.nchannels != 1 or stored not in ("uint8", "uint16"):
        raise InputFileError(
            f"{path} has {spec.nchannels} channels of {stored}; a raw image has one channel of 8 or 16 bits"
        )
    values = pixels_of(path, source, spec)[..., 0]
    # OpenImageIO stretches depths such as 12 bits over the whole of 16: the upper bits are what is stored.
    depth = 8 * values.dtype.itemsize
    unused = np.uint16(depth - spec.get_int_attribute("oiio:BitsPerSample", depth))
    return values.astype(np.uint16) >> unused, spec.get_float_attribute(EXPOSURE_TIME, 0.0) or None


@contextlib.contextmanager
def opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """OpenImageIO's input and the description of its only picture, whose size has been checked."""
    with named_in_utf8(path) as name, contextlib.closing(open_image(path, name)) as source:
        spec = source.spec()
        require_bearable(path, spec)
        require_whole_stack(path, spec, 1)
        if source.seek_subimage(1, 0):
            what = "page" if source.format_name() == "tiff" else "part"
            raise InputFileError(f"{path} holds more than one {what}; give a file of one picture, or render it alone")
        source.geterror()  # that there is no second one
        source.seek_subimage(0, 0)
        yield source, spec


def open_image(path: Path, name: str) -> Any:
    """OpenImageIO's input, of a file that is called `name` in UTF-8."""
    import OpenImageIO as oiio

    source = oiio.ImageInput.open(name)
    if source is None:
        raise InputFileError(f"{path} is not an image that can be read ({_reason(oiio.geterror(), name)})")
    return source


def require_bearable(path: Path, spec: Any) -> None:
    """Raise InputFileError unless a picture is flat and no larger than inputs may be."""
    require_picture(str(path), spec.height, spec.width, spec.nchannels * max(spec.format.size() // VALUE_BYTES, 1))
    if spec.deep or spec.depth != 1:
        raise InputFileError(f"{path} holds a volume or deep samples; give a flat picture")


def require_whole_stack(path: Path, spec: Any, pages: int) -> None:
    """Raise InputFileError if a picture's description counts more frames than there are pages: ImageJ and tifffile may store
    a stack as a single page, the other frames somewhere behind it."""
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
    """Return the pixels (row, col, channel) of an opened picture."""
    pixels = source.read_image(spec.format)
    if pixels is None:
        raise InputFileError(f"{path} is truncated or damaged ({_reason(source.geterror(), str(path))}); give a whole image")
    return pixels.reshape(spec.height, spec.width, spec.nchannels)


def _reason(message: str, name: str) -> str:
    """Return OpenImageIO's message in one line, without the name at its beginning."""
    line = message.strip().splitlines()[0] if message.strip() else "unknown format"
    return line.removeprefix(f"{name}: ")
