"""Read camera raw files with LibRaw: pixels, black and white levels, and colours.

The module also reads metadata about the camera (names, colour matrices, noise and lens) from DNG 1.7 and Exif tags or, if a
tag is missing, from LibRaw.
"""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.frame import with_one_black_level
from l3cli.frames.measurement import Stated, StatedMatrix
from l3cli.io.isolated import isolated
from l3cli.io.raw import RawContent
from l3cli.io.raw.cfa_codes import codes_of
from l3cli.io.raw.dng_colour import calibrations
from l3cli.io.tags import COLOUR_FILTER_ARRAY, camera_names, exif_of, number, numbers, shot_of_page
from l3cli.system.files import require_regular
from l3cli.system.limits import require_picture


@isolated("rawpy", "tifffile")
def read(path: Path) -> RawContent:
    """Read the visible area of a camera raw file.

    Raises InputFileError if LibRaw cannot read the file, or if the file contains no mosaic.
    """
    with opened(path) as raw:
        content = _visible(path, raw)
        content["camera"], shot = _stated_by_tags(path)
        content["shot"] = _shot(raw) | shot
    return content


@contextlib.contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Context manager that opens a raw file with LibRaw and yields its rawpy object.

    Raises InputFileError if LibRaw cannot read the file, or if the file contains no mosaic.
    """
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            require_picture(str(path), raw.sizes.raw_height, raw.sizes.raw_width)
            if raw.raw_type != rawpy.RawType.Flat or raw.raw_image_visible.ndim != 2:
                raise InputFileError(f"{path} is already demosaicked (linear); use the camera's original raw file")
            yield raw
    except rawpy.LibRawError as error:
        reason = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else str(error)
        raise InputFileError(
            f"{path} is damaged, or is not a raw file that LibRaw supports ({reason}); "
            "use a camera raw, a TIFF or PNG file with one channel, a .npy file, or a headerless .raw file"
        ) from error


def _visible(path: Path, raw: Any) -> RawContent:
    """Return the frame without masked borders.

    If the colours have different black levels, the values are converted to common levels. If only their white levels differ,
    the lowest white level is returned. Raises InputFileError if the colours or the levels are invalid.
    """
    colours, letters = raw.raw_colors_visible, raw.color_desc.decode("ascii", "replace")
    if raw.num_colors == 1:  # LibRaw reports colour index 6, which is not in `letters`, for monochrome sensors
        colours, letters = np.zeros_like(colours), "W"
    black_level = np.array(raw.black_level_per_channel, np.float64)
    whites = np.array(raw.camera_white_level_per_channel or (0,), np.float64)
    white_level = np.where(whites > 0, whites, raw.white_level) + np.zeros_like(black_level)
    if colours.max() >= min(len(letters), len(black_level)):
        raise InputFileError(f"{path} contains a pixel with an undefined colour; copy the file again")
    used = np.unique(colours)
    if not (black_level[used] < white_level[used]).all():
        levels = f"{black_level[used].max():g} is not below the white level {white_level[used].min():g}"
        raise InputFileError(f"{path}: the black level {levels}; copy the file again")
    values = raw.raw_image_visible.copy()
    if np.ptp(black_level[used]) == 0:
        common, top = float(black_level[used[0]]), float(white_level[used].min())
    else:
        values, common, top = with_one_black_level(values, black_level[colours], white_level[colours])
    rows, cols = raw.raw_pattern.shape
    pattern = codes_of(letters)[colours[:rows, :cols]]
    shot = getattr(raw, "other", None)  # None if rawpy is older than 0.26
    exposure = float(shot.shutter_speed) if shot is not None else None
    return RawContent(
        values=values,
        black_level=common,
        white_level=top,
        pattern=pattern,
        orientation=int(raw.sizes.flip),
        exposure=exposure,
        neutral=_neutral(raw, letters),
    )


def _neutral(raw: Any, letters: str) -> NDArray[np.float64] | None:
    """Return the code of each colour, and the signal of a grey surface in it, (colour, 2).

    The signal is the inverse of the white-balance multiplier. Returns None if there is only one colour, or if multipliers
    are missing, for which LibRaw returns 0.
    """
    multipliers = np.array(raw.camera_whitebalance[: len(letters)], np.float64)
    stated = {code: 1 / each for code, each in zip(codes_of(letters).tolist(), multipliers, strict=False) if each > 0}
    if len(stated) < max(len(set(letters)), 2):
        return None
    return np.array(list(stated.items()))


def _stated_by_tags(path: Path) -> tuple[list[str], dict[str, str | float]]:
    """Return the camera names and the shot settings from TIFF tags. Both are empty if the file has no such tags."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            return camera_names(file.pages[0]), shot_of_page(file.pages[0])
    except Exception:  # the frame, which LibRaw has already read, is usable without the tags
        return [], {}


