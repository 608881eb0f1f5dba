"""Raw frames as pictures of one channel: TIFF and PNG. The pages of a TIFF are the frames of a stack where they are alike, a
reason to refuse the file where they are not.

A plain mosaic, as l3 writes it, is read here, in this process; any other file by OpenImageIO, in an isolated one. A plain
file is little-endian, of one page, of one channel of 8 or 16 bits, not compressed, without a tag but those of ALLOWED, every
length just what the size of the picture makes it. Nothing is allocated that it does not hold, and nothing is believed.
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

MOST_PAGES = 1_000_000

_opened: dict[tuple[Any, ...], Any] = {}  # the last file, by what would change if it were another one


def read(path: Path) -> RawContent:
    """Return the frame that a picture of one channel holds."""
    if (plain := read_plain(path)) is not None:
        return plain
    return read_by_library(path)


@isolated("OpenImageIO", "tifffile")
def read_by_library(path: Path) -> RawContent:
    """Return the frame of any picture."""
    _check_first_page(path)
    with opened(path) as (source, spec):
        return _content(path, source, spec)


def _content(path: Path, source: Any, spec: Any) -> RawContent:
    """Return the frame that an input is at."""
    values, exposure = mono_of(path, source, spec)
    flip = flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))
    return RawContent(values=values, orientation=flip, exposure=exposure, shot=shot_of_spec(spec))


# --------------------------------------------------------------------------------------------------------- pages


def stack(path: Path) -> MultiFrameFile | None:
    """Return the frames of a TIFF of several pages."""
    if is_plain(path):
        return None
    count = count_pages(path)
    return MultiFrameFile(count, lambda number: read_page(path, number), "page", 1) if count > 1 else None


@isolated("OpenImageIO", "tifffile")
def count_pages(path: Path) -> int:
    """Return the number of pages of a TIFF. InputFileError if there are several that differ in size or kind, as a thumbnail
    behind a picture does, or if there are images that are no page."""
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
    """Return one page of one channel, values as stored; pages count from 0."""
    source = _page(path, number)
    require_bearable(path, source.spec())
    return _content(path, source, source.spec())


def _require_frames(path: Path, spec: Any, count: int) -> None:
    """Raise InputFileError if the pages are channels of a picture, as ImageJ, tifffile or OME say, or hold its columns."""
    text = spec.get_string_attribute("ImageDescription")
    channels = re.search(r"^channels=([0-9]{1,9})$", text, re.MULTILINE) if text.startswith("ImageJ=") else None
    channels = channels or re.search(r'<Pixels [^>]*SizeC="([0-9]{1,9})"', text)
    # More of them are frames: tifffile writes a stack so where its axes have no names.
    if (channels and 1 < int(channels[1]) <= MOST_CHANNELS) or re.match(r"""\{.*"axes": "[A-Z]*C[A-Z]*\"""", text):
        raise InputFileError(f"{path}: its pages are channels of a picture, as its description says; give the mosaic")
    frame_axes(str(path), (count, spec.height, spec.width))


def _page(path: Path, number: int) -> Any:
    """Return OpenImageIO's input, kept open from page to page, at a page."""
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
    """Return size, channels and type of a page, and whether it says that it is none."""
    part = ", a smaller copy or a mask" if spec.get_int_attribute("tiff:subfiletype", 0) & ~ONE_OF_MANY else ""
    channels = f"{spec.nchannels} channel{'s' if spec.nchannels > 1 else ''}"
    return f"{spec.height}×{spec.width} pixels, {channels} of {spec.format}{part}"


def _count(path: Path) -> int:
    """Return the number of pages; InputFileError if their chain is broken, or other images than smaller copies hang below
    one. Libraries take the end of a broken chain for the end of the file: what would be the next page tells."""
    import tifffile

    broken = InputFileError(f"{path}: the chain of its pages is broken; it is damaged, copy it again")
    with tifffile.TiffFile(path) as file:
        with contextlib.suppress(IndexError):
            file.pages.get(MOST_PAGES)  # no further: a chain may lead back
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
    """Check, as `_check_tags`, the first page of a TIFF, if it is one."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            _check_tags(path, file.pages.first)
    except InputFileError:
        raise
    except Exception:  # of a file that is damaged or no TIFF, of which OpenImageIO says what is wrong
        return


def _check_tags(path: Path, page: Any) -> None:
    """Raise InputFileError for what OpenImageIO passes over: an orientation that TIFF does not know, a DNG's mosaic."""
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
# tags that may have one value only, which is also what a file means that lacks them
FIXED = {NEW_SUBFILE_TYPE: 0, COMPRESSION: 1, ORIENTATION: UPRIGHT, CHANNELS: 1, PLANES: 1, SAMPLE_FORMAT: 1}
ALLOWED = {WIDTH, LENGTH, BITS, PHOTOMETRIC, OFFSETS, ROWS_PER_STRIP, COUNTS, DATE_TIME, EXIF, *FIXED}
# Of values: short, long, place of a directory.
TYPES: dict[int, np.dtype] = {3: np.dtype("<u2"), 4: np.dtype("<u4"), 13: np.dtype("<u4")}
EXIF_TYPES: dict[int, np.dtype] = {5: np.dtype(("<u4", 2))}  # rational


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
    """Return whether a file is a plain mosaic, as far as its tags go."""
    try:
        with open_regular(path) as stream:
            _parsed(stream)
    except (InputFileError, OSError, _NotPlain):
        return False
    return True


def read_plain(path: Path, depths: tuple[int, ...] = (8, 16)) -> RawContent | None:
    """Return the frame of a plain mosaic of one of the `depths` in bits; None if the file is of another kind, or damaged.
    OSError if its storage fails."""
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
                return None  # it has become shorter
            rest = rest[size:]
    return RawContent(values=values.astype(np.uint16, copy=False), exposure=plain.exposure)


def _parsed(stream: BinaryIO) -> _Plain:
    """Return the layout that the file states; _NotPlain unless it is a plain mosaic."""
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
    except RecipeError:  # of the setting: whoever reads all kinds says so
        too_large = True
    if too_large or rows * row_bytes > size or tags[COUNTS] != lengths:
        raise _NotPlain
    strips = list(zip(offsets, lengths, strict=True))
    if any(offset + length > size for offset, length in strips):
        raise _NotPlain
    exposure = _exposure(stream, _one(tags, EXIF), size) if EXIF in tags else None
    return _Plain(rows, cols, np.dtype(f"<u{bits // 8}"), strips, exposure)


def _exposure(stream: BinaryIO, at: int, size: int) -> float | None:
    """Return the exposure time (s) of an Exif directory that holds nothing else."""
    tags = _directory(stream, at, size, EXIF_TYPES)
    if set(tags) != {EXPOSURE_TIME} or len(tags[EXPOSURE_TIME]) != 2:
        raise _NotPlain
    above, below = tags[EXPOSURE_TIME]
    return float(np.float32(above / below)) or None if below else None


def _directory(stream: BinaryIO, at: int, size: int, types: dict[int, np.dtype]) -> dict[int, tuple[int, ...]]:
    """Return the values of a directory that none follows, by tag; texts are left out."""
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
