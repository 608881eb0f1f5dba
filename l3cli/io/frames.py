"""Read captured frames, in DN, from raw files or from single-channel 16-bit pictures (TIFF, PNG, PGM).

The module also lists the raw frames and the tables of spectra in a folder of captures.
"""

import os
import re
from collections import Counter
from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel, MaskedPixels
from l3cli.errors import InputFileError, L3Error
from l3cli.frames.frame import RawFrame
from l3cli.frames.measurement import CaptureFolder, RawFile
from l3cli.io.images import mono_of, opened
from l3cli.io.isolated import isolated
from l3cli.io.raw import MultiFrameFile, RawContent, refuse_faults, unread
from l3cli.io.raw.cfa_codes import FilterArray, find_phase
from l3cli.io.raw.files import BY_SUFFIX, RawOverrides, format_of, frame_of, read_raw
from l3cli.io.raw.tiff import read_plain
from l3cli.io.raw.unread import UNREAD
from l3cli.io.raw.values import require_dn
from l3cli.physics.mosaic import shifted_cfa
from l3cli.spectra.file import SUFFIXES, read_table
from l3cli.spectra.table import CurveTable
from l3cli.system.files import require_regular
from l3cli.system.limits import require_picture

TIFF = (".tif", ".tiff")
RAW_FILE = "use a raw file from the camera (DNG, CR2, NEF, ARW…)"
PICTURES = (".tif", ".png")  # formats whose bit depth is checked before the pixels are read
MOST_FILES, DEEPEST = 20_000, 8  # maximum number of files in a folder of captures, and maximum depth of its subfolders
DEVELOPED = tuple(suffix for each in UNREAD if each.instead == unread.DEVELOPED for suffix in each.suffixes)
PROSE = (".txt", ".asc", ".xml")  # suffixes of text files, many of which do not contain tables
FIGURES = re.compile(rb"^\s*[\d.]+[\s,;]+[\d.]", re.MULTILINE)  # start of a row of numbers


def raw_content(path: Path, answered: Container[str] = ()) -> RawContent:
    """Read a raw file that contains one frame.

    Parameters
    ----------
    path : Path
        The file.
    answered : container of str
        Names of the parameters that the user has set, such as "black_level". If one of these parameters resolves a fault in
        the file, the fault is ignored.

    Returns
    -------
    RawContent
        The content, with integer values, (row, col), in DN.

    Raises
    ------
    InputFileError
        If the file is not a raw file with a single-channel mosaic, is too large, or has an unresolved fault.
    """
    require_regular(path, RAW_FILE)
    kind = format_of(path)
    if not kind.holds_frame or kind.wants_geometry:
        raise InputFileError(f"{path} is not a camera raw file; {RAW_FILE} or a picture with one channel")
    content = kind.read(path)
    if content["values"].ndim != 2 or content["values"].size == 0:
        raise InputFileError(f"{path} is not a mosaic; {RAW_FILE}")
    require_picture(str(path), *content["values"].shape)
    refuse_faults(str(path), content, answered)
    if content["values"].dtype not in (np.uint8, np.uint16):  # values of these two types are already in DN
        content["values"] = require_dn(str(path), content["values"])
    return content


@dataclass(frozen=True)
class FrameFiles:
    """The frames in a list of files. Each iteration reads the files again, one frame at a time."""

    paths: tuple[Path, ...]
    shape: tuple[int, int]  # required number of rows and columns
    bits: int  # bit depth of the sensor
    array: FilterArray | None = None  # required CFA of raw files; None to accept any CFA
    masked: MaskedPixels | None = None  # masked pixels to cut off; None if the files contain none

    def __iter__(self) -> Iterator[NDArray[np.uint16]]:
        for path in self.paths:
            pages = pages_of(path)
            if pages is None:
                yield read_frame(path, self.shape, self.bits, self.array, self.masked)
                continue
            for name, content in pages:
                yield _whole_frame(Path(name), content, self.shape, self.bits, self.array, self.masked)


@dataclass(frozen=True)
class WholeFrames:
    """The frames in raw files from a known camera. Each iteration reads the files again, one frame at a time.

    The iteration raises InputFileError if a frame's size, CFA phase or bit depth does not match the camera.
    """

    paths: tuple[Path, ...]
    camera: CameraModel

    def __iter__(self) -> Iterator[NDArray[np.uint16]]:
        shape = (self.camera.rows, self.camera.cols)
        for path, frame in ((each, frame) for each in self.paths for frame in self._frames_in(each)):
            if frame.values.shape != shape or frame.phase != (0, 0):
                raise InputFileError(
                    f"{path} has {frame.values.shape[0]}×{frame.values.shape[1]} pixels and starts at CFA site "
                    f"{frame.phase}, but a full frame from camera {self.camera.name} has {shape[0]}×{shape[1]} pixels and "
                    "starts at CFA site (0, 0); use uncropped raw frames"
                )
            require_bits(path, frame.values, self.camera.bits)
            yield frame.values

    def _frames_in(self, path: Path) -> Iterator[RawFrame]:
        pages = pages_of(path)
        if pages is None:
            yield read_raw(path, self.camera)
            return
        for name, content in pages:
            yield frame_of(name, content, self.camera, RawOverrides())


