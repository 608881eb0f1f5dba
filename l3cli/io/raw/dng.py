"""Read DNG files, including CinemaDNG (Adobe DNG 1.7, TIFF/EP).

LibRaw decompresses the pixels and applies the linearisation table. Because LibRaw supports only CFAs of 2 × 2 or 6 × 6 sites
and four black levels, l3 reads the CFA, the levels and other properties from the tags. If an unsupported tag affects the
pixels, l3 rejects the file or warns (docs/raw-files.md#tags-of-a-dng).
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.correction import plan_correction
from l3cli.frames.frame import with_one_black_level
from l3cli.io import tags
from l3cli.io.isolated import isolated
from l3cli.io.raw import RawContent
from l3cli.io.raw.cfa_codes import LETTERS
from l3cli.io.raw.dng_colour import as_shot_neutral
from l3cli.io.raw.libraw import opened
from l3cli.io.raw.opcodes import Opcodes, bad_pixels, gain_of_pixels, read_opcodes
from l3cli.io.video import storable_rate
from l3cli.physics.mosaic import tiled
from l3cli.system.limits import require_picture

WHITE_CODE = LETTERS.index("W")
LATEST = (1, 7)  # latest supported DNG version
UNREAD = {8: "Deflate", 34892: "lossy JPEG", 52546: "JPEG XL"}  # compression methods that LibRaw cannot decode in mosaics
DUAL = 2  # samples per pixel from dual-pixel sensors, and from sensors with a second, less sensitive photodiode
WHOLE = (0, 0, 1, 1)  # value of DefaultUserCrop that means no crop
ONLY = {  # tag → its only supported value, and the message for any other value
    "CFALayout": (
        tags.RECTANGULAR,
        "is from a sensor with staggered pixels (CFALayout); use frames from a sensor with a rectangular pixel grid",
    ),
    "SampleFormat": (tags.UNSIGNED, "contains floating-point values; use the camera's original raw file"),
    "FillOrder": (
        1,
        "stores bits in reverse order (FillOrder), which l3 does not support; convert the camera's original file to DNG "
        "again",
    ),
    "Predictor": (
        1,
        "stores differences between pixels (Predictor), which l3 does not support; convert the camera's original file to "
        "DNG again",
    ),
    "SubTileBlockSize": (
        1,
        "stores pixels in blocks (SubTileBlockSize), which l3 does not support; "
        "convert the camera's original file to DNG again",
    ),
    "ColorimetricReference": (
        0,
        "contains the values of a developed picture (ColorimetricReference); use the camera's original raw file",
    ),
}
MOST_STOPS = 20.0  # largest plausible BaselineExposure in EV
FRAME_RATE = 51044  # number of the CinemaDNG tag FrameRate


@dataclass(frozen=True)
class Mosaic:
    """Properties of the raw image, from the tags of the file."""

    orientation: int  # LibRaw flip code
    pattern: NDArray[np.int64]  # (row, col) colour codes, starting at the upper left corner of the active area
    active: tuple[int, int, int, int]  # top, left, bottom and right edges of the light-sensitive area
    crop: tuple[int, int, int, int]  # default crop: first row and column in the active area, number of rows and columns
    black_level: NDArray[np.float64]  # (row, col) DN; pattern that repeats from the upper left corner of the active area
    black_of_row: NDArray[np.float64]  # DN to add to black_level in each row of the active area
    black_of_col: NDArray[np.float64]  # DN to add to black_level in each column of the active area
    black_fault: str  # why the black level is unknown, for messages; empty if it is known
    white_level: float  # DN
    exposure: float | None  # exposure time in s; None if unknown
    baseline_exposure: float  # EV
    neutral: NDArray[np.float64] | None  # (colour, 2) CFA code, and signal of a grey surface in this colour; None if unknown
    camera: list[str]  # make, model and other names of the camera
    shot: dict[str, str | float]  # fields of Shot
    opcodes: Opcodes
    planes: tuple[int, ...]  # colour code of each colour plane
    shape: tuple[int, int]  # rows and columns, including masked borders
    fields: tuple[int, int]  # numbers of interleaved fields of the rows and of the columns
    masked: tuple[tuple[int, ...], ...]  # top, left, bottom and right edges of each masked area
    notes: tuple[str, ...]  # warnings about unsupported tags


@isolated("rawpy", "tifffile")
def read(path: Path) -> RawContent:
    """Read the default crop of the raw image in a DNG file.

    Raises InputFileError if the file cannot be read, or if its tags are damaged or unsupported.
    """
    mosaic = _read_tags(path)  # before LibRaw reads them, because its messages about invalid tags are less clear
    with opened(path) as raw:
        if raw.raw_image.shape != mosaic.shape:
            rows, cols = mosaic.shape
            raise InputFileError(
                f"{path}: the tags state {rows}×{cols} pixels, but the image has "
                f"{'×'.join(map(str, raw.raw_image.shape))}; copy the file again"
            )
        return _described(path, mosaic, _in_order(raw.raw_image, mosaic.fields))


def _in_order(stored: NDArray[np.uint16], fields: tuple[int, int]) -> NDArray[np.uint16]:
    """Restore the pixel order on the sensor if an image, (row, col), is stored as interleaved fields.

    If the rows are divided into n fields (RowInterleaveFactor), the file contains rows 0, n, 2n… first, then rows 1, n + 1…,
    and so on. The columns can be divided in the same way (ColumnInterleaveFactor).
    """
    if fields == (1, 1):
        return stored
    rows, cols = (
        np.argsort(np.argsort(np.arange(length) % count, kind="stable"))
        for length, count in zip(stored.shape, fields, strict=True)
    )
    return stored[np.ix_(rows, cols)]


def _described(path: Path, mosaic: Mosaic, stored: NDArray[np.uint16]) -> RawContent:
    """Crop the linearised pixels `stored` (row, col) to the default crop, and shift them to one common black level.

    Raises InputFileError if the tags contradict the pixels.
    """
    top, left, bottom, right = mosaic.active
    row, col, rows, cols = mosaic.crop
    shown = np.s_[row : row + rows, col : col + cols]
    black_level = _black_levels(mosaic, (bottom - top, right - left))
    black_level = black_level if black_level.size == 1 else black_level[shown]
    fault = mosaic.black_fault
    if not (black_level.min() >= 0 and (black_level < mosaic.white_level).all()):
        levels = f"{black_level.min():g}" if black_level.size == 1 else f"{black_level.min():g}…{black_level.max():g}"
        fault = f"has a black level of {levels} DN, which is not between 0 and the white level of {mosaic.white_level:g} DN"
    if fault:
        black_level = np.zeros((1, 1))
    pixels = stored[top:bottom, left:right].copy()  # a copy, because LibRaw frees the memory of `stored`
    gain = None
    if mosaic.opcodes:
        pixels, gain = _changed(path, mosaic, pixels, bad_pixels(mosaic.opcodes, stored, mosaic.active))
    pixels, gain = pixels[shown], None if gain is None else gain[shown]
    values, common, white_level = with_one_black_level(pixels, black_level, np.array(mosaic.white_level))
    pattern = np.roll(mosaic.pattern, (-row, -col), axis=(0, 1))
    content = RawContent(
        values=values,
        white_level=white_level,
        pattern=pattern,
        orientation=mosaic.orientation,
        exposure=mosaic.exposure,
        baseline_exposure=mosaic.baseline_exposure,
        neutral=mosaic.neutral,
        camera=mosaic.camera,
        shot=mosaic.shot,
        notes=mosaic.notes + mosaic.opcodes.notes,
    )
    faults = {"black_level": f"{fault}; set ‹black_level›"} if fault else {}
    if mosaic.opcodes.demanded:
        faults["opcodes"] = (
            f"requires the correction {mosaic.opcodes.demanded[0]}, which l3 does not support; convert the original "
            "file without lens corrections, or ignore the correction with ‹opcodes› leave"
        )
        content["notes"] += tuple(f"the required correction {each} is ignored" for each in mosaic.opcodes.demanded)
    if faults:
        content["faults"] = faults
    if not fault:
        content["black_level"] = common
    if gain is not None:
        content["gain"] = gain
    beside, above = _masked_values(mosaic, stored)
    if beside.size or above.size:
        content["masked"] = (beside, above)
    if mosaic.opcodes.warps:
        content["warps"] = tuple(asdict(replace(warp, origin=(row, col))) for warp in mosaic.opcodes.warps)
    return content


def _masked_values(mosaic: Mosaic, stored: NDArray[np.uint16]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the masked pixels to the left and right of the default crop, and above and below it.

    Only areas that extend over all rows or all columns of the crop are used. The file's black levels are subtracted from the
    masked pixels, as from the frame. Outside the active area, the repeating pattern of black levels is continued.

    Returns
    -------
    beside : ndarray, (row, masked pixel)
        Masked pixels of each row in DN.
    above : ndarray, (masked pixel, col)
        Masked pixels of each column in DN.
    """
    row, col, rows, cols = mosaic.crop
    top, left = mosaic.active[0] + row, mosaic.active[1] + col
    beside, above = [np.zeros((rows, 0), np.float32)], [np.zeros((0, cols), np.float32)]
    for first_row, first_col, last_row, last_col in mosaic.masked:
        if first_row <= top and last_row >= top + rows:
            black = mosaic.black_of_row[row : row + rows, None] + _repeated_black(
                mosaic, (top, first_col), (rows, last_col - first_col)
            )
            beside.append((stored[top : top + rows, first_col:last_col] - black).astype(np.float32))
        elif first_col <= left and last_col >= left + cols:
            black = mosaic.black_of_col[col : col + cols] + _repeated_black(
                mosaic, (first_row, left), (last_row - first_row, cols)
            )
            above.append((stored[first_row:last_row, left : left + cols] - black).astype(np.float32))
    return np.concatenate(beside, axis=1), np.concatenate(above)


