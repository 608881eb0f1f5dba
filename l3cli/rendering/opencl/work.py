"""Manage the command queues and buffers of an OpenCL device, and divide a frame into bands.

A band is a range of rows that is rendered as a whole. `Band` contains the rows that each layer needs for it, and index
buffers for padding. These map rows and columns outside the frame to mirrored rows and columns inside.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.classes.clipping import reach as clipping_reach
from l3cli.classes.coarse_chroma import BLOCK
from l3cli.classes.coarse_chroma import REACH as COARSE_REACH
from l3cli.classes.structure import BORDER_PIXELS
from l3cli.frames.frame import mirrored_indices
from l3cli.physics.mosaic import channel_reach
from l3cli.rendering.opencl.devices import pyopencl, refusals
from l3cli.rendering.reference import CHROMA_REACH

STAGES = ("upload", "classes", "transforms", "encode", "download")
REFINEMENT_STAGES = ("upload", "classes", "planes", "structures", "transforms", "encode", "download")
COARSE_CHROMA = "coarse chroma"  # additional stage before the transforms
CHROMA = "chroma"  # additional stage after the transforms: chroma smoothing, which also encodes the picture
SPECTRA = "spectra"  # additional stage after the transforms: smoothing of spectra
BAND_PIXELS = 1 << 22  # approximate number of pixels in a band, without margins


Source = Any  # device buffer with the source index, inside the frame, of each row or column in a padded range


def stages_of(table: TransformTable) -> tuple[str, ...]:
    """Return the names of a table's rendering stages, in the order of execution."""
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
    """Return `buffer` if it has at least `size` bytes, otherwise a new buffer of `size` bytes."""
    if buffer is None or buffer.size < size:
        buffer = pyopencl().Buffer(context, pyopencl().mem_flags.READ_WRITE, size)
    return buffer


class Track:
    """A command queue with the device buffers for one band of rows at a time. Buffers grow as required."""

    def __init__(self, context: Any, layers: int) -> None:
        cl = pyopencl()
        self.queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.raw: Any = None  # raw values for the kernels: `uploaded`, or a buffer in host memory
        self.uploaded: Any = None  # copy of the raw values, unless kernels read them from host memory
        self.labels: Any = None  # class map of the first layer
        self.sets: Any = None  # transform set index of each pixel, if the device has its own memory
        self.chosen: tuple[Any, ...] = ()  # `sets`, or a buffer in host memory; empty for a single set of transforms
        self.planes: list[Any] = [None] * layers  # input planes of each refinement layer
        self.refined_labels: list[Any] = [None] * layers  # class map of each refinement layer
        self.coarse: tuple[tuple[int, int], list[Any]] | None = None  # shape and buffers of coarse chroma
        self.means: Any = None  # block means of the mosaic, for the correction of clipped areas
        self.maps: Any = None  # maps of each block (see `classes.clipping`)
        self.uniformity: Any = None  # uniformity of each block
        self.flags: Any = None  # for each group of blocks: whether any block has maps, and whether any signal is estimated
        self.estimates: list[Any] = [None, None]  # estimated signals of clipped blocks, before and after an iteration
        self.quads: Any = None  # `maps`, interpolated to quads of pixels
        self.first: Any = None  # outputs of the first layer, if the last layer corrects them
        self.made: Any = None  # outputs before smoothing
        self.result: Any = None  # outputs or encoded pixels
        self._typed: set[Any] = set()  # kernels with declared argument types

    def run(self, kernel: Any, grid: tuple[int, ...], group: tuple[int, ...], *arguments: Any) -> Any:
        """Enqueue a kernel.

        Its argument types are declared before the first call. Otherwise, pyopencl would determine them at every call. This
        would take longer than everything else before the first kernel of a frame.
        """
        if kernel not in self._typed:
            kernel.set_scalar_arg_dtypes([type(each) if isinstance(each, np.generic) else None for each in arguments])
            self._typed.add(kernel)
        return kernel(self.queue, grid, group, *arguments)


def shares_memory(device: Any) -> bool:
    """Whether a device uses host memory, so that no data need to be copied."""
    return bool(device.type & pyopencl().device_type.CPU)


