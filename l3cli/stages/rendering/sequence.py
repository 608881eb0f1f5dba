"""Frames, be it one or thousands: read ahead, render, write behind.

Reading, rendering and writing overlap in threads with short queues between them, so that memory is bounded whatever the
length; the libraries let go of Python's lock in their long calls.
"""

import hashlib
import itertools
import math
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from l3cli.errors import InputFileError, L3Error
from l3cli.frames.frame import RawFrame, upright
from l3cli.io.destination import Destination, sink_of
from l3cli.io.pictures.registry import file_identity, values_identity
from l3cli.io.sequences import FrameReference, FrameSequence
from l3cli.io.video import Pacing, VideoChoice
from l3cli.options.render import RenderOptions
from l3cli.parallel.threads import WriteBehind, prefetched
from l3cli.rendering.flicker import LOOKAHEAD, BrightnessRatio, flicker_at
from l3cli.rendering.raw_checks import FrameWarnings
from l3cli.rendering.rendition import FrameMeter, Rendition
from l3cli.rendering.temporal.chunks import Chunks, needed
from l3cli.rendering.white.scene_white import SceneWhite, WhiteBalance, implausible, unlike_stated
from l3cli.rendering.white.source import ChartSceneWhite, WhiteSource
from l3cli.stages.rendering.checkpoint import FrameDigests, PictureCheckpoint
from l3cli.stages.rendering.executors import Exposed, Local, Remote, Unread
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed, sha256

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable

EVEN, KEPT, LOST = "even", "kept", "lost"  # of the frames' times: evenly spaced, or not and kept in the video or lost
LEAST_FLICKER = 0.0005  # RMS of the log brightness, that is worth a line
DEPTH = 3  # frames that wait at most between reading and rendering, and between rendering and writing


@dataclass(frozen=True)
class SequenceJob:
    """Frames to be rendered, one or thousands, and how."""

    sequence: FrameSequence
    destination: Destination
    table: "TransformTable"
    rendition: Rendition
    source: WhiteSource | None  # of the white of each frame; None: that of the rendition
    choice: VideoChoice
    pacing: Pacing
    temporal: Chunks | None  # filters the frames in time
    options: RenderOptions

    @property
    def in_order(self) -> bool:
        """Return whether exposure and white that are measured follow one another in time: not of stills that become
        pictures, each of which has its own."""
        return not (self.sequence.stills and self.destination.pictures)

    @property
    def follows(self) -> bool:
        """Return whether what a frame is shown with depends on those before it."""
        measures = self.rendition.measures_exposure or self.source is not None or self.options.deflicker
        return (self.in_order and measures) or self.temporal is not None

    @property
    def last_read(self) -> int | None:
        """Return how many frames are read from the first on; None: all. Flicker is known by the frames after it, too."""
        part = self.sequence.part
        return None if part is None else part.stop + (LOOKAHEAD if self.options.deflicker else 0)


@dataclass(frozen=True)
class _Read:
    """A frame that was read or is to be, or why not."""

    reference: FrameReference
    frame: RawFrame | Unread | None
    scale: float = 0.0  # of its exposure, 0: automatic
    white: SceneWhite | None = None  # measured on it
    balance: WhiteBalance | None = None  # what it is shown with, if not the rendition's
    error: L3Error | None = None
    is_finished: bool = False  # its picture is there already, or not to be made
    brightness: float = 0.0  # as FrameMeter.looked_at returns it; with `ratio`, of a frame whose scale is not known yet
    ratio: float = 0.0  # log, of its brightness to that of the frame before
    counted: bool = True  # whether it is among those to be rendered
    lost: int = 1  # number of missing frames, if there is an error
    place: int | None = None  # in the sequence, if it is to be filtered


@dataclass
class Tally:
    """Numbers of frames rendered and left out, and the time taken."""

    done: int = 0
    made: int = 0  # of these, by this run; others were there already
    failures: int = 0
    seconds: float = 0.0  # from the first frame's reading to the last one's writing
    frame_times: str | None = None  # EVEN, KEPT or LOST of what is shown in time; None: pictures
    written: list[Path] = field(default_factory=list)
    files: FilesUsed = field(default_factory=FilesUsed)

    def leave_out(self, error: L3Error, options: RenderOptions, count: int = 1) -> None:
        """Report that a frame, or several, are left out; raise why, unless bad frames are skipped."""
        if not options.skip_bad:
            raise error
        self.failures += count
        options.console.report(f"l3: {error}")


