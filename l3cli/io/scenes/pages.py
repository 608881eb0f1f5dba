"""TIFF files with one page, or one channel, a band."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.apart import apart
from l3cli.io.images import picture_size
from l3cli.io.scenes import channels
from l3cli.limits import require_values
from l3cli.scene import SpectralCube

size = picture_size


def read(path: Path) -> SpectralCube:
    """The pages of a TIFF of one channel as bands; of one of several its channels."""
    pages = _read_pages(path)
    return channels.read(path) if pages is None else SpectralCube(pages, None)


@apart
def _read_pages(path: Path) -> NDArray | None:
    """(row, col, page) of a TIFF of one channel; None of one of several."""
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
