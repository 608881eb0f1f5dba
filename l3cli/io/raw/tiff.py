"""Read raw frames from single-channel pictures: TIFF and PNG. The pages of a TIFF are the frames of a stack if they are
alike, otherwise the file is rejected.

A plain mosaic, as l3 writes it, is read in this process; any other file by OpenImageIO in the isolated process. A plain file
is little-endian and uncompressed, has one page with one channel of 8 or 16 bits and no tags except those in ALLOWED, and all
lengths match the size of the picture exactly. No memory is allocated beyond the size of the file.
"""

import contextlib
import os
import re
import struct
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from l3cli.errors import InputFileError, RecipeError
from l3cli.io.images import mono_of, open_image, opened, require_bearable, require_whole_stack
from l3cli.io.isolated import isolated, named_in_utf8
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.io.raw.axes import MOST_CHANNELS, frame_axes
from l3cli.io.tags import COLOUR_FILTER_ARRAY, ONE_OF_MANY, UPRIGHT, flip_of, shot_of_spec
from l3cli.system.files import open_regular, stamp
from l3cli.system.limits import most_pixels

MOST_PAGES = 1_000_000  # largest number of pages

_opened: dict[tuple[Any, ...], Any] = {}  # the last file, with its identity as key


def read(path: Path) -> RawContent:
    """Read the frame of a single-channel picture."""
    if (plain := read_plain(path)) is not None:
        return plain
    return read_by_library(path)


@isolated("OpenImageIO", "tifffile")
def read_by_library(path: Path) -> RawContent:
    """Read the frame of any picture with OpenImageIO."""
    _check_first_page(path)
    with opened(path) as (source, spec):
        return _content(path, source, spec)


def _content(path: Path, source: Any, spec: Any) -> RawContent:
    """Return the frame at the input's current page."""
    values, exposure = mono_of(path, source, spec)
    flip = flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))
    return RawContent(values=values, orientation=flip, exposure=exposure, shot=shot_of_spec(spec))


# --------------------------------------------------------------------------------------------------------- pages


def stack(path: Path) -> MultiFrameFile | None:
    """Return the frames of a TIFF with several pages."""
    if is_plain(path):
        return None
    count = count_pages(path)
    return MultiFrameFile(count, lambda number: read_page(path, number), "page", 1) if count > 1 else None


@isolated("OpenImageIO", "tifffile")
def count_pages(path: Path) -> int:
    """Return the number of pages of a TIFF.

    Raises InputFileError if several pages differ in size or kind, such as a thumbnail after a picture, or if there are
    images that are not pages.
    """
    first = _page(path, 0).spec()
    usual, count = _kind(first), _count(path)
    require_whole_stack(path, first, count)
    if count > 1:
        _require_frames(path, first, count)
    for number in range(1, count):
        if (kind := _kind(_page(path, number).spec())) != usual:
            raise InputFileError(
                f"{path}: page {number + 1} holds {kind}, page 1 {usual}; give a file whose pages are frames of one kind"
            )
    return count


@isolated("OpenImageIO", "tifffile")
def read_page(path: Path, number: int) -> RawContent:
    """Read a single-channel page as stored. Pages count from 0."""
    source = _page(path, number)
    require_bearable(path, source.spec())
    return _content(path, source, source.spec())


def _require_frames(path: Path, spec: Any, count: int) -> None:
    """Raise InputFileError if the pages are channels of a picture, as ImageJ, tifffile or OME state, or its columns."""
    text = spec.get_string_attribute("ImageDescription")
    channels = re.search(r"^channels=([0-9]{1,9})$", text, re.MULTILINE) if text.startswith("ImageJ=") else None
    channels = channels or re.search(r'<Pixels [^>]*SizeC="([0-9]{1,9})"', text)
    # A larger number of channels are frames, because tifffile writes stacks with unnamed axes in this way.
    if (channels and 1 < int(channels[1]) <= MOST_CHANNELS) or re.match(r"""\{.*"axes": "[A-Z]*C[A-Z]*\"""", text):
        raise InputFileError(f"{path}: its pages are channels of a picture, as its description says; give the mosaic")
    frame_axes(str(path), (count, spec.height, spec.width))


