"""Work on an OpenCL device: queues with their buffers, events, and the bands of a frame.

A band defines which rows every layer reads, and the source of each padded row and column.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.coarse_chroma import BLOCK
from l3cli.classes.coarse_chroma import REACH as COARSE_REACH
from l3cli.classes.structure import BORDER_PIXELS
from l3cli.frames.frame import mirrored_indices
from l3cli.rendering.opencl.devices import pyopencl, refusals

STAGES = ("upload", "classes", "transforms", "encode", "download")
REFINEMENT_STAGES = ("upload", "classes", "planes", "structures", "transforms", "encode", "download")
COARSE_CHROMA = "coarse chroma"  # stage between structures and transforms, for tables with coarse chroma
SPECTRA = "spectra"  # stage between transforms and encoding, for tables that smooth spectra
BAND_PIXELS = 1 << 22  # number of pixels of a band, without margins


Source = Any  # a buffer of indices


def stages_of(table: TransformTable) -> tuple[str, ...]:
    """Return the stages into which the time of a frame is divided."""
    stages = REFINEMENT_STAGES if table.later else STAGES
    if table.later and table.later[-1].coarse_chroma:
        stages = (*stages[:-3], COARSE_CHROMA, *stages[-3:])
    return (*stages[:-2], SPECTRA, *stages[-2:]) if table.spectra else stages


def constant(context: Any, array: NDArray, dtype: Any = None) -> Any:
    """Return a device buffer with the contents of an array."""
    flags = pyopencl().mem_flags
    array = np.ascontiguousarray(array if array.size else np.zeros(1, array.dtype), dtype)  # buffers must not be empty
    return pyopencl().Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=array)


def scratch(context: Any, buffer: Any, size: int) -> Any:
    """Return the buffer if it has at least `size` bytes, otherwise a new one."""
    if buffer is None or buffer.size < size:
        buffer = pyopencl().Buffer(context, pyopencl().mem_flags.READ_WRITE, size)
    return buffer


class Track:
    """A queue and the buffers of one band. The buffers grow when needed."""

    def __init__(self, context: Any, layers: int) -> None:
        """Create a track without buffers, for a table with the given number of refinement layers."""
        cl = pyopencl()
        self.queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.raw: Any = None  # raw values that kernels read
        self.uploaded: Any = None  # copy of the host's raw values, unless the device reads the host's memory
        self.labels: Any = None
        self.sets: Any = None  # copy of the index of the set of transforms for each pixel
        self.chosen: tuple[Any, ...] = ()  # `sets` or the host's array; empty if there is only one set
        self.planes: list[Any] = [None] * layers  # planes that each refinement layer reads
        self.refined_labels: list[Any] = [None] * layers
        self.coarse: tuple[tuple[int, int], list[Any]] | None = None  # shape and buffers of coarse chroma
        self.means: Any = None  # block means of the mosaic, if uniform clipped areas are replaced
        self.maps: Any = None  # maps of blocks, computed from the means
        self.quads: Any = None  # maps of quads, interpolated from the maps of blocks
        self.first: Any = None  # outputs of the first layer, if the last layer corrects them
        self.made: Any = None  # outputs before smoothing of spectra
        self.result: Any = None
        self._typed: set[Any] = set()  # kernels whose argument types pyopencl knows

    def run(self, kernel: Any, grid: tuple[int, ...], group: tuple[int, ...], *arguments: Any) -> Any:
        """Enqueue a kernel.

        The types of its arguments are declared once. Otherwise pyopencl would determine them in every call, which would take
        longer than all other steps before the first kernel of a frame.
        """
        if kernel not in self._typed:
            kernel.set_scalar_arg_dtypes([type(each) if isinstance(each, np.generic) else None for each in arguments])
            self._typed.add(kernel)
        return kernel(self.queue, grid, group, *arguments)


def shares_memory(device: Any) -> bool:
    """Return whether a device shares the host's memory, so that nothing needs to be copied."""
    return bool(device.type & pyopencl().device_type.CPU)