class WhiteReport:
    """Report of the white assumed: of every still, of the first frame of a sequence and, if it has moved, of the last."""

    def __init__(self, source: WhiteSource | None, stills: bool, console: Console) -> None:
        self._source, self._stills, self._console = source, stills, console
        self._last: tuple[str, SceneWhite] | None = None
        self._reported: SceneWhite | None = None
        self._warned = False

    def report_white(self, frame: RawFrame, white: SceneWhite | None) -> None:
        """Take note of a frame."""
        if self._source is None:
            return
        if white is None:
            if self._stills:
                self._console.info(f"{frame.name}: nothing to tell its white by; the table's is taken")
            return
        self._last = frame.name, white
        if self._stills or self._reported is None:
            self._report(frame.name, white)
        if not self._warned:
            self._warned = True
            doubts = [implausible(f"{frame.name}: its white, {self._source.about},", white)]
            if isinstance(white, ChartSceneWhite) and white.stated is not None:
                doubts.append(unlike_stated(frame.name, white, white.stated))
            for doubt in filter(None, doubts):
                self._console.warn(doubt)

    def report(self) -> None:
        """Report at the end."""
        if self._last and self._last[1] is not self._reported:
            self._report(*self._last)

    def _report(self, name: str, white: SceneWhite) -> None:
        assert self._source is not None
        self._reported = white
        self._console.info(f"{name}: white {self._source.about}: {white}")


def render_frames(
    job: SequenceJob, executor: Local | Remote, checkpoint: PictureCheckpoint | None, digests: FrameDigests
) -> Tally:
    """Render every frame into the destination. What is broken is raised, or, where bad frames are skipped, said and left
    out."""
    start = time.monotonic()
    sequence, options, console = job.sequence, job.options, job.options.console
    meter = FrameMeter(job.table, job.rendition, job.source, job.choice.rate if job.in_order else None)
    tally, warnings, white_report = Tally(), FrameWarnings(job.table), WhiteReport(job.source, sequence.stills, console)
    for numbers in sequence.missing:
        tally.leave_out(sequence.absent(numbers), options, len(numbers))
    made = checkpoint.made if checkpoint else None
    sink = sink_of(job.destination, sequence, job.choice, job.pacing, made)
    with sink as (write, threads), WriteBehind(write, DEPTH, threads) as writing:
        reading = _Reading(job, meter, checkpoint, digests, executor.by_path).frames()
        flicker = FlickerTally()
        reading = prefetched(_deflickered(reading, job, meter, flicker) if options.deflicker else reading, DEPTH)
        if job.temporal:
            reading = prefetched(_filtered(reading, job.temporal), DEPTH)
        total = job.last_read if sequence.part else sequence.count and sequence.count - sequence.lost
        exposed = _exposed(console.progress(reading, total, "frames"), job, tally, white_report)
        for reference, picture in executor.render(warnings.watched(exposed, sequence.stills)):
            if isinstance(picture, L3Error):
                tally.done -= 1
                tally.leave_out(picture, options)
            else:
                writing.put((reference, picture))
                if job.destination.one_by_one:
                    tally.written.append(job.destination.file(reference.number, reference.stem))
        if not tally.done:
            raise InputFileError("none of the frames could be read; nothing is written")
    if job.destination.kind in ("pages", "video"):
        tally.written.append(job.destination.path)
    if warnings.assumption:
        console.info(warnings.assumption)
    for text in warnings.lines():
        console.warn(text)
    white_report.report()
    if options.deflicker:
        console.info(flicker.line())
    report_times(job, tally)
    tally.seconds = max(time.monotonic() - start, 1e-9)
    if not tally.made:
        console.info(f"{job.destination.path} is finished already")
    elif not sequence.stills:
        console.info(f"{job.destination.path}: {tally.done} frames, {tally.done / tally.seconds:.3g} a second")
    if tally.failures:
        console.report(f"l3: {tally.failures} of {tally.done + tally.failures} frames left out")
    return tally


