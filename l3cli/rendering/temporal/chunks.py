"""Divide a sequence into chunks that are filtered independently.

Chunks consist of `CHUNK` frames, counted from the first frame of the sequence. The filter of a chunk starts `LEAD` frames
earlier, so that the noise is already low when the chunk begins. These frames are the chunk's lead-in. A filtered frame
therefore depends on at most `LEAD` + `CHUNK` − 1 previous frames. A resumed command, or a machine that renders part of the
sequence, reads these frames again and computes the same result.
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
    """Interface of the temporal filters of all backends."""

    def filtered(self, frame: RawFrame) -> RawFrame:
        """Blend the next frame with the previous frames, and return the result."""


class Chunks:
    """Filters a sequence in order, with a new filter for each chunk.

    During the lead-in of the next chunk, two filters are active.

    Parameters
    ----------
    make : callable
        Creates a filter.
    """

    def __init__(self, make: Callable[[], Filter]) -> None:
        self._make = make
        self._filters: dict[int, Filter] = {}  # chunk → filter

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Filter the frame with index `place` in the sequence.

        Frames must be passed in order. Frames for which `needed` yields false may be omitted.
        """
        chunks = chunks_of(place)
        self._filters = {chunk: self._filters.get(chunk) or self._make() for chunk in chunks}
        made = [self._filters[chunk].filtered(frame) for chunk in chunks]  # made[1], if any: lead-in of the next chunk
        return made[0]


def chunks_of(place: int) -> range:
    """Return the numbers of the chunks for which the frame with index `place` must be read.

    A frame in the lead-in of the next chunk is needed for two chunks, and any other frame for one.
    """
    return range(place // CHUNK, (place + LEAD) // CHUNK + 1)


def needed(wanted: Iterable[tuple[int, bool]]) -> Iterator[bool]:
    """Yield True for each frame that the temporal filter must read, and False for all other frames.

    The filter must read a frame if the caller requests the result for this frame or for a later frame that depends on it.

    Parameters
    ----------
    wanted : iterable of (int, bool)
        Index of each frame, and whether the caller requests its result. Up to `LEAD` + `CHUNK` pairs are read ahead.
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
    """Filters frames in any order, for example for a video editor.

    The results are the same as in sequential order. If the requested frame precedes the last one, or is in a later chunk,
    the filter restarts at the lead-in of the requested frame's chunk. Threads may share an instance. It serves one thread at
    a time.

    Parameters
    ----------
    make : callable
        Creates a filter.
    read : callable
        Returns the raw frame with a given index, counted from 0. Its exceptions are passed on.
    most : int
        Number of filtered frames to cache, because several threads may request neighbouring frames out of order.
    """

    def __init__(self, make: Callable[[], Filter], read: Callable[[int], RawFrame], most: int) -> None:
        self._make, self._read, self._most = make, read, most
        self._alone = ThreadLock()
        self._made: dict[int, RawFrame] = {}  # index → filtered frame
        self._next = 0  # index of the next frame to filter
        self._complete = 0  # index of the first valid result; earlier frames belong to a lead-in
        self._chunks = Chunks(make)

    def filtered(self, place: int, frame: RawFrame) -> RawFrame:
        """Filter the frame with index `place` in the sequence, after all earlier frames on which the result depends."""
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
                    del self._made[next(iter(self._made))]  # the oldest
            return self._made[place]

    def _begin(self, place: int) -> None:
        """Restart the filter at `place`, the index of the first frame of a lead-in."""
        self._chunks, self._next = Chunks(self._make), place
        self._complete = place + LEAD if place else 0  # the frames of the lead-in belong to the previous chunk
        self._made = {}


FILTERS = {
    "opencl": "l3cli.rendering.temporal.opencl:opencl_filters",
    "reference": "l3cli.rendering.temporal.reference:reference_filters",
}


def filters(backend: str, table: TransformTable, **options: str | None) -> Callable[[], Filter]:
    """Return a function that creates temporal filters for a table's camera.

    Parameters
    ----------
    backend : str
        "opencl" or "reference".
    table : TransformTable
        Table that contains its camera.
    **options
        Options of the backend, as in `make_renderer`.

    Returns
    -------
    callable
        Takes no argument and returns a new `Filter`.

    Raises
    ------
    RecipeError
        If the table does not contain its camera, or if the camera has too much row or column noise.
    DeviceError
        If no device is found.
    """
    module, _, name = FILTERS[backend].partition(":")
    return getattr(importlib.import_module(module), name)(table.cfa.shape, require_noise(table.camera), **options)
