"""Camera raws through LibRaw: pixels, levels and colours as the file states them."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.frame import with_one_black_level
from l3cli.io.isolated import isolated, named_in_utf8
from l3cli.io.raw.cfa_codes import codes_of
from l3cli.io.raw.registry import RawContent
from l3cli.io.tags import BROKEN, camera_names, shot_of_file
from l3cli.system.limits import require_picture


@isolated("rawpy", "tifffile")
def read(path: Path) -> RawContent:
    """Return the content of a camera raw within its visible area; InputFileError as from `opened`."""
    with opened(path) as raw:
        content = _visible(path, raw)
        content["shot"] = _shot(raw) | shot_of_file(path)
    return content


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """rawpy's object of a file with a mosaic. InputFileError if LibRaw cannot read it, or if it is demosaicked already."""
    import rawpy

    try:
        with named_in_utf8(path) as name, rawpy.imread(name) as raw:
            require_picture(str(path), raw.sizes.raw_height, raw.sizes.raw_width)
            if raw.raw_type != rawpy.RawType.Flat or raw.raw_image_visible.ndim != 2:
                raise InputFileError(f"{path} is already demosaicked (linear); give the raw file the camera wrote")
            yield raw
    except rawpy.LibRawError as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputFileError(
            f"{path} is damaged or no raw file LibRaw can read ({reason}); "
            "give a camera raw, a one-channel TIFF or PNG, a .npy, or a headerless .raw"
        ) from error


def _visible(path: Path, raw: Any) -> RawContent:
    """LibRaw's frame without masked borders; black and white levels may differ between its colours."""
    colours, letters = raw.raw_colors_visible, raw.color_desc.decode("ascii", "replace")
    if raw.num_colors == 1:  # no filters: LibRaw gives 6, which is none of its colours
        colours, letters = np.zeros_like(colours), "W"
    black_level, white_level = _levels(raw)
    if colours.max() >= min(len(letters), len(black_level)):
        raise InputFileError(f"{path} names colours that it does not have; it is damaged")
    used = np.unique(colours)
    if not (black_level[used] < white_level[used]).all():
        levels = f"{black_level[used].max():g} is not below its white level {white_level[used].min():g}"
        raise InputFileError(f"{path}: its black level {levels}; it is damaged")
    values = raw.raw_image_visible.copy()
    if np.ptp(black_level[used]) == 0:
        common, top = float(black_level[used[0]]), float(white_level[used].min())
    else:
        values, common, top = with_one_black_level(values, black_level[colours], white_level[colours])
    rows, cols = raw.raw_pattern.shape
    pattern = codes_of(letters)[colours[:rows, :cols]]
    shot = getattr(raw, "other", None)  # rawpy has it since 0.26
    exposure = float(shot.shutter_speed) if shot is not None else None
    return RawContent(
        values=values,
        black_level=common,
        white_level=top,
        pattern=pattern,
        orientation=int(raw.sizes.flip),
        exposure=exposure,
        neutral=_neutral(raw, letters),
        camera=_camera_names(path),
    )


def _neutral(raw: Any, letters: str) -> NDArray[np.float64] | None:
    """Codes of the colours and the signals that the camera took for those of a grey: one over its multipliers. None where it
    states none, or LibRaw does not know them: then all are 1 or 0."""
    multipliers = np.array(raw.camera_whitebalance[: len(letters)], np.float64)
    stated = {code: 1 / each for code, each in zip(codes_of(letters).tolist(), multipliers, strict=False) if each > 0}
    if len(stated) < len(set(letters)) or len(set(stated.values())) == 1:
        return None
    return np.array(list(stated.items()))


def _camera_names(path: Path) -> list[str]:
    """As camera_names, of a raw file that is a TIFF file, as most are; nothing of another."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            return camera_names(file.pages[0])
    except (tifffile.TiffFileError, *BROKEN, OSError):  # LibRaw has read the file, whatever kind it is of
        return []


def _shot(raw: Any) -> dict[str, str | float]:
    """Return the settings that LibRaw reads from a raw file of any structure; rawpy has it since 0.26."""
    shot, lens = getattr(raw, "other", None), getattr(raw, "lens", None)
    stated = {
        "lens": getattr(lens, "model", None),
        "f_number": getattr(shot, "aperture", None),
        "focal_length": getattr(shot, "focal_length", None),
        "iso": getattr(shot, "iso_speed", None),
    }
    return {name: value for name, value in stated.items() if isinstance(value, str | float | int)}


def _levels(raw: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the black and white level (colour) in DN."""
    black_level = np.array(raw.black_level_per_channel, np.float64)
    whites = np.array(raw.camera_white_level_per_channel or (0,), np.float64)
    return black_level, np.where(whites > 0, whites, raw.white_level) + np.zeros_like(black_level)
