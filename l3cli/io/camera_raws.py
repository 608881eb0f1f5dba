"""Camera raws through LibRaw: pixels, levels and colours as the file tells them."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError
from l3cli.io.apart import apart
from l3cli.limits import require_picture

FRAME_RATE = 51044  # the tag of CinemaDNG


@apart
def read_camera_raw(path: Path) -> dict[str, Any]:
    """What a camera raw holds within its visible area: `values` (row, col) DN, `colours` (row, col) as indices of `blacks`
    (colour) DN and of the names `letters`, `white` DN, and `orientation`, LibRaw's flip code.

    InputFileError if LibRaw cannot read it, or if it is demosaicked already.
    """
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            require_picture(str(path), raw.sizes.raw_height, raw.sizes.raw_width)
            if raw.raw_type != rawpy.RawType.Flat or raw.raw_image_visible.ndim != 2:
                raise InputFileError(f"{path} is already demosaicked (linear); give the raw file the camera wrote")
            letters, colours = raw.color_desc.decode("ascii", "replace"), raw.raw_colors_visible.copy()
            if colours.max() >= min(len(letters), len(raw.black_level_per_channel)):
                raise InputFileError(f"{path} names colours that it does not have; it is damaged")
            whites = [white for white in (raw.camera_white_level_per_channel or ()) if white > 0]
            return {
                "values": raw.raw_image_visible.copy(),
                "colours": colours,
                "blacks": np.array(raw.black_level_per_channel),
                "letters": letters,
                "white": float(min(whites, default=raw.white_level)),
                "orientation": int(raw.sizes.flip),
            }
    except rawpy.LibRawError as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputFileError(
            f"{path} is damaged or no raw file LibRaw can read ({reason}); "
            "give a camera raw, a one-channel TIFF or PNG, a .npy, or a headerless .raw"
        ) from error


def film_rate(path: Path) -> Fraction | None:
    """Frames a second that a CinemaDNG file tells."""
    told = _film_rate(path)
    return Fraction(*told) if told else None


@apart
def _film_rate(path: Path) -> tuple[int, int] | None:
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            tag = file.pages[0].tags.get(FRAME_RATE)
            rate = Fraction(*tag.value) if tag else Fraction(0)
    except (tifffile.TiffFileError, TypeError, ValueError, IndexError, ZeroDivisionError, OSError):
        return None  # reading the frame tells what is wrong with it
    return (rate.numerator, rate.denominator) if rate > 0 else None
