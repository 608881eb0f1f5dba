"""Read raw files of all formats as RawFrame.

A new format is a module in this folder and a line in FORMATS. The module has `read`, and, as its line states, `stack`,
`rate` and `is_plain`. It is imported when the first file is read. The colour filter array comes from the table. Pixels,
levels, crop and orientation come from the file, and so does the phase if the file states its array. An array other than
the table's is rejected.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.errors import InputFileError
from l3cli.frames.correction import Correction, DarkFrame, HotTest, without_dark
from l3cli.frames.frame import RawFrame
from l3cli.frames.raw_sanity import smoother_reading
from l3cli.frames.shading import shading_of_gain
from l3cli.io.raw import MultiFrameFile, RawContent, refuse_faults
from l3cli.io.raw.cfa_codes import Sensor, find_phase, neutral_of_channels
from l3cli.io.raw.headerless import Layout, layout_of, stdin
from l3cli.io.raw.unread import refuse_unread
from l3cli.io.raw.values import SCALED_BLACK, SCALED_WHITE, as_dn, scaled_dn
from l3cli.io.tags import believable_shot
from l3cli.physics.mosaic import shifted_cfa
from l3cli.system.files import STDIN, naming, require_regular
from l3cli.system.limits import require_picture

RAW_FILE = "give a raw file, or - for headerless frames on stdin"
TOP = 65535  # DN, largest value of 16 bits
LONGEST = 1e5  # s, longest plausible exposure


@dataclass(frozen=True)
class RawFormat:
    """A raw file format."""

    suffixes: tuple[str, ...]  # in lower case
    module: str  # module in this folder
    what: str = ""  # kind of file, for the table in docs/raw-files.md
    read_as: str = ""  # contents that l3 reads, for the same table
    holds_frame: bool = True  # False if such a file is always a sequence
    stackable: bool = False  # whether a file may contain several frames
    isolated: bool = True  # whether files are decoded in the isolated process
    has_plain: bool = False  # whether the module's `is_plain` exempts simple files, which are read in this process
    wants_geometry: bool = False  # whether `read` and `stack` take a layout
    wants_dataset: bool = False  # whether `stack` takes the name of an array
    has_rate: bool = False  # whether a file with one frame may state the frame rate of its sequence

    def read(self, path: Path, layout: Layout | None = None) -> RawContent:
        """Read the frame of a file that contains one. Raises InputFileError if it does not, or if the format is
        unsupported.
        """
        if path.suffix.lower() not in self.suffixes:
            refuse_unread(path)
        with naming(path):
            content: RawContent = self._reader.read(path, *([layout] if self.wants_geometry else []))
            return content

    def stack(self, path: Path, layout: Layout | None = None, dataset: str | None = None) -> MultiFrameFile | None:
        """Return the frames of a file that contains several, or None if it contains one frame, which may be damaged.

        `dataset` is the name of an array in the file, or None for the only one.
        """
        wanted = [layout] if self.wants_geometry else [dataset] if self.wants_dataset else []
        with naming(path):
            return self._reader.stack(path, *wanted) if self.stackable else None

    def rate(self, path: Path) -> Fraction | None:
        """Return the frame rate that a file with one frame states."""
        return self._reader.rate(path) if self.has_rate else None

    def is_plain(self, path: Path) -> bool:
        """Whether a file is simple enough to be read in this process."""
        return self.has_plain and self._reader.is_plain(path)

    @property
    def _reader(self) -> Any:
        return importlib.import_module(f"l3cli.io.raw.{self.module}")


CAMERA_RAW = RawFormat(
    tuple(
        "." + name for name in ("3fr", "ari", "arw", "cr2", "cr3", "dcr", "erf", "fff", "iiq", "kdc", "mos", "mrw")
        + ("nef", "nrw", "orf", "pef", "raf", "rw2", "rwl", "srw", "x3f")
    ),
    "libraw", "camera raws", "pixels without masked borders, array (2×2 or X-Trans), orientation, levels and white",
)  # fmt: skip
HEADERLESS = (".raw", ".bin", ".raw10", ".raw12")
FORMATS = (
    RawFormat(
        (".tif", ".tiff"), "tiff", "TIFF", "one channel, unchanged; pages of the same kind are the frames of a sequence",
        stackable=True, has_plain=True,
    ),
    RawFormat((".png",), "tiff", "PNG", "one channel, unchanged"),
    RawFormat((".pgm",), "pgm", "PGM (P5)", "one channel, unchanged", isolated=False),
    RawFormat((".npy",), "npy", "numpy", "an array (row, col) or (frame, row, col)", stackable=True, isolated=False),
    RawFormat(
        HEADERLESS, "headerless", "headerless", "16-bit little-endian values, or a [packing](#headerless-frames)",
        stackable=True, isolated=False, wants_geometry=True,
    ),
    RawFormat(
        (".fits", ".fit", ".fts"), "fits", "FITS, also fpack (extra `fits`)",
        "an image or a cube; the keywords BAYERPAT (2×2 or X-Trans), XBAYROFF, YBAYROFF, ROWORDER and EXPTIME",
        stackable=True,
    ),
    RawFormat(
        (".h5", ".hdf5", ".hdf"), "hdf5", "HDF5",
        "a dataset and the names of its axes; if there are several datasets, give `‹dataset› NAME`",
        holds_frame=False, stackable=True, wants_dataset=True,
    ),
    RawFormat(
        (".mat",), "mat", "MATLAB", "a variable (row, col, frame); if there are several, give `‹dataset› NAME`",
        holds_frame=False, stackable=True, wants_dataset=True,
    ),
    RawFormat((".ser",), "ser", "SER", "all frames and the array", holds_frame=False, stackable=True, isolated=False),
    RawFormat(
        (".mkv", ".mov", ".mp4", ".avi", ".y4m"), "video", "video (extra `video`)",
        "one channel without loss (FFV1, uncompressed 8-bit AVI or y4m), frame rate and frame times", holds_frame=False,
        stackable=True,
    ),
    RawFormat(
        (".dng",), "dng", "DNG, CinemaDNG",
        "pixels of 8 to 16 bits, an array of any size, and [many tags](#tags-of-a-dng)", has_rate=True,
    ),
    CAMERA_RAW,
)  # fmt: skip
PHOTOS = (".dng", *CAMERA_RAW.suffixes)
BY_SUFFIX = {suffix: each for each in FORMATS for suffix in each.suffixes}


def format_of(path: Path) -> RawFormat:
    """Return the format for a file's suffix. Other suffixes count as camera raws, which LibRaw recognises by content."""
    return BY_SUFFIX.get(path.suffix.lower(), CAMERA_RAW)


