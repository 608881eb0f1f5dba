"""Raw files → RawFrame: camera raws and DNG through LibRaw, single-channel TIFF, PNG, PGM, FITS, .npy, headerless frames.

The colour filter array comes from the table. From the file come pixels, black, white, crop, orientation, and where it tells
of its array the phase; an array that is not the table's is refused. What a DNG says is read from its tags (`dng`).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.dark import DarkFrame, without_dark
from l3cli.errors import InputFileError
from l3cli.files import require_regular
from l3cli.frame import RawFrame
from l3cli.io.arrays import map_array
from l3cli.io.camera_raws import read_camera_raw
from l3cli.io.cfa_codes import Sensor, codes_of, find_phase
from l3cli.io.fits_files import read_fits
from l3cli.io.images import read_mono
from l3cli.io.packed import PACKED, WORDS, Layout, make_layout
from l3cli.io.pgm import read_pgm
from l3cli.limits import require_picture, require_values

HEADERLESS = (".raw", ".bin", *("." + packing for packing in PACKED))
TIFF = (".tif", ".tiff")
IMAGES = (*TIFF, ".png")
FITS = (".fits", ".fit", ".fts")
RAW_FILE = "give a raw file, or - for headerless frames on stdin"
TOP = 65535  # DN, the most that 16 bits hold
LONGEST = 1e5  # s, the longest exposure that is believed


@dataclass(frozen=True)
class KnownBetter:
    """What the caller knows about a raw file; None: as the file or, where it does not tell, the table says."""

    black: float | None = None  # DN
    white: float | None = None  # DN
    phase: tuple[int, int] | None = None  # CFA row and column of pixel (0, 0)
    size: tuple[int, int] | None = None  # rows, columns of a headerless file
    packing: str | None = None  # one of packed.PACKINGS, of a headerless file
    stride: int | None = None  # bytes from row to row of a headerless file
    exposure: float | None = None  # s
    dark: DarkFrame | None = None  # what the camera gives without light


def read_raw(path: Path, table: Sensor, known: KnownBetter | None = None) -> RawFrame:
    """The frame in `path`, read as its suffix tells; InputFileError names file and cure."""
    known = known or KnownBetter()
    require_regular(path, RAW_FILE)
    suffix, exposure = path.suffix.lower(), None
    try:
        if suffix in HEADERLESS:
            values: NDArray = _read_headerless(path, layout_of(path, table, known))
        elif suffix == ".npy":
            values = map_npy(path, 2)
        elif suffix in IMAGES:
            values, exposure = read_mono(path)
        elif suffix == ".pgm":
            values = read_pgm(path)
        elif suffix in FITS:
            return fits_frame(path, None, table, known)
        else:
            return _corrected(_read_camera_raw(path, table, known.phase), table, known)
        return frame_of(str(path), values, table, known, exposure)
    except OSError as error:
        raise InputFileError(f"{path}: {error.strerror or error}") from error


def frame_of(name: str, values: NDArray, table: Sensor, known: KnownBetter, exposure: float | None = None) -> RawFrame:
    """A frame of pixels (row, col) that came without levels: they are the table's, unless the caller knows better."""
    if values.size == 0 or values.ndim != 2:
        raise InputFileError(f"{name} holds no pixels; give a raw file")
    require_picture(name, *values.shape)
    frame = RawFrame(name, np.array(values, np.uint16, order="C"), table.black, table.white, exposure=exposure)
    return _corrected(frame, table, known)


def fits_frame(path: Path, number: int | None, table: Sensor, known: KnownBetter) -> RawFrame:
    """The frame of a FITS file, or its frame `number`, with the phase that its BAYERPAT tells."""
    values, letters, exposure = read_fits(path, number)
    name = str(path) if number is None else f"{path} frame {number}"
    if letters and known.phase is None:
        known = replace(known, phase=find_phase(name, codes_of(letters).reshape(2, 2), table))
    return frame_of(name, values, table, known, exposure)


def layout_of(path: Path, table: Sensor, known: KnownBetter) -> Layout:
    """How the values of a headerless file lie: as the caller knows, else by its suffix and the table's size."""
    suffix = path.suffix.lower().removeprefix(".")
    packing = known.packing or (suffix if suffix in PACKED else WORDS)
    layout = make_layout(known.size or (table.rows, table.cols), packing, known.stride)
    require_picture(str(path), layout.rows, layout.cols)
    require_values(str(path), (layout.rows, layout.stride), value_bytes=1)
    return layout


def _corrected(frame: RawFrame, table: Sensor, known: KnownBetter) -> RawFrame:
    """The frame with what the caller knows better in place of what the file says, and what dark current adds to it."""
    black = frame.black if known.black is None else known.black
    white = frame.white if known.white is None else known.white
    phase = frame.phase if known.phase is None else known.phase
    if not 0 <= black < white <= TOP:
        raise InputFileError(
            f"{frame.name}: black level {black:g} and white level {white:g} do not fit; give --black and --white-level"
        )
    rows, cols = table.cfa.shape
    told = frame.exposure if frame.exposure is not None and 0 < frame.exposure <= LONGEST else None
    exposure = told if known.exposure is None else known.exposure
    dark = table.dark_signal(exposure) * (white - black) / (table.white - table.black)
    if not dark < white - black:
        raise InputFileError(
            f"{frame.name}: dark current alone fills a pixel with {dark:.4g} of {white - black:.4g} DN; "
            "is its exposure time in seconds?"
        )
    corrected = replace(
        frame, black=black, white=white, phase=(phase[0] % rows, phase[1] % cols), exposure=exposure, dark=dark
    )
    return corrected if known.dark is None else without_dark(corrected, known.dark)


# -------------------------------------------------------------------------------------------------- plain formats


def _read_headerless(path: Path, layout: Layout) -> NDArray[np.uint16]:
    """One frame's values and nothing else."""
    found, wanted = path.stat().st_size, layout.frame_bytes
    if found != wanted:
        raise InputFileError(
            f"{path} has {found} bytes, {layout} have {wanted}; give its size with --size ROWSxCOLS, --packing and --stride"
        )
    return layout.unpack(np.fromfile(path, np.uint8))


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
    if phase is None:
        phase = find_phase(str(path), found["pattern"], table)
    levels = (found["black"], found["white"])
    return RawFrame(str(path), found["values"], *levels, phase, found["orientation"], found["exposure"])
