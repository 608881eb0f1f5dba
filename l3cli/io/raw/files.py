"""Raw files → RawFrame. How each format is read: registry.py.

The colour filter array comes from the table. From the file come pixels, levels, crop, orientation, and where it states
of its array the phase; an array that is not the table's is refused.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from l3cli.errors import InputFileError
from l3cli.frames.correction import Correction, DarkFrame, HotTest, without_dark
from l3cli.frames.frame import RawFrame, shifted_cfa
from l3cli.frames.shading import shading_of_gain
from l3cli.io.raw.cfa_codes import Sensor, find_phase, neutral_of_channels
from l3cli.io.raw.headerless import Layout, layout_of, stdin
from l3cli.io.raw.registry import CAMERA_RAW, MultiFrameFile, RawContent, RawFormat, format_of
from l3cli.io.tags import believable_shot
from l3cli.system.files import STDIN, require_regular
from l3cli.system.limits import require_picture

RAW_FILE = "give a raw file, or - for headerless frames on stdin"
TOP = 65535  # DN, the most that 16 bits hold
LONGEST = 1e5  # s, the longest exposure that is believed


@dataclass(frozen=True)
class RawOverrides:
    """Facts that the caller states about a raw file; None: as the file or else the table has them."""

    black_level: float | None = None  # DN
    white_level: float | None = None  # DN
    phase: tuple[int, int] | None = None  # CFA row and column of pixel (0, 0)
    size: tuple[int, int] | None = None  # rows, columns of a headerless file
    packing: str | None = None  # one of packed.PACKINGS, of a headerless file
    stride: int | None = None  # bytes from row to row of a headerless file
    exposure: float | None = None  # s
    gain: float | None = None  # analog gain over the camera's; None: by the ISO speed of the file
    dark: DarkFrame | None = None  # what the camera gives without light
    correction: Correction | None = None  # of its defects and shading
    hot: HotTest | None = None  # by which its hot pixels are found; None: they are left


def read_raw(path: Path, table: Sensor, known: RawOverrides | None = None) -> RawFrame:
    """Return the frame in `path`, read by its suffix; InputFileError names file and cure."""
    known = known or RawOverrides()
    require_regular(path, RAW_FILE)
    kind = format_of(path)
    kind = kind if kind.holds_frame else CAMERA_RAW  # LibRaw says what is wrong
    return frame_of(str(path), kind.read(path, _layout(kind, path, table, known)), table, known)


def read_stack(path: Path, table: Sensor, known: RawOverrides, dataset: str | None = None) -> MultiFrameFile | None:
    """Return the frames in `path`, the HDF5 file's array `dataset` of them; None if it holds one frame, or is of a format
    that can hold no more."""
    kind = format_of(path)
    return kind.stack(path, _layout(kind, path, table, known), dataset) if kind.stackable else None


def holds_several(path: Path, sensor: Callable[[], Sensor], known: RawOverrides) -> bool:
    """Return whether a file holds several frames; `sensor` is asked for the size of headerless ones. InputFileError if it
    cannot be read."""
    kind = format_of(path)
    if not kind.stackable:
        return False
    layout = _layout(kind, path, sensor(), known) if kind.wants_geometry else None
    return kind.stack(path, layout) is not None


def read_stdin(table: Sensor, known: RawOverrides) -> MultiFrameFile:
    """Return the headerless frames that come on stdin."""
    return stdin(layout_of(STDIN, known.size or (table.rows, table.cols), known.packing, known.stride))


def _layout(kind: RawFormat, path: Path, table: Sensor, known: RawOverrides) -> Layout | None:
    size = known.size or (table.rows, table.cols)
    return layout_of(path, size, known.packing, known.stride) if kind.wants_geometry else None


def frame_of(name: str, content: RawContent, table: Sensor, known: RawOverrides) -> RawFrame:
    """Return the frame of what a file holds; what it does not say is the table's, unless the caller knows better."""
    values, pattern = content["values"], content.get("pattern")
    if values.size == 0 or values.ndim != 2:
        raise InputFileError(f"{name} holds no pixels; give a raw file")
    require_picture(name, *values.shape)
    frame_phase = find_phase(name, pattern, table) if pattern is not None and known.phase is None else (0, 0)
    gain = content.get("gain")
    frame = RawFrame(
        name,
        np.ascontiguousarray(values, np.uint16),
        content.get("black_level", table.black_level),
        content.get("white_level", table.white_level),
        frame_phase,
        content.get("orientation", 0),
        content.get("exposure"),
        neutral=neutral_of_channels(content.get("neutral"), pattern if known.phase is None else None, frame_phase, table),
        taken_by=tuple(content.get("camera", ())),
        shot=believable_shot(content.get("shot", {})),
        shading=None if gain is None else shading_of_gain(gain, table.cfa.shape),
        notes=content.get("notes", ()),
        exchangeable=content.get("exchangeable", False),
    )
    return _corrected(frame, table, known)


def _corrected(frame: RawFrame, table: Sensor, known: RawOverrides) -> RawFrame:
    """Return the frame with what the caller knows better in place of what the file says, and what dark current adds to
    it."""
    black_level = frame.black_level if known.black_level is None else known.black_level
    white_level = frame.white_level if known.white_level is None else known.white_level
    phase = frame.phase if known.phase is None else known.phase
    if not 0 <= black_level < white_level <= TOP:
        raise InputFileError(
            f"{frame.name}: black level {black_level:g} and white level {white_level:g} do not fit; "
            "give ‹black_level› and ‹white_level›"
        )
    rows, cols = table.cfa.shape
    recorded = frame.exposure if frame.exposure is not None and 0 < frame.exposure <= LONGEST else None
    exposure = recorded if known.exposure is None else known.exposure
    gain = (table.gain_at(frame.shot.iso) or 1.0) if known.gain is None else known.gain
    dark = gain * table.dark_signal(exposure) * (white_level - black_level) / (table.white_level - table.black_level)
    if not dark < white_level - black_level:
        raise InputFileError(
            f"{frame.name}: dark current alone fills a pixel with {dark:.4g} of {white_level - black_level:.4g} DN; "
            "is its exposure time in seconds?"
        )
    corrected = replace(
        frame,
        black_level=black_level,
        white_level=white_level,
        phase=(phase[0] % rows, phase[1] % cols),
        exposure=exposure,
        dark=dark,
        gain=gain,
    )
    corrected = corrected if known.dark is None else without_dark(corrected, known.dark)
    corrected = corrected if known.correction is None else known.correction.corrected(corrected)
    return corrected if known.hot is None else known.hot.without_hot(corrected, shifted_cfa(table.cfa, corrected.phase))
