"""FITS: the first image of a file, a frame (row, col) or frames (frame, row, col) of unsigned integers, through astropy.

astropy and no reader of this package: unsigned values are coded by BZERO, images may be packed (fpack), and headers run over
blocks. Row order: the first row is the uppermost, unless ROWORDER says BOTTOM-UP; BAYERPAT gives the colours of the upper
left pixels, of Bayer (4 letters) or X-Trans (36), displaced by XBAYROFF and YBAYROFF.
"""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError, L3Error
from l3cli.io.isolated import isolated
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.io.raw.cfa_codes import LETTERS, codes_of
from l3cli.system.limits import require_picture

INSTALL = 'FITS files need astropy; install it with: pip install "l3cli[fits]"'
SIDES = {4: 2, 36: 6}  # letters of BAYERPAT → rows and columns of the array: Bayer, X-Trans
BOTTOM_UP = "BOTTOM-UP"
ROW_ORDERS = "TOP-DOWN", BOTTOM_UP


def stack(path: Path) -> MultiFrameFile | None:
    """Return the frames of an image of three axes."""
    shape = _shape(path)
    return MultiFrameFile(shape[0], lambda number: read(path, number)) if len(shape) == 3 else None


@isolated("astropy.io.fits")
def _shape(path: Path) -> tuple[int, ...]:
    """Return (row, col) or (frame, row, col) of the first image."""
    with _first_image(path) as image:
        return tuple(image.shape)


@isolated("astropy.io.fits")
def read(path: Path, number: int | None = None) -> RawContent:
    """Return the pixels (row, col) in DN, of frame `number` where there are several, the colours BAYERPAT names, and the
    exposure time (s) of EXPTIME or EXPOSURE.

    InputFileError if the file holds anything but unsigned integers of at most 16 bits.
    """
    with _first_image(path) as image:
        values = np.asarray(image.data if number is None else image.section[number])
        header = image.header
        pattern, order = str(header.get("BAYERPAT", "")).strip().upper(), str(header.get("ROWORDER", "")).strip().upper()
        offset = (int(header.get("YBAYROFF", 0)), int(header.get("XBAYROFF", 0)))
        seconds = header.get("EXPTIME", header.get("EXPOSURE"))
    if values.ndim != 2 or values.dtype.kind not in "ui" or values.dtype.itemsize > 2 or values.size == 0:
        raise InputFileError(f"{path} holds {values.dtype.name} {values.shape}; give unsigned 16-bit (rows, columns)")
    if values.min() < 0:
        raise InputFileError(f"{path} holds {values.min()} DN; give unsigned values, as BZERO = 32768 codes them")
    if order not in ("", *ROW_ORDERS):
        raise InputFileError(f'{path}: its ROWORDER is "{order}"; correct the header to {" or ".join(ROW_ORDERS)}')
    if order == BOTTOM_UP:
        values = values[::-1]
    exposure = float(seconds) if isinstance(seconds, int | float) else None
    content = RawContent(values=np.ascontiguousarray(values, np.uint16), exposure=exposure)
    side = SIDES.get(len(pattern))
    if side and set(pattern) <= set(LETTERS):
        content["pattern"] = np.roll(codes_of(pattern).reshape(side, side), (-offset[0], -offset[1]), axis=(0, 1))
    elif pattern:
        content["notes"] = (f'its BAYERPAT "{pattern}" is not an array of 2×2 or 6×6 colours; it is taken for the table\'s',)
    return content


@contextlib.contextmanager
def _first_image(path: Path) -> Iterator[Any]:
    try:
        from astropy.io import fits
    except ModuleNotFoundError as error:
        raise L3Error(INSTALL) from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sloppy headers; what cannot be read raises
        with fits.open(path, uint=True, lazy_load_hdus=True) as units:
            image = next((unit for unit in units if unit.is_image and unit.header.get("NAXIS", 0) >= 2), None)
            if image is None:
                raise InputFileError(f"{path} holds no image; give a FITS file with a raw frame")
            require_picture(str(path), *image.shape[-2:])
            yield image
