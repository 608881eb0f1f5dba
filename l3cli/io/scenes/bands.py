"""Folders with one picture a band."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.scene import SpectralCube
from l3cli.io.images import picture_size, read_image

BAND_PICTURES = (".png", ".tif", ".tiff", ".pgm", ".exr")


def read(path: Path) -> SpectralCube:
    """Return the pictures of a folder, one a band in the order of their names' numbers (CAVE: 16-bit PNG); of a picture with
    several channels the first. InputFileError if there are none or they differ in size."""
    folder = path if path.is_dir() else path.parent
    pictures = files(folder)
    if not pictures:
        raise InputFileError(f"{folder} holds no pictures ({', '.join(BAND_PICTURES)}); give a folder with one a band")
    cube: NDArray | None = None
    for band, picture in enumerate(pictures):
        pixels = read_image(picture)[0][..., 0]
        if cube is None:
            cube = np.empty((*pixels.shape, len(pictures)), pixels.dtype)
        if pixels.shape != cube.shape[:2] or pixels.dtype != cube.dtype:
            raise InputFileError(
                f"{picture} differs in size or depth from {pictures[0].name}; keep only bands in the folder"
            )
        cube[..., band] = pixels
    assert cube is not None
    return SpectralCube(cube, None)


def size(path: Path) -> tuple[int, int]:
    """(rows, cols) of the first picture; InputFileError if there is none."""
    pictures = files(path)
    if pictures:
        return picture_size(pictures[0])
    rows, cols, _ = read(path).values.shape  # which says what is wrong
    return rows, cols


def files(folder: Path) -> list[Path]:
    """Return the pictures in `folder`, those with numbers in their names by the last of these numbers."""

    def order(path: Path) -> tuple[str, int]:
        numbers = re.findall(r"\d+", path.stem)
        return (re.sub(r"\d+$", "", path.stem), int(numbers[-1])) if numbers else (path.stem, 0)

    return sorted((path for path in folder.iterdir() if path.suffix.lower() in BAND_PICTURES), key=order)