class Work:
    """The work that was started for one frame: its events by stage, and the arrays that the device still uses.

    References to the arrays are kept until the work is done, even after an interrupt.
    """

    def __init__(self, device: Any, stages: tuple[str, ...]) -> None:
        self._device = device
        self.events: dict[str, list[Any]] = {stage: [] for stage in stages}
        self.arrays: list[NDArray] = []
        self._queues: list[Any] = []
        self._in_place: list[Any] = []  # buffers in the memory of host arrays
        self._mapped: list[tuple[Any, Any]] = []  # pairs of queue and mapping
        self._owner = os.getpid()

    def __del__(self) -> None:
        if self._owner == os.getpid():  # in a forked process the queue would never finish
            for queue in self._queues:
                queue.finish()

    def in_place(self, queue: Any, array: NDArray, written: bool = False) -> Any:
        """Return a buffer in the memory of a contiguous array, for a device that shares the host's memory."""
        flags = pyopencl().mem_flags
        self.arrays.append(array)
        self._queues.append(queue)
        access = flags.WRITE_ONLY if written else flags.READ_ONLY
        self._in_place.append(pyopencl().Buffer(queue.context, flags.USE_HOST_PTR | access, hostbuf=array))
        return self._in_place[-1]

    def upload(self, queue: Any, array: NDArray, buffer: Any) -> Any:
        """Start to copy a contiguous array into a buffer, and return the buffer."""
        self.arrays.append(array)
        self.add("upload", pyopencl().enqueue_copy(queue, buffer, array, is_blocking=False))
        return buffer

    def fetch(self, queue: Any, buffer: Any, arrays: Iterable[NDArray], offset: int = 0) -> None:
        """Start to copy a buffer, from byte `offset` on, into consecutive contiguous arrays.

        Buffers in host memory are mapped instead of copied.
        """
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
        """Wait until the work is done, while other threads may run. Raises DeviceError if the device fails."""
        with refusals(self._device):
            for event in self.events["download"]:
                event.wait()
            while self._mapped:
                queue, mapping = self._mapped.pop()
                mapping.release(queue).wait()  # now the array belongs to the caller again
        self._queues.clear()
        return self

    def add(self, stage: str, event: Any) -> None:
        self.events[stage].append(event)

    def milliseconds(self) -> dict[str, float]:
        """Return the time in ms that the device spent in each stage, after the work is done."""
        return {
            stage: sum((event.profile.end - event.profile.start) * 1e-6 for event in events)
            for stage, events in self.events.items()
        }


@dataclass(frozen=True)
class PlaneSource:
    """The source of each padded row and column of planes, for a refinement layer."""

    classes: tuple[Source, Source, Source]  # (padded row) in the planes and in the first layer's classes; (padded col)
    transforms: tuple[Source, Source]  # (padded row); (padded col)


@dataclass(frozen=True)
class Band:
    """A range of rows of a frame, and the rows that every layer reads for it."""

    # Rows of the planes that each refinement layer reads, then rows of outputs if spectra are smoothed, then the band's own
    # rows.
    reads: tuple[slice, ...]
    raw_rows: slice  # raw rows that the patches of `reads[0]` cover
    columns: int
    mosaic_source: tuple[Source, Source]  # (padded row) in the raw rows; (padded col)
    later: tuple[PlaneSource, ...]

    @property
    def rows(self) -> slice:
        return self.reads[-1]

    @property
    def made(self) -> slice:
        """Rows that the last layer computes."""
        return self.reads[len(self.later)]

    def shape(self, number: int) -> tuple[int, int]:
        """Return the rows and columns of `reads[number]`."""
        return self.reads[number].stop - self.reads[number].start, self.columns


def bands(table: TransformTable, shape: tuple[int, ...], constant: Callable[[NDArray], Source]) -> Iterator[Band]:
    """Yield the bands for frames of a shape (row, col). `constant` copies indices (int32) to the device."""
    (rows, columns), radius, cfa = shape, table.first.rule.radius, table.cfa
    row_source = mirrored_indices(rows, radius, cfa.shape[0])
    column_source = constant(_int32(mirrored_indices(columns, radius, cfa.shape[1])))
    coarse = bool(table.later and table.later[-1].coarse_chroma)
    height = max(1, BAND_PIXELS * (2 if coarse else 1) // columns)  # the taller a band, the smaller the relative margins

    sides = {BORDER_PIXELS, *(layer.radius for layer in table.later)}
    across = {margin: constant(_int32(mirrored_indices(columns, margin, 1))) for margin in sides}

    def outside(seen: slice, margin: int, there: slice) -> Source:
        """Return where in the slice `there` to find the rows `seen` and `margin` further rows on both sides.

        Rows beyond the edges of the frame are mirrored.
        """
        return constant(_int32(mirrored_indices(rows, margin, 1)[seen.start : seen.stop + 2 * margin] - there.start))

    for first in range(0, rows, height):
        reads = [slice(first, min(first + height, rows))]
        margins = [max(BORDER_PIXELS, layer.radius) for layer in table.later] + (
            [table.spectra.radius] if table.spectra else []
        )
        if coarse:
            margins[-1] = COARSE_REACH
        for margin in reversed(margins):
            above = reads[0].start - margin
            if margin == COARSE_REACH:
                above -= above % BLOCK  # blocks are aligned with the frame and not with the band
            reads.insert(0, slice(max(0, above), min(rows, reads[0].stop + margin)))
        seen = row_source[reads[0].start : reads[0].stop + 2 * radius]
        raw_rows = slice(int(seen.min()), int(seen.max()) + 1)
        later = tuple(
            PlaneSource(
                (outside(made, BORDER_PIXELS, read), outside(made, BORDER_PIXELS, reads[0]), across[BORDER_PIXELS]),
                (outside(made, layer.radius, read), across[layer.radius]),
            )
            for layer, read, made in zip(table.later, reads, reads[1:], strict=False)
        )
        yield Band(tuple(reads), raw_rows, columns, (constant(_int32(seen - raw_rows.start)), column_source), later)


def _int32(indices: NDArray) -> NDArray[np.int32]:
    return indices.astype(np.int32)
