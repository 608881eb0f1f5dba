"""Read raw frames from single-channel TIFF and PNG files.

A TIFF file with several pages is a stack. Its pages must have the same size and type. Files in the layout in which l3 writes
mosaics are read in this process, and all other files with OpenImageIO in the isolated process.
"""

import contextlib
import os
import re
import struct
from math import prod
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from l3cli.errors import InputFileError, RecipeError
from l3cli.io.images import mono_of, open_image, opened, require_bearable, require_whole_stack
from l3cli.io.isolated import isolated
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.io.raw.axes import MOST_CHANNELS, frame_axes
from l3cli.io.tags import COLOUR_FILTER_ARRAY, ONE_OF_MANY, UPRIGHT, flip_of, shot_of_spec
from l3cli.system.files import open_regular, stamp
from l3cli.system.limits import most_pixels

MOST_PAGES = 1_000_000  # maximum number of pages

_opened: dict[tuple[Any, ...], Any] = {}  # identity of the last file → open ImageInput


def read(path: Path) -> RawContent:
    """Read a single-channel picture as a frame. Raises InputFileError for any other file."""
    if (plain := read_plain(path)) is not None:
        return plain
    return read_by_library(path)


@isolated("OpenImageIO", "tifffile")
def read_by_library(path: Path) -> RawContent:
    """Read a single-channel picture as a frame, with OpenImageIO. Raises the same errors as `read`."""
    _check_first_page(path)
    with opened(path) as (source, spec):
        return _content(path, source, spec)


def _content(path: Path, source: Any, spec: Any) -> RawContent:
    """Return the frame on the current page of an OpenImageIO ImageInput."""
    values, exposure = mono_of(path, source, spec)
    flip = flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))
    return RawContent(values=values, orientation=flip, exposure=exposure, shot=shot_of_spec(spec))


# --------------------------------------------------------------------------------------------------------- pages


def stack(path: Path) -> MultiFrameFile | None:
    """Open a TIFF file with several pages. Return None for any other file.

    Raises InputFileError if the pages differ in size or type.
    """
    if is_plain(path):
        return None
    count = count_pages(path)
    return MultiFrameFile(count, lambda number: read_page(path, number), "page", 1) if count > 1 else None


@isolated("OpenImageIO", "tifffile")
def count_pages(path: Path) -> int:
    """Return the number of pages in a TIFF file, or 1 for a PNG file.

    Raises InputFileError if the pages differ in size or type, as they do if one of them is a thumbnail. Also raises it if
    the pages are the channels of a picture, or if the file contains images that are not pages.
    """
    first = _page(path, 0).spec()
    usual, count = _kind(first), _count(path)
    require_whole_stack(path, first, count)
    if count > 1:
        _require_frames(path, first, count)
    for number in range(1, count):
        if (kind := _kind(_page(path, number).spec())) != usual:
            raise InputFileError(
                f"{path}: page {number + 1} has {kind}, but page 1 has {usual}; save only frames of the same size and type"
            )
    return count


@isolated("OpenImageIO", "tifffile")
def read_page(path: Path, number: int) -> RawContent:
    """Read the frame on page `number`, from 0. Raises InputFileError if the page is damaged or has several channels."""
    source = _page(path, number)
    require_bearable(path, source.spec())
    return _content(path, source, source.spec())


def _require_frames(path: Path, spec: Any, count: int) -> None:
    """Raise InputFileError if the pages are probably not separate raw frames.

    Pages are rejected if ImageJ, tifffile or OME metadata describe them as the channels of a single picture, or if they have
    so few columns that the axes are probably in a different order (see `frame_axes`).
    """
    text = spec.get_string_attribute("ImageDescription")
    channels = re.search(r"^channels=([0-9]{1,9})$", text, re.MULTILINE) if text.startswith("ImageJ=") else None
    channels = channels or re.search(r'<Pixels [^>]*SizeC="([0-9]{1,9})"', text)
    # More than MOST_CHANNELS channels are probably frames: by default, tifffile describes the frames of a stack as channels.
    if (channels and 1 < int(channels[1]) <= MOST_CHANNELS) or re.match(r"""\{.*"axes": "[A-Z]*C[A-Z]*\"""", text):
        raise InputFileError(
            f"{path}: according to the image description, the pages are the channels of one picture; save one raw frame per "
            "page"
        )
    frame_axes(str(path), (count, spec.height, spec.width))


