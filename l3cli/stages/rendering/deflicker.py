"""Removal of lamp flicker from a sequence by correcting each frame's exposure."""

import math
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from l3cli.rendering.flicker import LOOKAHEAD, flicker_at
from l3cli.rendering.rendition import FrameMeter
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look
from l3cli.stages.rendering.reading import FrameTask

SMALLEST_REPORTED = 0.0005  # RMS of the natural logarithm of the correction factors; weaker flicker is not reported


@dataclass
class FlickerReport:
    """The flicker that was removed from a sequence."""

    frames: int = 0  # number of frames
    squares: float = 0.0  # sum of squares of the logarithms of the correction factors
    # mains frequency in Hz (None: no flicker) → number of frames
    mains: Counter[int | None] = field(default_factory=Counter)

    def line(self) -> str:
        """Return the report as one line of text."""
        mains = self.mains.most_common(1)[0][0] if self.mains else None
        strength = math.sqrt(self.squares / max(self.frames, 1))
        if mains is None or strength < SMALLEST_REPORTED:
            return "no flicker of 100 or 120 Hz was found; if the pictures flicker, set ‹fps› to the rate of the camera"
        return f"flicker of {2 * mains} Hz removed: {strength:.1%} RMS"


def deflickered(
    tasks: Iterator[FrameTask], job: Job, look: Look, meter: FrameMeter, report: FlickerReport
) -> Iterator[FrameTask]:
    """Yield the frames, each with an exposure scale that removes the flicker.

    Flicker is estimated from the brightness of the LOOKAHEAD frames before and after each frame, so a frame is yielded only
    when these later frames have been read. Frames that were not read, for example because of an error, are yielded
    unchanged.
    """
    rate, unit = look.video.rate, job.sequence.unit
    window: deque[tuple[float, float]] = deque()  # (time in frames, brightness ratio) of nearby frames
    waiting: deque[tuple[float | None, FrameTask]] = deque()  # frames to yield, each with its time in frames
    ahead = 0  # number of frames in `waiting` that were read without an error

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
