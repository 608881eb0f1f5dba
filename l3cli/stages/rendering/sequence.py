"""Frames, be it one or thousands: read ahead, render, write behind.

Reading, rendering and writing overlap in threads with short queues between them, so that memory is bounded whatever the
length; the libraries let go of Python's lock in their long calls.
"""

import hashlib
import itertools
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

from l3cli.errors import InputFileError, L3Error
from l3cli.frames.frame import RawFrame, upright
from l3cli.io.frame_times import Pacing
from l3cli.io.pictures.registry import file_identity, values_identity
from l3cli.io.sequences import FrameReference, FrameSequence
from l3cli.io.video import VideoChoice
from l3cli.parallel.threads import WriteBehind, prefetched
from l3cli.rendering.exposure import LightMeter, SteadyExposure
from l3cli.rendering.temporal.chunks import Chunks, needed
from l3cli.rendering.white.balance import SteadyWhite, WhiteBalance
from l3cli.rendering.white.scene_white import SceneWhite
from l3cli.rendering.white.source import WhiteSource
from l3cli.stages.input_warnings import FrameWarnings
from l3cli.stages.rendering.destination import Destination, open_sink
from l3cli.stages.rendering.executors import Local, Remote
from l3cli.stages.rendering.frame_whites import FrameWhites, WhiteReport
from l3cli.stages.rendering.mark import Mark, Origins
from l3cli.stages.rendering.rendition import Exposed, Rendition, Unread
from l3cli.system.console import Console
from l3cli.system.files import sha256

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable

EVEN, KEPT, LOST = "even", "kept", "lost"  # of the frames' times: evenly spaced, or not and kept in the video or lost
DEPTH = 3  # frames that wait at most between reading and rendering, and between rendering and writing


@dataclass(frozen=True)
class _Read:
    """A frame that was read or is to be, or why not."""

    pending: FrameReference
    frame: RawFrame | Unread | None
    brightness: float = 0.0
    white: SceneWhite | None = None  # measured on it
    balance: WhiteBalance | None = None  # what it is shown with, if not the rendition's
    error: L3Error | None = None
    kept: bool = False  # its picture is there already, or not to be made
    counted: bool = True  # whether it is among those to be rendered
    lost: int = 1  # frames that there are not, if there is an error
    place: int | None = None  # in the sequence, if it is to be filtered


@dataclass
class Tally:
    """Numbers of frames rendered and left out, and the time taken."""

    done: int = 0
    failures: int = 0
    seconds: float = 0.0  # from the first frame's reading to the last one's writing
    frame_times: str | None = None  # EVEN, KEPT or LOST of what is shown in time; None: pictures

    def leave_out(self, error: L3Error, skip_bad: bool, console: Console, count: int = 1) -> None:
        """Say that a frame, or several, are left out; raise why, unless `skip_bad`."""
        if not skip_bad:
            raise error
        self.failures += count
        console.report(f"l3: {error}")


def render_frames(
    sequence: FrameSequence, destination: Destination, executor: Local | Remote, table: "TransformTable",
    rendition: Rendition, source: WhiteSource | None, choice: VideoChoice, mark: Mark | None, origins: Origins,
    skip_bad: bool, console: Console, pacing: Pacing, temporal: Chunks | None = None,
) -> Tally:  # fmt: skip
    """Render every frame into the destination. What is broken is raised, or, with `skip_bad`, said and left out.
    `source`: of the white of each frame, None: that of the rendition; `temporal`: filters them in time."""
    start = time.monotonic()
    in_order = follows(sequence, destination)
    steady = SteadyExposure(choice.rate) if in_order and rendition.measures_exposure else None
    whites = FrameWhites(source, SteadyWhite(choice.rate) if in_order else None) if source else None
    tally, warnings, told = Tally(), FrameWarnings(table), WhiteReport(source, sequence.stills, console)
    for numbers in sequence.missing:
        tally.leave_out(sequence.absent(numbers), skip_bad, console, len(numbers))
    sink = open_sink(destination, choice, rendition, table.outputs, mark, sequence, pacing)
    with sink as (write, threads), WriteBehind(write, DEPTH, threads) as writing:
        meters = _Meters(LightMeter(table) if steady else None, whites, in_order)
        reading = prefetched(
            _read(sequence, destination, meters, mark, origins, executor.by_path, temporal is not None), DEPTH
        )
        if temporal:
            reading = prefetched(_filtered(reading, temporal), DEPTH)
        total = sequence.part.stop if sequence.part else sequence.count and sequence.count - sequence.lost
        reading = console.progress(reading, total, "frames")
        exposed = warnings.watched(_exposed(reading, rendition, steady, skip_bad, tally, told, console), sequence.stills)
        for pending, made in executor.render(exposed):
            if isinstance(made, L3Error):
                tally.done -= 1
                tally.leave_out(made, skip_bad, console)
            else:
                writing.put((pending, made))
        if not tally.done:
            raise InputFileError("none of the frames could be read; nothing is written")
    warnings.report(console)
    told.report()
    report_times(sequence, destination, pacing, choice.rate, tally, console)
    tally.seconds = max(time.monotonic() - start, 1e-9)
    done, failures = tally.done, tally.failures
    if not sequence.stills:
        console.info(f"{destination.path}: {done} frames, {done / tally.seconds:.3g} a second")
    if failures:
        console.report(f"l3: {failures} of {done + failures} frames left out")
    return tally