def is_frame(path: Path) -> bool:
    """Whether a file with this name in a folder counts as a raw frame."""
    return path.suffix.lower() in BY_SUFFIX and format_of(path).holds_frame


def is_photo(path: Path) -> bool:
    """Whether a name is that of a DNG or of a camera's own raw file, which state their camera."""
    return path.suffix.lower() in PHOTOS


def are_photos(path: Path) -> bool:
    """Whether a file, a pattern, or files in a folder state their camera."""
    return is_photo(path) or (path.is_dir() and any(map(is_photo, path.iterdir())))


def needs_isolation(path: Path) -> bool:
    """Whether a file is decoded in the isolated process. False for folders and stdin, whose contents are unknown."""
    kind = format_of(path)
    return bool(path.suffix) and kind.isolated and not kind.is_plain(path)


@dataclass(frozen=True)
class RawOverrides:
    """Facts about a raw file that the caller states. None means that the file or otherwise the table decides."""

    black_level: float | None = None  # DN
    white_level: float | None = None  # DN
    phase: tuple[int, int] | None = None  # CFA row and column of pixel (0, 0)
    size: tuple[int, int] | None = None  # rows, columns of a headerless file
    packing: str | None = None  # key of frames.packings.PACKINGS, for a headerless file
    stride: int | None = None  # bytes from row to row of a headerless file
    exposure: float | None = None  # s
    gain: float | None = None  # analog gain relative to the camera's; None: from the ISO speed of the file
    gains: tuple[float, ...] = ()  # gain of each frame of a sequence, in order; empty if all have `gain`
    unlabelled_gain: float = 1.0  # gain of frames for which nothing else states it
    dark: DarkFrame | None = None  # dark frame to subtract
    correction: Correction | None = None  # correction of defects and shading
    hot: HotTest | None = None  # test for hot pixels; None to leave them
    skip: int = 0  # bytes before the first frame of a headerless file
    byte_order: str | None = None  # "little" or "big", for 16-bit values of a headerless file; None: little
    opcodes: str | None = None  # "leave" ignores unsupported opcodes of a DNG; None rejects the file

    def of_frame(self, place: int) -> "RawOverrides":
        """Return the facts about the frame at a position, from 0, of a sequence. Raises InputFileError if no gain is
        listed for it.
        """
        if not self.gains:
            return self
        if place >= len(self.gains):
            raise InputFileError(
                f"‹gains› lists {len(self.gains)} gains, none for frame {place + 1}; list one for each frame"
            )
        return replace(self, gain=self.gains[place], gains=())


