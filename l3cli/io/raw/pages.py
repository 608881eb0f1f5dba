"""Raw frames as pictures. The pages of a TIFF are the frames of a stack where they are alike, a reason to refuse the file
where they are not.

Pages are the directories that follow one another in a file. OpenImageIO reads their pixels; how many there are, and what
hangs below them, is read here: libraries take the end of a damaged chain for the end of the file. A smaller copy that hangs
below a page, in its SubIFDs, is no frame.
"""

import contextlib
import struct
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from l3cli.errors import InputFileError
from l3cli.io.images import mono_of, open_image, opened, require_bearable, require_whole_stack
from l3cli.io.isolated import isolated
from l3cli.io.names import named_in_utf8
from l3cli.io.raw import plain_tiff
from l3cli.io.raw.content import MultiFrameFile, RawContent, Request
from l3cli.io.raw.shot import shot_of_spec
from l3cli.io.raw.tiff_tags import ONE_OF_MANY, REDUCED, UPRIGHT, TiffTag, flip_of
from l3cli.system.files import stamp

TIFF, BIG_TIFF = 42, 43  # versions
MOST_PAGES = 1_000_000
MOST_BELOW = 1000  # images below a page

_opened: dict[tuple[Any, ...], Any] = {}  # the last file, by what would change if it were another one


def read(path: Path, _: Request) -> RawContent:
    """Return the frame that a picture of one channel holds."""
    if (plain := plain_tiff.read(path)) is not None:
        return plain
    return read_by_library(path)


@isolated("OpenImageIO")
def read_by_library(path: Path) -> RawContent:
    """As `read`, of any picture."""
    _refuse_orientation(path)
    with opened(path) as (source, spec):
        return _content(path, source, spec)


def _content(path: Path, source: Any, spec: Any) -> RawContent:
    """Return the frame that an input is at."""
    values, exposure = mono_of(path, source, spec)
    flip = flip_of(path, spec.get_int_attribute("Orientation", UPRIGHT))
    return RawContent(values=values, orientation=flip, exposure=exposure, shot=shot_of_spec(spec))


def stack(path: Path, _: Request) -> MultiFrameFile | None:
    """Return the frames of a TIFF of several pages."""
    if plain_tiff.is_plain(path):
        return None
    count = count_pages(path)

    def frame(number: int) -> RawContent:
        return read_page(path, number)

    return MultiFrameFile(count, frame, "page", 1) if count > 1 else None


@isolated("OpenImageIO")
def count_pages(path: Path) -> int:
    """Return the number of pages of a TIFF. InputFileError if there are several that differ in size or kind, as a thumbnail
    behind a picture does, or if there are images that are no page."""
    first = _page(path, 0).spec()
    usual, count = _kind(first), _count(path)
    require_whole_stack(path, first, count)
    for number in range(1, count):
        if (kind := _kind(_page(path, number).spec())) != usual:
            raise InputFileError(
                f"{path}: page {number + 1} holds {kind}, page 1 {usual}; give a file whose pages are frames of one kind"
            )
    return count


@isolated("OpenImageIO")
def read_page(path: Path, number: int) -> RawContent:
    """Return one page of one channel, values as stored; pages count from 0."""
    source = _page(path, number)
    require_bearable(path, source.spec())
    return _content(path, source, source.spec())


def _page(path: Path, number: int) -> Any:
    """Return the input, at a page."""
    source = _open(path)
    if not source.seek_subimage(number, 0):
        raise InputFileError(f"{path}: page {number + 1} is damaged; copy the file again")
    return source


def _open(path: Path) -> Any:
    """Return the input, kept open from page to page, at the page it was at."""
    key = (str(path), *stamp(path))
    if key not in _opened:
        for other in _opened.values():
            other.close()
        _opened.clear()
        with named_in_utf8(path) as name:
            _opened[key] = open_image(path, name)
    return _opened[key]


def _kind(spec: Any) -> str:
    """Size, channels and type of a page, and whether it says that it is none."""
    part = ", a smaller copy or a mask" if spec.get_int_attribute("tiff:subfiletype", 0) & ~ONE_OF_MANY else ""
    channels = f"{spec.nchannels} channel{'s' if spec.nchannels > 1 else ''}"
    return f"{spec.height}×{spec.width} pixels, {channels} of {spec.format}{part}"