def _page(path: Path, number: int) -> Any:
    """Return a file's OpenImageIO ImageInput, positioned at a page. The file stays open for further pages.

    Raises InputFileError if the page is damaged.
    """
    key = (str(path), *stamp(path))
    if key not in _opened:
        for other in _opened.values():
            other.close()
        _opened.clear()
        _opened[key] = open_image(path)
    if not _opened[key].seek_subimage(number, 0):
        raise InputFileError(f"{path}: page {number + 1} is damaged; copy the file again")
    return _opened[key]


def _kind(spec: Any) -> str:
    """Describe a page's size, channels and data type, and whether it is a smaller copy or a mask."""
    part = ", a smaller copy or a mask" if spec.get_int_attribute("tiff:subfiletype", 0) & ~ONE_OF_MANY else ""
    channels = f"{spec.nchannels} channel{'s' if spec.nchannels > 1 else ''}"
    return f"{spec.height}×{spec.width} pixels, {channels} of {spec.format}{part}"


def _count(path: Path) -> int:
    """Count the pages in a TIFF file.

    Libraries treat a broken chain of pages as the end of the file, so this function also checks that the offset after the
    last page is zero. Raises InputFileError if the chain is broken, or if a page has subpages that are not smaller copies.
    """
    import tifffile

    broken = InputFileError(f"{path} is damaged, because the chain of its pages is broken; copy the file again")
    with tifffile.TiffFile(path) as file:
        with contextlib.suppress(IndexError):
            file.pages.get(MOST_PAGES)  # must raise IndexError, unless a damaged chain of pages forms a loop
            raise broken
        file.filehandle.seek(file.pages.next_page_offset)
        following = file.filehandle.read(file.tiff.offsetsize)
        if len(following) < file.tiff.offsetsize or any(following):
            raise broken
        for page in file.pages:
            _check_tags(path, page)
            if not all(below.is_reduced for below in page.pages or ()):
                raise InputFileError(f"{path} contains images that are not pages (subimages); save each frame as a page")
        return len(file.pages)


