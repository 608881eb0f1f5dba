"""Write and read videos with PyAV (FFmpeg).

The module writes videos and y4m streams, decodes videos frame by frame, and determines frame times. Decoding functions must
be called only in a process from `io.isolated`. Raw videos are read by raw/video.py.

Pictures are written as sRGB. Videos are labelled with BT.709 primaries and the sRGB transfer function, except ProRes videos,
which are labelled with the BT.709 transfer function because ProRes has no label for sRGB. Videos that store luma and chroma
are also labelled with the BT.709 matrix and limited range.
"""

import contextlib
import itertools
import logging
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.system.files import atomic_output
from l3cli.system.limits import require_picture

INSTALL = 'videos need PyAV; install it with: pip install "l3cli[video]"'
SLOWEST, FASTEST = Fraction(1, 1000), Fraction(1000)  # plausible frame rates in frames per second
FINEST = 1_000_000  # maximum denominator of frame rates and times, because containers store numerators in 32 bits


def storable_rate(rate: Fraction) -> Fraction | None:
    """Round a frame rate in frames/s to a fraction that every container can store, such as 29.97002997 to 30000/1001.

    Returns None if the rate is below 1/1000 or above 1000 frames/s.
    """
    return rate.limit_denominator(FINEST) if SLOWEST <= rate <= FASTEST else None


def pyav() -> Any:
    """Import PyAV and suppress FFmpeg's messages. Raises L3Error if PyAV is not installed."""
    try:
        import av
    except ModuleNotFoundError as error:
        raise L3Error(INSTALL) from error
    # FFmpeg's errors go to Python's logger "libav", which must not print them, because l3 reports errors itself.
    av.logging.set_level(av.logging.ERROR)
    log = logging.getLogger("libav")
    if not log.handlers:  # add only one handler, although this function is called for every frame
        log.addHandler(logging.NullHandler())
    log.propagate = False
    return av


# ------------------------------------------------------------------------------------------------------------ encoding


@dataclass(frozen=True)
class Encoding:
    """Settings for encoding pictures as a video."""

    encoder: str  # name in FFmpeg
    formats: dict[int, str]  # bits per value of the pictures → pixel format in FFmpeg
    suffixes: tuple[str, ...]  # suffixes of the files that can contain the video
    presets: bool = False  # whether `preset` and `crf` apply
    options: tuple[tuple[str, str], ...] = ()  # names and values of encoder options
    tag: str | None = None  # codec tag in MP4 and QuickTime files; None for FFmpeg's default
    transfer: str = "IEC61966_2_1"  # transfer function, by its name in PyAV; IEC 61966-2-1 is sRGB
    frames_at_once: int | None = None  # number of frames encoded in parallel; None for the encoder's default
    reorders: int = 0  # number of frames that x265 needs to determine the decoding times of B-frames


# The output of x264 depends on how it divides the work between threads. By default, it splits every frame into one slice per
# core, which makes files up to 10 % larger. With a fixed number of parallel frames, all machines write the same bytes.
ENCODINGS = {
    "h264": Encoding("libx264", {8: "yuv420p"}, (".mp4", ".mov", ".mkv"), presets=True, frames_at_once=4),
    "h265": Encoding(
        "libx265",
        {8: "yuv420p", 16: "yuv420p10le"},
        (".mp4", ".mov", ".mkv"),
        presets=True,
        tag="hvc1",
        reorders=2,
    ),
    "ffv1": Encoding(
        "ffv1", {8: "bgr0", 16: "gbrp16le"}, (".mkv",), options=(("level", "3"), ("slicecrc", "1"), ("g", "1"))
    ),
    "prores": Encoding(
        "prores_ks", {8: "yuv422p10le", 16: "yuv422p10le"}, (".mov",), options=(("profile", "hq"),), transfer="BT709"
    ),
}
USUAL = {".mp4": "h264", ".mov": "prores", ".mkv": "ffv1"}  # suffix → default codec
X265_UNIT = 64  # width and height of x265's coding tree units in pixels
READ_BEHIND = 64  # bytes of padding; FFmpeg may read 16 bytes past the end of a picture (libavutil, frame.h)
RGB_MATRIX = 0  # ITU-T H.273 matrix coefficients: identity, for RGB
Y4M = ".y4m"
# Bit depth of the rendered pictures → FFmpeg pixel format and colour-space tag in the y4m header. 16-bit pictures are stored
# with 10 bits.
Y4M_FORMATS = {8: ("yuv420p", "C420jpeg"), 16: ("yuv420p10le", "C420p10 XYSCSS=420P10")}


