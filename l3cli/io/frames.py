"""Frames of a lab: single-channel 16-bit pictures (TIFF, PNG, PGM) or raw files of the whole sensor, raw DN, CFA phase
(0, 0)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.frame import shifted_cfa
from l3cli.io.images import mono_of, opened
from l3cli.io.isolated import isolated
from l3cli.io.photos import raw_content
from l3cli.io.raw.cfa_codes import FilterArray, find_phase
from l3cli.io.raw.registry import BY_SUFFIX, format_of
from l3cli.io.raw.tiff import read_plain

TIFF = (".tif", ".tiff")
PICTURES = (".tif", ".png")  # of formats whose depth is checked before their pixels are read


@dataclass(frozen=True)
class FrameFiles:
    """Frames read one by one each time they are gone through."""

    paths: tuple[Path, ...]
    shape: tuple[int, int]
    bits: int
    array: FilterArray | None = None  # of the sensor, that raw files have to state

    def __iter__(self) -> Iterator[NDArray[np.uint16]]:
        for path in self.paths:
            yield read_frame(path, self.shape, self.bits, self.array)


def read_frame(path: Path, shape: tuple[int, int], bits: int, array: FilterArray | None = None) -> NDArray[np.uint16]:
    """Return a single-channel 16-bit picture (row, col) in DN, an 8-bit one of a sensor of 8 bits or less, or a raw file's
    mosaic.

    InputFileError if it is none, not of `shape`, beyond `bits`, or if it states another `array` or phase.
    """
    if path.suffix.lower() in BY_SUFFIX and format_of(path).suffixes[0] not in PICTURES:
        content = raw_content(path)
        values, pattern = content["values"], content.get("pattern")
        if array is not None and pattern is not None:
            _check_array(path, pattern, array)
    elif bits > 8 and path.suffix.lower() in TIFF and (plain := read_plain(path, (16,))) is not None:
        values = plain["values"]
    else:
        values = _read_picture(path, *shape, bits)
    _check(path, str(values.dtype), 1, values.shape, shape, bits)
    require_bits(path, values, bits)
    return values.astype(np.uint16, copy=False)


def require_bits(path: Path, values: NDArray, bits: int) -> None:
    """Raise InputFileError if a sensor of so many bits cannot give the values."""
    if values.max() >= 2**bits:
        raise InputFileError(f"{path} holds {values.max()} DN, more than {bits} bits; check sensor.bits")


@isolated("OpenImageIO")
def _read_picture(path: Path, rows: int, cols: int, bits: int) -> NDArray:
    with opened(path) as (picture, spec):
        _check(path, str(spec.format), spec.nchannels, (spec.height, spec.width), (rows, cols), bits)
        return mono_of(path, picture, spec)[0]


def _check_array(path: Path, pattern: NDArray[np.int64], array: FilterArray) -> None:
    try:
        phase = find_phase(str(path), pattern, array)
    except InputFileError as error:
        reason = str(error).partition(";")[0].replace("the table", "cfa.pattern")
        raise InputFileError(f"{reason}; correct cfa.pattern") from error
    if not np.array_equal(shifted_cfa(array.cfa, phase), array.cfa):
        raise InputFileError(f"{path} begins at row {phase[0]}, column {phase[1]} of cfa.pattern; begin cfa.pattern there")


def _check(path: Path, depth: str, channels: int, size: tuple[int, ...], shape: tuple[int, int], bits: int) -> None:
    depths = ("uint16", "uint8") if bits <= 8 else ("uint16",)
    if depth not in depths or channels != 1:
        raise InputFileError(f"{path} holds {channels} channels of {depth}; give raw frames of one channel and 16 bits")
    if size != shape:
        raise InputFileError(
            f"{path} has {size[0]}×{size[1]} pixels, the sensor {shape[0]}×{shape[1]}; give whole raw frames"
        )