def report_times(
    sequence: FrameSequence, destination: Destination, pacing: Pacing, rate: Fraction, tally: Tally, console: Console
) -> None:  # fmt: skip
    """Say in the tally what became of the frames' times, and warn of gaps and of times that are lost. `rate`: frames/s."""
    cure = "name a .mp4, .mov or .mkv to keep their times"
    if pacing.stated is not None:
        tally.frame_times = KEPT if destination.has_times else LOST
        if tally.frame_times == LOST:
            shown = "pictures have no times" if destination.pictures else f"y4m shows {float(rate):.4g} a second"
            console.warn(f"{sequence.what}: its frames follow after {pacing.stated.range()}, and {shown}; {cure}")
    elif destination.pictures:
        return
    elif sequence.unit is None and not sequence.stills:
        tally.frame_times = LOST
        console.warn(f"{sequence.what}: the numbers of its files do not count frames; {float(rate):.4g} a second are shown")
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


def follows(sequence: FrameSequence, destination: Destination) -> bool:
    """Return whether exposure and white that are measured follow one another in time: not of stills that become pictures,
    each of which has its own."""
    return not (sequence.stills and destination.pictures)


@dataclass(frozen=True)
class _Meters:
    """Measurements on frames as they are read."""

    light: LightMeter | None
    whites: FrameWhites | None
    in_order: bool  # whether what a frame is shown with depends on those before it

    @property
    def any(self) -> bool:
        return bool(self.light or self.whites)

    def measured(self, pending: FrameReference, frame: RawFrame, kept: bool) -> _Read:
        white = self.whites.measured(frame) if self.whites else None
        balance = self.whites.balance if self.whites else None
        brightness = self.light.brightness(frame, balance) if self.light else 0.0
        return _Read(pending, frame, brightness, white, balance, kept=kept)


def _asked(
    sequence: FrameSequence, destination: Destination, mark: Mark | None, origins: Origins
) -> Iterator[tuple[int, FrameReference, bool]]:
    """Each frame with its place, and whether its picture is known to be there already, before it is read."""
    for place, pending in enumerate(itertools.islice(sequence.frames, sequence.part.stop if sequence.part else None)):
        kept = not sequence.renders(place)
        if mark:
            pending = origins.of(pending)
        if mark and not kept:
            kept = pending.origin is not None and mark.keeps(destination.file(pending.number, pending.stem), pending)
        yield place, pending, kept


def _with_need(asked: Iterator[tuple[int, FrameReference, bool]]) -> Iterator[tuple[int, FrameReference, bool, bool]]:
    """Each of `_asked`, and whether a picture that is not there yet depends on it in the filter."""
    frames, ahead_of_them = itertools.tee(asked)
    needs = needed((place, not kept) for place, _, kept in ahead_of_them)
    return ((*frame, need) for frame, need in zip(frames, needs, strict=True))