USUAL_RATE = Fraction(30)  # frames per second, if neither the user nor the input specifies the rate


@dataclass(frozen=True)
class VideoChoice:
    """Video settings."""

    rate: Fraction  # frames per second
    bits: int  # bit depth of the rendered pictures: 8 or 16
    codec: str | None = None  # key of ENCODINGS, or None for the default codec of the file suffix
    crf: float | None = None  # constant rate factor for h264 and h265; None for the encoder's default
    preset: str = "veryfast"  # speed preset for h264 and h265
    tick: Fraction | None = None  # duration of a tick of the frame times in s, or None if a tick is one frame


def is_video(path: Path) -> bool:
    """Return whether a file name has the suffix of a video that l3 can write: .mp4, .mov, .mkv or .y4m."""
    return path.suffix.lower() in (*USUAL, Y4M)


def check_video(path: Path, choice: VideoChoice) -> None:
    """Raise RecipeError if a video with these settings cannot be written, and L3Error if PyAV is not installed."""
    suffix = path.suffix.lower()
    if suffix == Y4M:
        if choice.codec or choice.crf is not None:
            raise RecipeError(f"{path}: y4m files are not compressed; remove ‹codec› and ‹crf›")
    else:
        encoding = _encoding(path, choice)
        if suffix not in encoding.suffixes:
            raise RecipeError(
                f"{path} cannot contain {choice.codec} video; use a file name that ends in {' or '.join(encoding.suffixes)}"
            )
        if choice.bits not in encoding.formats:
            raise RecipeError(f"{path}: h264 stores 8 bits per value; choose ‹codec› h265 or remove ‹bits›")
        if choice.crf is not None and not encoding.presets:
            raise RecipeError(f"{path}: ‹crf› applies only to h264 and h265; remove it or choose another ‹codec›")
    pyav()


def _encoding(path: Path, choice: VideoChoice) -> Encoding:
    return ENCODINGS[choice.codec or USUAL[path.suffix.lower()]]


class _Converter:
    """Converts pictures, (row, col, 3), to FFmpeg frames in one pixel format."""

    def __init__(self, pixel_format: str) -> None:
        self._reformatter = pyav().video.reformatter.VideoReformatter()  # reused, because it is slow to create
        self.pixel_format = pixel_format
        self._bytes = np.empty(0, np.uint8)

    def even(self, picture: NDArray) -> NDArray:
        """Pad a picture to an even number of rows and columns, as far as the pixel format requires this."""
        if not self.pixel_format.startswith(("yuv420", "yuv422")):
            return picture
        rows, cols = picture.shape[:2]
        down = rows % 2 if "420" in self.pixel_format else 0
        return np.pad(picture, ((0, down), (0, cols % 2), (0, 0)), mode="edge") if down or cols % 2 else picture

    def frame(self, picture: NDArray) -> Any:
        buffer, source = self._buffer_for(self.even(picture))
        frame = pyav().VideoFrame.from_numpy_buffer(buffer, format=source)
        # A single thread converts the picture. Several would take 20 % longer, because rendering keeps the other cores busy.
        coded = {"dst_colorspace": "ITU709", "dst_color_range": "MPEG"} if self.pixel_format.startswith("yuv") else {}
        return self._reformatter.reformat(frame, format=self.pixel_format, threads=1, **coded)

    def _buffer_for(self, picture: NDArray) -> tuple[NDArray, str]:
        """Copy a picture into a padded buffer, and return the buffer and its pixel format.

        The buffer is reused, because allocating an FFmpeg frame for each picture would take three times as long.
        """
        widened = picture.dtype == np.uint8 and self.pixel_format.startswith("yuv")
        rows, cols, count = *picture.shape[:2], 4 if widened else picture.shape[2]
        size = rows * cols * count * picture.itemsize
        if len(self._bytes) != size + READ_BEHIND:
            self._bytes = np.zeros(size + READ_BEHIND, np.uint8)
        buffer = self._bytes[:size].view(picture.dtype).reshape(rows, cols, count)
        if widened:
            _widen(np.ascontiguousarray(picture), buffer)
        else:
            buffer[...] = picture
        return buffer, "rgba" if widened else "rgb24" if picture.dtype == np.uint8 else "rgb48le"


