"""Queues and buffers on an OpenCL device, the commands for a frame, and the division of a frame into bands.

A band is a range of rows that is rendered as a whole. `Band` contains the rows that every layer reads for a band, and the
source of each padded row and column.
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
from l3cli.rendering.reference import CHROMA_REACH

STAGES = ("upload", "classes", "transforms", "encode", "download")
REFINEMENT_STAGES = ("upload", "classes", "planes", "structures", "transforms", "encode", "download")
COARSE_CHROMA = "coarse chroma"  # stage between structures and transforms, for tables with coarse chroma
CHROMA = "chroma"  # stage after the transforms, for tables that smooth chroma; it also encodes
SPECTRA = "spectra"  # stage between transforms and encoding, for tables that smooth spectra
BAND_PIXELS = 1 << 22  # approximate number of pixels of a band, without margins


Source = Any  # a device buffer with the source index of each padded row or column


def stages_of(table: TransformTable) -> tuple[str, ...]:
    """Return the names of the stages for which rendering times are measured."""
    stages = REFINEMENT_STAGES if table.later else STAGES
    if table.later and table.later[-1].coarse_chroma:
        stages = (*stages[:-3], COARSE_CHROMA, *stages[-3:])
    smoothing = [SPECTRA] if table.spectra else [CHROMA] if table.chroma_smoothing else []
    return (*stages[:-2], *smoothing, *stages[-2:])


def constant(context: Any, array: NDArray, dtype: Any = None) -> Any:
    """Copy an array to a new read-only device buffer."""
    flags = pyopencl().mem_flags
    array = np.ascontiguousarray(array if array.size else np.zeros(1, array.dtype), dtype)  # OpenCL has no empty buffers
    return pyopencl().Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=array)


def scratch(context: Any, buffer: Any, size: int) -> Any:
    """Return `buffer` if it has at least `size` bytes, otherwise a new buffer of this size."""
    if buffer is None or buffer.size < size:
        buffer = pyopencl().Buffer(context, pyopencl().mem_flags.READ_WRITE, size)
    return buffer


class Track:
    """A queue and the device buffers for one band. Buffers are replaced by larger buffers when necessary."""

    def __init__(self, context: Any, layers: int) -> None:
        """Create a track without buffers, for a table with the given number of refinement layers."""
        cl = pyopencl()
        self.queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.raw: Any = None  # raw values that the kernels read: `uploaded`, or the memory of the host
        self.uploaded: Any = None  # copy of the raw values, if the device has its own memory
        self.labels: Any = None  # classes in the first layer
        self.sets: Any = None  # copy of the number of the set of transforms for each pixel
        self.chosen: tuple[Any, ...] = ()  # `sets` or the memory of the host; empty if the table has one set of transforms
        self.planes: list[Any] = [None] * layers  # planes that each refinement layer reads
        self.refined_labels: list[Any] = [None] * layers  # classes in each refinement layer
        self.coarse: tuple[tuple[int, int], list[Any]] | None = None  # shape and buffers of coarse chroma
        self.means: Any = None  # block means of the mosaic, if uniform clipped areas are replaced
        self.maps: Any = None  # values for the replacement of clipped areas, per block
        self.quads: Any = None  # the same values, interpolated to quads of pixels
        self.first: Any = None  # outputs of the first layer, if the last layer corrects them
        self.made: Any = None  # outputs before the smoothing of spectra
        self.result: Any = None  # outputs, or codes of the picture
        self._typed: set[Any] = set()  # kernels whose argument types have been declared

    def run(self, kernel: Any, grid: tuple[int, ...], group: tuple[int, ...], *arguments: Any) -> Any:
        """Enqueue a kernel.

        The argument types of a kernel are declared at its first call. Otherwise pyopencl would determine the types in every
        call, which would take longer than all other steps before the first kernel of a frame.
        """
        if kernel not in self._typed:
            kernel.set_scalar_arg_dtypes([type(each) if isinstance(each, np.generic) else None for each in arguments])
            self._typed.add(kernel)
        return kernel(self.queue, grid, group, *arguments)


def shares_memory(device: Any) -> bool:
    """Return whether a device shares the memory of the host, so that nothing needs to be copied."""
    return bool(device.type & pyopencl().device_type.CPU)


class Work:
    """The commands that were enqueued for one frame: their events by stage, and the arrays that the device uses.

    The arrays are kept until all commands have finished, even if the program is interrupted.
    """

    def __init__(self, device: Any, stages: tuple[str, ...]) -> None:
        self._device = device
        self.events: dict[str, list[Any]] = {stage: [] for stage in stages}
        self.arrays: list[NDArray] = []
        self._queues: list[Any] = []
        self._in_place: list[Any] = []  # buffers that use the memory of host arrays
        self._mapped: list[tuple[Any, Any]] = []  # queue and mapping of each mapped buffer
        self._owner = os.getpid()

    def __del__(self) -> None:
        if self._owner == os.getpid():  # in a forked process, `finish` would wait forever
            for queue in self._queues:
                queue.finish()

    def in_place(self, queue: Any, array: NDArray, written: bool = False) -> Any:
        """Return a buffer that uses the memory of a contiguous array. The device must share the memory of the host."""
        flags = pyopencl().mem_flags
        self.arrays.append(array)
        self._queues.append(queue)
        access = flags.WRITE_ONLY if written else flags.READ_ONLY
        self._in_place.append(pyopencl().Buffer(queue.context, flags.USE_HOST_PTR | access, hostbuf=array))
        return self._in_place[-1]

    def upload(self, queue: Any, array: NDArray, buffer: Any) -> Any:
        """Enqueue a copy of a contiguous array to a buffer, and return the buffer."""
        self.arrays.append(array)
        self.add("upload", pyopencl().enqueue_copy(queue, buffer, array, is_blocking=False))
        return buffer

    def fetch(self, queue: Any, buffer: Any, arrays: Iterable[NDArray], offset: int = 0) -> None:
        """Enqueue a copy of a buffer to contiguous arrays, one after another, beginning with byte `offset` of the buffer.

        Buffers that use the memory of the host are mapped instead of copied.
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
        """Wait until all commands have finished. Other threads can run meanwhile.

        Raises a DeviceError if the device fails.
        """
        with refusals(self._device):
            for event in self.events["download"]:
                event.wait()
            while self._mapped:
                queue, mapping = self._mapped.pop()
                mapping.release(queue).wait()  # from now on, the caller may change the array
        self._queues.clear()
        return self

    def add(self, stage: str, event: Any) -> None:
        self.events[stage].append(event)

    def milliseconds(self) -> dict[str, float]:
        """Return the time that the device spent in each stage, in ms. All commands must have finished."""
        return {
            stage: sum((event.profile.end - event.profile.start) * 1e-6 for event in events)
            for stage, events in self.events.items()
        }


