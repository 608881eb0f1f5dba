"""Removal of the flicker of lamps from the exposure of frames, and its report."""

import math
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from l3cli.rendering.flicker import LOOKAHEAD, flicker_at
from l3cli.rendering.rendition import FrameMeter
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look
from l3cli.stages.rendering.reading import FrameTask

SMALLEST_REPORTED = 0.0005  # RMS of the log brightness


@dataclass
class FlickerReport:
    """The flicker that was removed from a sequence."""

    frames: int = 0
    squares: float = 0.0  # sum of squares of the log brightness that was removed
    mains: Counter[int | None] = field(default_factory=Counter)  # frames by the mains frequency that was found, in Hz

    def line(self) -> str:
        """Return the report in one line."""
        mains = self.mains.most_common(1)[0][0] if self.mains else None
        strength = math.sqrt(self.squares / max(self.frames, 1))
        if mains is None or strength < SMALLEST_REPORTED:
            return "no flicker of 100 or 120 Hz was found; if the pictures flicker, give the camera's rate as ‹fps›"
        return f"flicker of {2 * mains} Hz removed: {strength:.1%} RMS"


def deflickered(
    tasks: Iterator[FrameTask], job: Job, look: Look, meter: FrameMeter, report: FlickerReport
) -> Iterator[FrameTask]:
    """Yield the frames with exposure scales that remove the flicker.

    The flicker of a frame is fitted to LOOKAHEAD frames before and after it, so frames wait until these have been read.
    """
    rate, unit = look.video.rate, job.sequence.unit
    window: deque[tuple[float, float]] = deque()  # time in frames, and brightness ratio, of frames around the next one
    waiting: deque[tuple[float | None, FrameTask]] = deque()
    ahead = 0  # number of waiting frames that were read

    def released() -> FrameTask:
        nonlocal ahead
        time, task = waiting.popleft()
        if time is None or task.frame is None:
            return task
        ahead -= 1
        while window[0][0] < time - LOOKAHEAD:
            window.popleft()
        times, ratios = zip(*(point for point in window if point[0] <= time + LOOKAHEAD), strict=True)
        flicker = flicker_at(time, times, ratios, rate)
        if task.is_counted:
            report.frames += 1
            report.squares += flicker.log**2
            report.mains[flicker.mains] += 1
        return replace(task, scale=meter.scale(task.frame, task.brightness, flicker.log))

    for place, task in enumerate(tasks):
        time = None
        if task.frame is not None:
            time = task.reference.number / unit if unit else float(place)
            window.append((time, task.ratio))
            ahead += 1
        waiting.append((time, task))
        while ahead > LOOKAHEAD:
            yield released()
    while waiting:
        yield released()