def _page(path: Path, number: int) -> Any:
    """Return OpenImageIO's input, which stays open for further pages, at a page."""
    key = (str(path), *stamp(path))
    if key not in _opened:
        for other in _opened.values():
            other.close()
        _opened.clear()
        with named_in_utf8(path) as name:
            _opened[key] = open_image(path, name)
    if not _opened[key].seek_subimage(number, 0):
        raise InputFileError(f"{path}: page {number + 1} is damaged; copy the file again")
    return _opened[key]


def _kind(spec: Any) -> str:
    """Describe the size, channels and type of a page, and whether it is a copy or a mask."""
    part = ", a smaller copy or a mask" if spec.get_int_attribute("tiff:subfiletype", 0) & ~ONE_OF_MANY else ""
    channels = f"{spec.nchannels} channel{'s' if spec.nchannels > 1 else ''}"
    return f"{spec.height}×{spec.width} pixels, {channels} of {spec.format}{part}"


def _count(path: Path) -> int:
    """Return the number of pages.

    Libraries take the end of a broken chain of pages for the end of the file, so the offset of the next page is checked.
    Raises InputFileError if the chain is broken, or if images other than smaller copies hang below a page.
    """
    import tifffile

    broken = InputFileError(f"{path}: the chain of its pages is broken; it is damaged, copy it again")
    with tifffile.TiffFile(path) as file:
        with contextlib.suppress(IndexError):
            file.pages.get(MOST_PAGES)  # limited, because a chain of pages may form a loop
            raise broken
        file.filehandle.seek(file.pages.next_page_offset)
        following = file.filehandle.read(file.tiff.offsetsize)
        if len(following) < file.tiff.offsetsize or any(following):
            raise broken
        for page in file.pages:
            _check_tags(path, page)
            if not all(below.is_reduced for below in page.pages or ()):
                raise InputFileError(f"{path} holds images beside its pages; give a file whose pages are its frames")
        return len(file.pages)


def _check_first_page(path: Path) -> None:
    """Check the first page of a TIFF, if the file is one, with `_check_tags`."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            _check_tags(path, file.pages.first)
    except InputFileError:
        raise
    except Exception:  # the file is damaged or not a TIFF, which OpenImageIO reports
        return


def _check_tags(path: Path, page: Any) -> None:
    """Raise InputFileError for what OpenImageIO ignores: an orientation that TIFF does not define, or a DNG's mosaic."""
    tags = page.tags
    flip_of(path, tags.valueof("Orientation", UPRIGHT))
    if "DNGVersion" in tags or tags.valueof("PhotometricInterpretation") == COLOUR_FILTER_ARRAY:
        raise InputFileError(f"{path} is a DNG's mosaic, whose tags are read of files called .dng alone; rename it")


# ------------------------------------------------------------------------------------------------- plain mosaics

HEADER = b"II*\0"
NEW_SUBFILE_TYPE, WIDTH, LENGTH, BITS, COMPRESSION, PHOTOMETRIC, OFFSETS = 254, 256, 257, 258, 259, 262, 273  # tags
ORIENTATION, CHANNELS, ROWS_PER_STRIP, COUNTS, PLANES, DATE_TIME, SAMPLE_FORMAT = 274, 277, 278, 279, 284, 306, 339
EXIF, EXPOSURE_TIME = 34665, 33434
BLACK_IS_ZERO = 1
# tags with a single allowed value, which is also the default if the tag is missing
FIXED = {NEW_SUBFILE_TYPE: 0, COMPRESSION: 1, ORIENTATION: UPRIGHT, CHANNELS: 1, PLANES: 1, SAMPLE_FORMAT: 1}
ALLOWED = {WIDTH, LENGTH, BITS, PHOTOMETRIC, OFFSETS, ROWS_PER_STRIP, COUNTS, DATE_TIME, EXIF, *FIXED}
# Types of values: short, long, offset of a directory.
TYPES: dict[int, np.dtype] = {3: np.dtype("<u2"), 4: np.dtype("<u4"), 13: np.dtype("<u4")}
EXIF_TYPES: dict[int, np.dtype] = {5: np.dtype(("<u4", 2))}  # rational numbers


class _Plain(NamedTuple):
    """Layout of a plain file, and its exposure time."""

    rows: int
    cols: int
    dtype: np.dtype
    strips: list[tuple[int, int]]  # offset, bytes
    exposure: float | None  # s


class _NotPlain(Exception):
    """Raised for other kinds of files and for damaged ones."""