def read_raw(path: Path, table: Sensor, known: RawOverrides | None = None) -> RawFrame:
    """Read a raw file with one frame.

    Parameters
    ----------
    path : Path
        The file. Its suffix selects the reader.
    table : TransformTable or CameraModel
        States the array, and what the file does not state.
    known : RawOverrides, optional
        Facts that the caller states.

    Returns
    -------
    RawFrame
        The frame.

    Raises
    ------
    InputFileError
        If the file cannot be read or does not fit the table.
    """
    known = known or RawOverrides()
    require_regular(path, RAW_FILE)
    kind = format_of(path)
    if not kind.holds_frame:
        raise InputFileError(f"{path} holds frames, and one is wanted; give a file of one frame")
    return frame_of(str(path), kind.read(path, _layout(kind, path, table, known)), table, known)


def read_stack(path: Path, table: Sensor, known: RawOverrides, dataset: str | None = None) -> MultiFrameFile | None:
    """Return the frames of a file, or None if it contains one frame or if its format cannot contain more.

    `dataset` is the name of the array in an HDF5 or MATLAB file.
    """
    kind = format_of(path)
    return kind.stack(path, _layout(kind, path, table, known), dataset) if kind.stackable else None


def holds_several(path: Path, sensor: Callable[[], Sensor], known: RawOverrides) -> bool:
    """Whether a file contains several frames. Raises InputFileError if it cannot be read.

    `sensor` returns the table or camera; it is called only for the size of headerless frames.
    """
    kind = format_of(path)
    if not kind.stackable:
        return False
    layout = _layout(kind, path, sensor(), known) if kind.wants_geometry else None
    return kind.stack(path, layout) is not None


def read_stdin(table: Sensor, known: RawOverrides) -> MultiFrameFile:
    """Return the headerless frames on stdin."""
    return stdin(_headerless_layout(STDIN, table, known))


def _layout(kind: RawFormat, path: Path, table: Sensor, known: RawOverrides) -> Layout | None:
    return _headerless_layout(path, table, known) if kind.wants_geometry else None


def _headerless_layout(path: Path, table: Sensor, known: RawOverrides) -> Layout:
    size = known.size or (table.rows, table.cols)
    return layout_of(path, size, known.packing, known.stride, known.skip, known.byte_order)


