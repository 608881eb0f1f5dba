"""Divides a sequence into chunks, each of which has its own temporal filter.

A chunk has `CHUNK` frames, counted from the first frame of the sequence. The filter of a chunk starts `LEAD` frames before
the chunk, so the noise is already low when the chunk begins. These frames are called the lead-in of the chunk. A filtered
frame therefore depends on at most `LEAD` + `CHUNK` − 1 other frames. If a command is resumed, or if several machines share
the frames, the necessary frames are read again and the results are the same.
"""

import importlib
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.temporal.noise import require_noise
from l3cli.system.locks import ThreadLock

CHUNK = 240  # number of frames in a chunk
LEAD = 16  # number of frames in the lead-in of a chunk


class Filter(Protocol):
    """A recursive temporal filter of one backend."""

    def filtered(self, frame: RawFrame) -> RawFrame:
        """Blend the next frame with the previous frames, and return the result."""


class Chunks:
    """Applies the filters of a sequence. During the lead-in of the next chunk, two filters run in parallel.

    Parameters
    ----------
    make : callable
        Function that creates a filter.
    """

    def __init__(self, make: Callable[[], Filter]) -> None:
        self._make = make
        self._filters: dict[int, Filter] = {}  # chunk → filter

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Return the filtered frame. `place` is the index of the frame in the sequence.

        The indices of successive calls must increase. Frames for which `needed` yields false may be omitted.
        """
        chunks = chunks_of(place)
        self._filters = {chunk: self._filters.get(chunk) or self._make() for chunk in chunks}
        made = [self._filters[chunk].filtered(frame) for chunk in chunks]  # made[1], if any, is in the next chunk's lead-in
        return made[0]


def chunks_of(place: int) -> range:
    """Return the numbers of the chunks whose filters read the frame with index `place`.

    A frame in the lead-in of the next chunk belongs to two chunks. All other frames belong to one chunk.
    """
    return range(place // CHUNK, (place + LEAD) // CHUNK + 1)


def needed(wanted: Iterable[tuple[int, bool]]) -> Iterator[bool]:
    """Yield, for each frame, whether the temporal filter must read this frame.

    A frame must be read if its result is wanted, or if the result of a later frame depends on this frame.

    Parameters
    ----------
    wanted : iterable of (int, bool)
        Index of each frame, and whether its result is wanted. Up to `LEAD` + `CHUNK` pairs are read in advance.
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
    """Applies the filters of a sequence whose frames are requested in any order, for example by a video editor.

    The filtered frames are the same as in sequential order. If a requested frame does not follow the previous frame, the
    filter restarts at the lead-in of the requested frame's chunk. Several threads may share an instance, but only one thread
    at a time can filter.

    Parameters
    ----------
    make : callable
        Function that creates a filter.
    read : callable
        Function that takes the index of a frame, counted from 0, and returns the raw frame. Any exception is allowed.
    most : int
        Number of filtered frames to keep, because several threads may request neighbouring frames out of order.
    """

    def __init__(self, make: Callable[[], Filter], read: Callable[[int], RawFrame], most: int) -> None:
        self._make, self._read, self._most = make, read, most
        self._alone = ThreadLock()
        self._made: dict[int, RawFrame] = {}  # index → filtered frame
        self._next = 0  # index of the next frame to filter
        self._complete = 0  # index of the first frame whose result is valid; earlier frames belong to a lead-in
        self._chunks = Chunks(make)

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Return the filtered frame. `place` is the index of the frame in the sequence.

        If an earlier frame of the chunk has not been filtered yet, the necessary earlier frames are read and filtered first.
        """
        with self._alone:
            if place in self._made:
                return self._made[place]
            first = max(0, place // CHUNK * CHUNK - LEAD)  # first frame on which the result depends
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
        """Restart the filter at the index `place`, which must be the first frame of a lead-in."""
        self._chunks, self._next = Chunks(self._make), place
        self._complete = place + LEAD if place else 0  # the frames of the lead-in belong to the previous chunk
        self._made = {}


FILTERS = {
    "opencl": "l3cli.rendering.temporal.opencl:opencl_filters",
    "reference": "l3cli.rendering.temporal.reference:reference_filters",
}


def filters(backend: str, table: TransformTable, **options: str | None) -> Callable[[], Filter]:
    """Return a function that creates temporal filters.

    Parameters
    ----------
    backend : str
        "opencl" or "reference".
    table : TransformTable
        Table whose camera determines the noise.
    **options
        Options of the backend, as in `make_renderer`.

    Returns
    -------
    callable
        Function without parameters that returns a new `Filter`.

    Raises
    ------
    RecipeError
        If the table does not contain the noise model of its camera.
    DeviceError
        If no device is found.
    """
    module, _, name = FILTERS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table.cfa.shape, require_noise(table.camera), **options)