def report_times(job: SequenceJob, tally: Tally) -> None:
    """Note in the tally what became of the frames' times, and warn of gaps and of times that are lost."""
    sequence, destination, pacing, console = job.sequence, job.destination, job.pacing, job.options.console
    rate, cure = f"{float(job.choice.rate):.4g} a second", "name a .mp4, .mov or .mkv to keep their times"
    if pacing.stated is not None:
        tally.frame_times = KEPT if destination.has_times else LOST
        if tally.frame_times == LOST:
            shown = "pictures have no times" if destination.pictures else f"y4m shows {rate}"
            console.warn(f"{sequence.what}: its frames follow after {pacing.stated.range()}, and {shown}; {cure}")
    elif destination.pictures:
        return
    elif sequence.unit is None and not sequence.stills:
        tally.frame_times = LOST
        console.warn(f"{sequence.what}: the numbers of its files do not count frames; {rate} are shown")
    elif pacing.first_gap is None:
        tally.frame_times = EVEN
    else:
        tally.frame_times = KEPT if destination.has_times else LOST
        more = f", and {pacing.gaps - 1} more gaps" if pacing.gaps > 1 else ""
        gap = "{}: no frame is there between {} and {}".format(sequence.what, *pacing.first_gap) + more
        if tally.frame_times == LOST:
            console.warn(f"{gap}, and y4m has none; {cure}")
        elif not tally.failures:  # which have been said
            console.warn(f"{gap}; the frame before is shown for as long")


@dataclass
class _Reading:
    """Frame after frame, read and measured; of frames that are kept only what later ones need of it. `by_path`: a file that
    becomes a file, and is neither measured nor filtered, is left to who renders it, but for the first, which warnings go
    by."""

    job: SequenceJob
    meter: FrameMeter
    checkpoint: PictureCheckpoint | None
    digests: FrameDigests
    by_path: bool
    ratio: BrightnessRatio = field(init=False)
    _size: tuple[int, ...] | None = None  # of all frames that become one file
    _is_first: bool = True

    def __post_init__(self) -> None:
        self.ratio = BrightnessRatio(self.job.table)

    def _asked(self) -> Iterator[tuple[int, FrameReference, bool]]:
        """Yield each frame with its place, and whether its picture is known to be there already, before it is read."""
        sequence, destination = self.job.sequence, self.job.destination
        for place, reference in enumerate(itertools.islice(sequence.frames, self.job.last_read)):
            is_finished = not sequence.renders(place)
            if self.checkpoint:
                reference = self.digests.of(reference)
                file = destination.file(reference.number, reference.stem)
                is_finished = is_finished or (reference.origin is not None and self.checkpoint.has(file, reference))
            yield place, reference, is_finished

    def frames(self) -> Iterator[_Read]:
        sequence = self.job.sequence
        # A stream is not asked for what has not come yet, unless its length is known.
        looks_ahead = self.job.temporal is not None and (not sequence.is_stream or sequence.part is not None)
        asked, ahead = itertools.tee(self._asked()) if looks_ahead else (self._asked(), iter(()))
        # Whether a picture depends on a frame in the filter.
        needs = needed((place, not is_finished) for place, _, is_finished in ahead)
        for place, reference, is_finished in asked:
            need = next(needs) if looks_ahead else not is_finished
            read = self._read(reference, is_finished, need)
            if read is None:
                if rest := sequence.rest(reference.number):
                    yield _Read(reference, None, error=sequence.absent(rest), lost=len(rest))
                break
            to_filter = self.job.temporal and isinstance(read.frame, RawFrame) and (need or not looks_ahead)
            yield replace(read, counted=sequence.renders(place), place=place if to_filter else None)
        if self.checkpoint:
            self.checkpoint.refuse_others()

    def _read(self, reference: FrameReference, is_finished: bool, need: bool) -> _Read | None:
        """Read a frame; None at the end of a stream."""
        job, destination = self.job, self.job.destination
        measures = (self.meter or job.options.deflicker) and job.in_order
        if not need and not measures and not job.sequence.is_stream:
            return _Read(reference, None, is_finished=True)
        leaves = self.by_path and destination.one_by_one and not (self.meter or job.temporal)
        try:
            if leaves and reference.source and not self._is_first:
                unread = Unread(reference.source.absolute(), sha256(reference.source))
                reference = replace(reference, identity=file_identity(unread.digest))
                return _Read(reference, unread, job.rendition.exposure or 0.0, is_finished=is_finished)
            frame, self._is_first = reference.read(), False
            if frame is None:
                return None
            if not destination.one_by_one:
                self._require_size(frame)
            brightness, balance, white = self.meter.looked_at(frame)
            if job.options.deflicker:
                scale, ratio = 0.0, self.ratio.of(frame)
            else:
                scale, ratio = self.meter.scale(frame, brightness), 0.0
        except (L3Error, OSError) as error:
            return _Read(reference, None, error=error if isinstance(error, L3Error) else InputFileError(str(error)))
        if self.checkpoint and reference.origin is None:
            reference = self.digests.of_read(reference, frame)
            is_finished = is_finished or self.checkpoint.has(destination.file(reference.number, reference.stem), reference)
        if destination.pictures and not is_finished:
            reference = replace(reference, identity=_identity(reference, frame))
        return _Read(reference, frame, scale, white, balance, is_finished=is_finished, brightness=brightness, ratio=ratio)

    def _require_size(self, frame: RawFrame) -> None:
        """Raise InputFileError unless a frame has the size of the first."""
        shape = upright(frame.values, frame.orientation).shape
        self._size = size = self._size or shape
        if shape != size:
            of = "first page" if self.job.destination.pictures else "video"
            raise InputFileError(
                f"{frame.name} has {shape[0]}×{shape[1]} pixels, the {of} {size[0]}×{size[1]}; give frames of one size"
            )


