"""Work queued on an OpenCL device: queues with their buffers, events, and the bands of a frame: which rows every layer reads
for them, and which row and column each padded one is."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.coarse_chroma import BLOCK
from l3cli.classes.coarse_chroma import REACH as COARSE_REACH
from l3cli.classes.structure import REACH
from l3cli.frames.frame import mirrored_indices
from l3cli.rendering.opencl.devices import pyopencl, refusals

STAGES = ("upload", "classes", "transforms", "encode", "download")
REFINEMENT_STAGES = ("upload", "classes", "planes", "structures", "transforms", "encode", "download")
COARSE_CHROMA = "coarse chroma"  # between structures and transforms, where the last layer reads it
SPECTRA = "spectra"  # between transforms and encoding, where spectra are smoothed
BAND_PIXELS = 1 << 22  # of a band, margins aside


Source = Any  # a buffer of indices


def stages_of(table: TransformTable) -> tuple[str, ...]:
    """Return the stages by which the time of a frame is counted."""
    stages = REFINEMENT_STAGES if table.later else STAGES
    if table.later and table.later[-1].coarse_chroma:
        stages = (*stages[:-3], COARSE_CHROMA, *stages[-3:])
    return (*stages[:-2], SPECTRA, *stages[-2:]) if table.spectra else stages


def constant(context: Any, array: NDArray, dtype: Any = None) -> Any:
    """Return a buffer that holds an array."""
    flags = pyopencl().mem_flags
    array = np.ascontiguousarray(array if array.size else np.zeros(1, array.dtype), dtype)  # no buffer may be empty
    return pyopencl().Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=array)


def scratch(context: Any, buffer: Any, size: int) -> Any:
    """Return the buffer if it has room for `size` bytes, else one that has."""
    if buffer is None or buffer.size < size:
        buffer = pyopencl().Buffer(context, pyopencl().mem_flags.READ_WRITE, size)
    return buffer


class Track:
    """A queue and the buffers of one band; buffers grow to what is asked of them."""

    def __init__(self, context: Any, layers: int) -> None:
        """Begin with no buffers, for a table of so many refinement layers."""
        cl = pyopencl()
        self.queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.raw: Any = None  # buffer that is read
        self.uploaded: Any = None  # buffer for a copy of the host's array; `raw`, unless the device reads that
        self.labels: Any = None
        self.sets: Any = None  # buffer for a copy of the number of the set that renders each pixel
        self.chosen: tuple[Any, ...] = ()  # `sets`, or the host's array of them; empty where there is one set
        self.planes: list[Any] = [None] * layers  # that each refinement layer reads
        self.refined_labels: list[Any] = [None] * layers
        self.coarse: tuple[tuple[int, int], list[Any]] | None = None  # shape and buffers, of coarse chroma
        self.means: Any = None  # of blocks of the mosaic, where a table replaces plain clipped areas
        self.maps: Any = None  # of blocks, made of these
        self.quads: Any = None  # maps of quads, read of those
        self.first: Any = None  # outputs of the first layer, where the last one corrects them
        self.made: Any = None  # outputs whose spectra are still to be smoothed
        self.result: Any = None
        self._typed: set[Any] = set()  # kernels

    def run(self, kernel: Any, grid: tuple[int, ...], group: tuple[int, ...], *arguments: Any) -> Any:
        """Enqueue a kernel. Its types are stated once: pyopencl would find them out anew each time, which takes longer than
        all else before a frame's first kernel."""
        if kernel not in self._typed:
            kernel.set_scalar_arg_dtypes([type(each) if isinstance(each, np.generic) else None for each in arguments])
            self._typed.add(kernel)
        return kernel(self.queue, grid, group, *arguments)


def shares_memory(device: Any) -> bool:
    """Return whether a device computes in the host's memory, so that nothing need be copied."""
    return bool(device.type & pyopencl().device_type.CPU)


