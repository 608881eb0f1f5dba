"""Places in a sequence at which the filter starts anew, the same whoever renders it.

A sequence is cut into chunks of CHUNK frames, counted from its first one. A chunk's filter starts LEAD frames before the
chunk, so that little noise is left where it takes over. A frame depends on at most LEAD + CHUNK − 1 others; a run that goes
on where another stopped takes these again, and makes the same.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from l3cli.frames.frame import RawFrame

CHUNK, LEAD = 240, 16  # frames


class Filter(Protocol):
    """A recursive filter of one backend."""

    def filtered(self, frame: RawFrame) -> RawFrame:
        """The next frame, with what it shares with those before it."""


class Chunks:
    """The filters of a sequence, one a chunk, two where the next one leads in."""

    def __init__(self, make: Callable[[], Filter]) -> None:
        self._make = make
        self._filters: dict[int, Filter] = {}  # by chunk

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """The frame at a place of the sequence, from 0; places increase, and may leave out what nothing needs."""
        chunks = chunks_of(place)
        self._filters = {chunk: self._filters.get(chunk) or self._make() for chunk in chunks}
        made = [self._filters[chunk].filtered(frame) for chunk in chunks]  # the next one leads in
        return made[0]


def chunks_of(place: int) -> range:
    """The chunks whose filters take the frame at a place: its own and, where that leads in, the next."""
    return range(place // CHUNK, (place + LEAD) // CHUNK + 1)


def first_needed(place: int) -> int:
    """The first place that the frame at a place depends on."""
    return max(0, place // CHUNK * CHUNK - LEAD)


def needed(wanted: Iterable[tuple[int, bool]]) -> Iterator[bool]:
    """Yield whether the filter must take each frame, given as its place and whether it is wanted itself: whether it, or a
    later one that depends on it, is wanted. Looks up to LEAD + CHUNK frames ahead."""
    prefetched: list[tuple[int, bool]] = []
    frames = iter(wanted)
    while True:
        while len(prefetched) < LEAD + CHUNK and (frame := next(frames, None)) is not None:
            prefetched.append(frame)
        if not prefetched:
            return
        place = prefetched.pop(0)
        last = (chunks_of(place[0])[-1] + 1) * CHUNK
        yield place[1] or any(later for at, later in prefetched if at < last)