@dataclass
class FlickerTally:
    """The flicker that was taken off a sequence."""

    frames: int = 0
    squares: float = 0.0  # sum of the squares of its logs
    mains: Counter[int | None] = field(default_factory=Counter)

    def line(self) -> str:
        """Return one line on it."""
        mains = self.mains.most_common(1)[0][0] if self.mains else None
        strength = math.sqrt(self.squares / max(self.frames, 1))
        if mains is None or strength < LEAST_FLICKER:
            return "no flicker of 100 or 120 Hz was found; if the pictures flicker, give the camera's rate as ‹fps›"
        return f"flicker of {2 * mains} Hz taken off: {strength:.1%} RMS"


def _deflickered(reading: Iterator[_Read], job: SequenceJob, meter: FrameMeter, tally: FlickerTally) -> Iterator[_Read]:
    """Yield the same frames with their scale, of which flicker is taken off. It is fitted to LOOKAHEAD frames before and
    after each, which are held meanwhile."""
    rate, unit = job.choice.rate, job.sequence.unit
    window: deque[tuple[float, float]] = deque()  # time in frames, and ratio, of frames around the next one
    held: deque[tuple[float | None, _Read]] = deque()
    ahead = 0  # frames that are held

    def released() -> _Read:
        nonlocal ahead
        time_of, each = held.popleft()
        if time_of is None or not isinstance(each.frame, RawFrame):
            return each
        ahead -= 1
        while window[0][0] < time_of - LOOKAHEAD:
            window.popleft()
        times, ratios = zip(*(point for point in window if point[0] <= time_of + LOOKAHEAD), strict=True)
        flicker = flicker_at(time_of, times, ratios, rate)
        if each.counted:
            tally.frames += 1
            tally.squares += flicker.log**2
            tally.mains[flicker.mains] += 1
        return replace(each, scale=meter.scale(each.frame, each.brightness, flicker.log))

    for place, each in enumerate(reading):
        time_of = None
        if isinstance(each.frame, RawFrame):
            time_of = each.reference.number / unit if unit else float(place)
            window.append((time_of, each.ratio))
            ahead += 1
        held.append((time_of, each))
        while ahead > LOOKAHEAD:
            yield released()
    while held:
        yield released()


def _filtered(reading: Iterator[_Read], temporal: Chunks) -> Iterator[_Read]:
    """Yield the same, filtered. In a thread of its own: a filter waits between its kernels for those of rendering, and the
    next frame is read meanwhile."""
    for each in reading:
        if each.place is not None and isinstance(each.frame, RawFrame):
            each = replace(each, frame=temporal.filtered(each.place, each.frame))
        yield each


def _identity(reference: FrameReference, frame: RawFrame) -> str:
    """Return the identity of the frame that a picture was made from, as the picture states it."""
    if reference.source is not None:
        return file_identity(sha256(reference.source))
    return values_identity(hashlib.sha256(frame.values.astype("<u2", copy=False).tobytes()).hexdigest())


def _exposed(reading: Iterable[_Read], job: SequenceJob, tally: Tally, white_report: WhiteReport) -> Iterator[Exposed]:
    """Yield the frames to render, each with its scale (0: automatic); errors are raised, or reported and counted."""
    for each in reading:
        if each.error is not None:
            if each.counted or not job.options.skip_bad:
                tally.leave_out(each.error, job.options, each.lost)
            continue
        tally.done += each.counted
        if each.frame is not None:
            if isinstance(each.frame, RawFrame) and each.counted:
                white_report.report_white(each.frame, each.white)
            if not each.is_finished:
                tally.made += 1
                yield Exposed(each.reference, each.frame, each.scale, each.balance)
