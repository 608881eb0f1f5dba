"""The temporal filters of a sequence. They start at fixed frames, so that the result does not depend on how it is rendered.

A sequence is divided into chunks of CHUNK frames, counted from the first frame. The filter of a chunk starts LEAD frames
before the chunk, so that little noise is left when the chunk begins. A frame therefore depends on at most LEAD + CHUNK − 1
other frames. A resumed run reads these frames again and gives the same result.
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
        """Return the next frame, blended with the previous frames."""


class Chunks:
    """The filters of a sequence: one per chunk, or two during the lead-in of the next chunk."""

    def __init__(self, make: Callable[[], Filter]) -> None:
        self._make = make
        self._filters: dict[int, Filter] = {}  # chunk → filter

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Filter the frame with index `place` in the sequence.

        Indices must increase. Frames that are not `needed` may be left out.
        """
        chunks = chunks_of(place)
        self._filters = {chunk: self._filters.get(chunk) or self._make() for chunk in chunks}
        made = [self._filters[chunk].filtered(frame) for chunk in chunks]  # the filter of the next chunk is in its lead-in
        return made[0]


def chunks_of(place: int) -> range:
    """Return the chunks whose filters read the frame with index `place`: its own and, during its lead-in, the next."""
    return range(place // CHUNK, (place + LEAD) // CHUNK + 1)


def needed(wanted: Iterable[tuple[int, bool]]) -> Iterator[bool]:
    """Yield whether the filter must read each frame, because this frame or a later frame that depends on it is wanted.

    `wanted` are the index of each frame and whether it is wanted. They are read up to LEAD + CHUNK frames ahead.
    """
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
    """The filters of a sequence whose frames are requested in any order, as by video editors.

    Each frame is the same as in a sequential run. If a frame does not follow the previous request, filtering begins at the
    start of its chunk's lead-in. Several threads may share an instance, but only one works at a time.

    Parameters
    ----------
    make : callable
        Function that creates a filter.
    read : callable
        Function that takes the index of a frame, from 0, and returns the raw frame. Its exceptions are passed on.
    most : int
        Number of recent frames that are kept, because threads request frames in any order.
    """

    def __init__(self, make: Callable[[], Filter], read: Callable[[int], RawFrame], most: int) -> None:
        self._make, self._read, self._most = make, read, most
        self._alone = ThreadLock()
        self._made: dict[int, RawFrame] = {}  # index → frame
        self._next, self._complete = 0, 0  # index of the next frame; first index for which the result is complete
        self._chunks = Chunks(make)

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Return the frame with index `place`, blended with the previous frames."""
        with self._alone:
            if place in self._made:
                return self._made[place]
            first = max(0, place // CHUNK * CHUNK - LEAD)  # earliest frame on which the result depends
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
                    del self._made[next(iter(self._made))]  # removes the oldest frame
            return self._made[place]

    def _begin(self, place: int) -> None:
        """Restart the filter at an index where the lead-in of a chunk begins."""
        self._chunks, self._next = Chunks(self._make), place
        self._complete = place + LEAD if place else 0  # frames of the lead-in belong to an earlier chunk
        self._made = {}


FILTERS = {
    "opencl": "l3cli.rendering.temporal.opencl:opencl_filters",
    "reference": "l3cli.rendering.temporal.reference:reference_filters",
}


def filters(backend: str, table: TransformTable, **options: str | None) -> Callable[[], Filter]:
    """Return a function that creates filters of a backend. The `options` are the same as for `make_renderer`.

    Raises
    ------
    RecipeError
        If the table does not contain the noise of its camera.
    DeviceError
        If no device is found.
    """
    module, _, name = FILTERS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table.cfa.shape, require_noise(table.camera), **options)