def pages_of(path: Path) -> Iterator[tuple[str, RawContent]] | None:
    """Iterate over the frames of a stack: a TIFF file with several pages, or a .npy or FITS file with three axes.

    Parameters
    ----------
    path : Path
        A file with captured frames.

    Returns
    -------
    iterator of (str, RawContent), or None
        Name and content of each frame. None if the file is not a stack.

    Raises
    ------
    InputFileError
        If the file is damaged, or if its pages differ in size or type. The iterator may also raise this error.
    """
    pages = _stack(path)
    if pages is None or pages.count is None:
        return None
    return ((f"{path} {pages.name(number)}", _counted(pages, number)) for number in range(pages.count))


def _stack(path: Path) -> MultiFrameFile | None:
    """Open a stack. Return None if the file is not a stack."""
    kind = BY_SUFFIX.get(path.suffix.lower())
    if kind is None or not kind.holds_frame or kind.wants_geometry:
        return None
    require_regular(path, RAW_FILE)
    return kind.stack(path)


def _counted(pages: MultiFrameFile, number: int) -> RawContent:
    content = pages.read(number)
    assert content is not None  # `number` is below the number of frames in the stack
    if content["values"].dtype.kind in "iu" and content["values"].dtype.itemsize > 2:
        content["values"] = require_dn(pages.name(number), content["values"])
    return content


def read_frame(
    path: Path, shape: tuple[int, int], bits: int, array: FilterArray | None = None, masked: MaskedPixels | None = None
) -> NDArray[np.uint16]:
    """Read a frame from a raw file or from a single-channel 16-bit picture.

    Parameters
    ----------
    path : Path
        The file. If `bits` is at most 8, a picture may also have 8 bits.
    shape : tuple of int
        Required number of rows and columns.
    bits : int
        Bit depth of the sensor.
    array : FilterArray, optional
        CFA of the sensor. If a raw file contains a CFA, it must be this CFA in the same phase.
    masked : MaskedPixels, optional
        Masked pixels of the camera. If the file contains them, they are cut off, which leaves the size `shape`.

    Returns
    -------
    ndarray of uint16, (row, col)
        Values in DN.

    Raises
    ------
    InputFileError
        If the file cannot be read, if it is neither a raw file nor a single-channel picture, or if its size, bit depth or
        CFA does not match.
    """
    if path.suffix.lower() in BY_SUFFIX and format_of(path).suffixes[0] not in PICTURES:
        content = raw_content(path, ("black_level",))
    elif bits > 8 and path.suffix.lower() in TIFF and (plain := read_plain(path, (16,))) is not None:
        content = plain
    else:
        content = RawContent(values=_read_picture(path, *(masked.around(*shape) if masked else shape), bits))
    return _whole_frame(path, content, shape, bits, array, masked)


def _whole_frame(
    path: Path, content: RawContent, shape: tuple[int, int], bits: int, array: FilterArray | None,
    masked: MaskedPixels | None = None,
) -> NDArray[np.uint16]:  # fmt: skip
    """Check a file's content, and return its values as uint16. Parameters and errors are as in `read_frame`."""
    values, pattern = content["values"], content.get("pattern")
    if masked is not None and values.shape == masked.around(*shape):
        values = values[masked.top : masked.top + shape[0], masked.left : masked.left + shape[1]]
        pattern = None if pattern is None else np.roll(pattern, (-masked.top, -masked.left), axis=(0, 1))
    if array is not None and pattern is not None:
        phase = phase_of(path, pattern, array)
        if not np.array_equal(shifted_cfa(array.cfa, phase), array.cfa):
            raise InputFileError(
                f'{path} starts at row {phase[0]}, column {phase[1]} of "cfa.pattern"; rewrite the pattern so that it '
                "starts with this site"
            )
    _check(path, str(values.dtype), 1, values.shape, shape, bits)
    require_bits(path, values, bits)
    return values.astype(np.uint16, copy=False)


def require_bits(path: Path, values: NDArray, bits: int) -> None:
    """Raise InputFileError if a value needs more than `bits` bits."""
    if values.max() >= 2**bits:
        raise InputFileError(
            f'{path} contains the value {values.max()} DN, which does not fit into {bits} bits; correct "sensor.bits"'
        )


@isolated("OpenImageIO")
def _read_picture(path: Path, rows: int, cols: int, bits: int) -> NDArray:
    with opened(path) as (picture, spec):
        _check(path, str(spec.format), spec.nchannels, (spec.height, spec.width), (rows, cols), bits)
        return mono_of(path, picture, spec)[0]