def _widen(picture: NDArray[np.uint8], buffer: NDArray[np.uint8]) -> None:
    """Copy three-byte RGB pixels to four-byte pixels.

    FFmpeg converts four-byte pixels to luma and chroma so much faster that copy and conversion together take 20 % less time
    than the conversion of three-byte pixels. Each pixel is copied as a 32-bit integer, so its fourth byte is the first byte
    of the next pixel. FFmpeg ignores the fourth byte.
    """
    pixels = picture.size // 3
    buffer.reshape(-1).view("<u4")[: pixels - 1] = np.ndarray(pixels - 1, "<u4", picture.data, strides=(3,))
    buffer[-1, -1, :3] = picture[-1, -1]


def _x265_parameters(rows: int, cols: int, is_short: bool) -> str:
    """Return parameters that work around two bugs of x265.

    In videos of one or two frames, x265 does not set the decoding times of B-frames, so such videos are encoded without
    B-frames. For frames smaller than a coding tree unit, its assembly code writes beyond the frame, so assembly is disabled.
    """
    return "log-level=none" + ":bframes=0" * is_short + ":asm=0" * (min(rows, cols) < X265_UNIT)


class VideoWriter:
    """Writes pictures of equal size and type to a video. Call `finish` at the end."""

    def __init__(self, path: Path, container: Any, choice: VideoChoice) -> None:
        self._container, self._choice = container, choice
        self._encoding = _encoding(path, choice)
        self._converter = _Converter(self._encoding.formats[choice.bits])
        self._stream: Any = None
        self._waiting: list[Any] = []  # first frames, kept until the video is long enough for B-frames
        self._tick, self._time = choice.tick or 1 / choice.rate, -1

    def write(self, picture: NDArray, time: int | None = None) -> None:
        """Add a picture to the video.

        Parameters
        ----------
        picture : ndarray, (row, col, 3)
            Encoded sRGB, uint8 or uint16.
        time : int, optional
            Time of the picture in ticks. Times must increase. [default: 0 for the first picture, otherwise one tick after
            the previous picture]
        """
        frame = self._converter.frame(picture)
        self._tag(frame)
        self._time = self._time + 1 if time is None else time
        frame.pts, frame.time_base = self._time, self._tick
        self._waiting.append(frame)
        if self._stream is not None or len(self._waiting) > self._encoding.reorders:
            self._encode_waiting()

    def finish(self) -> None:
        """Write the pictures that are still buffered here or in the encoder."""
        if self._waiting:
            self._encode_waiting()
        if self._stream is not None:
            self._container.mux(self._stream.encode())

    def _encode_waiting(self) -> None:
        if self._stream is None:
            self._stream = self._new_stream(self._waiting[0].height, self._waiting[0].width)
        for frame in self._waiting:
            self._container.mux(self._stream.encode(frame))
        self._waiting.clear()

    def _new_stream(self, rows: int, cols: int) -> Any:
        encoding, choice = self._encoding, self._choice
        options = dict(encoding.options)
        if encoding.encoder == "libx265":
            options["x265-params"] = _x265_parameters(rows, cols, len(self._waiting) <= encoding.reorders)
        if encoding.presets:
            options["preset"] = choice.preset
            if choice.crf is not None:
                options["crf"] = str(choice.crf)
        stream = self._container.add_stream(encoding.encoder, rate=choice.rate, options=options)
        context = stream.codec_context
        context.width, context.height, context.pix_fmt = cols, rows, self._converter.pixel_format
        context.time_base = self._tick
        if encoding.frames_at_once:
            context.thread_type, context.thread_count = "FRAME", encoding.frames_at_once
        self._tag(context)
        if encoding.tag and self._container.format.name != "matroska":
            context.codec_tag = encoding.tag
        return stream

    def _tag(self, where: Any) -> None:
        """Set the colour primaries, transfer function, matrix and range of an FFmpeg frame or codec context."""
        names = pyav().video.reformatter
        where.color_primaries = names.ColorPrimaries.BT709
        where.color_trc = names.ColorTrc[self._encoding.transfer]
        coded = self._converter.pixel_format.startswith("yuv")
        where.colorspace = names.Colorspace.ITU709 if coded else RGB_MATRIX
        where.color_range = names.ColorRange.MPEG if coded else names.ColorRange.JPEG