def _shot(raw: Any) -> dict[str, str | float]:
    """Return the shot settings that LibRaw reports, in any file format. The result is empty if rawpy is older than 0.26."""
    shot, lens = getattr(raw, "other", None), getattr(raw, "lens", None)
    stated = {
        "lens": getattr(lens, "model", None),
        "f_number": getattr(shot, "aperture", None),
        "focal_length": getattr(shot, "focal_length", None),
        "iso": getattr(shot, "iso_speed", None),
    }
    return {name: value for name, value in stated.items() if isinstance(value, str | float | int)}


# ----------------------------------------------------------------------------------------- metadata about the camera

LIGHTS = {  # value of the Exif tag LightSource (and CalibrationIlluminant in DNG) → name of the illuminant
    1: "D55", 2: "F2", 3: "A", 4: "D55", 9: "D55", 10: "D65", 11: "D75", 12: "F1", 13: "F3", 14: "F2", 15: "F3", 17: "A",
    18: "B", 19: "C", 20: "D55", 21: "D65", 22: "D75", 23: "D50", 24: "3200K",
}  # fmt: skip
USUAL_LIGHT = "D65"  # assumed illuminant of matrices without a stated illuminant, such as LibRaw's built-in matrices
UNITS_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # value of the Exif tag FocalPlaneResolutionUnit → unit in mm
PITCHES_UM = 0.5, 50.0  # range of plausible pixel pitches in µm
LONGEST = 60  # makes and models are cut to this number of characters


def stated(path: Path) -> Stated:
    """Read the metadata about the camera from a raw file. Invalid tags are treated as missing.

    Raises InputFileError if LibRaw cannot read the file.
    """
    require_regular(path, "use a raw file")
    names, figures, matrices = _stated(path)
    found = tuple(
        StatedMatrix(LIGHTS.get(int(light), USUAL_LIGHT), int(light) not in LIGHTS, rows)
        for light, codes, values in matrices
        if (rows := _rows(codes, values))
    )
    slope, constant = figures.get("noise_slope"), figures.get("noise_constant")
    noise = (slope, constant) if slope and constant is not None and 0 < slope < 1 and 0 <= constant < 1 else None
    pitch = _positive(figures.get("pitch_um"))
    return Stated(
        camera=_named(names),
        matrices=found,
        noise=noise,
        iso=_positive(figures.get("iso")),
        pitch_um=pitch if pitch and PITCHES_UM[0] <= pitch <= PITCHES_UM[1] else None,
        focal_length_mm=_positive(figures.get("focal_length_mm")),
        f_number=_positive(figures.get("f_number")),
    )


def _rows(codes: NDArray, values: NDArray) -> dict[int, NDArray[np.float64]]:
    """Return the rows of a colour matrix by colour code, or {} if the matrix is invalid.

    If several rows have the same code, the first of them is returned.
    """
    values = np.asarray(values, np.float64)
    if values.size != 3 * len(codes) or not np.isfinite(values).all() or not values.any(axis=-1).all():
        return {}
    rows: dict[int, NDArray[np.float64]] = {}
    for code, row in zip(codes.tolist(), values.reshape(-1, 3), strict=True):
        rows.setdefault(int(code), row)
    return rows


