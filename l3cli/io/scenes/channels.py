"""Pictures of many channels, such as EXR, with one channel a band, and TIFF files with one page or one channel a band."""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.scene import SpectralCube
from l3cli.io.images import picture_size, read_image
from l3cli.io.isolated import isolated
from l3cli.system.limits import require_values

TIFF = (".tif", ".tiff")
size = picture_size


def read(path: Path) -> SpectralCube:
    """Return all channels as bands in increasing wavelength, which their names may give ("450nm", "S0.450,5nm"); of a TIFF
    of one channel its pages."""
    pages = _read_pages(path) if path.suffix.lower() in TIFF else None
    if pages is not None:
        return SpectralCube(pages, None)
    pixels, names = read_image(path)
    matches = [re.search(r"(\d+(?:[.,]\d+)?)\s*nm", name) for name in names]
    keep = [index for index, match in enumerate(matches) if match]
    if not keep:
        return SpectralCube(pixels, None)
    nanometres = np.array([float(match[1].replace(",", ".")) for match in matches if match])
    order = np.argsort(nanometres, kind="stable")
    return SpectralCube(pixels[..., np.array(keep)[order]], nanometres[order])


@isolated("tifffile")
def _read_pages(path: Path) -> NDArray | None:
    """Return the pages (row, col, page) of a TIFF of one channel; None of one of several."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            if file.pages[0].samplesperpixel > 1:
                return None
            first = file.series[0]
            require_values(str(path), first.shape, first.dtype.itemsize if first.dtype else 1)
            pages = first.asarray()
    except (tifffile.TiffFileError, OSError, ValueError, IndexError) as error:
        raise InputFileError(f"{path} is truncated or damaged; give a whole TIFF") from error
    return np.moveaxis(pages, 0, 2) if pages.ndim == 3 else pages[..., None]
