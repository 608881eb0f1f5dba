"""Read raw files in all supported formats as RawFrame.

To add a format, write a module in this folder, and add the format to FORMATS. The module must define the function `read`.
Three fields of the entry in FORMATS require further functions: `stackable` requires `stack`, `has_rate` requires `rate`, and
`has_plain` requires `is_plain`. l3 imports the module when it reads the first file in this format.

l3 reads the pixels, the levels, the crop and the orientation from the file, and the colour filter array from the table. If
the file also contains a colour filter array, it must be that of the table, and it determines the phase.
"""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import InputFileError
from l3cli.frames.correction import Correction, DarkFrame, HotTest, without_dark
from l3cli.frames.frame import RawFrame
from l3cli.frames.lens_warp import LensWarp
from l3cli.frames.line_offsets import without_picture_offsets
from l3cli.frames.masked import MaskedValues, split_masked, without_line_offsets
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

RAW_FILE = "use a raw file, or - for headerless frames on stdin"
TOP = 65535  # largest 16-bit value
LONGEST = 1e5  # longest plausible exposure time in s


@dataclass(frozen=True)
class RawFormat:
    """A raw file format, and the capabilities of its reader."""

    suffixes: tuple[str, ...]  # file suffixes in lower case, with the period
    module: str  # name of the module in this folder that reads the format
    what: str = ""  # name of the format, for the table in docs/raw-files.md
    read_as: str = ""  # what l3 reads from the file, for the table in docs/raw-files.md
    holds_frame: bool = True  # whether a file can be read as a single frame; if False, every file is a sequence
    stackable: bool = False  # whether a file may contain several frames
    isolated: bool = True  # whether files are decoded in the isolated process
    has_plain: bool = False  # whether the module defines `is_plain`, because some files need no isolation
    wants_geometry: bool = False  # whether `read` and `stack` need the layout of a headerless file
    wants_dataset: bool = False  # whether `stack` needs the name of a dataset in the file
    has_rate: bool = False  # whether a file with one frame may contain the frame rate of its sequence

    def read(self, path: Path, layout: Layout | None = None) -> RawContent:
        """Read a file with one frame.

        Raises
        ------
        InputFileError
            If the format is not supported, or if the file does not contain exactly one frame.
        """
        if path.suffix.lower() not in self.suffixes:
            refuse_unread(path)
        with naming(path):
            content: RawContent = self._reader.read(path, *([layout] if self.wants_geometry else []))
            return content

    def stack(self, path: Path, layout: Layout | None = None, dataset: str | None = None) -> MultiFrameFile | None:
        """Open a file with several frames. Return None if the file contains a single frame.

        `dataset` is the name of the dataset with the frames, or None for the only such dataset.
        """
        wanted = [layout] if self.wants_geometry else [dataset] if self.wants_dataset else []
        with naming(path):
            return self._reader.stack(path, *wanted) if self.stackable else None

    def rate(self, path: Path) -> Fraction | None:
        """Return the frame rate in frames/s from a file with one frame, or None if the file does not contain it."""
        return self._reader.rate(path) if self.has_rate else None

    def is_plain(self, path: Path) -> bool:
        """Return whether a file has such a simple layout that it need not be decoded in the isolated process."""
        return self.has_plain and self._reader.is_plain(path)

    @property
    def _reader(self) -> Any:
        return importlib.import_module(f"l3cli.io.raw.{self.module}")


CAMERA_RAW = RawFormat(
    tuple(
        "." + name for name in ("3fr", "ari", "arw", "cr2", "cr3", "dcr", "erf", "fff", "iiq", "kdc", "mos", "mrw")
        + ("nef", "nrw", "orf", "pef", "raf", "rw2", "rwl", "srw")
    ),
    "libraw", "camera raws", "pixels without masked borders, array (2×2 or X-Trans), orientation, levels and white balance",
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
        "a dataset and the names of its axes; if there are several datasets, set `‹dataset› NAME`",
        holds_frame=False, stackable=True, wants_dataset=True,
    ),
    RawFormat(
        (".mat",), "mat", "MATLAB", "a variable (row, col, frame); if there are several, set `‹dataset› NAME`",
        holds_frame=False, stackable=True, wants_dataset=True,
    ),
    RawFormat((".ser",), "ser", "SER", "all frames and the array", holds_frame=False, stackable=True, isolated=False),
    RawFormat(
        (".mkv", ".mov", ".mp4", ".avi", ".y4m"), "video", "video (extra `video`)",
        "one channel, lossless (FFV1, uncompressed 8-bit AVI or y4m); frame rate and frame times", holds_frame=False,
        stackable=True,
    ),
    RawFormat(
        (".dng",), "dng", "DNG, CinemaDNG",
        "pixels of 8 to 16 bits, a colour filter array of up to 8×8 sites, and [many tags](#tags-of-a-dng)", has_rate=True,
    ),
    CAMERA_RAW,
)  # fmt: skip
PHOTOS = (".dng", *CAMERA_RAW.suffixes)
BY_SUFFIX = {suffix: each for each in FORMATS for suffix in each.suffixes}


