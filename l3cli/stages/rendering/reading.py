"""First steps of rendering: reading the frames, and measuring exposure and white in frame order.

Each frame becomes a `FrameTask`, to which later steps add their results. If the picture of a frame is already finished, the
frame is read only if later frames depend on it.
"""

import hashlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

from l3cli.errors import InputFileError, L3Error
from l3cli.frames.frame import RawFrame, upright
from l3cli.io.pictures.registry import file_identity, values_identity
from l3cli.io.sequences import FrameReference
from l3cli.rendering.flicker import LOOKAHEAD, BrightnessRatio
from l3cli.rendering.rendition import FrameMeter
from l3cli.rendering.temporal.chunks import needed
from l3cli.rendering.white.scene_white import SceneWhite, WhiteBalance
from l3cli.stages.rendering.checkpoint import FrameOrigins
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look
from l3cli.system.files import sha256


@dataclass(frozen=True)
class FrameTask:
    """A frame and the results of the rendering steps so far. Tasks are picklable, because they are sent to workers."""

    reference: FrameReference
    place: int  # position in the sequence, counted from 0
    is_finished: bool = False  # whether the frame can be skipped, because its picture exists or is not wanted
    is_counted: bool = True  # whether a picture of the frame is wanted; if not, other frames may still depend on it
    is_filtered: bool = False  # whether the temporal filter processes the frame
    frame: RawFrame | None = None  # None if a worker reads the frame, if the frame is not needed, or after an error
    digest: str = ""  # SHA-256 of the file if a worker reads the frame
    identity: str = ""  # identity of the frame in the metadata of its picture
    scale: float = 0.0  # factor by which the linear outputs are scaled; 0 for automatic exposure
    balance: WhiteBalance | None = None  # white balance; None for the white balance of the rendition
    white: SceneWhite | None = None  # measured white
    brightness: float = 0.0  # brightness from FrameMeter.looked_at
    ratio: float = 0.0  # ln(brightness / brightness of the previous frame)
    error: L3Error | None = None  # reason why the frame cannot be rendered
    lost: int = 1  # number of frames lost because of the error