def _named(names: list[str]) -> str:
    """Join make and model without repetition: "Canon" and "Canon EOS 550D" become "Canon EOS 550D"."""
    make, model = (" ".join("".join(c if c.isprintable() else " " for c in name).split())[:LONGEST] for name in names)
    return model if model.lower().startswith(make.lower()) else f"{make} {model}".strip()


def _positive(value: float | None) -> float | None:
    return value if value is not None and 0 < value < 1e6 else None


# --------------------------------------------------------------------------- functions that run in the decoding process


@isolated("rawpy", "tifffile")
def _stated(path: Path) -> tuple[list[str], dict[str, float], list[tuple[int, NDArray, NDArray]]]:
    """Read the metadata about the camera in a raw file.

    Returns
    -------
    names : list of str
        Make and model, which may be empty.
    figures : dict of str to float
        Numbers such as "iso" and "f_number".
    matrices : list of tuple
        One tuple per colour matrix: illuminant code, colour code of each row, and values, (row, 3).
    """
    names, figures, matrices = _facts_of_tags(path)
    with opened(path) as raw:
        if not matrices:
            letters = raw.color_desc.decode("ascii", "replace")[: raw.num_colors]
            values = np.array(raw.rgb_xyz_matrix, np.float64)[: len(letters)]
            matrices = [(0, codes_of(letters), values)] if values.any() else []
        shot = getattr(raw, "other", None)  # None if rawpy is older than 0.26
        known = {"iso": "iso_speed", "focal_length_mm": "focal_length", "f_number": "aperture"}
        if not getattr(shot, "focal_length", 0.0):
            del known["f_number"]  # for a file without an aperture, LibRaw returns 1
        figures = {name: float(getattr(shot, key, 0.0)) for name, key in known.items()} | figures
    return names, figures, matrices


def _facts_of_tags(path: Path) -> tuple[list[str], dict[str, float], list[tuple[int, NDArray, NDArray]]]:
    """Read the names, figures and matrices (see `_stated`) from the tags of a TIFF or DNG file.

    All three are empty for files in other formats, and for files with unreadable tags.
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            first = file.pages[0]
            pages = [first, *(first.pages or ())]
            return [str(first.tags.valueof(tag) or "") for tag in ("Make", "Model")], _figures(pages), _matrices(pages)
    except Exception:  # unreadable tags are accepted, and LibRaw reports damaged files
        return ["", ""], {}, []


def _figures(pages: list[Any]) -> dict[str, float]:
    tags, exif = pages[0].tags, exif_of(pages[0])
    stated = {
        "iso": tags.valueof("ISOSpeedRatings") or exif.get("ISOSpeedRatings"),
        "focal_length_mm": tags.valueof("FocalLength") or exif.get("FocalLength"),
        "f_number": tags.valueof("FNumber") or exif.get("FNumber"),
    }
    found = {name: figure for name, value in stated.items() if (figure := number(value))}
    per_unit, unit = number(exif.get("FocalPlaneXResolution")), exif.get("FocalPlaneResolutionUnit", 2)
    if per_unit and unit in UNITS_MM:
        found["pitch_um"] = 1000.0 * UNITS_MM[unit] / per_unit
    profile = next((page.tags.valueof("NoiseProfile") for page in pages if "NoiseProfile" in page.tags), None)
    if profile is not None:
        slope, constant = np.asarray(profile, np.float64).reshape(-1, 2).mean(axis=0).tolist()
        found |= {"noise_slope": slope, "noise_constant": constant}
    return found


def _matrices(pages: list[Any]) -> list[tuple[int, NDArray, NDArray]]:
    """Return the matrices from XYZ to camera signals: AnalogBalance · CameraCalibration · ColorMatrix.

    Each of them is a tuple (illuminant code, colour code of each row, values).
    """
    raw = [page for page in pages if page.tags.valueof("PhotometricInterpretation") == COLOUR_FILTER_ARRAY]
    codes = np.array(numbers((raw or pages)[0], "CFAPlaneColor", (0, 1, 2)), np.int64)
    return [(each.light, codes, each.camera @ each.colour) for each in calibrations(pages[0], len(codes))]
