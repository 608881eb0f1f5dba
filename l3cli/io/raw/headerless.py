"""Headerless files: the values of frames and nothing else, laid out as the caller or the table says. 16-bit words, or the
packed formats of MIPI CSI-2.

RAW10 stores four pixels in five bytes: their upper eight bits, then their lower two bits, first pixel lowest. RAW12 stores
two pixels in three bytes: their upper eight bits, then their lower four. A row ends with a whole group.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, RecipeError
from l3cli.io.raw import InOrder, MultiFrameFile, RawContent
from l3cli.system.limits import require_picture, require_values


@dataclass(frozen=True)
class Packing:
    """Pixels in groups of bytes: one byte of upper bits for each pixel, one byte of all their lower bits."""

    bits: int
    pixels: int  # of a group


WORDS = "u16"
PACKED = {"raw10": Packing(10, 4), "raw12": Packing(12, 2)}
PACKINGS = (WORDS, *PACKED)


@dataclass(frozen=True)
class Layout:
    """Layout of the pixels of a headerless frame."""

    rows: int
    cols: int
    packing: str  # one of PACKINGS
    stride: int  # bytes from one row to the next

    @property
    def frame_bytes(self) -> int:
        return self.rows * self.stride

    @property
    def exchangeable(self) -> bool:
        """Return whether as many columns and rows fit the same bytes."""
        rows, cols = (row_bytes(length, self.packing) for length in (self.rows, self.cols))
        return self.stride == cols and rows * self.cols == self.frame_bytes

    def __str__(self) -> str:
        words = "16-bit values" if self.packing == WORDS else f"{self.packing} values"
        padded = f" in rows of {self.stride} bytes" if self.stride != row_bytes(self.cols, self.packing) else ""
        return f"{self.rows}×{self.cols} {words}{padded}"

    def unpack(self, content: bytes | bytearray | NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Return the pixels (row, col) in DN of the `frame_bytes` bytes of one frame."""
        used = np.frombuffer(content, np.uint8).reshape(self.rows, self.stride)[:, : row_bytes(self.cols, self.packing)]
        if self.packing == WORDS:
            return np.ascontiguousarray(used).view("<u2").astype(np.uint16, copy=False)
        packing = PACKED[self.packing]
        groups = used.reshape(self.rows, -1, packing.pixels + 1)
        low_bits = packing.bits - 8
        low = groups[..., -1:] >> np.arange(0, 8, low_bits, dtype=np.uint8) & np.uint8(2**low_bits - 1)
        values = groups[..., :-1].astype(np.uint16) << np.uint16(low_bits) | low
        return np.ascontiguousarray(values.reshape(self.rows, -1)[:, : self.cols])


def row_bytes(cols: int, packing: str) -> int:
    """Return the bytes of a row without padding."""
    if packing == WORDS:
        return 2 * cols
    return -(-cols // PACKED[packing].pixels) * (PACKED[packing].pixels + 1)


def make_layout(size: tuple[int, int], packing: str, stride: int | None) -> Layout:
    """Return the layout of rows × columns; RecipeError if a row does not fit into `stride` bytes or there are no pixels."""
    rows, cols = size
    needed = row_bytes(cols, packing)
    if min(size) < 1:
        raise RecipeError(f"‹size› {rows}x{cols} holds no pixels; give rows and columns above 0")
    if stride is not None and stride < needed:
        raise RecipeError(f"‹stride› {stride} is too short; a row of {cols} {packing} values has {needed} bytes")
    return Layout(rows, cols, packing, stride or needed)


# ------------------------------------------------------------------------------------------ files


def layout_of(path: Path, size: tuple[int, int], packing: str | None, stride: int | None) -> Layout:
    """Return the layout of a headerless file of frames of `size` (rows, columns); its suffix may name the packing."""
    suffix = path.suffix.lower().removeprefix(".")
    layout = make_layout(size, packing or (suffix if suffix in PACKED else WORDS), stride)
    require_picture(str(path), layout.rows, layout.cols)
    require_values(str(path), (layout.rows, layout.stride), value_bytes=1)
    return layout


def read(path: Path, layout: Layout) -> RawContent:
    """Return one frame's values and nothing else."""
    size = path.stat().st_size
    if size != layout.frame_bytes:
        raise InputFileError(
            f"{path} has {size} bytes, {layout} have {layout.frame_bytes}; "
            "give its size with ‹size› ROWSxCOLS, ‹packing› and ‹stride›"
        )
    return RawContent(values=layout.unpack(np.fromfile(path, np.uint8)), exchangeable=layout.exchangeable)


def stack(path: Path, layout: Layout) -> MultiFrameFile | None:
    """Return as many frames as the file has room for; one that is cut is noticed when it is read. None without a second."""
    size = path.stat().st_size
    if size < 2 * layout.frame_bytes:
        return None

    def frame(number: int) -> RawContent:
        content = np.fromfile(path, np.uint8, layout.frame_bytes, offset=number * layout.frame_bytes)
        if content.size < layout.frame_bytes:
            raise InputFileError(f"{path} ends within frame {number} of {layout}; give its size with ‹size› ROWSxCOLS")
        return RawContent(values=layout.unpack(content), exchangeable=layout.exchangeable)

    return MultiFrameFile(-(-size // layout.frame_bytes), frame)


def stdin(layout: Layout) -> MultiFrameFile:
    """Return the frames that come on stdin."""
    # Unbuffered: a thread that waits in a buffered stream would keep the interpreter from ending.
    pipe = open(0, "rb", buffering=0, closefd=False)  # noqa: SIM115

    def following() -> np.ndarray | None:
        content = bytearray(layout.frame_bytes)
        filled = 0
        while filled < len(content) and (got := pipe.readinto(memoryview(content)[filled:])):
            filled += got
        if 0 < filled < len(content):
            raise InputFileError(f"stdin ends within the frame, of {layout}; check ‹size› ROWSxCOLS")
        return layout.unpack(content) if filled else None

    return MultiFrameFile(None, InOrder(following, layout.exchangeable).read)