@dataclass(frozen=True)
class PlaneSource:
    """Sources of the padded rows and columns of the planes that a refinement layer reads."""

    classes: tuple[Source, Source, Source]  # for the classes: rows of the planes, rows of the first layer's classes, columns
    transforms: tuple[Source, Source]  # for the transforms: rows and columns of the planes


@dataclass(frozen=True)
class Band:
    """A range of rows of a frame that is rendered as a whole, and the rows that every layer reads for the band."""

    # Rows of the planes that each refinement layer reads, then the rows of outputs before the smoothing of spectra (if the
    # table smooths spectra), then the rows of the band itself.
    reads: tuple[slice, ...]
    raw_rows: slice  # raw rows that the windows of the first layer need
    columns: int  # number of columns of the frame
    mosaic_source: tuple[Source, Source]  # sources of the padded rows, as indices in `raw_rows`, and of the padded columns
    later: tuple[PlaneSource, ...]  # one per refinement layer

    @property
    def rows(self) -> slice:
        """Rows of the band itself."""
        return self.reads[-1]

    @property
    def made(self) -> slice:
        """Rows of the outputs of the last layer."""
        return self.reads[len(self.later)]

    def shape(self, number: int) -> tuple[int, int]:
        """Return the number of rows in `reads[number]`, and the number of columns."""
        return self.reads[number].stop - self.reads[number].start, self.columns


def bands(table: TransformTable, shape: tuple[int, ...], constant: Callable[[NDArray], Source]) -> Iterator[Band]:
    """Yield the bands of frames with a shape (rows, columns). `constant` is a function that copies indices to the device."""
    (rows, columns), radius, cfa = shape, table.first.rule.radius, table.cfa
    row_source = mirrored_indices(rows, radius, cfa.shape[0])
    column_source = constant(_int32(mirrored_indices(columns, radius, cfa.shape[1])))
    coarse = bool(table.later and table.later[-1].coarse_chroma)
    height = max(1, BAND_PIXELS * (2 if coarse else 1) // columns)  # margins of coarse chroma are wide, so bands are taller

    sides = {BORDER_PIXELS, *(layer.radius for layer in table.later)}
    across = {margin: constant(_int32(mirrored_indices(columns, margin, 1))) for margin in sides}

    def outside(seen: slice, margin: int, there: slice) -> Source:
        """Return the positions, in the slice `there`, of the rows `seen` with a margin of `margin` rows on both sides.

        Rows outside the frame are mirrored.
        """
        return constant(_int32(mirrored_indices(rows, margin, 1)[seen.start : seen.stop + 2 * margin] - there.start))

    for first in range(0, rows, height):
        reads = [slice(first, min(first + height, rows))]
        margins = [max(BORDER_PIXELS, layer.radius) for layer in table.later] + (
            [table.spectra.radius] if table.spectra else [CHROMA_REACH] if table.chroma_smoothing else []
        )
        if coarse:
            margins[len(table.later) - 1] = COARSE_REACH
        for margin in reversed(margins):
            above = reads[0].start - margin
            if margin == COARSE_REACH:
                above -= above % BLOCK  # blocks must have the same positions in the frame for every band
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
