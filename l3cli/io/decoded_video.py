"""Videos of others, decoded frame by frame through PyAV (FFmpeg); who uses one lets that run apart."""

import itertools
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from l3cli.errors import InputFileError
from l3cli.io.video import pyav
from l3cli.system.limits import require_picture

FORMATS = "matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,avi"


class DecodedVideo:
    """The video stream of a file."""

    def __init__(self, path: Path, what: str, require: Callable[[Path, Any], None], formats: str = FORMATS) -> None:
        """Raise InputFileError if it is none of `formats`, or by `require`, which gets FFmpeg's codec context; `what` to
        give."""
        av = pyav()
        self.path = path
        # A playlist under the name of a video would have FFmpeg read other files and addresses.
        options = {"protocol_whitelist": "file", "format_whitelist": formats}
        try:
            self._container = av.open(str(path), options=options)
        except (av.error.FFmpegError, OSError) as error:
            raise InputFileError(f"{path} is no video that can be read ({error.strerror}); give {what}") from error
        if not self._container.streams.video:
            raise InputFileError(f"{path} holds no video; give {what}")
        stream = self._container.streams.video[0]
        context = stream.codec_context
        require(path, context)
        require_picture(str(path), context.height, context.width)
        context.thread_count = 1  # see `following`
        self.shape: tuple[int, int] = context.height, context.width
        self.rate: Fraction | None = stream.average_rate or None
        self.tick: Fraction = stream.time_base  # s
        self._packets = self._container.demux(stream)
        self._decoded: Iterator[Any] = iter(())
        self._damaged = False  # since the last key frame
        self.position = 0  # number of the frame that comes next

    def close(self) -> None:
        self._container.close()

    def following(self) -> Any | None:
        """Return the next frame, FFmpeg's; None after the last. InputFileError if it is damaged; the call after goes on."""
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
        return frame

    def times(self, most: int) -> list[int | None]:
        """Return the times of the next frames, `most` at most, in ticks and the file's order; None where it states none."""
        try:
            packets = list(itertools.islice((packet for packet in self._packets if packet.size), most))
        except (pyav().error.FFmpegError, OSError) as error:
            raise InputFileError(f"{self.path} is damaged ({error.strerror}); copy the video again") from error
        self.position += len(packets)
        return [packet.pts for packet in packets]


class InTurn:
    """Frames asked for one after the other, from 0, of the one video that is being read."""

    def __init__(self, opened: Callable[[Path], DecodedVideo]) -> None:
        self._opened = opened
        self._video: DecodedVideo | None = None

    def frame(self, path: Path, number: int) -> Any | None:
        """Return the frame `number`, FFmpeg's; None after the last. InputFileError if it is damaged; the next may be whole
        again."""
        return self.video(path, number).following()

    def video(self, path: Path, number: int) -> DecodedVideo:
        """Return the video before that frame."""
        if number == 0:
            if self._video is not None:
                self._video.close()
            self._video = None
            self._video = self._opened(path)
        if self._video is None or self._video.path != path or self._video.position != number:
            raise InputFileError(f"{path} cannot be read past the frame that crashed its decoder; copy the video again")
        return self._video