def format_of(path: Path) -> RawFormat:
    """Return the raw format for a file suffix.

    Unknown suffixes are treated as camera raws, because LibRaw recognises camera raws by their content.
    """
    return BY_SUFFIX.get(path.suffix.lower(), CAMERA_RAW)


def is_frame(path: Path) -> bool:
    """Return whether a file in a folder is a raw frame, according to its suffix."""
    return path.suffix.lower() in BY_SUFFIX and format_of(path).holds_frame


def is_photo(path: Path) -> bool:
    """Return whether a file is a DNG file or a camera raw, according to its suffix. Both contain the camera model."""
    return path.suffix.lower() in PHOTOS


def are_photos(path: Path) -> bool:
    """Return whether a path is a photo (`is_photo`), or a folder that contains at least one photo."""
    return is_photo(path) or (path.is_dir() and any(map(is_photo, path.iterdir())))


def needs_isolation(path: Path) -> bool:
    """Return whether a file must be decoded in the isolated process. False for paths without a suffix, such as "-"."""
    kind = format_of(path)
    return bool(path.suffix) and kind.isolated and not kind.is_plain(path)


@dataclass(frozen=True)
class RawOverrides:
    """User settings that override the metadata in raw files, and corrections to apply to the frames.

    If the black level, white level, phase, exposure or gain is None, l3 uses the value in the file or, if there is none, the
    value in the table or a default.
    """

    black_level: float | None = None  # black level in DN
    white_level: float | None = None  # white level in DN
    phase: tuple[int, int] | None = None  # CFA row and column of the first pixel
    size: tuple[int, int] | None = None  # rows and columns of a headerless frame
    packing: str | None = None  # packing of a headerless file, a key of frames.packings.PACKINGS
    stride: int | None = None  # bytes from the start of one row to the next in a headerless file
    exposure: float | None = None  # exposure time in s
    gain: float | None = None  # analog gain relative to the gain in the camera model; None to compute it from the ISO speed
    gains: tuple[float, ...] = ()  # gain of each frame in a sequence, in order; empty if `gain` applies to all frames
    unlabelled_gain: float = 1.0  # gain of frames whose gain cannot be computed from an ISO speed
    dark: DarkFrame | None = None  # dark frame to subtract
    correction: Correction | None = None  # correction of defects and shading
    hot: HotTest | None = None  # test for hot pixels, which are then corrected; None to keep them
    skip: int = 0  # bytes before the first frame in a headerless file
    byte_order: str | None = None  # byte order of 16-bit values in a headerless file: "big", "little" or None for little
    opcodes: str | None = None  # "leave" to ignore lens warps and unsupported opcodes in DNG files; otherwise None

    def of_frame(self, place: int) -> "RawOverrides":
        """Return the overrides for the frame at position `place` (counted from 0) in a sequence.

        Raises
        ------
        InputFileError
            If `gains` is set but contains no gain for this frame.
        """
        if not self.gains:
            return self
        if place >= len(self.gains):
            raise InputFileError(
                f"‹gains› lists {len(self.gains)} gains, but the input has at least {place + 1} frames; "
                "list one gain per frame"
            )
        return replace(self, gain=self.gains[place], gains=())


def read_raw(path: Path, table: Sensor, known: RawOverrides | None = None) -> RawFrame:
    """Read a raw file with one frame.

    Parameters
    ----------
    path : Path
        The raw file. Its suffix selects the format.
    table : TransformTable or CameraModel
        Source of the colour filter array, and of all properties that the file does not contain.
    known : RawOverrides, optional
        User settings. [default: none]

    Returns
    -------
    RawFrame
        The frame, after the corrections in `known`.

    Raises
    ------
    InputFileError
        If the file cannot be read, contains several frames, or does not match the table.
    """
    known = known or RawOverrides()
    require_regular(path, RAW_FILE)
    kind = format_of(path)
    if not kind.holds_frame:
        raise InputFileError(f"{path} is a sequence of frames; use a file with one frame")
    return frame_of(str(path), kind.read(path, _layout(kind, path, table, known)), table, known)