def _check_first_page(path: Path) -> None:
    """Check the tags on the first page of a TIFF file. Other files and damaged files are left to OpenImageIO."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            _check_tags(path, file.pages.first)
    except InputFileError:
        raise
    except Exception:  # OpenImageIO will report the damage
        return


def _check_tags(path: Path, page: Any) -> None:
    """Raise InputFileError for invalid orientations and for DNG mosaics, neither of which OpenImageIO detects."""
    tags = page.tags
    flip_of(path, tags.valueof("Orientation", UPRIGHT))
    if "DNGVersion" in tags or tags.valueof("PhotometricInterpretation") == COLOUR_FILTER_ARRAY:
        raise InputFileError(
            f"{path} contains a DNG mosaic; rename the file to {path.stem}.dng, so that l3 reads the DNG tags"
        )


# ------------------------------------------------------------------------------------------------- plain mosaics
# Files in the layout of l3's mosaics are read without tifffile and the isolated process. When a single frame is rendered,
# importing tifffile would take 10 % of the time, and starting the isolated process 25 %.

ENTRY = np.dtype([("tag", "<u2"), ("type", "<u2"), ("count", "<u4"), ("content", "V4")])
MAX_TAGS, MAX_STRIPS = 20, 1 << 20
# Tag numbers
WIDTH, LENGTH, BITS, OFFSETS, ROWS_PER_STRIP, COUNTS, DATE_TIME, EXIF = 256, 257, 258, 273, 278, 279, 306, 34665
EXPOSURE_TIME = 33434
# Tags with only one supported value: compression, photometric interpretation, orientation, channels, planes, sample format.
FIXED = {259: [1], 262: [1], 274: [UPRIGHT], 277: [1], 284: [1], 339: [1]}
NEEDED = {WIDTH, LENGTH, BITS, OFFSETS, ROWS_PER_STRIP, COUNTS, *FIXED}
RATIONAL = np.dtype("<u4,<u4")
TYPES: dict[int, np.dtype] = {3: np.dtype("<u2"), 4: np.dtype("<u4"), 5: RATIONAL, 13: np.dtype("<u4")}


class _Plain(NamedTuple):
    """Layout and exposure time of a TIFF file that can be read without a library."""

    shape: tuple[int, int]
    dtype: np.dtype
    offset: int  # number of bytes before the pixels
    exposure: float | None  # exposure time in s; None if the file does not contain it


def is_plain(path: Path) -> bool:
    """Return whether a TIFF file has the layout of mosaics that l3 writes. Returns False if the file cannot be read."""
    try:
        with open_regular(path) as stream:
            return _layout(stream) is not None
    except (InputFileError, OSError):
        return False


def read_plain(path: Path, depths: tuple[int, ...] = (8, 16)) -> RawContent | None:
    """Read a mosaic as uint16, (row, col), if the file has the layout that l3 writes and a bit depth in `depths`.

    Otherwise, return None.
    """
    with open_regular(path) as stream:
        plain = _layout(stream)
        if plain is None or 8 * plain.dtype.itemsize not in depths:
            return None
        stream.seek(plain.offset)
        values = np.fromfile(stream, plain.dtype, prod(plain.shape))
    if values.size < prod(plain.shape):
        return None  # the file was truncated after its layout was read
    return RawContent(values=values.reshape(plain.shape).astype(np.uint16, copy=False), exposure=plain.exposure)


def _layout(stream: BinaryIO) -> _Plain | None:
    """Return the layout of a TIFF file that looks like a mosaic written by l3, or None for any other file.

    Such files are little-endian and uncompressed, with one page, one channel of 8 or 16 bits, consecutive strips, and no
    additional tags.
    """
    try:
        magic, at = struct.unpack("<4sI", stream.read(8))
        tags = _directory(stream, at)
        [rows], [cols], [bits], [per_strip] = (tags[tag] for tag in (LENGTH, WIDTH, BITS, ROWS_PER_STRIP))
        if magic != b"II*\0" or not NEEDED <= set(tags) <= NEEDED | {DATE_TIME, EXIF} or bits not in (8, 16):
            return None
        if any(tags[tag] != value for tag, value in FIXED.items()) or not 0 < rows * cols <= most_pixels():
            return None
        offsets, lengths = np.array(tags[OFFSETS]), np.array(tags[COUNTS])
        ends = cols * bits // 8 * np.minimum(per_strip * np.arange(1, len(offsets) + 1), rows)
        if len(offsets) != -(-rows // max(per_strip, 1)) or not np.array_equal(np.cumsum(lengths), ends):
            return None
        if np.any(offsets + lengths != offsets[0] + ends) or offsets[0] + ends[-1] > os.fstat(stream.fileno()).st_size:
            return None
        exposure = None
        if EXIF in tags:
            ((tag, [(above, below)]),) = _directory(stream, *tags[EXIF]).items()
            exposure = (float(np.float32(above / below)) or None) if below else None
            if tag != EXPOSURE_TIME:
                return None
    except (ValueError, KeyError, TypeError, struct.error, RecipeError):  # OpenImageIO will report the fault
        return None
    return _Plain((rows, cols), np.dtype(f"<u{bits // 8}"), int(offsets[0]), exposure)


def _directory(stream: BinaryIO, at: int) -> dict[int, list[Any]]:
    """Return the values of each tag in the TIFF directory that starts at byte `at`.

    Raises ValueError or KeyError if a tag is repeated, if the type of a tag is not in TYPES, or if a second directory
    follows.
    """
    [count] = _numbers(stream, at, np.dtype("<u2"), 1)
    [following] = _numbers(stream, at + 2 + ENTRY.itemsize * count, np.dtype("<u4"), 1)
    tags: dict[int, list[Any]] = {}
    for tag, kind, length, content in _numbers(stream, at + 2, ENTRY, min(count, MAX_TAGS)):
        if tag == DATE_TIME:  # l3 does not need the date, so its text is not read
            tags[tag] = []
        elif TYPES[kind].itemsize * length > len(content):
            tags[tag] = _numbers(stream, int.from_bytes(content, "little"), TYPES[kind], length)
        else:
            tags[tag] = np.frombuffer(content, TYPES[kind], length).tolist()
    if len(tags) != count or following:
        raise ValueError
    return tags


def _numbers(stream: BinaryIO, at: int, dtype: np.dtype, count: int) -> list[Any]:
    """Read `count` numbers from byte `at`. Raises ValueError if `count` is too large, or if the file is too short."""
    if count > MAX_STRIPS or at + count * dtype.itemsize > os.fstat(stream.fileno()).st_size:
        raise ValueError
    stream.seek(at)
    return np.frombuffer(stream.read(count * dtype.itemsize), dtype).tolist()
