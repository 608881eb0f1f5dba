"""Read binary portable graymaps (PGM, P5) of 8 or 16 bits as stored.

OpenImageIO scales values to the full range of 16 bits by the header's maximum, but a raw mosaic must not be scaled.
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
LONGEST_HEADER = 65536  # bytes, comments included


def read(path: Path) -> RawContent:
    """Read the pixels (row, col) of a graymap in DN, uint8 or uint16 as in the file.

    Raises InputFileError unless the file is a single complete P5 graymap.
    """
    with open_regular(path) as stream:
        start = stream.read(LONGEST_HEADER)
    header = HEADER.match(start)
    if header is None:
        kind = "a PGM in text" if start.startswith(b"P2") else "no binary PGM"
        raise InputFileError(f"{path} is {kind}; give a P5 graymap of raw values")
    cols, rows, top = (int(number) for number in header.groups())
    if not (rows and cols and 0 < top < 65536):
        raise InputFileError(f"{path} says it has {rows}×{cols} values up to {top}; it is damaged")
    dtype = np.dtype(np.uint8 if top < 256 else ">u2")
    wanted, size = rows * cols * dtype.itemsize, path.stat().st_size - header.end()
    if size != wanted:
        held = "is truncated" if size < wanted else "has more than one graymap"
        raise InputFileError(
            f"{path} {held}: {size} bytes, {rows}×{cols} values have {wanted}; give whole files of one frame"
        )
    require_picture(str(path), rows, cols)
    values = np.fromfile(path, dtype, offset=header.end()).reshape(rows, cols)
    if values.max() > top:
        raise InputFileError(f"{path} holds {values.max()} DN, its header says at most {top}; it is damaged")
    return RawContent(values=values.astype(dtype.newbyteorder("=")))
