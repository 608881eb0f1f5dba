"""Read FITS files with astropy. The first image is a frame, (row, col), or a stack, (frame, row, col).

astropy supports unsigned values (BZERO), compressed images (fpack) and headers of several blocks. The first stored row is
the top row, unless ROWORDER is BOTTOM-UP. BAYERPAT contains the colours of a Bayer array (4 letters) or an X-Trans array (36
letters), starting at the top left pixel. XBAYROFF and YBAYROFF shift this pattern.
"""

import contextlib
import warnings
from collections import ChainMap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError, L3Error
from l3cli.io.isolated import isolated
from l3cli.io.raw import MultiFrameFile, RawContent
from l3cli.io.raw.axes import MEANING, STACK, frame_axes
from l3cli.io.raw.cfa_codes import LETTERS, codes_of
from l3cli.system.limits import require_picture

INSTALL = 'FITS files need astropy; install it with: pip install "l3cli[fits]"'
SIDES = {4: 2, 36: 6}  # number of letters in BAYERPAT → side length of the pattern in pixels (Bayer, X-Trans)
PLANES = 3  # number of planes in an RGB picture
BOTTOM_UP = "BOTTOM-UP"
ROW_ORDERS = "TOP-DOWN", BOTTOM_UP


def stack(path: Path) -> MultiFrameFile | None:
    """Open an image with three axes as a stack. Return None for any other image.

    Raises InputFileError if the axes are not in the order (frame, row, col), or if there are three planes, which are
    probably the colours of a picture.
    """
    shape, names, has_pattern = _shape(path)
    if len(shape) != 3:
        return None
    axes = frame_axes(str(path), shape, names)
    if axes != STACK:
        raise InputFileError(
            f"{path}: the axes (CTYPE keywords) are not in the order frame, row, column; save the frames along NAXIS3"
        )
    if shape[0] == PLANES and not has_pattern and MEANING.get(names[0].lower()) != "frame":
        raise InputFileError(
            f"{path} contains {PLANES} planes of {shape[1]}×{shape[2]} pixels, which look like a picture with {PLANES} "
            f"channels; use the raw mosaic, or set CTYPE3 = 'FRAME' if the planes are {PLANES} frames"
        )
    return MultiFrameFile(shape[0], lambda number: read(path, number))


@isolated("astropy.io.fits")
def _shape(path: Path) -> tuple[tuple[int, ...], list[str], bool]:
    """Return the shape and axis names (CTYPEn) of the first image, and whether BAYERPAT is set."""
    with _first_image(path) as (image, header):
        count = len(image.shape)
        names = [str(image.header.get(f"CTYPE{number}", "")).strip() for number in range(count, 0, -1)]
        return tuple(image.shape), names, bool(str(header.get("BAYERPAT", "")).strip())


@isolated("astropy.io.fits")
def read(path: Path, number: int | None = None) -> RawContent:
    """Read the pixels, (row, col), in DN, the colours (BAYERPAT), and the exposure time in s (EXPTIME or EXPOSURE).

    `number` (counted from 0) selects a frame in a stack. Raises InputFileError if the file contains no frame, or if ROWORDER
    is invalid.
    """
    with _first_image(path) as (image, header):
        values = np.asarray(image.data if number is None else image.section[number])
        pattern, order = str(header.get("BAYERPAT", "")).strip().upper(), str(header.get("ROWORDER", "")).strip().upper()
        offset = (int(header.get("YBAYROFF", 0)), int(header.get("XBAYROFF", 0)))
        seconds = header.get("EXPTIME", header.get("EXPOSURE"))
    if values.ndim != 2 or values.size == 0:
        raise InputFileError(f"{path} contains a {values.dtype.name} array of shape {values.shape}; save a frame (row, col)")
    if order not in ("", *ROW_ORDERS):
        raise InputFileError(f'{path}: the keyword ROWORDER is "{order}"; set it to {" or ".join(ROW_ORDERS)}')
    if order == BOTTOM_UP:
        values = values[::-1]
    exposure = float(seconds) if isinstance(seconds, int | float) else None
    content = RawContent(values=np.ascontiguousarray(values, values.dtype.newbyteorder("=")), exposure=exposure)
    side = SIDES.get(len(pattern))
    if side and set(pattern) <= set(LETTERS):
        content["pattern"] = np.roll(codes_of(pattern).reshape(side, side), (-offset[0], -offset[1]), axis=(0, 1))
    elif pattern:
        content["notes"] = (
            f'BAYERPAT "{pattern}" is not a 2×2 or 6×6 pattern of known colours; l3 uses the table\'s colour filter array',
        )
    return content


@contextlib.contextmanager
def _first_image(path: Path) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """Context manager that opens a file, and yields its first image and the keywords of this image.

    Keywords in the image's own header take precedence over those in the primary header.
    """
    try:
        from astropy.io import fits
    except ModuleNotFoundError as error:
        raise L3Error(INSTALL) from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ignore nonstandard headers; unreadable data still raise exceptions
        with fits.open(path, uint=True, lazy_load_hdus=True) as units:
            image = next((unit for unit in units if unit.is_image and unit.header.get("NAXIS", 0) >= 2), None)
            if image is None:
                raise InputFileError(f"{path} contains no image; use a FITS file with a raw frame")
            require_picture(str(path), *image.shape[-2:])
            yield image, ChainMap(image.header, units[0].header)
