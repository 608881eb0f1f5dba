"""Mosaics in TIFF as l3 itself writes them, read without a library and so in this process.

Only the plainest files are: little-endian, one page, one channel of 8 or 16 bits, not compressed, no tag but those of
ALLOWED, every length just what the size of the picture makes it. Nothing is allocated that the file does not hold, and
nothing is believed: any other file is left to whoever reads all kinds.
"""

import os
import struct
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from l3cli.errors import InputFileError, RecipeError
from l3cli.io.raw.content import RawContent
from l3cli.io.raw.tiff_tags import LONG, RATIONAL, SHORT, UNSIGNED, UPRIGHT, TiffTag
from l3cli.system.files import open_regular
from l3cli.system.limits import most_pixels

HEADER = b"II*\0"
WIDTH, LENGTH, BITS, OFFSETS, ROWS_PER_STRIP, COUNTS, DATE_TIME = 256, 257, 258, 273, 278, 279, 306  # tags of TIFF 6
NO_COMPRESSION, BLACK_IS_ZERO, ONE_CHANNEL, INTERLEAVED = 1, 1, 1, 1
FIXED = {  # tags that may have one value only, which is also what a file means that lacks them
    TiffTag.NEW_SUBFILE_TYPE: 0,
    259: NO_COMPRESSION,
    TiffTag.ORIENTATION: UPRIGHT,
    277: ONE_CHANNEL,
    284: INTERLEAVED,
    TiffTag.SAMPLE_FORMAT: UNSIGNED,
}
ALLOWED = {WIDTH, LENGTH, BITS, TiffTag.PHOTOMETRIC_INTERPRETATION, OFFSETS, ROWS_PER_STRIP, COUNTS, DATE_TIME}
ALLOWED |= {TiffTag.EXIF, *FIXED}
SUB_DIRECTORY = 13  # a type of values
SIZES = {SHORT: (2, "H"), LONG: (4, "I"), SUB_DIRECTORY: (4, "I")}


class _Plain(NamedTuple):
    """Content of a plain file, and its place."""

    rows: int
    cols: int
    dtype: np.dtype
    strips: list[tuple[int, int]]  # offset, bytes
    exposure: float | None  # s


class _NotPlain(Exception):
    """Another kind of file, or a damaged one."""


def is_plain(path: Path) -> bool:
    """Return whether a file is such a mosaic, as far as its tags go."""
    try:
        with open_regular(path) as stream:
            _parsed(stream)
    except (InputFileError, OSError, _NotPlain):
        return False
    return True


def read(path: Path) -> RawContent | None:
    """Return the frame of such a mosaic; None if the file is of another kind, or damaged. OSError if its storage fails."""
    with open_regular(path) as stream:
        try:
            plain = _parsed(stream)
        except _NotPlain:
            return None
        values = np.empty((plain.rows, plain.cols), plain.dtype)
        rest = values.reshape(-1).view(np.uint8).data
        for offset, size in plain.strips:
            stream.seek(offset)
            if stream.readinto(rest[:size]) != size:
                return None  # it has become shorter
            rest = rest[size:]
    return RawContent(values=values.astype(np.uint16, copy=False), exposure=plain.exposure)


def _parsed(stream: BinaryIO) -> _Plain:
    """Return the layout that the file states; _NotPlain unless it is such a mosaic."""
    size = os.fstat(stream.fileno()).st_size
    if stream.read(4) != HEADER:
        raise _NotPlain
    tags = _directory(stream, _number(stream.read(4)), size)
    if not set(tags) <= ALLOWED or any(tags.get(tag, (value,)) != (value,) for tag, value in FIXED.items()):
        raise _NotPlain
    rows, cols, bits = _one(tags, LENGTH), _one(tags, WIDTH), _one(tags, BITS)
    per_strip = min(_one(tags, ROWS_PER_STRIP), rows)
    if _one(tags, TiffTag.PHOTOMETRIC_INTERPRETATION) != BLACK_IS_ZERO or bits not in (8, 16) or not rows * cols * per_strip:
        raise _NotPlain
    row_bytes, offsets = cols * bits // 8, tags.get(OFFSETS, ())
    if not len(offsets) == len(tags.get(COUNTS, ())) == -(-rows // per_strip):
        raise _NotPlain
    lengths = tuple(row_bytes * min(per_strip, rows - first) for first in range(0, rows, per_strip))
    try:
        too_large = rows * cols > most_pixels()
    except RecipeError:  # of the setting: whoever reads all kinds says so
        too_large = True
    if too_large or rows * row_bytes > size or tags[COUNTS] != lengths:
        raise _NotPlain
    if any(offset + length > size for offset, length in zip(offsets, lengths, strict=True)):
        raise _NotPlain
    exposure = _exposure(stream, _one(tags, TiffTag.EXIF), size) if TiffTag.EXIF in tags else None
    return _Plain(rows, cols, np.dtype(f"<u{bits // 8}"), list(zip(offsets, lengths, strict=True)), exposure)


def _exposure(stream: BinaryIO, at: int, size: int) -> float | None:
    """Return the exposure time (s) of an Exif directory that holds nothing else."""
    above, below = _directory(stream, at, size, exif=True)[TiffTag.EXPOSURE_TIME]
    return float(np.float32(above / below)) or None if below else None


def _directory(stream: BinaryIO, at: int, size: int, exif: bool = False) -> dict[int, tuple[int, ...]]:
    """Return the values of a directory that none follows, by tag; texts are left out."""
    stream.seek(at)
    (count,) = struct.unpack("<H", _exactly(stream, 2))
    entries = _exactly(stream, 12 * count)
    if _number(_exactly(stream, 4)):
        raise _NotPlain
    tags: dict[int, tuple[int, ...]] = {}
    for tag, kind, length, place in struct.iter_unpack("<HHI4s", entries):
        if exif and (count, tag, kind, length) != (1, TiffTag.EXPOSURE_TIME, RATIONAL, 1):
            raise _NotPlain
        width, code = (8, "II") if exif else SIZES.get(kind, (0, ""))
        if tag == DATE_TIME:
            tags[tag] = ()
        elif tag in tags or not width or width * length > size:
            raise _NotPlain
        elif width * length <= 4:
            tags[tag] = struct.unpack(f"<{length}{code}", place[: width * length])
        else:
            stream.seek(_number(place))
            tags[tag] = struct.unpack(f"<{code if exif else f'{length}{code}'}", _exactly(stream, width * length))
    if exif and TiffTag.EXPOSURE_TIME not in tags:
        raise _NotPlain
    return tags


def _one(tags: dict[int, tuple[int, ...]], tag: int) -> int:
    values = tags.get(tag, ())
    if len(values) != 1:
        raise _NotPlain
    return values[0]


def _number(four: bytes) -> int:
    return int.from_bytes(four, "little") if len(four) == 4 else 0


def _exactly(stream: BinaryIO, count: int) -> bytes:
    content = stream.read(count)
    if len(content) < count:
        raise _NotPlain
    return content
