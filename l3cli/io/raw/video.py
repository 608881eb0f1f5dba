"""Raw videos through PyAV (FFmpeg): mosaics from lossless ones of one channel."""

import contextlib
import itertools
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.apart import apart
from l3cli.io.decoded_video import DecodedVideo, InTurn
from l3cli.io.raw.content import InOrder, Request, Stack
from l3cli.io.video import storable_rate


def stack(path: Path, _: Request) -> Stack:
    """The frames of a video, whose number is not known beforehand."""
    rate, numbers = raw_video_rate(path), itertools.count()
    return Stack(None, InOrder(lambda: raw_video_frame(path, next(numbers))).read, rate=rate)


def raw_video_rate(path: Path) -> Fraction | None:
    """Frames a second of a raw video, or None; InputFileError if it is no video, or not of one grey channel of 8 to
    16 bits, such as FFV1 in MKV."""
    fraction = _raw_video_rate(path)
    return storable_rate(Fraction(*fraction)) if fraction else None


@apart
def _raw_video_rate(path: Path) -> tuple[int, int] | None:
    with contextlib.closing(_raw_video(path)) as video:
        return (video.rate.numerator, video.rate.denominator) if video.rate else None


@apart
def raw_video_frame(path: Path, number: int) -> NDArray[np.uint16] | None:
    """Frame `number` (row, col) of a raw video in DN; None after the last. Frames are asked for one after the other, from 0.
    InputFileError if it is damaged; the next may be whole again."""
    frame = _in_turn.frame(path, number)
    return None if frame is None else frame.to_ndarray().astype(np.uint16)


def _raw_video(path: Path) -> DecodedVideo:
    return DecodedVideo(path, "raw frames as FFV1 in MKV", _require_mosaics)


_in_turn = InTurn(_raw_video)


def _require_mosaics(path: Path, context: Any) -> None:
    """InputFileError unless a video has one grey channel of 8 to 16 bits."""
    if not (context.pix_fmt or "").startswith("gray") or "f" in context.pix_fmt:
        raise InputFileError(
            f"{path} holds {context.pix_fmt or 'unknown'} pixels; a raw video has one channel (gray, gray12le…)"
        )