def _read(
    sequence: FrameSequence, destination: Destination, meters: _Meters, mark: Mark | None, origins: Origins, by_path: bool,
    temporal: bool,
) -> Iterator[_Read]:  # fmt: skip
    """Read and measure frame after frame; of frames that are kept only what later ones need of it. `by_path`: a file that
    becomes a file, and is neither measured nor filtered, is left to who renders it, but for the first, which warnings go by;
    `temporal`: frames will be filtered."""
    size: tuple[int, ...] | None = None
    leaves = by_path and destination.one_by_one and not (meters.any or temporal)
    first = True
    asked = _asked(sequence, destination, mark, origins)
    # A stream is not asked for what has not come yet, unless its length is known.
    looks_ahead = temporal and (not sequence.is_stream or sequence.part is not None)
    ahead_of = _with_need(asked) if looks_ahead else ((*each, not each[2]) for each in asked)
    for place, pending, kept, need in ahead_of:
        counted = sequence.renders(place)
        file = destination.file(pending.number, pending.stem)
        if not need and not (meters.any and meters.in_order) and not sequence.is_stream:
            yield _Read(pending, None, kept=True, counted=counted)
            continue
        try:
            if leaves and pending.source and not first:
                digest = sha256(pending.source)
                unread = Unread(pending.source.absolute(), digest)
                yield _Read(replace(pending, identity=file_identity(digest)), unread, kept=kept)
                continue
            frame, first = pending.read(), False
            if frame is None:
                if rest := sequence.rest(pending.number):
                    yield _Read(pending, None, error=sequence.absent(rest), lost=len(rest))
                break
            if not destination.one_by_one:
                size = size or _upright_shape(frame)
                _require_size(frame, size, "first page" if destination.pictures else "video")
            read = meters.measured(pending, frame, kept)
        except (L3Error, OSError) as error:
            wrong = error if isinstance(error, L3Error) else InputFileError(str(error))
            yield _Read(pending, None, error=wrong, counted=counted)
            continue
        if mark and pending.origin is None:
            pending = origins.of_read(pending, frame)
            kept = kept or mark.keeps(file, pending)
        if destination.pictures and not kept:
            pending = replace(pending, identity=_identity(pending, frame))
        to_filter = place if temporal and (need or not looks_ahead) else None
        yield replace(read, pending=pending, kept=kept, counted=counted, place=to_filter)
    if mark:
        mark.refuse_others()


def _filtered(reading: Iterator[_Read], temporal: Chunks) -> Iterator[_Read]:
    """The same, filtered. In a thread of its own: a filter waits between its kernels for those of rendering, and the next
    frame is read meanwhile."""
    for each in reading:
        if each.place is not None and isinstance(each.frame, RawFrame):
            each = replace(each, frame=temporal.filtered(each.place, each.frame))
        yield each


def _identity(pending: FrameReference, frame: RawFrame) -> str:
    """Return the identity of the frame that a picture was made from, as the picture states it."""
    if pending.source is not None:
        return file_identity(sha256(pending.source))
    return values_identity(hashlib.sha256(frame.values.astype("<u2", copy=False).tobytes()).hexdigest())


def _upright_shape(frame: RawFrame) -> tuple[int, ...]:
    return upright(frame.values, frame.orientation).shape


def _require_size(frame: RawFrame, size: tuple[int, ...], of: str) -> None:
    shape = _upright_shape(frame)
    if shape != size:
        raise InputFileError(
            f"{frame.name} has {shape[0]}×{shape[1]} pixels, the {of} {size[0]}×{size[1]}; give frames of one size"
        )


def _exposed(
    reading: Iterable[_Read],
    rendition: Rendition,
    steady: SteadyExposure | None,
    skip_bad: bool,
    tally: Tally,
    told: WhiteReport,
    console: Console,
) -> Iterator[Exposed]:
    """The frames to render, each with its scale (0: automatic exposure); what is broken is raised, or said and counted."""
    for each in reading:
        if each.error is not None:
            if each.counted or not skip_bad:
                tally.leave_out(each.error, skip_bad, console, each.lost)
            continue
        tally.done += each.counted
        if each.frame is not None:
            scale = rendition.exposure or (steady.scale(each.brightness) if steady else 0.0)
            if isinstance(each.frame, RawFrame) and each.counted:
                told.tell(each.frame, each.white)
            if not each.kept:
                yield Exposed(each.pending, each.frame, scale, each.balance)
