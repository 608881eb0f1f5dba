"""Frames of a sequence that are asked for in any order, as by programs that edit films: each is what it is in order.

A frame that does not follow the one before it is made as a run does that goes on there (chunks.py): those that it depends on
are read again, and a new filter takes them.
"""

from collections.abc import Callable

from l3cli.frames.frame import RawFrame
from l3cli.rendering.temporal import chunks
from l3cli.rendering.temporal.chunks import Chunks, Filter
from l3cli.system.locks import ThreadLock


class AnyOrder:
    """The filters of a sequence, from any number of threads (one at a time is at work). `read`: gives the raw frame at a
    place, from 0; `keep`: so many of the frames made last are kept, since threads that ask for one after the other come in
    any order. What `read` raises is raised."""

    def __init__(self, make: Callable[[], Filter], read: Callable[[int], RawFrame], keep: int) -> None:
        self._make, self._read, self._keep = make, read, keep
        self._alone = ThreadLock()
        self._made: dict[int, RawFrame] = {}  # by place
        self._next, self._complete = 0, 0  # places: of the frame that the filters take next; from which on they are right
        self._chunks = Chunks(make)

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """The frame at a place, with what it shares with those before it."""
        with self._alone:
            if place in self._made:
                return self._made[place]
            first = chunks.first_needed(place)
            if not first <= self._next <= place:
                self._begin(first)
            for at in range(self._next, place + 1):
                try:
                    made = self._chunks.filtered(at, frame if at == place else self._read(at))
                except BaseException:
                    self._begin(0)
                    raise
                self._next = at + 1
                if at >= self._complete:
                    self._made[at] = made
                if len(self._made) > self._keep:
                    del self._made[next(iter(self._made))]  # the oldest
            return self._made[place]

    def _begin(self, place: int) -> None:
        """Start anew with the frame at a place that begins a chunk's lead-in."""
        self._chunks, self._next = Chunks(self._make), place
        self._complete = place + chunks.LEAD if place else 0  # before it frames are of a chunk that begins earlier
        self._made = {}
