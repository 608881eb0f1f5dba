"""Headerless frames: how values lie in their bytes. 16-bit words, or the packed formats of MIPI CSI-2.

RAW10 stores four pixels in five bytes: their upper eight bits, then their lower two bits, first pixel lowest. RAW12 stores
two pixels in three bytes: their upper eight bits, then their lower four. A row ends with a whole group.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import RecipeError


@dataclass(frozen=True)
class Packing:
    """Pixels in groups of bytes: one byte of upper bits for each pixel, one byte of all their lower bits."""

    bits: int
    pixels: int  # of a group

    @property
    def group_bytes(self) -> int:
        return self.pixels + 1


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
        groups = used.reshape(self.rows, -1, packing.group_bytes)
        low_bits = packing.bits - 8
        low = groups[..., -1:] >> np.arange(0, 8, low_bits, dtype=np.uint8) & np.uint8(2**low_bits - 1)
        values = groups[..., :-1].astype(np.uint16) << np.uint16(low_bits) | low
        return np.ascontiguousarray(values.reshape(self.rows, -1)[:, : self.cols])


def row_bytes(cols: int, packing: str) -> int:
    """Return the bytes of a row without padding."""
    if packing == WORDS:
        return 2 * cols
    return -(-cols // PACKED[packing].pixels) * PACKED[packing].group_bytes


def make_layout(size: tuple[int, int], packing: str, stride: int | None) -> Layout:
    """Return the layout of rows × columns; RecipeError if a row does not fit into `stride` bytes or there are no pixels."""
    rows, cols = size
    needed = row_bytes(cols, packing)
    if min(size) < 1:
        raise RecipeError(f"‹size› {rows}x{cols} holds no pixels; give rows and columns above 0")
    if stride is not None and stride < needed:
        raise RecipeError(f"‹stride› {stride} is too short; a row of {cols} {packing} values has {needed} bytes")
    return Layout(rows, cols, packing, stride or needed)