@contextlib.contextmanager
def new_video(
    path: Path, choice: VideoChoice, finished: Callable[[Path], None] = lambda temporary: None
) -> Iterator[VideoWriter]:
    """Context manager that creates a video file, and yields an object that writes pictures to it.

    The pictures are written to a temporary file. At the end of the block, `finished` is called with its path, and then the
    file is renamed to `path`. If the block raises an exception, the file is removed. Raises L3Error if FFmpeg cannot write
    the video.
    """
    av = pyav()
    form = {".mp4": "mp4", ".mov": "mov", ".mkv": "matroska"}[path.suffix.lower()]
    with atomic_output(path) as temporary:
        try:
            # With bitexact, FFmpeg writes no versions, times or random numbers, so equal inputs result in equal bytes.
            with av.open(str(temporary), "w", format=form, container_options={"fflags": "+bitexact"}) as container:
                writer = VideoWriter(path, container, choice)
                yield writer
                writer.finish()
            finished(temporary)
        except av.error.FFmpegError as error:
            cure = "check the free space, or choose another output"
            raise L3Error(f"{path} cannot be written: {error.strerror}; {cure}") from error


class Y4mWriter:
    """Writes pictures of equal size, (row, col, 3), to a y4m stream as limited-range 4:2:0 luma and chroma."""

    def __init__(self, stream: BinaryIO, choice: VideoChoice) -> None:
        pixels, self._colours = Y4M_FORMATS[choice.bits]
        self._stream, self._rate = stream, choice.rate
        self._converter = _Converter(pixels)
        self._begun = False

    def write(self, picture: NDArray) -> None:
        frame = self._converter.frame(picture)
        if not self._begun:
            self._begun = True
            head = f"YUV4MPEG2 W{frame.width} H{frame.height} F{self._rate.numerator}:{self._rate.denominator}"
            _write_all(self._stream, f"{head} Ip A1:1 {self._colours} XCOLORRANGE=LIMITED\n".encode())
        _write_all(self._stream, b"FRAME\n")
        for plane in frame.planes:
            values = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
            used = plane.width * (1 if frame.format.name == "yuv420p" else 2)
            _write_all(self._stream, np.ascontiguousarray(values[:, :used]).data)


def _write_all(stream: BinaryIO, content: Any) -> None:
    """Write all bytes to an unbuffered stream, which may accept only some of them per call."""
    rest = memoryview(content).cast("B")
    while len(rest):
        rest = rest[stream.write(rest) :]


@contextlib.contextmanager
def new_y4m(
    path: Path | None, choice: VideoChoice, finished: Callable[[Path], None] = lambda temporary: None
) -> Iterator[Y4mWriter]:
    """Context manager that creates a y4m file, and yields an object that writes pictures to it.

    The pictures are written to a temporary file. At the end of the block, `finished` is called with its path, and then the
    file is renamed to `path`. If `path` is None, the pictures are written to stdout, and `finished` is not called.
    """
    if path is None:
        # Unbuffered, because a thread that is blocked in a buffered stream would prevent the interpreter from exiting.
        with open(1, "wb", buffering=0, closefd=False) as stream:
            yield Y4mWriter(stream, choice)
        return
    with atomic_output(path) as temporary:
        with open(os.fspath(temporary), "wb", buffering=0) as stream:
            yield Y4mWriter(stream, choice)
        finished(temporary)


