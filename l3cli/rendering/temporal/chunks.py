"""The filters of a sequence, and the places at which they start anew, the same whoever renders it.

A sequence is cut into chunks of CHUNK frames, counted from its first one. A chunk's filter starts LEAD frames before the
chunk, so that little noise is left where it takes over. A frame depends on at most LEAD + CHUNK − 1 others; a run that goes
on where another stopped takes these again, and makes the same.
"""

import importlib
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.temporal.noise import require_noise
from l3cli.system.locks import ThreadLock

CHUNK, LEAD = 240, 16  # frames


class Filter(Protocol):
    """A recursive filter of one backend."""

    def filtered(self, frame: RawFrame) -> RawFrame:
        """Return the next frame, with what it shares with those before it."""


class Chunks:
    """The filters of a sequence, one a chunk, two where the next one leads in."""

    def __init__(self, make: Callable[[], Filter]) -> None:
        self._make = make
        self._filters: dict[int, Filter] = {}  # by chunk

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Return the frame at a place of the sequence, from 0; places increase, and may leave out what nothing needs."""
        chunks = chunks_of(place)
        self._filters = {chunk: self._filters.get(chunk) or self._make() for chunk in chunks}
        made = [self._filters[chunk].filtered(frame) for chunk in chunks]  # the next one leads in
        return made[0]


def chunks_of(place: int) -> range:
    """Return the chunks whose filters take the frame at a place: its own and, where that leads in, the next."""
    return range(place // CHUNK, (place + LEAD) // CHUNK + 1)


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


class AnyOrder:
    """The filters of a sequence whose frames are asked for in any order, as by programs that edit films.

    Each frame is what it is in order: one that does not follow the one before it is made as by a run that goes on there.
    Threads may share it; one at a time is at work. `read` gives the raw frame at a place, from 0, and what it raises is
    raised; `most`: number of the last frames that are held, since threads come in any order.
    """

    def __init__(self, make: Callable[[], Filter], read: Callable[[int], RawFrame], most: int) -> None:
        self._make, self._read, self._most = make, read, most
        self._alone = ThreadLock()
        self._made: dict[int, RawFrame] = {}  # by place
        self._next, self._complete = 0, 0  # places: of the frame that the filters take next; from which on they are right
        self._chunks = Chunks(make)

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Return the frame at a place, with what it shares with those before it."""
        with self._alone:
            if place in self._made:
                return self._made[place]
            first = max(0, place // CHUNK * CHUNK - LEAD)  # that it depends on
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
                if len(self._made) > self._most:
                    del self._made[next(iter(self._made))]  # the oldest
            return self._made[place]

    def _begin(self, place: int) -> None:
        """Start anew with the frame at a place that begins a chunk's lead-in."""
        self._chunks, self._next = Chunks(self._make), place
        self._complete = place + LEAD if place else 0  # before it frames are of a chunk that begins earlier
        self._made = {}


FILTERS = {
    "opencl": "l3cli.rendering.temporal.opencl:opencl_filters",
    "reference": "l3cli.rendering.temporal.reference:reference_filters",
}


def filters(backend: str, table: TransformTable, **options: str | None) -> Callable[[], Filter]:
    """Return a function that makes filters of a backend for a table's frames; `options` as for renderer.make_renderer.

    RecipeError if the table does not know its camera's noise, DeviceError if there is no device."""
    module, _, name = FILTERS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table.cfa.shape, require_noise(table.camera), **options)