class Work:
    """The commands enqueued for one frame: their events by stage, and the host arrays that the device accesses.

    `Work` keeps these arrays alive until all commands have finished, even if the program is interrupted.
    """

    def __init__(self, device: Any, stages: tuple[str, ...]) -> None:
        self._device = device
        self.events: dict[str, list[Any]] = {stage: [] for stage in stages}
        self.arrays: list[NDArray] = []
        self._queues: list[Any] = []
        self._in_place: list[Any] = []  # buffers that share the memory of arrays
        self._mapped: list[tuple[Any, Any]] = []  # queue and mapping of each mapped buffer
        self._owner = os.getpid()

    def __del__(self) -> None:
        if self._owner == os.getpid():  # in a forked process, `finish` would never return
            for queue in self._queues:
                queue.finish()

    def in_place(self, queue: Any, array: NDArray, written: bool = False) -> Any:
        """Return a buffer that shares the memory of a contiguous array, for a device that uses host memory."""
        flags = pyopencl().mem_flags
        self.arrays.append(array)
        self._queues.append(queue)
        access = flags.WRITE_ONLY if written else flags.READ_ONLY
        self._in_place.append(pyopencl().Buffer(queue.context, flags.USE_HOST_PTR | access, hostbuf=array))
        return self._in_place[-1]

    def upload(self, queue: Any, array: NDArray, buffer: Any) -> Any:
        """Enqueue the upload of a contiguous array to a buffer, and return the buffer."""
        self.arrays.append(array)
        self.add("upload", pyopencl().enqueue_copy(queue, buffer, array, is_blocking=False))
        return buffer

    def fetch(self, queue: Any, buffer: Any, arrays: Iterable[NDArray], offset: int = 0) -> None:
        """Enqueue the download of a buffer into one or several contiguous arrays.

        The arrays are filled one after another, from byte `offset` of the buffer. A buffer from `in_place` is mapped instead
        of copied.
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
        """Wait until all commands have finished, while other threads can run.

        Raises
        ------
        DeviceError
            If the device fails.
        """
        with refusals(self._device):
            for event in self.events["download"]:
                event.wait()
            while self._mapped:
                queue, mapping = self._mapped.pop()
                mapping.release(queue).wait()  # the caller may now change the array
        self._queues.clear()
        return self

    def add(self, stage: str, event: Any) -> None:
        self.events[stage].append(event)

    def milliseconds(self) -> dict[str, float]:
        """Return the device time of each stage in ms, after `end`."""
        return {
            stage: sum((event.profile.end - event.profile.start) * 1e-6 for event in events)
            for stage, events in self.events.items()
        }


@dataclass(frozen=True)
class PlaneSource:
    """Index buffers that pad the input of a refinement layer with mirrored rows and columns."""

    classes: tuple[Source, Source, Source]  # for classification: plane rows, rows of the first class map, columns
    transforms: tuple[Source, Source]  # for the transforms: plane rows, plane columns


@dataclass(frozen=True)
class Band:
    """A range of rows that is rendered as a whole, and the rows that each step reads for it."""

    # The rows of each refinement layer's input planes, then (if the table smooths chroma or spectra) the rows of the outputs
    # to smooth, then the rows of the band itself.
    reads: tuple[slice, ...]
    raw_rows: slice  # raw rows that any of the steps needs
    columns: int  # number of columns in the frame
    mosaic_source: tuple[Source, Source]  # index buffers for rows, counted from the start of `raw_rows`, and for columns
    later: tuple[PlaneSource, ...]  # one per refinement layer

    @property
    def rows(self) -> slice:
        """Rows of the band in the picture."""
        return self.reads[-1]

    @property
    def made(self) -> slice:
        """Rows for which the last layer computes outputs."""
        return self.reads[len(self.later)]

    def shape(self, number: int) -> tuple[int, int]:
        """Return the numbers of rows and columns in `reads[number]`."""
        return self.reads[number].stop - self.reads[number].start, self.columns


def bands(table: TransformTable, shape: tuple[int, ...], constant: Callable[[NDArray], Source]) -> Iterator[Band]:
    """Yield the bands of a frame (rows, columns) from top to bottom.

    The margins of all later steps determine the rows that a step reads. `constant` copies an index array to the device.
    """
    (rows, columns), radius, cfa = shape, table.first.rule.radius, table.cfa
    row_source = mirrored_indices(rows, radius, cfa.shape[0])
    column_source = constant(_int32(mirrored_indices(columns, radius, cfa.shape[1])))
    coarse = bool(table.later and table.later[-1].coarse_chroma)
    height = max(1, BAND_PIXELS * (2 if coarse else 1) // columns)  # coarse chroma needs wide margins

    sides = {BORDER_PIXELS, *(layer.radius for layer in table.later)}
    across = {margin: constant(_int32(mirrored_indices(columns, margin, 1))) for margin in sides}

    def outside(seen: slice, margin: int, there: slice) -> Source:
        """Return an index buffer for the rows `seen` with `margin` rows above and below, mirrored at the frame's edges.

        Indices are counted from the first row of `there`.
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
                above -= above % BLOCK  # aligns the band with the blocks of the whole frame
            reads.insert(0, slice(max(0, above), min(rows, reads[0].stop + margin)))
        seen = row_source[reads[0].start : reads[0].stop + 2 * radius]
        raw_rows = slice(int(seen.min()), int(seen.max()) + 1)
        needed = [(reads[len(table.later) - 1], clipping_reach(cfa))] if table.later and table.later[-1].clipping else []
        needed += [(reads[-1], channel_reach(cfa))] if table.chroma_smoothing else []
        for read, margin in needed:
            start, stop = max(0, read.start - margin), min(rows, read.stop + margin)
            raw_rows = slice(min(raw_rows.start, start), max(raw_rows.stop, stop))
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
