"""Read headerless files, which contain pixel values without any metadata.

The user's options and the table determine the layout. Packings are defined in frames/packings.py.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, RecipeError
from l3cli.frames.packings import CELL, PACKINGS, WORDS, Packing, packing_named, unknown_packing
from l3cli.io.raw import InOrder, MultiFrameFile, RawContent
from l3cli.io.raw.cfa_codes import codes_of
from l3cli.system.limits import require_picture, require_values

GIVE_LAYOUT = "specify the layout with ‹size› ROWSxCOLS, ‹packing›, ‹stride› and ‹skip›"


@dataclass(frozen=True)
class Layout:
    """Layout of a headerless frame."""

    rows: int
    cols: int
    packing: Packing
    stride: int | None = None  # bytes from the start of one row to the start of the next; None if rows have no padding
    skip: int = 0  # bytes before the first frame
    big_endian: bool = False  # whether 16-bit words are big-endian

    @property
    def bits(self) -> int:
        """Bit depth of the values: 16 for unpacked words, because any 16-bit value can occur if the byte order is wrong."""
        return 16 if self.packing.is_words else self.packing.bits

    @property
    def frame_bytes(self) -> int:
        lines, pixels = self._lines
        return lines * (self.stride or self.packing.bytes_of(pixels))

    @property
    def row_pixels(self) -> int:
        """Number of pixels in a stored row. It contains two sensor rows if the packing stores cells of 2×2 pixels."""
        return 2 * self.cols if self.packing.cells else self.cols

    @property
    def row_bytes(self) -> int:
        """Number of bytes in a stored row, without padding."""
        return self.packing.bytes_of(self.row_pixels)

    @property
    def _lines(self) -> tuple[int, int]:
        """Number of lines, and number of pixels per line. A line is a sequence of pixels that starts at a byte boundary.

        Usually, each stored row is a line. If unpadded rows would end within a byte, the whole frame is one line.
        """
        run_on = 8 * self.row_pixels * self.packing.group_bytes % (8 * self.packing.group_pixels)
        if self.stride is None and self.packing.family != "mipi" and run_on:
            return 1, self.rows * self.cols
        return self.rows * self.cols // self.row_pixels, self.row_pixels

    @property
    def exchangeable(self) -> bool:
        """Whether a frame of cols×rows pixels would have the same number of bytes."""
        padded = self.stride is not None and self.stride != self.row_bytes
        return not padded and self.frame_bytes == replace(self, rows=self.cols, cols=self.rows, stride=None).frame_bytes

    @property
    def pattern(self) -> NDArray[np.int64] | None:
        """Colour codes, (row, col), of the CFA that the packing implies, or None if it implies none."""
        return codes_of(self.packing.pattern).reshape(2, 2) if self.packing.pattern else None

    def __str__(self) -> str:
        words = "16-bit values" if self.packing.name == WORDS else f"{self.packing.name} values"
        padded = f" in rows of {self.stride} bytes" if self.stride not in (None, self.row_bytes) else ""
        return f"{self.rows}×{self.cols} {words}{padded}"

    def unpack(self, content: bytes | bytearray | NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Convert the bytes of a frame to pixels, (row, col), in DN."""
        values = self._stored(content)
        if not self.packing.cells:
            return values.reshape(self.rows, self.cols)
        cells, mosaic = values.reshape(self.rows // 2, self.cols // 2, 4), np.empty((self.rows, self.cols), np.uint16)
        for number, (row, col) in enumerate(CELL):
            mosaic[row::2, col::2] = cells[..., number]
        return mosaic

    def _stored(self, content: bytes | bytearray | NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Convert the bytes of a frame to pixels, (line, pixel), in the order in which they are stored."""
        packing, (lines, pixels) = self.packing, self._lines
        used = np.frombuffer(content, np.uint8).reshape(lines, -1)[:, : packing.bytes_of(pixels)]
        if packing.family == "words":
            dtype = np.uint8 if packing.group_bytes == 1 else ">u2" if self.big_endian else "<u2"
            return np.ascontiguousarray(used).view(dtype).astype(np.uint16, copy=False)
        used = np.pad(used, ((0, 0), (0, -used.shape[1] % packing.group_bytes)))
        groups = used.reshape(lines, -1, packing.group_bytes)
        values = np.zeros((*groups.shape[:2], packing.group_pixels), np.uint16)
        for pixel, pieces in enumerate(packing.pieces):
            for piece in pieces:
                part = groups[..., piece.byte] >> np.uint8(piece.shift) & np.uint8(2**piece.bits - 1)
                values[..., pixel] |= part.astype(np.uint16) << np.uint16(piece.place)
        return np.ascontiguousarray(values.reshape(lines, -1)[:, :pixels])

    def others(self) -> Iterator[tuple[str, "Layout"]]:
        """Yield (option that selects the layout, layout) for all other layouts with the same number of bytes per frame."""
        if self.packing.is_words:
            yield f"‹byte_order› {'little' if self.big_endian else 'big'}", replace(self, big_endian=not self.big_endian)
        for other in () if self.packing.cells else PACKINGS.values():
            same_array = other.pattern == self.packing.pattern or (other.family == "mipi" and not other.pattern)
            if not same_array or other.polarised or other.family == "words" or other.pieces == self.packing.pieces:
                continue
            layout = replace(self, packing=other)
            if layout.frame_bytes == self.frame_bytes and layout.row_bytes <= (self.stride or self.frame_bytes):
                yield f"‹packing› {other.name}", layout


def make_layout(
    size: tuple[int, int], name: str, stride: int | None = None, skip: int = 0, byte_order: str | None = None
) -> Layout:
    """Create the layout of headerless frames from user options.

    Parameters
    ----------
    size : tuple of int
        Number of rows and columns.
    name : str
        Name of the packing, in upper or lower case.
    stride : int, optional
        Bytes from the start of one row to the start of the next. [default: rows without padding]
    skip : int
        Bytes before the first frame.
    byte_order : {"little", "big"}, optional
        Byte order of 16-bit words, for packings of such words only. [default: "little"]

    Raises
    ------
    RecipeError
        If a parameter is invalid, or if two parameters contradict each other.
    """
    rows, cols = size
    if min(size) < 1:
        raise RecipeError(f"a frame of ‹size› {rows}x{cols} has no pixels; set at least 1 row and 1 column")
    packing = packing_named(name)
    if packing is None:
        raise RecipeError(f"‹packing› {unknown_packing(name)}")
    if byte_order is not None and not packing.is_words:
        raise RecipeError(
            f"‹byte_order› applies only to 16-bit values, not to the packing {packing.name}; remove ‹byte_order›"
        )
    if packing.cells and (rows % 2 or cols % 2):
        raise RecipeError(f"‹packing› {packing.name} stores cells of 2×2 pixels; set an even number of rows and columns")
    layout = Layout(rows, cols, packing, stride, skip, byte_order == "big")
    if stride is not None and stride < layout.row_bytes:
        raise RecipeError(
            f"‹stride› {stride} is too small; a row of {layout.row_pixels} {packing.name} values needs at least "
            f"{layout.row_bytes} bytes"
        )
    return layout


# ------------------------------------------------------------------------------------------ files


def layout_of(
    path: Path, size: tuple[int, int], packing: str | None, stride: int | None, skip: int = 0, byte_order: str | None = None
) -> Layout:
    """Create the layout of a headerless file as `make_layout` does.

    If `packing` is None, it is selected by the file suffix, such as .raw10, or is u16 for other suffixes. Raises RecipeError
    if a parameter is invalid, and InputFileError if a frame is too large.
    """
    suffix = path.suffix.lower().removeprefix(".")
    layout = make_layout(size, packing or (suffix if suffix in PACKINGS else WORDS), stride, skip, byte_order)
    require_picture(str(path), layout.rows, layout.cols)
    require_values(str(path), (layout.frame_bytes,), value_bytes=1)
    return layout


def read(path: Path, layout: Layout) -> RawContent:
    """Read a file with a single frame. Raises InputFileError if the file size does not match the layout."""
    size = path.stat().st_size - layout.skip
    if size != layout.frame_bytes:
        raise InputFileError(
            f"{path} has {_counted(size, layout)}, but {layout} need {layout.frame_bytes}; {_cure(size, layout)}"
        )
    return content_of(np.fromfile(path, np.uint8, offset=layout.skip), layout)


def _counted(size: int, layout: Layout) -> str:
    """Describe the size of a file for a message, such as "1024 bytes after ‹skip› 16"."""
    if size < 0:
        return f"{size + layout.skip} bytes, fewer than ‹skip› {layout.skip}"
    return f"{size} bytes after ‹skip› {layout.skip}" if layout.skip else f"{size} bytes"


def _cure(size: int, layout: Layout) -> str:
    """Suggest how to correct the layout for a file with an unexpected size, by listing packings that match the size."""
    fitting = [
        name
        for name, packing in PACKINGS.items()
        if not (packing.pattern or packing.polarised) and replace(layout, packing=packing, stride=None).frame_bytes == size
    ]
    if fitting:
        return f"{layout.rows}×{layout.cols} pixels match this size with ‹packing› {', '.join(fitting)}; {GIVE_LAYOUT}"
    return GIVE_LAYOUT


def content_of(stored: bytes | bytearray | NDArray[np.uint8], layout: Layout) -> RawContent:
    """Convert the bytes of a frame to a RawContent, with the CFA if the packing implies one.

    The content also provides the pixels in all other layouts with the same number of bytes per frame, so that a wrong layout
    can be detected.
    """
    content = RawContent(values=layout.unpack(stored), exchangeable=layout.exchangeable)

    def readings() -> Iterator[tuple[str, NDArray[np.uint16], int]]:
        yield "", content["values"], layout.bits
        for option, other in layout.others():
            yield option, other.unpack(stored), other.bits

    content["readings"] = readings
    if layout.pattern is not None:
        content["pattern"] = layout.pattern
    return content


def stack(path: Path, layout: Layout) -> MultiFrameFile | None:
    """Open a file with several frames. Return None if the file is too short for two frames.

    Reading a truncated last frame raises InputFileError.
    """
    size = path.stat().st_size - layout.skip
    if size < 2 * layout.frame_bytes:
        return None
    return MultiFrameFile(-(-size // layout.frame_bytes), lambda number: read_frame(path, layout, number))


def read_frame(path: Path, layout: Layout, number: int) -> RawContent:
    """Read frame `number` (counted from 0) in a file. Raises InputFileError if the frame is truncated."""
    stored = np.fromfile(path, np.uint8, layout.frame_bytes, offset=layout.skip + number * layout.frame_bytes)
    if stored.size < layout.frame_bytes:
        raise InputFileError(f"{path} ends in the middle of frame {number} ({layout}); {GIVE_LAYOUT}")
    return content_of(stored, layout)


def stdin(layout: Layout) -> MultiFrameFile:
    """Open the frames on stdin, which are read one at a time.

    Reading a frame raises InputFileError if stdin ends in the middle of it.
    """
    # Unbuffered, because a thread that is blocked in a buffered stream would prevent the interpreter from exiting.
    pipe = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115
    to_skip = layout.skip

    def filled(content: bytearray) -> int:
        count = 0
        while count < len(content) and (got := pipe.readinto(memoryview(content)[count:])):
            count += got
        return count

    def following() -> RawContent | None:
        nonlocal to_skip
        while to_skip:
            skipped = filled(bytearray(min(to_skip, 1 << 20)))
            to_skip = to_skip - skipped if skipped else 0
        content = bytearray(layout.frame_bytes)
        count = filled(content)
        if 0 < count < len(content):
            raise InputFileError(f"stdin ends in the middle of a frame ({layout}); correct ‹size› ROWSxCOLS")
        return content_of(content, layout) if count else None

    return MultiFrameFile(None, InOrder(following).read)
