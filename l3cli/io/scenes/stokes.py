"""Read pictures of the Stokes parameters S0, S1 and S2 from OpenEXR, TIFF and .npy files."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.scene import PolarisedPictures
from l3cli.io.images import read_image
from l3cli.io.raw.npy import map_array
from l3cli.io.scenes import bands
from l3cli.physics.stokes import FEATURES, IN_ORDER


def read(path: Path) -> PolarisedPictures:
    """Read the Stokes parameters S0, S1 and S2.

    Raises
    ------
    InputFileError
        If the file does not contain S0, S1 and S2, or if its values are unsigned integers.

    Notes
    -----
    Channels named S0, S1 and S2 may be in any order. OpenEXR files must contain these names. In other files without these
    names, the channels must be S0, S1 and S2, or S0, S1, S2, DoLP and AoLP as in files from l3. The array in a .npy file
    must have the axes (row, col, parameter) or (parameter, row, col).
    """
    values, names = _planes(path)
    if set(IN_ORDER) <= set(names):
        chosen = [names.index(name) for name in IN_ORDER]
    elif values.shape[2] in (len(IN_ORDER), len(IN_ORDER + FEATURES)) and path.suffix.lower() != ".exr":
        chosen = list(range(len(IN_ORDER)))
    else:
        found = f" ({', '.join(names)})" if names else ""
        raise InputFileError(f"{path} has {values.shape[2]} channels{found}; save three channels named S0, S1 and S2")
    if values.dtype.kind == "u":
        raise InputFileError(f"{path} has unsigned integers, but S1 and S2 can be negative; save floating-point numbers")
    return PolarisedPictures(np.stack([values[..., index, None] for index in chosen]), None)


def size(path: Path) -> tuple[int, int]:
    """Return the number of rows and columns. Raises the same errors as `read`."""
    rows, cols = read(path).values.shape[1:3]
    return rows, cols


def _planes(path: Path) -> tuple[NDArray, list[str]]:
    """Return a file's channels, (row, col, channel), and their names, or an empty list if it contains no names."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        values = map_array(path)
        if values.dtype.kind not in "fiu" or values.ndim != 3:
            shape = "×".join(map(str, values.shape))
            raise InputFileError(f"{path} has {shape} values of type {values.dtype}; save numbers with axes (row, col, 3)")
        if values.shape[2] != len(IN_ORDER) and values.shape[0] == len(IN_ORDER):
            values = np.moveaxis(values, 0, 2)
        return np.array(values), []
    if suffix in bands.TIFF:
        values, labels, _ = bands.read_tiff(path)
        return values, labels
    pixels, names = read_image(path, "use an OpenEXR, TIFF or .npy file")
    return pixels, list(names)
