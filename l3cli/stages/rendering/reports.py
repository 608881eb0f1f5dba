"""What a rendering reports about its frames: counts, whites and times."""

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

EVEN, KEPT, LOST = "even", "kept", "lost"  # frame times: evenly spaced, or uneven and kept in the video, or lost


@dataclass
class Tally:
    """Counts of a rendering, which change while it runs."""

    done: int = 0  # frames whose pictures exist
    made: int = 0  # frames whose pictures this run has made
    failures: int = 0  # frames left out
    seconds: float = 0.0  # from the first frame's reading to the last one's writing
    frame_times: str | None = None  # EVEN, KEPT or LOST; None for pictures, which have no times
    written: list[Path] = field(default_factory=list)
    files: FilesUsed = field(default_factory=FilesUsed)

    def leave_out(self, error: L3Error, job: Job, count: int = 1) -> None:
        """Count and report frames that are left out because of an error. Without --skip-bad, raise the error."""
        if not job.options.skip_bad:
            raise error
        self.failures += count
        job.options.console.report(f"l3: {error}")

    def report(self, job: Job) -> None:
        """Report the end of the run."""
        console, path = job.options.console, job.destination.path
        if not self.made:
            console.info(f"{path} is finished already")
        elif not job.sequence.stills:
            console.info(f"{path}: {self.done} frames, {self.done / self.seconds:.3g} a second")
        if self.failures:
            console.report(f"l3: {self.failures} of {self.done + self.failures} frames left out")


class WhiteReport:
    """Reports the white with which frames are shown.

    It names the white of every still, of the first frame of a sequence and, if it has changed, of the last.
    """

    def __init__(self, source: WhiteSource | None, stills: bool, console: Console) -> None:
        self._source, self._stills, self._console = source, stills, console
        self._last: tuple[str, SceneWhite] | None = None
        self._reported: SceneWhite | None = None
        self._warned = False

    def add(self, frame: RawFrame, white: SceneWhite | None) -> None:
        """Add a frame and its white, or None if it could not be determined."""
        if self._source is None:
            return
        if white is None:
            if self._stills:
                self._console.info(f"{frame.name}: the white cannot be determined; that of the table is used")
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
    """Note in the tally whether the frames' times were kept, and warn of gaps and of times that are lost."""
    sequence, destination, pacing, console = job.sequence, job.destination, look.pacing, job.options.console
    rate, cure = f"{float(look.video.rate):.4g} a second", "name a .mp4, .mov or .mkv to keep their times"
    if pacing.stated is not None:
        tally.frame_times = KEPT if destination.has_times else LOST
        if tally.frame_times == LOST:
            reason = "pictures have no times" if destination.pictures else f"y4m shows {rate}"
            console.warn(f"{sequence.what}: the time between frames varies ({pacing.stated.range()}), but {reason}; {cure}")
    elif destination.pictures:
        return
    elif sequence.unit is None and not sequence.stills:
        tally.frame_times = LOST
        console.warn(
            f"{sequence.what}: the numbers in its file names are not consecutive frame numbers; the video shows {rate}"
        )
    elif pacing.first_gap is None:
        tally.frame_times = EVEN
    else:
        tally.frame_times = KEPT if destination.has_times else LOST
        more = f", and {pacing.gaps - 1} more gaps" if pacing.gaps > 1 else ""
        gap = "{}: frames are missing between {} and {}".format(sequence.what, *pacing.first_gap) + more
        if tally.frame_times == LOST:
            console.warn(f"{gap}, and y4m has no gaps; {cure}")
        elif not tally.failures:  # frames that were left out have been reported
            console.warn(f"{gap}; the frame before the gap is shown for that time")
