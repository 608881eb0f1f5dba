"""Read RGB pictures as scenes. Their values are colours, from which l3 estimates spectra, or camera signals."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.images import picture_size, read_image
from l3cli.physics.display import srgb_decoded


def size(path: Path, holds: str = "sRGB") -> tuple[int, int]:
    """Return a picture's number of rows and columns. `holds` has no effect. Raises the same errors as `read`."""
    return picture_size(path)


def read(path: Path, holds: str = "sRGB") -> NDArray[np.float32]:
    """Read a picture, (row, col, 3), as linear values, where 1 is white. An alpha channel is ignored.

    Integers are decoded from sRGB or, if `holds` is "codes", divided by the maximum of their data type. Floating-point
    values are assumed to be linear, and negative values and NaN become 0. Raises InputFileError if the file is not a colour
    picture.
    """
    pixels, names = read_image(path)
    if len(names) < 3:
        raise InputFileError(f"{path} has no red, green and blue channels; use a colour picture")
    if pixels.dtype.kind == "f":
        return np.maximum(np.nan_to_num(pixels[..., :3]), 0.0).astype(np.float32)
    levels = np.arange(np.iinfo(pixels.dtype).max + 1) / np.iinfo(pixels.dtype).max
    linear = (levels if holds == "codes" else srgb_decoded(levels)).astype(np.float32)
    return linear[pixels[..., :3]]
