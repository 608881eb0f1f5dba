"""Times of the frames of a sequence: even, by their numbers, or those that a video of variable rate states."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

JITTER = Fraction(1, 1000)  # s, to which Matroska rounds times
FINEST = Fraction(1, 1_000_000)  # s, the finest times that every container holds


@dataclass(frozen=True)
class StatedTimes:
    """Times of all frames of a video, as its file states them."""

    tick: Fraction  # s
    ticks: NDArray[np.int64]  # of each frame, in the order in which they are shown

    @property
    def are_even(self) -> bool:
        """Return whether all frames follow one another after the same time, but for rounding."""
        steps = np.diff(self.ticks)
        return steps.size == 0 or int(steps.max() - steps.min()) * self.tick <= JITTER

    def range(self) -> str:
        """Return the shortest and the longest time between two frames, in s."""
        steps = np.diff(self.ticks) * float(self.tick)
        return f"{steps.min():.3g}–{steps.max():.3g} s"


def unit_of(numbers: Sequence[int]) -> int | None:
    """Return by how much the numbers of files grow from frame to frame: that by which most of them do, of which every gap is
    a multiple. None where there is none, so that they do not count frames."""
    steps = Counter(after - before for before, after in pairwise(numbers))
    unit = min(steps, default=1)
    usual = unit > 0 and 2 * steps[unit] >= steps.total() and all(step % unit == 0 for step in steps)
    return unit if usual else None


class Pacing:
    """Times of frames that are asked for in order, in ticks from the first. `unit`: by how much frame numbers grow, None:
    they do not count frames, which follow evenly; `stated`: times in their place, of frames of which every `step`th is
    taken, and shown as if it were every one."""

    def __init__(self, unit: int | None, stated: StatedTimes | None = None, step: int = 1) -> None:
        self._unit, self.stated = unit, stated
        self.tick = None if stated is None else max(stated.tick / step, FINEST)  # s; None: the time of a frame
        self._scale = Fraction(0) if stated is None or self.tick is None else stated.tick / step / self.tick
        self._first, self._last = 0, -1
        self.gaps = 0  # so far, in numbers
        self.first_gap: tuple[int, int] | None = None  # numbers before and after it
        self._number = 0  # of the frame before

    def time(self, number: int) -> int:
        """Return the time of the next frame, of that number."""
        time = self._time(number)
        if self._last < 0:
            self._first = time
        time = max(time - self._first, self._last + 1)
        if self.stated is None and time > self._last + 1:
            self.gaps += 1
            self.first_gap = self.first_gap or (self._number, number)
        self._last, self._number = time, number
        return time

    def _time(self, number: int) -> int:
        if self.stated is not None:
            ticks = self.stated.ticks
            return round(int(ticks[min(number, len(ticks) - 1)]) * self._scale)
        return self._last + 1 if self._unit is None else number // self._unit


Stated = Callable[[], StatedTimes | None]  # reads them, which takes a while; None: the file states none
