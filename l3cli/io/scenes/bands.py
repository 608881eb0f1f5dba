"""Bands as pictures: a folder with one picture a band; one picture of many channels, such as EXR, with one a band; a TIFF
with one page a band."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.scene import SpectralCube
from l3cli.io.images import picture_size, read_image
from l3cli.io.isolated import isolated
from l3cli.system.limits import require_values

BAND_PICTURES = (".png", ".tif", ".tiff", ".pgm", ".exr")
TIFF = (".tif", ".tiff")


def read(path: Path) -> SpectralCube:
    """Return the pictures of a folder, one a band in the order of their names' numbers (CAVE: 16-bit PNG), of a picture with
    several channels the first; or all channels of a picture, in increasing wavelength, which their names may give ("450nm",
    "S0.450,5nm"), of a TIFF of one channel its pages. InputFileError if there are none or they differ in size."""
    if path.is_dir():
        return SpectralCube(_stacked(_pictures(path)), None)
    pages = _read_pages(path) if path.suffix.lower() in TIFF else None
    if pages is not None:
        return SpectralCube(pages, None)
    pixels, names = read_image(path)
    matches = [re.search(r"(\d+(?:[.,]\d+)?)\s*nm", name) for name in names]
    wanted = [index for index, match in enumerate(matches) if match]
    if not wanted:
        return SpectralCube(pixels, None)
    nanometres = np.array([float(match[1].replace(",", ".")) for match in matches if match])
    order = np.argsort(nanometres, kind="stable")
    return SpectralCube(pixels[..., np.array(wanted)[order]], nanometres[order])


def size(path: Path) -> tuple[int, int]:
    """Return (rows, cols) of the first picture; InputFileError if there is none."""
    return picture_size(_pictures(path)[0] if path.is_dir() else path)


def files(path: Path) -> list[Path]:
    """Return the pictures in a folder, those with numbers in their names by the last of these numbers; or the file."""

    def order(path: Path) -> tuple[str, int]:
        numbers = re.findall(r"\d+", path.stem)
        return (re.sub(r"\d+$", "", path.stem), int(numbers[-1])) if numbers else (path.stem, 0)

    if not path.is_dir():
        return [path]
    return sorted((each for each in path.iterdir() if each.suffix.lower() in BAND_PICTURES), key=order)


def _pictures(folder: Path) -> list[Path]:
    pictures = files(folder)
    if not pictures:
        raise InputFileError(f"{folder} holds no pictures ({', '.join(BAND_PICTURES)}); give a folder with one a band")
    return pictures


def _stacked(pictures: list[Path]) -> NDArray:
    """Return the first channel of each picture (row, col, band)."""
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
    return cube


@isolated("tifffile")
def _read_pages(path: Path) -> NDArray | None:
    """Return the pages (row, col, page) of a TIFF of one channel; None of one of several."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        if file.pages[0].samplesperpixel > 1:
            return None
        first = file.series[0]
        require_values(str(path), first.shape, first.dtype.itemsize if first.dtype else 1)
        pages = first.asarray()
    return np.moveaxis(pages, 0, 2) if pages.ndim == 3 else pages[..., None]
