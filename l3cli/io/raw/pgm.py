"""Read binary portable graymaps (PGM, P5) with 8 or 16 bits, without scaling.

OpenImageIO is not used, because it would scale the values so that the maximum in the header becomes 65535.
"""

import re
from pathlib import Path

import numpy as np

from l3cli.errors import InputFileError
from l3cli.io.raw import RawContent
from l3cli.system.files import open_regular
from l3cli.system.limits import require_picture

GAP = rb"(?:\s|#[^\n\r]*[\n\r])+"
HEADER = re.compile(rb"P5" + GAP + rb"(\d{1,9})" + GAP + rb"(\d{1,9})" + GAP + rb"(\d{1,5})\s")
LONGEST_HEADER = 65536  # maximum length of the header in bytes, including comments


def read(path: Path) -> RawContent:
    """Read a graymap's pixels, (row, col), in DN: uint8 if the maximum in the header is below 256, otherwise uint16.

    Raises InputFileError if the file is not a single, complete P5 graymap.
    """
    with open_regular(path) as stream:
        start = stream.read(LONGEST_HEADER)
    header = HEADER.match(start)
    if header is None:
        kind = "a PGM file in text form" if start.startswith(b"P2") else "not a binary PGM file"
        raise InputFileError(f"{path} is {kind}; save the raw values as a binary graymap (P5)")
    cols, rows, top = (int(number) for number in header.groups())
    if not (rows and cols and 0 < top < 65536):
        raise InputFileError(f"{path} has an invalid header ({rows}×{cols} values up to {top}); write the file again")
    dtype = np.dtype(np.uint8 if top < 256 else ">u2")
    wanted, size = rows * cols * dtype.itemsize, path.stat().st_size - header.end()
    if size != wanted:
        problem, cure = (
            ("is truncated", "copy the file again") if size < wanted else ("is too long", "save one graymap per file")
        )
        raise InputFileError(
            f"{path} {problem}: {size} bytes follow the header, but {rows}×{cols} values need {wanted}; {cure}"
        )
    require_picture(str(path), rows, cols)
    values = np.fromfile(path, dtype, offset=header.end()).reshape(rows, cols)
    if values.max() > top:
        raise InputFileError(
            f"{path} contains the value {values.max()}, but its header states a maximum of {top}; write the file again"
        )
    return RawContent(values=values.astype(dtype.newbyteorder("=")))