def _repeated_black(mosaic: Mosaic, corner: tuple[int, int], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the repeating black levels, (row, col), in an image area of this shape with the first pixel `corner`."""
    shift = [active - first for active, first in zip(mosaic.active, corner, strict=False)]
    return np.asarray(tiled(np.roll(mosaic.black_level, shift, axis=(0, 1)), shape))


def _changed(
    path: Path, mosaic: Mosaic, pixels: NDArray[np.uint16], bad: NDArray[np.bool_]
) -> tuple[NDArray[np.uint16], NDArray[np.float32] | None]:
    """Apply the file's opcodes: correct the pixels marked in `bad`, and compute the gain of each pixel.

    Returns
    -------
    pixels : ndarray of uint16, (row, col)
        The corrected pixels. The gains are not applied.
    gains : ndarray, (row, col), or None
        Gain of each pixel. None if no opcode requests gains.

    Raises
    ------
    InputFileError
        If the gains are implausible.
    """
    if bad.any():
        pixels = plan_correction(bad, mosaic.pattern).corrected(pixels)
    if not mosaic.opcodes.gains:
        return pixels, None
    try:
        rows, cols = pixels.shape
        return pixels, gain_of_pixels(mosaic.opcodes, mosaic.pattern, mosaic.planes, (rows, cols))
    except ValueError as error:
        raise InputFileError(f"{path} has damaged tags ({error}); copy the file again") from error


def _black_levels(mosaic: Mosaic, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the black level of each pixel in the active area, (row, col), or an array (1, 1) if all levels are equal."""
    if np.ptp(mosaic.black_level) == 0 and not mosaic.black_of_row.any() and not mosaic.black_of_col.any():
        return mosaic.black_level[:1, :1]
    return tiled(mosaic.black_level, shape) + mosaic.black_of_row[:, None] + mosaic.black_of_col


def rate(path: Path) -> Fraction | None:
    """Return the frame rate in a CinemaDNG file, in frames/s, or None if it is missing or invalid."""
    fraction = _rate(path)
    return storable_rate(Fraction(*fraction)) if fraction else None


@isolated("tifffile")
def _rate(path: Path) -> tuple[int, int] | None:
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            tag = file.pages[0].tags.get(FRAME_RATE)
            rate = Fraction(*tag.value) if tag else Fraction(0)
    except (tifffile.TiffFileError, TypeError, ValueError, IndexError, ZeroDivisionError, OSError):
        return None  # reading the frame will report the error
    return (rate.numerator, rate.denominator) if rate > 0 else None


# ------------------------------------------------------------------------------------------------------------ tags


def _read_tags(path: Path) -> Mosaic:
    """Read the tags of the raw image in a file.

    Raises InputFileError if the tags are damaged, if the file contains no mosaic, or if it is unsupported (see
    `_refuse_unsupported`).
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            first, raw = file.pages[0], _raw_page(path, file)
            _refuse_unsupported(path, first, raw)
            return _mosaic(path, first, raw)
    except tifffile.TiffFileError as error:
        raise InputFileError(f"{path} is damaged or not a DNG file; use the camera's original raw file") from error
    except tags.BROKEN as error:
        raise InputFileError(f"{path} has damaged tags ({error}); copy the file again") from error


def _raw_page(path: Path, file: Any) -> Any:
    """Return the page or subpage with the largest raw image. Previews, masks and enhanced images are ignored.

    Raises InputFileError if the file contains no raw image.
    """
    pages = [each for page in file.pages for each in (page, *(page.pages or ()))]
    kinds = (tags.COLOUR_FILTER_ARRAY, tags.LINEAR_RAW)
    raw = [page for page in pages if page.tags.valueof("PhotometricInterpretation") in kinds]
    full = [page for page in raw if not page.tags.valueof("NewSubfileType", 0) & ~tags.ONE_OF_MANY]
    if not full:
        raise InputFileError(f"{path} contains no raw image; use a DNG file with a raw mosaic")
    return max(full, key=lambda page: page.imagelength * page.imagewidth)


def _refuse_unsupported(path: Path, first: Any, raw: Any) -> None:
    """Raise InputFileError if l3 or LibRaw does not support the file.

    Unsupported files require a newer DNG version, are demosaicked, store their data in an unsupported form, or contain an
    unsupported tag that affects the pixels.
    """
    version = tuple(first.tags.valueof("DNGBackwardVersion") or LATEST)[:2]
    if version > LATEST:
        raise InputFileError(
            f"{path} requires DNG version {version[0]}.{version[1]}, but l3 supports only versions up to "
            f"{LATEST[0]}.{LATEST[1]}; convert the camera's original file to an earlier version"
        )
    if raw.samplesperpixel != 1 and raw.tags.valueof("PhotometricInterpretation") == tags.LINEAR_RAW:
        raise InputFileError(f"{path} is already demosaicked (linear DNG); use the camera's original raw file")
    if raw.samplesperpixel > DUAL:
        raise InputFileError(
            f"{path} has {raw.samplesperpixel} samples per pixel, but l3 supports only one, or two from dual-pixel sensors; "
            "use the camera's original raw file"
        )
    if raw.compression in UNREAD:
        raise InputFileError(
            f"{path} has {UNREAD[raw.compression]} compression, which l3 does not support; "
            "convert the file to DNG with lossless JPEG compression or without compression"
        )
    for tag, (only, what) in ONLY.items():
        page = first if tag == "ColorimetricReference" else raw
        if set(np.ravel(page.tags.valueof(tag, only)).tolist()) != {only}:
            raise InputFileError(f"{path} {what}")
    if raw.compression == 1 and not raw.is_tiled and not _contiguous(raw.dataoffsets, raw.databytecounts):
        raise InputFileError(
            f"{path}: the strips of the image are not contiguous, but LibRaw requires contiguous strips; save the image in "
            "one strip"
        )
    one_tile = raw.compression != 1 or raw.tilelength >= raw.imagelength
    if raw.is_tiled and raw.tilewidth > raw.imagewidth and one_tile:
        raise InputFileError(
            f"{path}: the tiles are wider than the image, which LibRaw does not support; save the image in strips"
        )


def _mosaic(path: Path, first: Any, raw: Any) -> Mosaic:
    shape = (int(raw.imagelength), int(raw.imagewidth))
    require_picture(str(path), *shape)
    top, left, bottom, right = (int(edge) for edge in tags.numbers(raw, "ActiveArea", (0, 0, *shape)))
    if not (0 <= top < bottom <= shape[0] and 0 <= left < right <= shape[1]):
        raise InputFileError(
            f"{path}: the active area {top, left, bottom, right} exceeds the {shape[0]}×{shape[1]} pixels of the image; "
            "copy the file again"
        )
    rows, cols = bottom - top, right - left
    origin, size = tags.numbers(raw, "DefaultCropOrigin", (0, 0)), tags.numbers(raw, "DefaultCropSize", (cols, rows))
    crop = tuple(round(value) for value in (origin[1], origin[0], size[1], size[0]))
    if not (min(crop[:2]) >= 0 and min(crop[2:]) >= 1 and crop[0] + crop[2] <= rows and crop[1] + crop[3] <= cols):
        raise InputFileError(
            f"{path}: the default crop {crop} exceeds the active area of {rows}×{cols} pixels; copy the file again"
        )
    pattern = _pattern(path, raw)
    planes = tuple(raw.tags.valueof("CFAPlaneColor") or (0, 1, 2))
    masked, damaged = _masked_areas(raw, shape, (top, left, bottom, right))
    black, fault = _stated_black(raw, pattern.shape, (rows, cols))
    return Mosaic(
        orientation=tags.flip_of(path, first.tags.valueof("Orientation", tags.UPRIGHT)),
        pattern=pattern,
        active=(top, left, bottom, right),
        crop=crop,
        black_level=black[0],
        black_of_row=black[1],
        black_of_col=black[2],
        black_fault=fault,
        white_level=float(tags.numbers(raw, "WhiteLevel", (2**raw.bitspersample - 1,))[0]),
        exposure=tags.exposure_time(first),
        baseline_exposure=_baseline_exposure(first),
        neutral=_neutral(first, raw),
        camera=tags.camera_names(first),
        shot=tags.shot_of_page(first),
        opcodes=read_opcodes(raw, planes, (rows, cols)),
        planes=planes,
        shape=shape,
        fields=_fields(raw),
        masked=masked,
        notes=(*_notes(raw), *damaged),
    )


def _stated_black(
    raw: Any, cfa_shape: tuple[int, ...], shape: tuple[int, int]
) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], str]:
    """Read the black level from the tags.

    Returns
    -------
    levels : tuple of ndarray
        Pattern of levels, (row, col), that repeats over the image, and the offsets, (row,) and (col,), to add to each row
        and to each column.
    fault : str
        Message about a damaged tag, in which case all levels are 0. Empty if the tags are valid.
    """
    rows, cols = shape
    try:
        added = _as_many(raw, "BlackLevelDeltaV", rows), _as_many(raw, "BlackLevelDeltaH", cols)
        return (_repeating_black(raw, cfa_shape), *added), ""
    except tags.BROKEN as error:
        return (np.zeros((1, 1)), np.zeros(rows), np.zeros(cols)), f"has a damaged black level ({error})"


def _repeating_black(raw: Any, cfa_shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the repeating pattern of black levels, (row, col), for the first sample of each pixel.

    Many programs omit BlackLevelRepeatDim, or write a size that contradicts the number of levels. l3 then accepts one level
    per CFA site, or levels that are all equal, and otherwise raises ValueError.
    """
    levels = np.asarray(tags.numbers(raw, "BlackLevel", (0,)), np.float64)
    stated = tuple(np.ravel(raw.tags.valueof("BlackLevelRepeatDim", (1, 1))).tolist())
    for shape in (stated, cfa_shape):
        for samples in (raw.samplesperpixel, 1):
            if len(shape) == 2 and min(shape) >= 1 and levels.size == shape[0] * shape[1] * samples:
                return levels.reshape(*shape, samples)[..., 0]
    if levels.size and np.ptp(levels) == 0:
        return levels[:1, None]
    repeat = "×".join(map(str, stated))
    raise ValueError(f"BlackLevel has {levels.size} values, but BlackLevelRepeatDim is {repeat}")


def _masked_areas(
    raw: Any, shape: tuple[int, int], active: tuple[int, int, int, int]
) -> tuple[tuple[tuple[int, ...], ...], tuple[str, ...]]:
    """Read the top, left, bottom and right edges of each masked area.

    The areas must be inside the image and outside the active area. If the tag is damaged, return no areas and a warning.
    """
    try:
        areas = np.asarray(tags.numbers(raw, "MaskedAreas", ()), np.int64).reshape(-1, 4)
        (first_row, first_col, last_row, last_col), (top, left, bottom, right) = areas.T, active
        inside = (first_row >= 0) & (first_row < last_row) & (last_row <= shape[0])
        inside &= (first_col >= 0) & (first_col < last_col) & (last_col <= shape[1])
        outside = (last_row <= top) | (first_row >= bottom) | (last_col <= left) | (first_col >= right)
        if (inside & outside).all():
            return tuple(map(tuple, areas.tolist())), ()
    except tags.BROKEN:  # the pixels can be used without this tag
        pass
    return (), ("the tag MaskedAreas is damaged, so the masked pixels are not used",)


def _fields(raw: Any) -> tuple[int, int]:
    """Return the numbers of interleaved fields of the rows and of the columns. Raises ValueError if one is below 1."""
    rows, cols = (int(tags.numbers(raw, tag, (1,))[0]) for tag in ("RowInterleaveFactor", "ColumnInterleaveFactor"))
    if min(rows, cols) < 1:
        raise ValueError(f"RowInterleaveFactor is {rows} and ColumnInterleaveFactor is {cols}, but both must be at least 1")
    return rows, cols


def _notes(raw: Any) -> Iterator[str]:
    """Yield a warning for each unsupported tag that affects the picture."""
    across, down = tags.numbers(raw, "DefaultScale", (1, 1))
    if across != down:
        yield f"the pixels are not square (DefaultScale {across:g}, {down:g}), but the picture is not stretched"
    if raw.samplesperpixel == DUAL:
        yield "the file has two samples per pixel (dual pixels), and l3 uses only the first sample"
    if tuple(tags.numbers(raw, "DefaultUserCrop", WHOLE)) != WHOLE:
        yield "the crop that was chosen in the camera (DefaultUserCrop) is not applied"


def _neutral(first: Any, raw: Any) -> NDArray[np.float64] | None:
    """Return the colour code of each plane and the signal of a grey surface in it, (plane, 2).

    Returns None if the tags are unusable.
    """
    try:
        codes = np.asarray(tags.numbers(raw, "CFAPlaneColor", (0, 1, 2)), np.float64)
    except tags.BROKEN:  # the pixels can be used without this tag
        return None
    signals = as_shot_neutral(first, len(codes))
    return None if signals is None else np.stack([codes, signals], axis=1)


def _baseline_exposure(first: Any) -> float:
    """Return BaselineExposure in EV, or 0 if it is missing, damaged or implausible."""
    try:
        (stops,) = tags.numbers(first, "BaselineExposure", (0.0,))
    except tags.BROKEN:  # the pixels can be used without this tag
        return 0.0
    return float(stops) if abs(stops) <= MOST_STOPS else 0.0


def _contiguous(offsets: Sequence[int], lengths: Sequence[int]) -> bool:
    return all(offset + length == after for offset, length, after in zip(offsets, lengths, offsets[1:], strict=False))


def _pattern(path: Path, raw: Any) -> NDArray[np.int64]:
    if raw.tags.valueof("PhotometricInterpretation") == tags.LINEAR_RAW:  # the sensor is monochrome
        return np.array([[WHITE_CODE]])
    codes, shape = raw.tags.valueof("CFAPattern"), raw.tags.valueof("CFARepeatPatternDim")
    if codes is None or shape is None:
        raise InputFileError(
            f"{path} does not contain its colour filter array; convert the camera's original file to DNG again"
        )
    return _repeating(list(codes), shape).astype(np.int64)


def _repeating(values: Sequence[float], shape: Sequence[int]) -> NDArray:
    """Reshape a pattern to (row, col). Raises ValueError if the number of values does not match the shape."""
    if min(shape) < 1:
        raise ValueError(f"invalid pattern size {shape}")
    return np.reshape(values, tuple(shape))


def _as_many(page: Any, name: str, length: int) -> NDArray[np.float64]:
    values = tags.numbers(page, name, np.zeros(length))
    if len(values) != length:
        raise ValueError(f"{name} has {len(values)} values instead of {length}")
    return np.asarray(values, np.float64)
