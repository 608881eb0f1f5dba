"""Read raw videos, which contain losslessly compressed mosaics, with PyAV (FFmpeg)."""

import contextlib
import itertools
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.isolated import isolated
from l3cli.io.raw import InOrder, MultiFrameFile, RawContent
from l3cli.io.video import CONTAINERS, DecodedVideo, InTurn, StatedTimes, storable_rate

PALETTE = "pal8"  # pixel format of uncompressed 8-bit AVI files
AT_A_TIME = 500  # number of frame times per request to the isolated process


def stack(path: Path) -> MultiFrameFile:
    """Open a raw video. The number of frames is unknown until the video ends.

    Raises InputFileError unless the video has one grey channel with 8 to 16 bits, such as FFV1 in MKV.
    """
    fraction, numbers = _rate(path), itertools.count()
    rate = storable_rate(Fraction(*fraction)) if fraction else None

    def following() -> RawContent | None:
        pixels = _frame(path, next(numbers))
        return None if pixels is None else RawContent(values=pixels)

    return MultiFrameFile(None, InOrder(following).read, rate=rate, times=lambda: _times(path))


def _times(path: Path) -> StatedTimes | None:
    """Read the frame times, up to the first damaged frame, without decoding the frames.

    Returns None if the video has no frames, or if a time is missing.
    """
    ticks: list[int | None] = []
    tick = (1, 1)
    with contextlib.suppress(InputFileError):  # reading the damaged frame will report the error
        while True:
            tick, more = _some_times(path, len(ticks))
            if not more:
                break
            ticks += more
    known = [each for each in ticks if each is not None]
    if not known or len(known) < len(ticks):
        return None
    return StatedTimes(Fraction(*tick), np.sort(np.array(known, np.int64)))


@isolated("av")
def _rate(path: Path) -> tuple[int, int] | None:
    with contextlib.closing(_opened(path)) as video:
        return (video.rate.numerator, video.rate.denominator) if video.rate else None


@isolated("av")
def _some_times(path: Path, number: int) -> tuple[tuple[int, int], list[int | None]]:
    """Return the duration of a tick in s, and the times in ticks of up to AT_A_TIME frames, starting at frame `number`."""
    video = _timed.video(path, number)
    return (video.tick.numerator, video.tick.denominator), video.times(AT_A_TIME)


@isolated("av")
def _frame(path: Path, number: int) -> NDArray[np.uint16] | None:
    """Return frame `number` in a raw video, (row, col), in DN, or None after the last frame.

    Frames must be requested in order, starting at 0. Raises InputFileError if the frame is damaged. The following frames can
    still be read.
    """
    frame = _in_turn.frame(path, number)
    if frame is None:
        return None
    pixels = frame.to_ndarray()
    return (_of_palette(path, *pixels) if isinstance(pixels, tuple) else pixels).astype(np.uint16)


def _of_palette(path: Path, pixels: NDArray[np.uint8], palette: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the raw values in a palette image: the indices, provided that the palette, (colour, ARGB), is a grey ramp.

    Raises InputFileError if the palette is not a grey ramp.
    """
    if not (palette[:, 1:] == np.arange(256)[:, None]).all():
        raise InputFileError(
            f"{path} has a colour palette; record a raw video with one channel (pixel format gray, gray12le, …)"
        )
    return pixels


def _opened(path: Path) -> DecodedVideo:
    return DecodedVideo(path, "raw frames as FFV1 in MKV", _require_mosaics, f"{CONTAINERS},yuv4mpegpipe")


_in_turn, _timed = InTurn(_opened), InTurn(_opened)


def _require_mosaics(path: Path, context: Any) -> None:
    """Raise InputFileError unless a video has one grey channel with 8 to 16 bits, or a palette."""
    if not (context.pix_fmt or "").startswith(("gray", PALETTE)) or "f" in context.pix_fmt:
        raise InputFileError(
            f"{path} has the pixel format {context.pix_fmt or 'unknown'}; "
            "record a raw video with one channel (pixel format gray, gray12le, …)"
        )
