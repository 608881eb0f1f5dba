"""Camera raws through LibRaw: pixels, levels and colours as the file tells them."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frame import with_one_black
from l3cli.io.apart import apart
from l3cli.io.cfa_codes import codes_of
from l3cli.io.dng import CameraRaw, described
from l3cli.io.names import named_in_utf8
from l3cli.io.video import storable_rate
from l3cli.limits import require_picture

FRAME_RATE = 51044  # the tag of CinemaDNG


@apart
def read_camera_raw(path: Path) -> CameraRaw:
    """What a camera raw holds within its visible area, or a DNG within its default crop.

    InputFileError if LibRaw cannot read it, or if it is demosaicked already.
    """
    import rawpy

    try:
        with named_in_utf8(path) as name, rawpy.imread(name) as raw:
            require_picture(str(path), raw.sizes.raw_height, raw.sizes.raw_width)
            if raw.raw_type != rawpy.RawType.Flat or raw.raw_image_visible.ndim != 2:
                raise InputFileError(f"{path} is already demosaicked (linear); give the raw file the camera wrote")
            return described(path, raw.raw_image) if path.suffix.lower() == ".dng" else _visible(path, raw)
    except rawpy.LibRawError as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputFileError(
            f"{path} is damaged or no raw file LibRaw can read ({reason}); "
            "give a camera raw, a one-channel TIFF or PNG, a .npy, or a headerless .raw"
        ) from error


def _visible(path: Path, raw: Any) -> CameraRaw:
    """LibRaw's frame without masked borders; black and white levels may differ between its colours."""
    colours, letters = raw.raw_colors_visible, raw.color_desc.decode("ascii", "replace")
    if raw.num_colors == 1:  # no filters: LibRaw gives 6, which is none of its colours
        colours, letters = np.zeros_like(colours), "W"
    black, white = _levels(raw)
    if colours.max() >= min(len(letters), len(black)):
        raise InputFileError(f"{path} names colours that it does not have; it is damaged")
    used = np.unique(colours)
    if not (black[used] < white[used]).all():
        levels = f"{black[used].max():g} is not below its white level {white[used].min():g}"
        raise InputFileError(f"{path}: its black level {levels}; it is damaged")
    values = raw.raw_image_visible.copy()
    if np.ptp(black[used]) == 0:
        common, top = float(black[used[0]]), float(white[used].min())
    else:
        values, common, top = with_one_black(values, black[colours], white[colours])
    rows, cols = raw.raw_pattern.shape
    pattern = codes_of(letters)[colours[:rows, :cols]]
    shot = getattr(raw, "other", None)  # rawpy has it since 0.26
    exposure = float(shot.shutter_speed) if shot is not None else None
    return CameraRaw(
        values=values, black=common, white=top, pattern=pattern, orientation=int(raw.sizes.flip), exposure=exposure
    )


def _levels(raw: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Black and white level (colour) in DN."""
    black = np.array(raw.black_level_per_channel, np.float64)
    whites = np.array(raw.camera_white_level_per_channel or (0,), np.float64)
    return black, np.where(whites > 0, whites, raw.white_level) + np.zeros_like(black)


def film_rate(path: Path) -> Fraction | None:
    """Frames a second that a CinemaDNG file tells."""
    told = _film_rate(path)
    return storable_rate(Fraction(*told)) if told else None


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
