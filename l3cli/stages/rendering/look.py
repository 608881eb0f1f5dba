"""Second phase of a rendering: the choices that depend on the first frame, such as gain, white, display and frame times."""

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
    """How the frames of a job are shown."""

    table: TransformTable  # with the transforms for the light of the frames
    light_mix: Mix | None  # lights of the table that these transforms are for; None: all in common
    overrides: RawOverrides  # the job's, with the estimated gain
    sequence: FrameSequence  # the job's frames, to be read with these facts
    rendition: Rendition
    white_source: WhiteSource | None  # source of each frame's white; None: the white of the rendition
    video: VideoChoice
    pacing: Pacing
    temporal: Chunks | None  # temporal filters


def choose_look(job: Job) -> Look:
    """Choose how the frames of a job are shown. Reads the first frame if gain or white depend on it."""
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
    """Estimate the analog gain from the noise of the first frame, for all frames that do not state their gain.

    Returns None if the options or the first frame state the gain, if the estimate fails, or if the noise of the table's
    camera is known at one gain only.
    """
    table, console = job.table, job.options.console
    if job.overrides.gain is not None or job.overrides.gains or table.camera is None or known_gains(table) == (1, 1):
        return None
    if job.sequence.what == STDIN_NAME:
        console.warn("the gain of frames on stdin cannot be estimated; 1 is assumed; give ‹gain›")
        return None
    frame, _ = _first_frame(job.find(job.overrides))
    if frame is None or table.gain_at(frame.shot.iso) is not None:
        return None
    try:
        estimate = estimate_gain(frame, table.camera)
    except ValueError as reason:
        console.warn(f"{frame.name}: the gain is unknown ({reason}); 1 is assumed; give ‹gain›")
        return None
    low, high = estimate.bounds
    extent = "" if job.sequence.count == 1 else ", for all frames without ISO speed"
    console.warn(
        f"{frame.name}: gain {estimate.gain:.3g} ({low:.2g} to {high:.2g}) estimated from its noise{extent}; ‹gain› sets it"
    )
    return estimate.gain


def _light_mix_of_first(source: WhiteSource, job: Job, sequence: FrameSequence) -> tuple[Mix | None, FrameSequence]:
    """Return the mixture of the table's illuminants that is nearest to the white of the first frame, and the frames.

    All frames are rendered with the transforms for this mixture. It is None if the first frame states no white. Errors in
    the first frame are reported when it is rendered.
    """
    console, is_single = job.options.console, sequence.count == 1
    frame, frames = _first_frame(sequence)
    white = None
    if frame is not None:
        with contextlib.suppress(L3Error):
            white = source.white(frame)
    if frame is None or white is None:
        if not is_single:
            console.info("the first frame has no known white; using the table's common transforms for all its illuminants")
        return None, frames
    light_mix = nearest_for(job.table, white.light.xyz)
    assert light_mix is not None
    extent = "" if is_single else ", for all frames"
    console.info(f"{frame.name}: white {source.about}: transforms of {described(job.table, light_mix)}{extent}")
    return light_mix, frames


def _first_frame(sequence: FrameSequence) -> tuple[RawFrame | None, FrameSequence]:
    """Return the first frame, or None if there is none or it is damaged, and the frames including the first.

    Frames of a stream can be read only once, so the returned sequence repeats the first one.
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

    # An endless iterator of numbers has also been advanced.
    numbers = itertools.chain([number], frames.wanted) if isinstance(frames.wanted, Iterator) else frames.wanted
    return first, replace(sequence, frames=replace(frames, series=replace(frames.series, read=read), wanted=numbers))


def _timing(job: Job) -> tuple[VideoChoice, Pacing]:
    """Return how a video is encoded, with its rate, and the times of its frames."""
    sequence, options = job.sequence, job.options
    stated = sequence.times() if sequence.times is not None and options.fps is None else None
    uneven = None if stated is None or stated.are_even else stated
    pacing = Pacing(sequence.unit, uneven, sequence.unit or 1)
    rate = options.fps or sequence.rate or USUAL_RATE
    return replace(video_choice(options), rate=rate, tick=pacing.tick if job.destination.has_times else None), pacing


def _temporal_filters(job: Job, table: TransformTable) -> Chunks:
    """Return the temporal filters. They run in this process even if workers render, because each needs all frames."""
    if job.sequence.count == 1:
        job.options.console.warn("‹temporal› has no effect on a single frame; give a sequence")
    try:
        return Chunks(filters(job.options.backend, table, **job.engine))
    except DeviceError:
        if job.scheduler is None:
            raise
        return Chunks(filters("reference", table))  # this machine may have no device; all backends give the same frames
