"""Second phase of rendering: settings that may depend on the first frame, such as gain, white balance and frame times."""

import contextlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, L3Error
from l3cli.frames.frame import RawFrame
from l3cli.frames.gain_estimate import estimate_gain
from l3cli.io.raw.files import RawOverrides
from l3cli.io.sequences import STDIN_NAME, FrameSequence
from l3cli.io.video import USUAL_RATE, Pacing, VideoChoice
from l3cli.rendering.conditions import Mix, described, known_gains, mixed, nearest_for
from l3cli.rendering.rendition import Rendition
from l3cli.rendering.temporal.chunks import Chunks, filters
from l3cli.rendering.white.source import WhiteSource, usual_balance, white_source
from l3cli.stages.rendering.job import Job, video_choice


@dataclass(frozen=True)
class Look:
    """Settings of a rendering that may depend on the first frame."""

    table: TransformTable  # table that contains only the transforms for the illuminant of the frames
    light_mix: Mix | None  # mixture of illuminants for which transforms are interpolated; None: common transforms
    overrides: RawOverrides  # Job.overrides, with the estimated gain
    sequence: FrameSequence  # the frames, which are read with these overrides
    rendition: Rendition
    white_source: WhiteSource | None  # method that finds each frame's white; None to use the white of the rendition
    video: VideoChoice
    pacing: Pacing
    temporal: Chunks | None  # temporal filters; None if frames are not filtered in time


def choose_look(job: Job) -> Look:
    """Determine the settings that may depend on the first frame.

    The first frame is read only if the gain or the white depends on it.
    """
    gain = _estimated_gain(job)
    overrides = job.overrides if gain is None else replace(job.overrides, unlabelled_gain=gain)
    found = job.sequence if gain is None else replace(job.sequence, frames=job.find(overrides).frames)
    video, pacing = _timing(job)
    if job.white_source is None or not job.table.lights:
        light_mix, sequence, table = job.light_mix, found, mixed(job.table, job.light_mix)
        rendition, source = job.rendition, job.white_source
    else:
        light_mix, sequence = _light_mix_of_first(job.white_source, job, found)
        table = mixed(job.table, light_mix)
        rendition = replace(job.rendition, balance=usual_balance(table))
        source = white_source(job.options.white, table, job.shows_photos, job.table)
    temporal = _temporal_filters(job, table) if job.options.temporal else None
    return Look(
        table=table,
        light_mix=light_mix,
        overrides=overrides,
        sequence=sequence,
        rendition=rendition,
        white_source=source,
        video=video,
        pacing=pacing,
        temporal=temporal,
    )


def _estimated_gain(job: Job) -> float | None:
    """Estimate the analog gain from the noise of the first frame, if the gain is not stated.

    Returns None if the options or the first frame state a gain, if the estimate fails, or if the camera's noise is known at
    only one gain.
    """
    table, console = job.table, job.options.console
    if job.overrides.gain is not None or job.overrides.gains or table.camera is None or known_gains(table) == (1, 1):
        return None
    if job.sequence.what == STDIN_NAME:
        console.warn("the gain of frames from stdin cannot be estimated, so l3 assumes a gain of 1; set ‹gain›")
        return None
    frame, _ = _first_frame(job.find(job.overrides))
    if frame is None or table.gain_at(frame.shot.iso) is not None:
        return None
    try:
        estimate = estimate_gain(frame, table.camera)
    except ValueError as reason:
        console.warn(f"{frame.name}: the gain is unknown ({reason}), so l3 assumes a gain of 1; set ‹gain›")
        return None
    low, high = estimate.bounds
    extent = "" if job.sequence.count == 1 else " and used for all frames without an ISO speed"
    console.warn(
        f"{frame.name}: the gain is estimated from the noise as {estimate.gain:.3g} ({low:.2g} to {high:.2g}){extent}; "
        "if you know the gain, set ‹gain›"
    )
    return estimate.gain


def _light_mix_of_first(source: WhiteSource, job: Job, sequence: FrameSequence) -> tuple[Mix | None, FrameSequence]:
    """Find the mixture of the table's illuminants that is nearest to the white of the first frame.

    Its transforms are used for all frames. Errors in the first frame are reported later, when the frame is rendered.

    Returns
    -------
    Mix or None
        The mixture, or None if the white of the first frame is unknown.
    FrameSequence
        All frames, including the first frame.
    """
    console, is_single = job.options.console, sequence.count == 1
    frame, frames = _first_frame(sequence)
    white = None
    if frame is not None:
        with contextlib.suppress(L3Error):
            white = source.white(frame)
    if frame is None or white is None:
        if not is_single:
            console.info(
                "the white of the first frame is unknown; using the transforms trained on all illuminants of the table"
            )
        return None, frames
    light_mix = nearest_for(job.table, white.light.xyz)
    assert light_mix is not None
    extent = "" if is_single else ", for all frames"
    console.info(f"{frame.name}: using the transforms for {described(job.table, light_mix)}{extent} (white {source.about})")
    return light_mix, frames


def _first_frame(sequence: FrameSequence) -> tuple[RawFrame | None, FrameSequence]:
    """Read the first frame.

    Returns
    -------
    RawFrame or None
        The first frame. None if there are no frames or if the first frame is damaged.
    FrameSequence
        All frames. The first frame is put back, because frames from a stream can be read only once.
    """
    frames = sequence.frames
    number = next(iter(frames.wanted), None)
    if number is None:
        return None, sequence
    first: RawFrame | None = None
    fault: Exception | None = None
    try:
        first = frames.read(number)
    except (L3Error, OSError) as error:
        fault = error
    if not sequence.is_stream:
        return first, sequence

    def read(wanted: int) -> RawFrame | None:
        if wanted != number:
            return frames.read(wanted)
        if fault is not None:
            raise fault
        return first

    # If the frame numbers are an iterator, reading the first frame has also consumed the first number.
    numbers = itertools.chain([number], frames.wanted) if isinstance(frames.wanted, Iterator) else frames.wanted
    return first, replace(sequence, frames=replace(frames, series=replace(frames.series, read=read), wanted=numbers))


def _timing(job: Job) -> tuple[VideoChoice, Pacing]:
    """Return the video encoder's settings, including the frame rate, and the pacing of the frames."""
    sequence, options = job.sequence, job.options
    stated = sequence.times() if sequence.times is not None and options.fps is None else None
    uneven = None if stated is None or stated.are_even else stated
    pacing = Pacing(sequence.unit, uneven, sequence.unit or 1)
    rate = options.fps or sequence.rate or USUAL_RATE
    return replace(video_choice(options), rate=rate, tick=pacing.tick if job.destination.has_times else None), pacing


def _temporal_filters(job: Job, table: TransformTable) -> Chunks:
    """Create the temporal filters of a run.

    The filters need all frames in order, so they run in this process even if workers render the frames. In that case, they
    run with numpy if this machine has no OpenCL device. A warning is printed if there is only one frame.
    """
    if job.sequence.count == 1:
        job.options.console.warn("‹temporal› has no effect on a single frame; render a sequence, or remove ‹temporal›")
    try:
        return Chunks(filters(job.options.backend, table, **job.engine))
    except DeviceError:
        if job.scheduler is None:
            raise
        return Chunks(filters("reference", table))  # the filters of all backends compute the same results
