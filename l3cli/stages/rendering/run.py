"""Third phase of rendering: read, render and write all frames.

The steps for each frame are: read, measure, filter in time, render, encode, write. They run in several threads. The queues
between the threads are short, so memory use does not grow with the number of frames.
"""

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import astuple, replace
from pathlib import Path

from l3cli.errors import InputFileError, L3Error
from l3cli.io.destination import sink_of
from l3cli.io.sequences import FrameReference
from l3cli.parallel.threads import WriteBehind, prefetched
from l3cli.rendering.opencl.devices import cache_warning
from l3cli.rendering.raw_checks import FrameWarnings, odd_exposure_time
from l3cli.rendering.rendition import FrameMeter
from l3cli.rendering.temporal.chunks import Chunks
from l3cli.stages.rendering.checkpoint import FrameOrigins
from l3cli.stages.rendering.deflicker import FlickerReport, deflickered
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look
from l3cli.stages.rendering.pictures import LocalPictures, RemotePictures, Renderers, picture_makers
from l3cli.stages.rendering.reading import FrameReader, FrameTask, last_read
from l3cli.stages.rendering.reports import Tally, WhiteReport, report_times
from l3cli.stages.rendering.uncertainty import write_uncertainty

QUEUE_FRAMES = 3  # maximum number of frames in the queue between two steps


def run(job: Job, look: Look, renderers: Renderers) -> Tally:
    """Render the frames of a job, and report warnings at the end.

    If `resume` is set, finished pictures are not rendered again.

    Raises
    ------
    InputFileError, L3Error
        If a frame is damaged and `skip_bad` is not set, if no frame can be read, or if an output cannot be written.
    """
    tally = Tally()
    if not _is_finished(job, look, tally):
        keeping = job.checkpoint.kept() if job.checkpoint else contextlib.nullcontext()
        with keeping, picture_makers(job, look, renderers) as makers:
            if job.options.uncertainty is not None:  # before the picture, because small frames cause an error
                tally.written.append(write_uncertainty(job, look))
            _render_frames(job, look, makers, tally)
    tally.report(job)
    for warning in filter(None, (odd_exposure_time(job.overrides.exposure, look.table), cache_warning())):
        job.options.console.warn(warning)
    tally.files = job.files.and_wrote(*sorted(tally.written))
    return tally


def _is_finished(job: Job, look: Look, tally: Tally) -> bool:
    """Return whether a video or multi-page file is already finished and, if so, add its frames to the tally."""
    if job.checkpoint is None or job.destination.one_by_one:
        return False
    path = job.destination.path
    if not job.checkpoint.has(path, _origins(job, look).of_all(look.sequence)):
        return False
    counts = job.checkpoint.items[path.name]
    tally.done, tally.failures = counts["frames"], counts["left_out"]
    return True


def _render_frames(job: Job, look: Look, makers: LocalPictures | RemotePictures, tally: Tally) -> None:
    """Render and write all frames, count them in the tally, and report warnings about them.

    Raises InputFileError if no frame can be read.
    """
    start = time.monotonic()
    sequence, options, console = look.sequence, job.options, job.options.console
    meter = FrameMeter(look.table, look.rendition, look.white_source, look.video.rate if job.in_order else None)
    for numbers in sequence.missing:
        tally.leave_out(sequence.absent(numbers), job, len(numbers))
    warnings, whites = FrameWarnings(look.table), WhiteReport(look.white_source, sequence.stills, console)
    flicker = FlickerReport()
    total = last_read(job) if sequence.part else sequence.count and sequence.count - sequence.lost
    sink = sink_of(job.destination, sequence, look.video, look.pacing, _lister(job, look, tally))
    with sink as (write, threads), WriteBehind(write, QUEUE_FRAMES, threads) as writing:
        read = FrameReader(job, look, meter, _origins(job, look), makers.workers_read).frames()
        steady = deflickered(read, job, look, meter, flicker) if options.deflicker else read
        measured = prefetched(steady, QUEUE_FRAMES)
        filtered = prefetched(_filtered(measured, look.temporal), QUEUE_FRAMES) if look.temporal else measured
        unfinished = _unfinished(console.progress(filtered, total, "frames"), job, tally, warnings, whites)
        for task, picture in makers.pictures(unfinished):
            if isinstance(picture, L3Error):
                tally.done -= 1
                tally.leave_out(picture, job)
            else:
                writing.put((task.reference, picture))
        if not tally.done:
            raise InputFileError("none of the frames could be read, so no output was written; check the errors above")
    tally.seconds = max(time.monotonic() - start, 1e-9)
    if warnings.assumption:
        console.info(warnings.assumption)
    for warning in warnings.lines():
        console.warn(warning)
    whites.end()
    if options.deflicker:
        console.info(flicker.line())
    report_times(job, look, tally)
    if job.checkpoint and job.checkpoint.abandoned:
        console.warn(
            f"{job.checkpoint.abandoned[0]} was rendered by an earlier run from a frame that is not an input of this run; "
            "remove the picture if you do not need it"
        )


def _filtered(tasks: Iterable[FrameTask], temporal: Chunks) -> Iterator[FrameTask]:
    for task in tasks:
        if task.is_filtered and task.frame is not None:
            yield replace(task, frame=temporal.filtered(task.place, task.frame))
        else:
            yield task


def _unfinished(
    tasks: Iterable[FrameTask], job: Job, tally: Tally, warnings: FrameWarnings, whites: WhiteReport
) -> Iterator[FrameTask]:
    """Yield the frames without a finished picture, and count all frames.

    Whites are reported, and warnings about frames are collected. An error in a frame is raised, or reported if `skip_bad` is
    set.
    """
    for task in tasks:
        if task.error is not None:
            if task.is_counted or not job.options.skip_bad:
                tally.leave_out(task.error, job, task.lost)
            continue
        tally.done += task.is_counted
        if task.frame is not None and task.is_counted:
            whites.add(task.frame, task.white)
        if not task.is_finished:
            tally.made += 1
            if task.frame is not None:
                warnings.check(task.frame, job.sequence.stills)
            yield task


def _origins(job: Job, look: Look) -> FrameOrigins:
    """Return the object that computes each picture's origin, a digest of its frame and settings.

    With flicker removal, the origin includes the number of frames, because the last pictures depend on it.
    """
    count = job.sequence.count if job.options.deflicker else None
    settings = [look.light_mix and astuple(look.light_mix), look.overrides.unlabelled_gain, astuple(look.video), count]
    return FrameOrigins(job.inputs[0], settings, job.frames_depend_on_earlier)


def _lister(job: Job, look: Look, tally: Tally) -> Callable[[Path, Path, FrameReference | None], None]:
    """Return a function that adds a finished output to the tally and to the checkpoint.

    The returned function must be called before the temporary file of the output is renamed.
    """
    whole = "" if job.destination.one_by_one or job.checkpoint is None else _origins(job, look).of_all(look.sequence)

    def add(file: Path, temporary: Path, reference: FrameReference | None) -> None:
        tally.written.append(file)
        if job.checkpoint is not None and reference is not None:
            job.checkpoint.list_output(file, temporary, reference.origin)
        elif job.checkpoint is not None:
            job.checkpoint.list_output(file, temporary, whole, frames=tally.done, left_out=tally.failures)

    return add
