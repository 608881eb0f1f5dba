"""Raw files → RawFrame: camera raws through LibRaw, single-channel TIFF and PNG, .npy, headerless .raw and .bin.

The colour filter array comes from the table, never from the decoder, which reports anything but 2 × 2 wrongly and silently
(DESIGN 4). From the file come pixels, black, white, crop, orientation, and for 2 × 2 arrays the phase.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError
from l3cli.frame import RawFrame, shifted_cfa
from l3cli.io.arrays import map_array
from l3cli.io.camera_raws import read_camera_raw
from l3cli.io.images import read_mono
from l3cli.limits import require_picture

HEADERLESS = (".raw", ".bin")
IMAGES = (".tif", ".tiff", ".png")
TOP = 65535  # DN, the most that 16 bits hold
Sensor = TransformTable | CameraModel  # whose size, levels and colour filter array raw files have


@dataclass(frozen=True)
class KnownBetter:
    """What the caller knows about a raw file; None: as the file or, where it does not tell, the table says."""

    black: float | None = None  # DN
    white: float | None = None  # DN
    phase: tuple[int, int] | None = None  # CFA row and column of pixel (0, 0)
    size: tuple[int, int] | None = None  # rows, columns of a headerless file


def read_raw(path: Path, table: Sensor, known: KnownBetter | None = None) -> RawFrame:
    """The frame in `path`, read as its suffix tells; InputFileError names file and cure."""
    known = known or KnownBetter()
    if path.is_dir() or not path.exists():
        raise InputFileError(f"{path} {'is a folder' if path.is_dir() else 'does not exist'}; give a raw file")
    suffix = path.suffix.lower()
    try:
        if suffix in HEADERLESS:
            values = _read_headerless(path, known.size or (table.rows, table.cols))
        elif suffix == ".npy":
            values = map_npy(path, 2)
        elif suffix in IMAGES:
            values = read_mono(path)
        else:
            return _corrected(_read_camera_raw(path, table, known.phase), table, known)
        return frame_of(str(path), values, table, known)
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error


def frame_of(name: str, values: NDArray, table: Sensor, known: KnownBetter) -> RawFrame:
    """A frame of pixels (row, col) that came with nothing else: levels are the table's, unless the caller knows better."""
    if values.size == 0 or values.ndim != 2:
        raise InputFileError(f"{name} holds no pixels; give a raw file")
    require_picture(name, *values.shape)
    frame = RawFrame(name, np.array(values, np.uint16, order="C"), table.black, table.white)
    return _corrected(frame, table, known)


def _corrected(frame: RawFrame, table: Sensor, known: KnownBetter) -> RawFrame:
    """The frame with what the caller knows better in place of what the file says."""
    black = frame.black if known.black is None else known.black
    white = frame.white if known.white is None else known.white
    phase = frame.phase if known.phase is None else known.phase
    if not 0 <= black < white <= TOP:
        raise InputFileError(
            f"{frame.name}: black level {black:g} and white level {white:g} do not fit; give --black and --white-level"
        )
    rows, cols = table.cfa.shape
    return RawFrame(frame.name, frame.values, black, white, (phase[0] % rows, phase[1] % cols), frame.orientation)


# -------------------------------------------------------------------------------------------------- plain formats


def _read_headerless(path: Path, size: tuple[int, int]) -> NDArray[np.uint16]:
    """Little-endian 16-bit values row by row, nothing else."""
    rows, cols = size
    found, wanted = path.stat().st_size, rows * cols * 2
    if found != wanted:
        raise InputFileError(
            f"{path} has {found} bytes, {rows}×{cols} 16-bit values have {wanted}; give its size with --size ROWSxCOLS"
        )
    return np.fromfile(path, "<u2").reshape(rows, cols)


def map_npy(path: Path, axes: int) -> NDArray:
    """The array of a .npy file, mapped. InputFileError unless it has `axes` axes of DN."""
    values = map_array(path)
    if values.ndim != axes or values.dtype.kind != "u" or values.dtype.itemsize > 2:
        held = f"{values.ndim}-dimensional {values.dtype}"
        raise InputFileError(f"{path} holds {held}; give a uint16 array of rows × columns, or of frames × rows × columns")
    return values


def npy_axes(path: Path) -> int:
    """Number of axes of a .npy file's array."""
    return map_array(path).ndim


# ---------------------------------------------------------------------------------------------------- camera raws


def _read_camera_raw(path: Path, table: Sensor, phase: tuple[int, int] | None) -> RawFrame:
    found = read_camera_raw(path)
    values, black = _common_black(found["values"], found["colours"], found["blacks"])
    white = found["white"]
    if not black < white:
        raise InputFileError(f"{path}: its black level {black:g} is not below its white level {white:g}; it is damaged")
    if phase is None:
        phase = _phase(
            path, np.array([[found["letters"][index] for index in row] for row in found["colours"][:2, :2]]), table
        )
    return RawFrame(str(path), values, black, white, phase, found["orientation"])


def _common_black(
    values: NDArray[np.uint16], colours: NDArray[np.uint8], blacks: NDArray[np.integer]
) -> tuple[NDArray[np.uint16], float]:
    """values (row, col) shifted so that all colours have the rounded mean of their black levels, and that mean."""
    used = np.unique(colours)
    black = int(np.rint(blacks[used].mean()))
    if (blacks[used] == black).all():
        return values.copy(), float(black)
    shifted = values.astype(np.int64) + (black - blacks.astype(np.int64))[colours]
    return np.clip(shifted, 0, TOP).astype(np.uint16), float(black)


def _phase(path: Path, letters: NDArray[np.str_], table: Sensor) -> tuple[int, int]:
    """Site of pixel (0, 0): the shift of the table's CFA that gives the file's 2 × 2 colour `letters`; (0, 0) where the
    two cannot be compared, because the table's CFA is no 2 × 2 of r, g, b. InputFileError if no shift matches."""
    names = np.array([name.lower() for name in table.channels])
    if table.cfa.shape != (2, 2) or not set(names) <= {"r", "g", "b"}:
        return 0, 0
    wanted = np.char.lower(letters)
    for phase in ((0, 0), (0, 1), (1, 0), (1, 1)):
        if (names[shifted_cfa(table.cfa, phase)] == wanted).all():
            return phase
    ours, theirs = ("/".join("".join(row) for row in pattern) for pattern in (names[table.cfa], wanted))
    raise InputFileError(
        f"{path} has the colour filter array {theirs}, the table {ours}; "
        "give the table of this camera, or the site of the first pixel with --phase ROW,COL"
    )
