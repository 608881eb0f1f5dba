"""Frames of a lab: single-channel 16-bit pictures (TIFF, PNG, PGM) of the whole sensor, raw DN, CFA phase (0, 0)."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.apart import apart
from l3cli.io.images import opened, pixels_of


@dataclass(frozen=True)
class FrameFiles:
    """Frames read one by one each time they are gone through."""

    paths: tuple[Path, ...]
    shape: tuple[int, int]
    bits: int

    def __iter__(self) -> Iterator[NDArray[np.uint16]]:
        for path in self.paths:
            yield read_frame(path, self.shape, self.bits)


def read_frame(path: Path, shape: tuple[int, int], bits: int) -> NDArray[np.uint16]:
    """A single-channel 16-bit picture (row, col) in DN, or an 8-bit one of a sensor of 8 bits or less.

    InputFileError if it is none, not of `shape`, or beyond `bits`.
    """
    return _read(path, *shape, bits)


@apart
def _read(path: Path, rows: int, cols: int, bits: int) -> NDArray[np.uint16]:
    with opened(path) as (picture, spec):
        depths = ("uint16", "uint8") if bits <= 8 else ("uint16",)
        if str(spec.format) not in depths or spec.nchannels != 1:
            raise InputFileError(
                f"{path} holds {spec.nchannels} channels of {spec.format}; give raw frames of one channel and 16 bits"
            )
        if (spec.height, spec.width) != (rows, cols):
            raise InputFileError(
                f"{path} has {spec.height}×{spec.width} pixels, the sensor {rows}×{cols}; give whole raw frames"
            )
        frame = pixels_of(path, picture, spec)[..., 0].astype(np.uint16, copy=False)
    if frame.max() >= 2**bits:
        raise InputFileError(f"{path} holds {frame.max()} DN, more than {bits} bits; check sensor.bits")
    return frame