class FrameReader:
    """Reads and measures the frames of a job in order.

    Parameters
    ----------
    job : Job
        The job.
    look : Look
        Settings of the job that may depend on its first frame.
    meter : FrameMeter
        Measures exposure and white.
    origins : FrameOrigins
        Computes the origin of each picture for the checkpoint.
    workers_read : bool
        Whether workers can read files. They then read all frames that need not be measured.
    """

    def __init__(self, job: Job, look: Look, meter: FrameMeter, origins: FrameOrigins, workers_read: bool) -> None:
        self._job, self._sequence, self._meter, self._origins = job, look.sequence, meter, origins
        self._ratio = BrightnessRatio(look.table)
        self._checkpoint = job.checkpoint if job.destination.one_by_one else None
        measures = bool(meter) or job.options.deflicker
        self._measures_all = measures and job.in_order
        self._leaves_to_workers = workers_read and job.destination.one_by_one and not (measures or job.options.temporal)
        self._fixed_scale = look.rendition.exposure or 0.0
        self._shape: tuple[int, ...] | None = None  # shape of the first frame
        # Frames from a stream are not read ahead, because the next one may not have arrived yet.
        self._looks_ahead = job.options.temporal and (not self._sequence.is_stream or self._sequence.part is not None)

    def frames(self) -> Iterator[FrameTask]:
        """Yield a task for each frame.

        Unneeded frames are marked as finished. All other frames are read and measured, except those that a worker reads.
        """
        listed, ahead = itertools.tee(self._listed()) if self._looks_ahead else (self._listed(), iter(()))
        needs = needed((task.place, not task.is_finished) for task in ahead)
        for task in listed:
            is_needed = next(needs) if self._looks_ahead else not task.is_finished
            if not is_needed and not self._measures_all and not self._sequence.is_stream:
                yield replace(task, is_finished=True)
            elif self._leaves_to_workers and task.reference.source and self._shape:
                yield self._left_to_worker(task)
            else:
                measured = self._measured(task)
                if measured is None:
                    yield from self._missing_at_end(task)
                    return
                filtered = self._job.options.temporal and (is_needed or not self._looks_ahead)
                yield replace(measured, is_filtered=filtered and measured.frame is not None)

    def _listed(self) -> Iterator[FrameTask]:
        """Yield a task for each frame, without reading the frame.

        The task is marked as finished if the picture is already finished, or if the frame is not to be rendered.
        """
        references = itertools.islice(self._sequence.frames, last_read(self._job))
        for place, reference in enumerate(references):
            is_counted = self._sequence.renders(place)
            identified = self._origins.of(reference) if self._checkpoint else reference
            yield FrameTask(identified, place, not is_counted or self._exists(identified), is_counted)

    def _exists(self, reference: FrameReference) -> bool:
        file = self._job.destination.file(reference.number, reference.stem)
        return self._checkpoint is not None and self._checkpoint.has(file, reference.origin)

    def _left_to_worker(self, task: FrameTask) -> FrameTask:
        """Prepare a task for a worker that will read the frame's file, and add the digest of this file.

        If the file cannot be read, the task contains the error instead. The first frame is never left to a worker, because
        it is needed for warnings.
        """
        assert task.reference.source is not None
        try:
            digest = sha256(task.reference.source)
        except L3Error as error:
            return replace(task, error=error)
        return replace(task, digest=digest, identity=file_identity(digest), scale=self._fixed_scale)

    def _measured(self, task: FrameTask) -> FrameTask | None:
        """Read a frame, measure its exposure and white, and determine its identity for the metadata.

        Returns None at the end of a stream. An error in the frame becomes part of the task.
        """
        try:
            frame = self._sequence.frames.read(task.reference.number)
            if frame is None:
                return None
            self._require_shape(frame)
            brightness, balance, white = self._meter.looked_at(frame)
            deflicker = self._job.options.deflicker  # if set, the scale depends on later frames, so it is computed later
            scale, ratio = (0.0, self._ratio.of(frame)) if deflicker else (self._meter.scale(frame, brightness), 0.0)
            reference = self._origins.of_read(task.reference, frame) if self._checkpoint else task.reference
            is_finished = task.is_finished or (not task.reference.origin and self._exists(reference))
            identity = _identity(reference, frame) if self._job.destination.pictures and not is_finished else ""
        except L3Error as error:
            return replace(task, error=error)
        except OSError as error:
            return replace(task, error=InputFileError(str(error)))
        return replace(
            task, reference=reference, is_finished=is_finished, frame=frame, identity=identity, scale=scale, balance=balance,
            white=white, brightness=brightness, ratio=ratio,
        )  # fmt: skip

    def _missing_at_end(self, task: FrameTask) -> Iterator[FrameTask]:
        """If a stream ended before the last selected frame, yield a task with an error."""
        if numbers := self._sequence.rest(task.reference.number):
            yield replace(task, error=self._sequence.absent(numbers), lost=len(numbers), is_counted=True)

    def _require_shape(self, frame: RawFrame) -> None:
        """Raise InputFileError if a frame of a video or of a multi-page file differs in size from the first frame.

        Frames in separate files may differ in size.
        """
        shape = upright(frame.values, frame.orientation).shape
        self._shape = first = self._shape or shape
        if shape != first and not self._job.destination.one_by_one:
            whole = "first page" if self._job.destination.pictures else "video"
            raise InputFileError(
                f"{frame.name} has {shape[0]}×{shape[1]} pixels, but the {whole} has {first[0]}×{first[1]}; use frames of "
                "the same size"
            )


def last_read(job: Job) -> int | None:
    """Return the number of frames to read, or None for all frames.

    The removal of flicker also needs some frames after the last frame of a shard.
    """
    part = job.sequence.part
    return None if part is None else part.stop + (LOOKAHEAD if job.options.deflicker else 0)


def _identity(reference: FrameReference, frame: RawFrame) -> str:
    """Return the identity of a frame for the metadata of its picture.

    It is derived from the SHA-256 of the frame's file or, if the frame has no file of its own, of its raw values.
    """
    if reference.source is not None:
        return file_identity(sha256(reference.source))
    return values_identity(hashlib.sha256(frame.values.astype("<u2", copy=False).tobytes()).hexdigest())