def frame_of(name: str, content: RawContent, table: Sensor, known: RawOverrides) -> RawFrame:
    """Convert the content of a file to a frame. Missing facts come from `known` or otherwise from the table."""
    values, pattern = content["values"], content.get("pattern")
    if values.size == 0:
        raise InputFileError(f"{name} holds no pixels; give a raw file")
    if values.ndim != 2:
        raise InputFileError(f"{name} holds {values.dtype} of {values.ndim} axes {values.shape}; give rows × columns")
    require_picture(name, *values.shape)
    refuse_faults(name, content, [each.name for each in fields(known) if getattr(known, each.name) is not None])
    dn = as_dn(values)
    if dn is None:
        dn = scaled_dn(name, values, known.black_level, known.white_level)
        known = replace(known, black_level=SCALED_BLACK, white_level=SCALED_WHITE)
    black_level = content.get("black_level", table.black_level) if known.black_level is None else known.black_level
    white_level = content.get("white_level", table.white_level) if known.white_level is None else known.white_level
    if not 0 <= black_level < white_level <= TOP:
        raise InputFileError(
            f"{name}: black level {black_level:g} and white level {white_level:g} do not fit; "
            "give ‹black_level› and ‹white_level›"
        )
    frame_phase = find_phase(name, pattern, table) if pattern is not None and known.phase is None else (0, 0)
    gain = content.get("gain")
    frame = RawFrame(
        name,
        np.ascontiguousarray(dn),
        black_level,
        white_level,
        frame_phase,
        content.get("orientation", 0),
        content.get("exposure"),
        neutral=neutral_of_channels(content.get("neutral"), pattern if known.phase is None else None, frame_phase, table),
        taken_by=tuple(content.get("camera", ())),
        shot=believable_shot(content.get("shot", {})),
        shading=None if gain is None else shading_of_gain(gain, table.cfa.shape),
        notes=(*content.get("notes", ()), *_displaced(content, table, frame_phase)),
        baseline_exposure=content.get("baseline_exposure", 0.0),
        exchangeable=content.get("exchangeable", False),
        misread=_misread(content, table, frame_phase if known.phase is None else known.phase),
    )
    return _corrected(frame, table, known)


def _misread(content: RawContent, table: Sensor, phase: tuple[int, int]) -> str:
    """Return the option that selects another reading of a frame's bytes, if that reading is far smoother. Otherwise ""."""
    return smoother_reading(content["readings"](), shifted_cfa(table.cfa, phase)) if "readings" in content else ""


def _displaced(content: RawContent, table: Sensor, phase: tuple[int, int]) -> tuple[str, ...]:
    """Return a note if the packing of a whole frame names an array in another phase than the table's."""
    if "readings" not in content or phase == (0, 0) or content["values"].shape != (table.rows, table.cols):
        return ()
    begins = f"its packing says that it begins at row {phase[0]}, column {phase[1]} of the table's array"
    return (f"{begins}, though it has the size of the whole sensor; check ‹packing›, or give ‹phase›",)


def _corrected(frame: RawFrame, table: Sensor, known: RawOverrides) -> RawFrame:
    """Return the frame with the facts that the caller states, its dark signal, and corrections."""
    phase = frame.phase if known.phase is None else known.phase
    rows, cols = table.cfa.shape
    span = frame.white_level - frame.black_level
    recorded = frame.exposure if frame.exposure is not None and 0 < frame.exposure <= LONGEST else None
    exposure = recorded if known.exposure is None else known.exposure
    gain = (table.gain_at(frame.shot.iso) or known.unlabelled_gain) if known.gain is None else known.gain
    dark = (
        (gain if exposure is not None else 1.0)
        * table.dark_signal(exposure)
        * span
        / (table.white_level - table.black_level)
    )
    if not dark < span:
        raise InputFileError(
            f"{frame.name}: dark current alone fills a pixel with {dark:.4g} of {span:.4g} DN; "
            "is its exposure time in seconds?"
        )
    corrected = replace(
        frame,
        phase=(phase[0] % rows, phase[1] % cols),
        exposure=exposure,
        dark=dark,
        gain=gain,
    )
    corrected = corrected if known.dark is None else without_dark(corrected, known.dark)
    corrected = corrected if known.correction is None else known.correction.corrected(corrected)
    return corrected if known.hot is None else known.hot.without_hot(corrected, shifted_cfa(table.cfa, corrected.phase))