# ---------------------------------------------------------------------------------------------------------------- decoding

CONTAINERS = "matroska,webm,mov,mp4,m4a,3gp,3g2,mj2,avi"


class DecodedVideo:
    """Decodes the video stream in a file frame by frame.

    Parameters
    ----------
    path : Path
        The video file.
    what : str
        Description of suitable files for messages, where it follows the word "use".
    require : callable
        Function that takes the path and FFmpeg's codec context, and raises InputFileError if the video is unsuitable.
    formats : str
        FFmpeg's names of the accepted container formats, separated by commas.

    Raises
    ------
    InputFileError
        If the file is not a video in one of `formats`, if its codec is not supported, or if its frames are too large.
    """

    def __init__(self, path: Path, what: str, require: Callable[[Path, Any], None], formats: str = CONTAINERS) -> None:
        av = pyav()
        self.path = path
        # Without these options, a playlist that is named like a video could make FFmpeg read other files and URLs.
        options = {"protocol_whitelist": "file", "format_whitelist": formats}
        try:
            self._container = av.open(str(path), options=options)
        except (av.error.FFmpegError, OSError) as error:
            raise InputFileError(f"{path} is not a video that FFmpeg can read ({error.strerror}); use {what}") from error
        if not self._container.streams.video:
            raise InputFileError(f"{path} contains no video stream; use {what}")
        stream = self._container.streams.video[0]
        context = stream.codec_context
        if context is None:
            raise InputFileError(f"{path} is encoded with a codec that FFmpeg does not support; use {what}")
        require(path, context)
        require_picture(str(path), context.height, context.width)
        context.thread_count = 1  # decode in this thread, so that `following` can capture FFmpeg's messages
        self.shape: tuple[int, int] = context.height, context.width
        self.rate: Fraction | None = stream.average_rate or None  # frames per second
        self.tick: Fraction = stream.time_base  # unit of times in s
        self._packets = self._container.demux(stream)
        self._decoded: Iterator[Any] = iter(())
        self._damaged = False  # whether any frame since the last intact key frame is damaged
        self.position = 0  # number of the next frame

    def close(self) -> None:
        self._container.close()

    def following(self) -> Any | None:
        """Return the next frame as a PyAV frame, or None after the last frame.

        Raises InputFileError if the frame is damaged. The following frames may be intact, and can still be read.
        """
        av = pyav()
        self.position += 1
        try:
            while (frame := next(self._decoded, None)) is None:
                packet = next(self._packets)
                # If a slice has a wrong checksum, FFmpeg conceals the slice and only logs a message in this thread.
                with av.logging.Capture() as complaints:
                    self._decoded = iter(packet.decode())
                self._damaged = bool(complaints) or (self._damaged and not packet.is_keyframe)
        except StopIteration:
            return None
        except (av.error.FFmpegError, OSError) as error:
            self._damaged = True
            raise InputFileError(f"{self.path} is damaged ({error.strerror}); use an undamaged copy of the video") from error
        if self._damaged:
            raise InputFileError(f"{self.path} is damaged (wrong checksum); use an undamaged copy of the video")
        return frame

    def times(self, most: int) -> list[int | None]:
        """Read the times of up to `most` frames, in ticks, without decoding the frames.

        The times are in file order, which may differ from display order. A time is None if the file does not contain it.
        Raises InputFileError if the file is damaged.
        """
        try:
            packets = list(itertools.islice((packet for packet in self._packets if packet.size), most))
        except (pyav().error.FFmpegError, OSError) as error:
            raise InputFileError(f"{self.path} is damaged ({error.strerror}); use an undamaged copy of the video") from error
        self.position += len(packets)
        return [packet.pts for packet in packets]