def read_stack(path: Path, table: Sensor, known: RawOverrides, dataset: str | None = None) -> MultiFrameFile | None:
    """Open a file with several frames. Return None if the file contains only one frame.

    Parameters
    ----------
    path : Path
        The file.
    table : TransformTable or CameraModel
        Table or camera. By default, headerless frames have the size of its sensor.
    known : RawOverrides
        User settings.
    dataset : str, optional
        Name of the dataset in an HDF5 or MATLAB file. [default: the only dataset with frames]

    Raises
    ------
    InputFileError
        If the file cannot be read.
    """
    kind = format_of(path)
    return kind.stack(path, _layout(kind, path, table, known), dataset) if kind.stackable else None


def holds_several(path: Path, sensor: Callable[[], Sensor], known: RawOverrides) -> bool:
    """Return whether a file contains several frames.

    Parameters
    ----------
    path : Path
        The file.
    sensor : callable
        Function that returns the table or camera. It is called only for headerless files, because their frames have the size
        of the sensor by default.
    known : RawOverrides
        User settings.

    Raises
    ------
    InputFileError
        If the file cannot be read.
    """
    kind = format_of(path)
    if not kind.stackable:
        return False
    layout = _layout(kind, path, sensor(), known) if kind.wants_geometry else None
    return kind.stack(path, layout) is not None


def read_stdin(table: Sensor, known: RawOverrides) -> MultiFrameFile:
    """Return the headerless frames on stdin. By default, they have the size of the table's or camera's sensor."""
    return stdin(_headerless_layout(STDIN, table, known))


def _layout(kind: RawFormat, path: Path, table: Sensor, known: RawOverrides) -> Layout | None:
    return _headerless_layout(path, table, known) if kind.wants_geometry else None


def _headerless_layout(path: Path, table: Sensor, known: RawOverrides) -> Layout:
    camera, size = table if isinstance(table, CameraModel) else table.camera, (table.rows, table.cols)
    size = known.size or (camera.masked.around(*size) if camera is not None and camera.masked else size)
    return layout_of(path, size, known.packing, known.stride, known.skip, known.byte_order)


def _without_masked(content: RawContent, table: Sensor) -> tuple[RawContent, MaskedValues | None, tuple[int, int]]:
    """Separate the light-sensitive pixels in a frame from the camera's masked pixels.

    Returns
    -------
    content : RawContent
        The light-sensitive pixels, with a note if the camera has masked pixels that the frame lacks.
    masked : MaskedValues or None
        The masked pixels. None if there are none.
    corner : tuple of int
        Row and column of the first light-sensitive pixel among the values in the file.
    """
    camera = table if isinstance(table, CameraModel) else table.camera
    if "masked" in content:
        return content, MaskedValues(*content["masked"]), (0, 0)
    if camera is None or camera.masked is None:
        return content, None, (0, 0)
    parts, corner = split_masked(content["values"], camera), (camera.masked.top, camera.masked.left)
    if parts is None and not camera.has_line_noise:
        return content, None, (0, 0)
    if parts is None:
        rows, cols = camera.masked.around(camera.rows, camera.cols)
        left = replace(camera, masked=None).offset_noise
        note = (
            f"the frame does not include the sensor's masked pixels ({rows}×{cols} pixels in total), so row and column "
            f"offsets are estimated from the picture, which leaves about {left:.2g} e- of them instead of "
            f"{camera.offset_noise:.2g} e-; use uncropped frames, unless your camera has already subtracted the offsets"
        )
        return {**content, "notes": (*content.get("notes", ()), note)}, None, (0, 0)
    content = {**content, "values": parts[0]}
    if "pattern" in content:
        content["pattern"] = np.roll(content["pattern"], np.negative(corner), axis=(0, 1))
    return content, parts[1], corner