def is_plain(path: Path) -> bool:
    """Whether a file is a plain mosaic, judging by its tags."""
    try:
        with open_regular(path) as stream:
            _parsed(stream)
    except (InputFileError, OSError, _NotPlain):
        return False
    return True


def read_plain(path: Path, depths: tuple[int, ...] = (8, 16)) -> RawContent | None:
    """Read the frame of a plain mosaic with one of the `depths` in bits, or return None for any other or damaged file.

    Raises OSError if the storage fails.
    """
    with open_regular(path) as stream:
        try:
            plain = _parsed(stream)
        except _NotPlain:
            return None
        if 8 * plain.dtype.itemsize not in depths:
            return None
        values = np.empty((plain.rows, plain.cols), plain.dtype)
        rest = values.reshape(-1).view(np.uint8).data
        for offset, size in plain.strips:
            stream.seek(offset)
            if stream.readinto(rest[:size]) != size:
                return None  # the file has become shorter
            rest = rest[size:]
    return RawContent(values=values.astype(np.uint16, copy=False), exposure=plain.exposure)


def _parsed(stream: BinaryIO) -> _Plain:
    """Return the layout that the file states. Raises _NotPlain unless it is a plain mosaic."""
    size = os.fstat(stream.fileno()).st_size
    if stream.read(4) != HEADER:
        raise _NotPlain
    tags = _directory(stream, _number(stream.read(4)), size, TYPES)
    if not set(tags) <= ALLOWED or any(tags.get(tag, (value,)) != (value,) for tag, value in FIXED.items()):
        raise _NotPlain
    rows, cols, bits, per_strip = (_one(tags, tag) for tag in (LENGTH, WIDTH, BITS, ROWS_PER_STRIP))
    per_strip = min(per_strip, rows)
    if _one(tags, PHOTOMETRIC) != BLACK_IS_ZERO or bits not in (8, 16) or not rows * cols * per_strip:
        raise _NotPlain
    row_bytes, offsets = cols * bits // 8, tags.get(OFFSETS, ())
    if not len(offsets) == len(tags.get(COUNTS, ())) == -(-rows // per_strip):
        raise _NotPlain
    lengths = tuple(row_bytes * min(per_strip, rows - first) for first in range(0, rows, per_strip))
    try:
        too_large = rows * cols > most_pixels()
    except RecipeError:  # the setting is invalid, which the general reader reports
        too_large = True
    if too_large or rows * row_bytes > size or tags[COUNTS] != lengths:
        raise _NotPlain
    strips = list(zip(offsets, lengths, strict=True))
    if any(offset + length > size for offset, length in strips):
        raise _NotPlain
    exposure = _exposure(stream, _one(tags, EXIF), size) if EXIF in tags else None
    return _Plain(rows, cols, np.dtype(f"<u{bits // 8}"), strips, exposure)


def _exposure(stream: BinaryIO, at: int, size: int) -> float | None:
    """Return the exposure time (s) of an Exif directory that contains nothing else."""
    tags = _directory(stream, at, size, EXIF_TYPES)
    if set(tags) != {EXPOSURE_TIME} or len(tags[EXPOSURE_TIME]) != 2:
        raise _NotPlain
    above, below = tags[EXPOSURE_TIME]
    return float(np.float32(above / below)) or None if below else None


def _directory(stream: BinaryIO, at: int, size: int, types: dict[int, np.dtype]) -> dict[int, tuple[int, ...]]:
    """Return the values in a directory, by tag, without texts. No further directory may follow."""
    stream.seek(at)
    (count,) = struct.unpack("<H", _exactly(stream, 2))
    entries = _exactly(stream, 12 * count)
    if _number(_exactly(stream, 4)):
        raise _NotPlain
    tags: dict[int, tuple[int, ...]] = {}
    for tag, kind, length, content in struct.iter_unpack("<HHI4s", entries):
        nbytes = length * types[kind].itemsize if kind in types else 0
        if tag == DATE_TIME:
            nbytes = 0
        elif tag in tags or not 0 < nbytes <= size:
            raise _NotPlain
        elif nbytes > len(content):
            stream.seek(_number(content))
            content = _exactly(stream, nbytes)
        tags[tag] = tuple(np.frombuffer(content[:nbytes], types.get(kind, np.uint8)).ravel().tolist())
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
