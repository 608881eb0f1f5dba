"""RGB pictures, to be raised to spectra."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.images import picture_size, read_image
from l3cli.physics.display import srgb_decoded

size = picture_size


def read(path: Path) -> NDArray[np.float32]:
    """Linear sRGB (row, col, 3) of a picture, 1 being white: integers are decoded from sRGB, floats are linear already.

    InputFileError if the file is no colour picture.
    """
    pixels, names = read_image(path)
    if len(names) < 3:
        raise InputFileError(f"{path} has no red, green and blue; give a colour picture")
    if pixels.dtype.kind == "f":
        return np.maximum(np.nan_to_num(pixels[..., :3]), 0.0).astype(np.float32)
    levels = np.arange(np.iinfo(pixels.dtype).max + 1) / np.iinfo(pixels.dtype).max
    linear = srgb_decoded(levels).astype(np.float32)
    return linear[pixels[..., :3]]