def phase_of(path: Path, pattern: NDArray[np.int64], array: FilterArray) -> tuple[int, int]:
    """Return the CFA row and column of a file's first pixel.

    `pattern` contains the colour codes in the file. Raises InputFileError if it matches the sensor's CFA in no phase, or in
    several phases that are not equivalent.
    """
    try:
        return find_phase(str(path), pattern, array)
    except InputFileError as error:
        reason = str(error).partition(";")[0].replace("the table", '"cfa.pattern"')
        raise InputFileError(f'{reason}; correct "cfa.pattern"') from error


def _check(path: Path, depth: str, channels: int, size: tuple[int, ...], shape: tuple[int, int], bits: int) -> None:
    depths = ("uint16", "uint8") if bits <= 8 else ("uint16",)
    if depth not in depths or channels != 1:
        raise InputFileError(
            f"{path} has {channels} channel{'s' * (channels != 1)} of {depth}; use 16-bit raw frames with one channel"
        )
    if size != shape:
        raise InputFileError(
            f"{path} has {size[0]}×{size[1]} pixels, but the sensor has {shape[0]}×{shape[1]}; use uncropped raw frames"
        )


# --------------------------------------------------------------------------------------------------- a folder of captures


def list_captures(folder: Path) -> CaptureFolder:
    """List the raw frames and the tables of spectra in a folder and its subfolders, according to file suffixes.

    Hidden files are ignored, and the result contains notes about other skipped files. Raises InputFileError if `folder` is
    not a folder, or if it contains more than MOST_FILES files.
    """
    if not folder.is_dir():
        raise InputFileError(f"{folder} is not a folder; specify the folder that contains the captures")
    frames, tables, notes = [], [], Counter[str]()
    for number, path in enumerate(_files(folder)):
        if number >= MOST_FILES:
            raise InputFileError(
                f"{folder} contains more than {MOST_FILES} files; specify a folder with the captures of one camera"
            )
        suffix, name = path.suffix.lower(), path.relative_to(folder).as_posix()
        if re.search("[\ud800-\udfff]", name):  # a measurement file cannot contain names that are not UTF-8
            notes[f"{suffix}: the file names are not UTF-8 text; skipped"] += 1
            continue
        kind = BY_SUFFIX.get(suffix)
        if suffix in SUFFIXES:
            tables.append(name)
        elif suffix in DEVELOPED:
            notes[f"{suffix}: developed pictures contain no raw values; skipped"] += 1
        elif kind is None:
            continue
        elif kind.wants_geometry:
            notes[f"{suffix}: headerless files do not state their size or packing (save the frames as TIFF); skipped"] += 1
        elif not kind.holds_frame:
            notes[f"{suffix}: sequences and data files are not single frames; skipped"] += 1
        else:
            frames.append(name)
    return CaptureFolder(
        folder, tuple(frames), tuple(tables), tuple(f"{count} × {note}" for note, count in sorted(notes.items()))
    )


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files in a folder and its subfolders, at most DEEPEST levels deep, sorted by name within each folder.

    Hidden files and folders are skipped, and symbolic links to folders are not followed.
    """
    for place, folders, names in os.walk(folder):
        deep = len(Path(place).relative_to(folder).parts)
        folders[:] = sorted(name for name in folders if not name.startswith(".") and deep < DEEPEST)
        for name in sorted(names):
            path = Path(place) / name
            if not name.startswith(".") and path.is_file():
                yield path


def read_capture(path: Path) -> RawFile:
    """Read a raw frame with its metadata. If the file is a stack, only its first frame is read.

    Raises InputFileError if the file is damaged or is not a raw file.
    """
    pages = _stack(path)
    content = raw_content(path) if pages is None else _counted(pages, 0)
    return RawFile(
        np.ascontiguousarray(require_dn(str(path), content["values"])),
        max(content.get("exposure") or 0.0, 0.0) or None,
        content.get("pattern"),
        content.get("black_level"),
        content.get("white_level"),
        1 if pages is None or pages.count is None else pages.count,
    )


def read_spectra(folder: CaptureFolder, notes: list[str]) -> list[tuple[str, CurveTable]]:
    """Read the tables of spectra in a folder of captures, and return the name and the content of each table.

    For each unreadable table, a line is appended to `notes`. Text files without rows of numbers are silently skipped.
    """
    found = []
    for name in folder.tables:
        try:
            found.append((name, read_table(folder.folder / name)))
        except L3Error as error:
            if Path(name).suffix.lower() in PROSE and not _has_numbers(folder.folder / name):
                continue
            reason = str(error).removeprefix(f"{folder.folder / name}: ").removeprefix(f"{folder.folder / name} ")
            notes.append(f"{name}: not a table of spectra ({reason}); skipped")
    return found


def _has_numbers(path: Path) -> bool:
    """Return whether a text file contains at least three rows of numbers, and is therefore probably a table.

    Also returns True if the file cannot be read.
    """
    try:
        with open(path, "rb") as stream:
            return len(FIGURES.findall(stream.read(65536))) >= 3
    except OSError:
        return True