class Work:
    """Work started for one frame: its events by stage, and the arrays that the device may still use, which are held until
    it is done, also where an interrupt leaves the work."""

    def __init__(self, device: Any, stages: tuple[str, ...]) -> None:
        self._device = device
        self.events: dict[str, list[Any]] = {stage: [] for stage in stages}
        self.arrays: list[NDArray] = []
        self._queues: list[Any] = []
        self._in_place: list[Any] = []  # buffers that are arrays
        self._mapped: list[tuple[Any, Any]] = []  # queue, what is mapped
        self._owner = os.getpid()

    def __del__(self) -> None:
        if self._owner == os.getpid():  # in a forked child nothing would ever end
            for queue in self._queues:
                queue.finish()

    def in_place(self, queue: Any, array: NDArray, written: bool = False) -> Any:
        """Return a buffer that is a contiguous array, to be read or `written` by a device that shares the host's memory."""
        flags = pyopencl().mem_flags
        self.arrays.append(array)
        self._queues.append(queue)
        access = flags.WRITE_ONLY if written else flags.READ_ONLY
        self._in_place.append(pyopencl().Buffer(queue.context, flags.USE_HOST_PTR | access, hostbuf=array))
        return self._in_place[-1]

    def upload(self, queue: Any, array: NDArray, buffer: Any) -> Any:
        """Start to copy a contiguous array into a buffer; return the buffer."""
        self.arrays.append(array)
        self.add("upload", pyopencl().enqueue_copy(queue, buffer, array, is_blocking=False))
        return buffer

    def fetch(self, queue: Any, buffer: Any, arrays: Iterable[NDArray], offset: int = 0) -> None:
        """Start to bring a buffer, from byte `offset` on, into contiguous arrays one after the other, unless it is the only
        one in place: then the host is to see what is written into that."""
        cl = pyopencl()
        for array in arrays:
            if any(each is buffer for each in self._in_place):
                kind = array.shape, array.dtype
                mapped, event = cl.enqueue_map_buffer(queue, buffer, cl.map_flags.READ, 0, *kind, is_blocking=False)
                self._mapped.append((queue, mapped.base))
            else:
                event = cl.enqueue_copy(queue, array, buffer, src_offset=offset, is_blocking=False)
                offset += array.nbytes
            queue.flush()
            self.add("download", event)

    def end(self) -> "Work":
        """Return the work once it is done; other threads run on meanwhile. DeviceError if the device refuses."""
        with refusals(self._device):
            for event in self.events["download"]:
                event.wait()
            while self._mapped:
                queue, mapping = self._mapped.pop()
                mapping.release(queue).wait()  # the array is the caller's from now on
        self._queues.clear()
        return self

    def add(self, stage: str, event: Any) -> None:
        self.events[stage].append(event)

    def milliseconds(self) -> dict[str, float]:
        """Return the milliseconds that the device spent in each stage, once all is done."""
        return {
            stage: sum((event.profile.end - event.profile.start) * 1e-6 for event in events)
            for stage, events in self.events.items()
        }


@dataclass(frozen=True)
class PlaneSource:
    """For a layer that reads planes, which of their rows and columns each padded one repeats."""

    classes: tuple[Source, Source, Source]  # (padded row) of the planes and of the first layer's classes, (padded col)
    transforms: tuple[Source, Source]  # (padded row), (padded col)


@dataclass(frozen=True)
class Band:
    """Rows of a frame, and what every layer reads for them."""

    # rows of planes that each refinement layer reads, of outputs if their spectra are smoothed, and the band's own
    reads: tuple[slice, ...]
    raw_rows: slice  # that the patches of the first of them touch
    columns: int
    mosaic_source: tuple[Source, Source]  # (padded row) of the raw rows, (padded col)
    later: tuple[PlaneSource, ...]

    @property
    def rows(self) -> slice:
        return self.reads[-1]

    @property
    def made(self) -> slice:
        """Return the rows that the last layer makes."""
        return self.reads[len(self.later)]

    def shape(self, number: int) -> tuple[int, int]:
        """Return the rows and columns of `reads`."""
        return self.reads[number].stop - self.reads[number].start, self.columns


def bands(table: TransformTable, shape: tuple[int, ...], constant: Callable[[NDArray], Source]) -> Iterator[Band]:
    """Return the bands of frames of a shape (row, col); `constant` puts indices (int32) on the device."""
    (rows, columns), radius, cfa = shape, table.first.rule.radius, table.cfa
    row_source = mirrored_indices(rows, radius, cfa.shape[0])
    column_source = constant(_int32(mirrored_indices(columns, radius, cfa.shape[1])))
    coarse = bool(table.later and table.later[-1].coarse_chroma)
    height = max(1, BAND_PIXELS * (2 if coarse else 1) // columns)  # the more, the less margins add

    sides = {REACH, *(layer.radius for layer in table.later)}
    across = {margin: constant(_int32(mirrored_indices(columns, margin, 1))) for margin in sides}

    def outside(seen: slice, margin: int, there: slice) -> Source:
        """Return the rows of `there` for the rows `seen` and `margin` more."""
        return constant(_int32(mirrored_indices(rows, margin, 1)[seen.start : seen.stop + 2 * margin] - there.start))

    for first in range(0, rows, height):
        reads = [slice(first, min(first + height, rows))]
        margins = [max(REACH, layer.radius) for layer in table.later] + ([table.spectra.radius] if table.spectra else [])
        if coarse:
            margins[-1] = COARSE_REACH
        for margin in reversed(margins):
            above = reads[0].start - margin
            if margin == COARSE_REACH:
                above -= above % BLOCK  # blocks are of the frame's rows, whatever the band
            reads.insert(0, slice(max(0, above), min(rows, reads[0].stop + margin)))
        seen = row_source[reads[0].start : reads[0].stop + 2 * radius]
        raw_rows = slice(int(seen.min()), int(seen.max()) + 1)
        later = tuple(
            PlaneSource(
                (outside(made, REACH, read), outside(made, REACH, reads[0]), across[REACH]),
                (outside(made, layer.radius, read), across[layer.radius]),
            )
            for layer, read, made in zip(table.later, reads, reads[1:], strict=False)
        )
        yield Band(tuple(reads), raw_rows, columns, (constant(_int32(seen - raw_rows.start)), column_source), later)


def _int32(indices: NDArray) -> NDArray[np.int32]:
    return indices.astype(np.int32)
