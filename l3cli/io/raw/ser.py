"""Read SER files, the raw videos of planetary astronomy: a header of 178 bytes, and frames with 8 or 16 bits per value.

The reference is the SER format description 3. Because programs disagree about the meaning of the header field LittleEndian,
l3 chooses the byte order that makes the first frame smoother. The frame times at the end of the file are not read.
"""

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.packings import PACKINGS
from l3cli.frames.raw_sanity import roughness
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.io.raw.cfa_codes import codes_of
from l3cli.io.raw.headerless import Layout, read_frame
from l3cli.system.files import open_regular
from l3cli.system.limits import require_picture

HEADER = struct.Struct("<14s7i")  # first fields of the header; names and two dates follow
HEADER_BYTES = 178
MAGIC = b"LUCAM-RECORDER"
# Value of ColorID → letters of the CFA, or "" for a monochrome sensor.
PATTERNS = {0: "", 8: "RGGB", 9: "GRBG", 10: "GBRG", 11: "BGGR", 16: "CYYM", 17: "YCMY", 18: "YMCY", 19: "MYYC"}
COLOURS = (100, 101)  # values of ColorID for RGB and BGR


def stack(path: Path) -> MultiFrameFile:
    """Open the frames of a SER file.

    Raises
    ------
    InputFileError
        If the file is not a SER file, contains demosaicked frames, or contains fewer frames than its header states.
    """
    layout, pattern, count = _header(path)

    def frame(number: int) -> RawContent:
        content = RawContent(values=read_frame(path, layout, number)["values"])
        if pattern is not None:
            content["pattern"] = pattern
        return content

    return MultiFrameFile(count, frame)


def _header(path: Path) -> tuple[Layout, NDArray[np.int64] | None, int]:
    """Return the frame layout, the colour codes of the CFA (None for monochrome cameras), and the number of frames.

    Raises InputFileError if the header is damaged or describes demosaicked frames, or if frames are missing.
    """
    with open_regular(path) as stream:
        stored = stream.read(HEADER_BYTES)
    if len(stored) < HEADER_BYTES or not stored.startswith(MAGIC):
        raise InputFileError(f"{path} is not a complete SER file; copy the file again")
    _, _, colour, _, cols, rows, bits, count = HEADER.unpack_from(stored)
    if colour in COLOURS:
        raise InputFileError(f"{path} contains colour frames, which are already demosaicked; use the raw frames")
    if colour not in PATTERNS or not (rows > 0 and cols > 0 and count > 0 and 0 < bits <= 16):
        stated = f"ColorID {colour}, {count} frames of {rows}×{cols} pixels with {bits} bits"
        raise InputFileError(f"{path} has an invalid header ({stated}); copy the file again")
    require_picture(str(path), rows, cols)
    layout = Layout(rows, cols, PACKINGS["u8" if bits <= 8 else "u16"], skip=HEADER_BYTES)
    size = path.stat().st_size - HEADER_BYTES
    if size < count * layout.frame_bytes:
        whole = size // layout.frame_bytes
        raise InputFileError(f"{path} contains only {whole} of {count} frames; copy or repair the file")
    pattern = codes_of(PATTERNS[colour]).reshape(2, 2) if PATTERNS[colour] else None
    return _in_byte_order(path, layout), pattern, count


def _in_byte_order(path: Path, layout: Layout) -> Layout:
    """Set the byte order that makes the first frame smoother. 8-bit layouts are returned unchanged."""
    if not layout.packing.is_words:
        return layout
    first = read_frame(path, layout, 0)
    period = np.arange(4, dtype=np.uint8).reshape(2, 2)  # every CFA in a SER file has a period of 2×2
    readings = [roughness(values, bits, period) for _, values, bits in first["readings"]()][:2]
    return Layout(layout.rows, layout.cols, layout.packing, skip=layout.skip, big_endian=readings[1] < readings[0])