# -------------------------------------------------------------------------------------------------------- directories


class _Form(NamedTuple):
    """Form in which a TIFF stores offsets and entries."""

    order: str  # of bytes
    offset: str  # codes of struct
    length: str
    entry: int  # bytes

    def read(self, stream: BinaryIO, code: str) -> int:
        (number,) = struct.unpack(self.order + code, stream.read(struct.calcsize(code)))
        return int(number)


def _count(path: Path) -> int:
    """Return the number of directories in the chain; InputFileError if it is broken, or other images than smaller copies
    hang below it."""
    seen: set[int] = set()
    with open(path, "rb") as stream:
        try:
            form, at = _form(stream)
            while at and at not in seen and len(seen) < MOST_PAGES:
                seen.add(at)
                tags, following = _directory(stream, form, at)
                _require_orientation(path, form, tags)
                if not all(_is_copy(stream, form, below) for below in _below(stream, form, tags)):
                    raise InputFileError(f"{path} holds images beside its pages; give a file whose pages are its frames")
                at = following
        except struct.error as error:
            raise InputFileError(f"{path}: the chain of its pages is cut; it is damaged, copy it again") from error
    if at or not seen:
        raise InputFileError(f"{path}: the chain of its pages has no end; it is damaged, copy it again")
    return len(seen)


def _refuse_orientation(path: Path) -> None:
    """Raise InputFileError if a TIFF's first page has an orientation that TIFF does not know: OpenImageIO passes over it."""
    with open(path, "rb") as stream, contextlib.suppress(struct.error):  # of a file that is damaged or none
        if stream.read(2) in (b"II", b"MM"):
            stream.seek(0)
            form, at = _form(stream)
            _require_orientation(path, form, _directory(stream, form, at)[0])


def _require_orientation(path: Path, form: _Form, tags: dict[int, bytes]) -> None:
    """Raise InputFileError if a page has an orientation that TIFF does not know."""
    if entry := tags.get(TiffTag.ORIENTATION):
        flip_of(path, struct.unpack_from(form.order + "H", entry, 4 + struct.calcsize(form.offset))[0])


def _form(stream: BinaryIO) -> tuple[_Form, int]:
    """Return the form of this file, and the place of its first directory."""
    order = ">" if stream.read(2) == b"MM" else "<"
    (version,) = struct.unpack(order + "H", stream.read(2))
    if version == BIG_TIFF:
        stream.seek(8)
    form = _Form(order, "Q", "Q", 20) if version == BIG_TIFF else _Form(order, "I", "H", 12)
    return form, form.read(stream, form.offset)


def _directory(stream: BinaryIO, form: _Form, at: int) -> tuple[dict[int, bytes], int]:
    """Return the entries of a directory by tag, and where the next one lies."""
    stream.seek(at)
    count = form.read(stream, form.length)
    content = stream.read(count * form.entry) if count < 2**16 else b""
    entries = [content[start : start + form.entry] for start in range(0, count * form.entry, form.entry)]
    return {struct.unpack(form.order + "H", entry[:2])[0]: entry for entry in entries}, form.read(stream, form.offset)


def _below(stream: BinaryIO, form: _Form, tags: dict[int, bytes]) -> tuple[int, ...]:
    """Return the places of the images below a page."""
    entry = tags.get(TiffTag.SUB_IFDS)
    if entry is None:
        return ()
    kind, count = struct.unpack(f"{form.order}H{form.offset}", entry[2 : 4 + struct.calcsize(form.offset)])
    width = {13: "I", 4: "I", 16: "Q", 18: "Q"}.get(kind, form.offset)
    content = entry[4 + struct.calcsize(form.offset) :]
    size = count * struct.calcsize(width)
    if count > MOST_BELOW:
        raise struct.error
    if size > len(content):
        stream.seek(struct.unpack(form.order + form.offset, content)[0])
        content = stream.read(size)
    return struct.unpack(f"{form.order}{count}{width}", content[:size])


def _is_copy(stream: BinaryIO, form: _Form, at: int) -> bool:
    """Return whether an image is a smaller copy of another."""
    entry = _directory(stream, form, at)[0].get(TiffTag.NEW_SUBFILE_TYPE)
    value = entry[4 + struct.calcsize(form.offset) :] if entry else bytes(4)
    return bool(struct.unpack(form.order + "I", value[:4])[0] & REDUCED)