def frame_of(name: str, content: RawContent, table: Sensor, known: RawOverrides) -> RawFrame:
    """Convert the content of a raw file to a frame, and apply the corrections in `known`.

    Parameters
    ----------
    name : str
        Name of the frame, for messages.
    content : RawContent
        Content of the file.
    table : TransformTable or CameraModel
        Table or camera. Its properties apply if neither `known` nor the file contains them.
    known : RawOverrides
        User settings, which override the file.

    Returns
    -------
    RawFrame
        The frame, after the corrections.

    Raises
    ------
    InputFileError
        If the content is not an array (row, col), is too large, or has an unresolved fault, if its levels are invalid, or if
        its colour filter array does not match the table.
    """
    values = content["values"]
    if values.size == 0:
        raise InputFileError(f"{name} contains no pixels; use a raw file")
    if values.ndim != 2:
        raise InputFileError(f"{name} contains an array of shape {values.shape}; use an array with rows and columns only")
    require_picture(name, *values.shape)
    refuse_faults(name, content, [each.name for each in fields(known) if getattr(known, each.name) is not None])
    dn = as_dn(values)
    if dn is None:
        dn = scaled_dn(name, values, known.black_level, known.white_level)
        known = replace(known, black_level=SCALED_BLACK, white_level=SCALED_WHITE)
    content, masked, corner = _without_masked({**content, "values": dn}, table)
    pattern = content.get("pattern")
    black_level = content.get("black_level", table.black_level) if known.black_level is None else known.black_level
    white_level = content.get("white_level", table.white_level) if known.white_level is None else known.white_level
    if not 0 <= black_level < white_level <= TOP:
        raise InputFileError(
            f"{name}: a black level of {black_level:g} DN and a white level of {white_level:g} DN are invalid; set "
            f"‹black_level› and ‹white_level› so that 0 ≤ black level < white level ≤ {TOP}"
        )
    frame_phase = find_phase(name, pattern, table) if pattern is not None and known.phase is None else (0, 0)
    gain, warps = content.get("gain"), tuple(LensWarp(**each) for each in content.get("warps", ()))
    leave = known.opcodes == "leave"
    left = ("the lens warp that the file requests is not applied",) if leave and warps else ()
    frame = RawFrame(
        name,
        np.ascontiguousarray(content["values"]),
        black_level,
        white_level,
        frame_phase,
        content.get("orientation", 0),
        content.get("exposure"),
        neutral=neutral_of_channels(content.get("neutral"), pattern if known.phase is None else None, frame_phase, table),
        taken_by=tuple(content.get("camera", ())),
        shot=believable_shot(content.get("shot", {})),
        shading=None if gain is None else shading_of_gain(gain, table.cfa.shape),
        warps=() if leave else warps,
        notes=(*content.get("notes", ()), *left, *_displaced(content, table, frame_phase)),
        baseline_exposure=content.get("baseline_exposure", 0.0),
        exchangeable=content.get("exchangeable", False),
        misread=_misread(content, table, np.subtract(frame_phase if known.phase is None else known.phase, corner)),
    )
    return _corrected(frame, table, known, masked)


def _misread(content: RawContent, table: Sensor, phase: NDArray[np.integer]) -> str:
    """Suggest an option that selects a more plausible layout for a headerless file, for example another packing.

    Returns "" if the current layout is plausible. A layout is more plausible if the frame becomes much smoother. `phase` is
    the CFA row and column of the first pixel in the file, which may be a masked pixel.
    """
    first = int(phase[0]), int(phase[1])
    return smoother_reading(content["readings"](), shifted_cfa(table.cfa, first)) if "readings" in content else ""


def _displaced(content: RawContent, table: Sensor, phase: tuple[int, int]) -> tuple[str, ...]:
    """Return a warning if a headerless frame has the size of the sensor, but does not start at the first site of the CFA.

    `phase` is the CFA row and column at which the frame starts according to its packing. Only a cropped frame, which is
    smaller than the sensor, should start at another site.
    """
    if "readings" not in content or phase == (0, 0) or content["values"].shape != (table.rows, table.cols):
        return ()
    begins = f"according to its packing, the frame starts at row {phase[0]}, column {phase[1]} of the table's array"
    return (f"{begins}, but the frame has the size of the whole sensor; check ‹packing›, or set ‹phase›",)


def _corrected(frame: RawFrame, table: Sensor, known: RawOverrides, masked: MaskedValues | None) -> RawFrame:
    """Set a frame's phase, exposure time, gain and dark signal, and apply the corrections in `known`.

    Pixel values are changed only by the correction of row and column offsets, the dark frame, the correction of defects and
    the hot-pixel test. The dark signal is recorded in the frame, but is not subtracted from the values.

    Raises InputFileError if the dark signal reaches the white level.
    """
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
            f"{frame.name}: the dark signal alone is {dark:.4g} DN, but full scale is only {span:.4g} DN; "
            "check that the exposure time is in seconds"
        )
    corrected = replace(
        frame,
        phase=(phase[0] % rows, phase[1] % cols),
        exposure=exposure,
        dark=dark,
        gain=gain,
    )
    camera = table if isinstance(table, CameraModel) else table.camera
    if camera is not None and masked is not None:
        corrected = without_line_offsets(corrected, masked, camera)
    elif camera is not None:
        corrected = without_picture_offsets(corrected, camera)
    corrected = corrected if known.dark is None else without_dark(corrected, known.dark)
    corrected = corrected if known.correction is None else known.correction.corrected(corrected)
    return corrected if known.hot is None else known.hot.without_hot(corrected, shifted_cfa(table.cfa, corrected.phase))