class InTurn:
    """Reads several videos one after the other, with only one of them open at a time.

    Each video's frames must be read in order, starting with frame 0, before the next video.
    """

    def __init__(self, opened: Callable[[Path], DecodedVideo]) -> None:
        self._opened = opened
        self._video: DecodedVideo | None = None

    def frame(self, path: Path, number: int) -> Any | None:
        """Return a video's frame `number`, counted from 0, as a PyAV frame, or None after the last frame.

        Raises InputFileError if the frame is damaged. Later frames may be intact.
        """
        return self.video(path, number).following()

    def video(self, path: Path, number: int) -> DecodedVideo:
        """Return a video that is positioned before frame `number`. If `number` is 0, the video is opened again.

        Raises InputFileError if the video is at a different position, which happens only after a frame has crashed the
        decoder.
        """
        if number == 0:
            if self._video is not None:
                self._video.close()
            self._video = None
            self._video = self._opened(path)
        if self._video is None or self._video.path != path or self._video.position != number:
            raise InputFileError(
                f"the decoder crashed on a frame of {path}, so the rest cannot be read; use an undamaged copy of the video"
            )
        return self._video


# --------------------------------------------------------------------------------------------------------- times of frames

JITTER = Fraction(1, 1000)  # time resolution of Matroska files in s


@dataclass(frozen=True)
class StatedTimes:
    """The frame times stated in a video file."""

    tick: Fraction  # unit of `ticks` in s
    ticks: NDArray[np.int64]  # (frame,) in display order

    @property
    def are_even(self) -> bool:
        """Whether all frames have the same duration, within the time resolution of Matroska files."""
        steps = np.diff(self.ticks)
        return steps.size == 0 or int(steps.max() - steps.min()) * self.tick <= JITTER

    def range(self) -> str:
        """Format the shortest and the longest interval between frames, such as "0.0333–0.05 s".

        The video must have at least two frames.
        """
        steps = np.diff(self.ticks) * float(self.tick)
        return f"{steps.min():.3g}–{steps.max():.3g} s"


def unit_of(numbers: Sequence[int]) -> int | None:
    """Return the step between consecutive frame numbers, or None if they are irregular, as time stamps are.

    The numbers must be in ascending order. The step is the smallest difference between consecutive numbers, or 1 if there
    are fewer than two. The numbers are regular if at least half of the differences equal the step, and all differences are
    multiples of it.
    """
    steps = Counter(after - before for before, after in pairwise(numbers))
    unit = min(steps, default=1)
    usual = unit > 0 and 2 * steps[unit] >= steps.total() and all(step % unit == 0 for step in steps)
    return unit if usual else None


class Pacing:
    """Assigns times to frames in order, in ticks after the first frame.

    Parameters
    ----------
    unit : int or None
        Step between consecutive frame numbers, which corresponds to one tick. If the frame numbers are irregular (None),
        consecutive frames are one tick apart.
    stated : StatedTimes, optional
        Times to use instead of the frame numbers.
    step : int
        Step of the frame selection, if only every `step`-th frame is used. Stated times are divided by `step`, so that each
        frame keeps its original duration.
    """

    def __init__(self, unit: int | None, stated: StatedTimes | None = None, step: int = 1) -> None:
        self._unit, self.stated = unit, stated
        # Duration of a tick in s. None if no times are stated, so that ticks are counted in frames.
        self.tick = None if stated is None else max(stated.tick / step, Fraction(1, FINEST))
        self._scale = Fraction(0) if stated is None or self.tick is None else stated.tick / step / self.tick
        self._first, self._last = 0, -1
        self.gaps = 0  # number of gaps in the frame numbers so far
        self.first_gap: tuple[int, int] | None = None  # frame numbers before and after the first gap
        self._number = 0  # number of the previous frame

    def time(self, number: int) -> int:
        """Return the time of the next frame, `number`, which is at least one tick after the previous frame."""
        time = self._time(number)
        if self._last < 0:
            self._first = time
        time = max(time - self._first, self._last + 1)
        if self.stated is None and time > self._last + 1:
            self.gaps += 1
            self.first_gap = self.first_gap or (self._number, number)
        self._last, self._number = time, number
        return time

    def _time(self, number: int) -> int:
        if self.stated is not None:
            ticks = self.stated.ticks
            return round(int(ticks[min(number, len(ticks) - 1)]) * self._scale)
        return self._last + 1 if self._unit is None else number // self._unit


Stated = Callable[[], StatedTimes | None]  # slow function that reads the frame times; None if the file contains none
