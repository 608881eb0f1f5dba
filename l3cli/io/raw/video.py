"""Raw videos through PyAV (FFmpeg): mosaics from lossless ones of one channel."""

import contextlib
import itertools
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.io.apart import apart
from l3cli.io.raw.content import InOrder, Request, Stack
from l3cli.io.video import pyav, storable_rate
from l3cli.limits import require_picture

# A playlist under the name of a video would have FFmpeg read other files and addresses.
NOTHING_ELSE = {"protocol_whitelist": "file", "format_whitelist": "matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,avi"}

_videos: dict[Path, "_RawVideo"] = {}  # the one that is being read


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
    with contextlib.closing(_RawVideo(path)) as video:
        return (video.rate.numerator, video.rate.denominator) if video.rate else None


@apart
def raw_video_frame(path: Path, number: int) -> NDArray[np.uint16] | None:
    """Frame `number` (row, col) of a raw video in DN; None after the last. Frames are asked for one after the other, from 0.
    InputFileError if it is damaged; the next may be whole again."""
    if number == 0:
        for video in _videos.values():
            video.close()
        _videos.clear()
        _videos[path] = _RawVideo(path)
    if path not in _videos or _videos[path].position != number:
        raise InputFileError(f"{path} cannot be read on behind the frame that ended its decoder; copy the video again")
    return _videos[path].following()


class _RawVideo:
    """A video of one grey channel of 8 to 16 bits, such as FFV1 in MKV, decoded frame by frame: a mosaic in DN."""

    def __init__(self, path: Path) -> None:
        """InputFileError if it is no video, or not of one channel."""
        av = pyav()
        self.path = path
        try:
            self._container = av.open(str(path), options=NOTHING_ELSE)
        except (av.error.FFmpegError, OSError) as error:
            raise InputFileError(f"{path} is no video that can be read ({error.strerror}); give FFV1 in MKV") from error
        if not self._container.streams.video:
            raise InputFileError(f"{path} holds no video; give raw frames as FFV1 in MKV")
        stream = self._container.streams.video[0]
        context = stream.codec_context
        if not (context.pix_fmt or "").startswith("gray") or "f" in context.pix_fmt:
            raise InputFileError(
                f"{path} holds {context.pix_fmt or 'unknown'} pixels; a raw video has one channel (gray, gray12le…)"
            )
        require_picture(str(path), context.height, context.width)
        context.thread_count = 1  # see `following`
        self.rate: Fraction | None = stream.average_rate or None
        self._packets = self._container.demux(stream)
        self._decoded: Iterator[Any] = iter(())
        self._damaged = False  # since the last key frame
        self.position = 0  # number of the frame that comes next

    def close(self) -> None:
        self._container.close()

    def following(self) -> NDArray[np.uint16] | None:
        """The next frame (row, col); None after the last. InputFileError if it is damaged; the call after goes on."""
        av = pyav()
        self.position += 1
        try:
            while (frame := next(self._decoded, None)) is None:
                packet = next(self._packets)
                # A slice with a wrong checksum is concealed and only logged, in the thread that decodes: this one.
                with av.logging.Capture() as complaints:
                    self._decoded = iter(packet.decode())
                self._damaged = bool(complaints) or (self._damaged and not packet.is_keyframe)
        except StopIteration:
            return None
        except (av.error.FFmpegError, OSError) as error:
            self._damaged = True
            raise InputFileError(f"{self.path} is damaged ({error.strerror}); copy the video again") from error
        if self._damaged:
            raise InputFileError(f"{self.path} is damaged (checksum); copy the video again")
        return frame.to_ndarray().astype(np.uint16)
