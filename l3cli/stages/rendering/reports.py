"""Messages about the frames of a rendering: number, white points and times of the frames."""

from dataclasses import dataclass, field
from pathlib import Path

from l3cli.errors import L3Error
from l3cli.frames.frame import RawFrame
from l3cli.rendering.white.scene_white import SceneWhite, implausible, unlike_stated
from l3cli.rendering.white.source import ChartSceneWhite, WhiteSource
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look
from l3cli.system.console import Console
from l3cli.system.files import FilesUsed
from l3cli.system.text import counted

# values of Tally.frame_times: evenly spaced frames; uneven times, kept in the video; uneven times, lost
EVEN, KEPT, LOST = "even", "kept", "lost"


@dataclass
class Tally:
    """Numbers of frames, and other facts about a rendering, which are updated while it runs."""

    done: int = 0  # number of frames whose pictures exist
    made: int = 0  # number of frames whose pictures this run has rendered
    failures: int = 0  # number of frames that were skipped because of errors
    seconds: float = 0.0  # time between reading the first frame and writing the last picture
    frame_times: str | None = None  # EVEN, KEPT or LOST; None for pictures, which have no times
    written: list[Path] = field(default_factory=list)  # files that were written
    files: FilesUsed = field(default_factory=FilesUsed)

    def leave_out(self, error: L3Error, job: Job, count: int = 1) -> None:
        """Report an error, and count the frames that are skipped because of it.

        If `skip_bad` is not set, the error is raised instead.
        """
        if not job.options.skip_bad:
            raise error
        self.failures += count
        job.options.console.report(f"l3: {error}")

    def report(self, job: Job) -> None:
        """Report the number of frames, the speed and the number of skipped frames at the end of a run.

        If this run has rendered no frames, report that the output is already finished.
        """
        console, path = job.options.console, job.destination.path
        if not self.made:
            console.info(f"{path} is already finished")
        elif not job.sequence.stills:
            console.info(f"{path}: {self.done} frames, {self.done / self.seconds:.3g} per second")
        if self.failures:
            console.report(f"l3: {self.failures} of {self.done + self.failures} frames failed and were skipped")


class WhiteReport:
    """Reports the white of each still or, for a sequence, the first white and, if it differs, the last white.

    A warning is printed if the first white is implausible.
    """

    def __init__(self, source: WhiteSource | None, stills: bool, console: Console) -> None:
        self._source, self._stills, self._console = source, stills, console
        self._last: tuple[str, SceneWhite] | None = None
        self._reported: SceneWhite | None = None
        self._warned = False

    def add(self, frame: RawFrame, white: SceneWhite | None) -> None:
        """Add a frame and its white, or None if the white is unknown.

        The white of a still, and of the first frame of a sequence, is reported immediately. The first white is checked.
        """
        if self._source is None:
            return
        if white is None:
            if self._stills:
                self._console.info(f"{frame.name}: the white cannot be determined; using the white of the table")
            return
        self._last = frame.name, white
        if self._stills or self._reported is None:
            self._report(self._source, frame.name, white)
        if not self._warned:
            self._warned = True
            doubts = [implausible(f"{frame.name}: the white {self._source.about}", white)]
            if isinstance(white, ChartSceneWhite) and white.stated is not None:
                doubts.append(unlike_stated(frame.name, white, white.stated))
            for doubt in filter(None, doubts):
                self._console.warn(doubt)

    def end(self) -> None:
        """Report the white of the last frame, unless it has already been reported."""
        if self._source and self._last and self._last[1] is not self._reported:
            self._report(self._source, *self._last)

    def _report(self, source: WhiteSource, name: str, white: SceneWhite) -> None:
        self._reported = white
        self._console.info(f"{name}: white {source.about}: {white}")


def report_times(job: Job, look: Look, tally: Tally) -> None:
    """Warn about gaps between frames and lost frame times, and record in the tally whether frame times are kept."""
    sequence, destination, pacing, console = job.sequence, job.destination, look.pacing, job.options.console
    rate = f"{float(look.video.rate):.4g} frames per second"
    cure = "to preserve the frame times, write a .mp4, .mov or .mkv"
    if pacing.stated is not None:
        tally.frame_times = KEPT if destination.has_times else LOST
        if tally.frame_times == LOST:
            reason = "pictures have no times" if destination.pictures else f"y4m has a constant rate of {rate}"
            console.warn(f"{sequence.what}: the time between frames varies ({pacing.stated.range()}), but {reason}; {cure}")
    elif destination.pictures:
        return
    elif sequence.unit is None and not sequence.stills:
        tally.frame_times = LOST
        console.warn(
            f"{sequence.what}: the numbers in the file names are not consecutive frame numbers, so the frame times "
            f"are unknown and the video shows {rate}"
        )
    elif pacing.first_gap is None:
        tally.frame_times = EVEN
    else:
        tally.frame_times = KEPT if destination.has_times else LOST
        more = f" and in {counted(pacing.gaps - 1, 'other gap')}" if pacing.gaps > 1 else ""
        gap = "{}: frames are missing between {} and {}".format(sequence.what, *pacing.first_gap) + more
        if tally.frame_times == LOST:
            console.warn(f"{gap}, but a y4m video cannot contain gaps; {cure}")
        elif not tally.failures:  # skipped frames have already been reported
            console.warn(f"{gap}; the video shows the frame before a gap until the next frame")
