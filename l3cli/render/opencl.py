"""Rendering on an OpenCL device: upload, two kernels (opencl/*.cl), download (DESIGN 4).

A frame is taken in horizontal bands, so that the device's memory is bounded whatever the frame's size; a usual frame is one
band. Two tracks, each a queue with buffers of its own, take the bands in turn, of this frame and the next: while one
computes, the other may upload and download.
"""

import contextlib
import os
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, RecipeError
from l3cli.frame import RawFrame, mirrored_indices
from l3cli.render import layout
from l3cli.render.display import Display, require_xyz
from l3cli.render.opencl_devices import choose_device, pyopencl

BAND_PIXELS = 1 << 22  # of a band, margins aside
TRACKS = 2
STAGES = ("upload", "classes", "transforms", "download")
BUILD_OPTIONS = ("-w", "-cl-mad-enable", "-cl-std=CL1.2")


class OpenCLRenderer:
    """Renderer on the OpenCL device that `device`, or else the environment variable L3_DEVICE, names by a part of its name
    or its number; without either on the first GPU or the first of any kind.

    `variant` is a key of layout.VARIANTS, by default the one made for the device's type; `lanes` the length of the processor
    variant's vectors, by default what the device's compiler has registers for. Device, program, kernels and the table's
    buffers are made once, a band's buffers once for each frame size. One thread may use a renderer at a time; others run on
    while it waits. DeviceError if there is no device or it refuses.
    """

    def __init__(
        self, table: TransformTable, device: str | None = None, variant: str | None = None, lanes: int | None = None
    ) -> None:
        self.table = table
        self.device = choose_device(os.environ.get("L3_DEVICE", "") if device is None else device)
        cl = pyopencl()
        self.variant = variant or ("graphics" if self.device.type & cl.device_type.GPU else "processor")
        if self.variant not in layout.VARIANTS:
            raise RecipeError(f'variant "{self.variant}" is unknown; use one of {", ".join(layout.VARIANTS)}')
        with self._refusals():
            self._context = cl.Context([self.device])
            self._cut = layout.VARIANTS[self.variant].cut(table, lanes or self._register_lanes())
            self._transforms: dict[tuple[int | str, ...], Any] = {}
            self._classes = cl.Kernel(self._build(layout.display_macros(None)), "classes")
            self._class_buffers = [self._constant(array) for array in layout.class_arrays(table)]
            self._weights = self._constant(layout.VARIANTS[self.variant].pack(table, self._cut.lanes))
            self._tracks = deque(_Track(self._context) for _ in range(TRACKS))
            self._layout: _Layout | None = None

    def labels(self, frame: RawFrame) -> NDArray[np.uint32]:
        """Class (row, col) of every pixel."""
        labels = np.empty(frame.values.shape, np.uint32)
        with self._refusals():
            work = _Work()
            for track, band in self._classified(frame, work):
                track.download(work, track.labels, labels[band.rows])
        return self._finished(labels, work)

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Outputs of the table, (output, row, col)."""
        planes = np.empty((len(self.table.outputs), *frame.values.shape), np.float32)
        with self._refusals():
            kernel, matrix, work = self._transform_kernel(None), self._constant(np.zeros(9, np.float32)), _Work()
            for track, band in self._classified(frame, work):
                self._transform(kernel, matrix, track, band, work, planes[:, band.rows].nbytes)
                for output, plane in enumerate(planes):
                    track.download(work, track.result, plane[band.rows], output * plane[band.rows].nbytes)
        return self._finished(planes, work)

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """The frame as the display shows it (row, col, 3), encoded on the device; RecipeError unless the table's outputs are
        X, Y, Z."""
        return self._finished(*self._start_picture(frame, display))

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """The picture of each frame, in order. While the caller looks at one the next is at work."""
        started: deque[tuple[NDArray, _Work]] = deque()
        for frame, display in frames:
            started.append(self._start_picture(frame, display))
            if len(started) == TRACKS:
                yield self._finished(*started.popleft())
        while started:
            yield self._finished(*started.popleft())

    def stage_times(self, frame: RawFrame, display: Display) -> dict[str, float]:
        """Milliseconds that the device spent in each of STAGES for one picture; call it twice, the first run warms up."""
        picture, work = self._start_picture(frame, display)
        self._finished(picture, work)
        return {
            stage: sum((event.profile.end - event.profile.start) * 1e-6 for event in work.events[stage]) for stage in STAGES
        }

    def _start_picture(self, frame: RawFrame, display: Display) -> tuple[NDArray, "_Work"]:
        require_xyz(self.table.outputs)
        picture = np.empty((*frame.values.shape, 3), display.dtype)
        with self._refusals():
            kernel, matrix = self._transform_kernel(display), self._constant(display.matrix.astype(np.float32))
            work = _Work()
            for track, band in self._classified(frame, work):
                self._transform(kernel, matrix, track, band, work, picture[band.rows].nbytes)
                track.download(work, track.result, picture[band.rows])
        return picture, work

    def _finished(self, result: NDArray, work: "_Work") -> NDArray:
        """`result` once its downloads are done. Other threads run on meanwhile."""
        with self._refusals():
            for event in work.events["download"]:
                event.wait()
        return result

    def _classified(self, frame: RawFrame, work: "_Work") -> Iterator[tuple["_Track", "_Band"]]:
        """Each band of a frame, with the track that its upload and classes are under way on."""
        table, cl = self.table, pyopencl()
        if (frame.black, frame.white) != (table.black, table.white):  # the kernels clip the others
            frame = frame.at_levels(table.black, table.white, table.bits)
        values = np.ascontiguousarray(frame.values)
        if self._layout is None or self._layout.shape != values.shape:
            self._layout = self._lay_out(values.shape)
        for band in self._layout.bands:
            track = self._tracks[0]
            self._tracks.rotate()
            pixels = (band.rows.stop - band.rows.start) * values.shape[1]
            source = values[band.raw_rows]
            track.raw = self._scratch(track.raw, source.nbytes)
            track.labels = self._scratch(track.labels, 4 * pixels)
            work.add("upload", cl.enqueue_copy(track.queue, track.raw, source, is_blocking=False))
            buffers = (track.raw, band.row_source, self._layout.column_source, *self._class_buffers, track.labels)
            phase = ((frame.phase[0] + band.rows.start) % table.cfa.shape[0], frame.phase[1])
            work.add("classes", self._run(self._classes, track, band, *buffers, *map(np.int32, phase)))
            yield track, band
        work.sources.append(values)

    def _transform(self, kernel: Any, matrix: Any, track: "_Track", band: "_Band", work: "_Work", size: int) -> None:
        """Transforms and encoding of a classified band, `size` bytes, into the track's result."""
        assert self._layout is not None
        track.result = self._scratch(track.result, size)
        sources = (track.raw, band.row_source, self._layout.column_source, track.labels)
        arguments = (*sources, self._weights, matrix, track.result, np.float32(self.table.black))
        work.add("transforms", self._run(kernel, track, band, *arguments))

    def _run(self, kernel: Any, track: "_Track", band: "_Band", *arguments: Any) -> Any:
        """Enqueue a kernel over a band; rows and columns are the last arguments of each."""
        assert self._layout is not None
        rows, columns = band.rows.stop - band.rows.start, self._layout.shape[1]
        grid = (-(-columns // self._cut.tile) * self._cut.group[0], -(-rows // self._cut.band) * self._cut.group[1])
        return kernel(track.queue, grid, self._cut.group, *arguments, np.int32(rows), np.int32(columns))

    def _transform_kernel(self, display: Display | None) -> Any:
        """The kernel `transform` that ends in this display's encoding, or in the outputs as they are; built when first
        asked for."""
        macros = layout.display_macros(display)
        key = tuple(macros.values())
        if key not in self._transforms:
            self._transforms[key] = pyopencl().Kernel(self._build(macros), "transform")
        return self._transforms[key]

    def _build(self, macros: dict[str, int | str]) -> Any:
        shapes = {**layout.table_macros(self.table), **self._cut.macros, **macros}
        options = [*BUILD_OPTIONS, *(f"-D{name}={value}" for name, value in shapes.items())]
        return self._compile(layout.program_source(self.variant), options)

    def _compile(self, source: str, options: list[str]) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pyopencl warns of every word a compiler says
            return pyopencl().Program(self._context, source).build(options)

    def _register_lanes(self) -> int:
        """Floats in a vector register, as far as the device's compiler knows its processor: PoCL 3.0 takes processors
        younger than itself for older ones, and 16 lanes in registers of 8 are slower than 8 lanes."""
        probe = "__kernel void\n#ifdef __AVX512F__\nwide\n#else\nnarrow\n#endif\n() {}"
        return 16 if self._compile(probe, list(BUILD_OPTIONS)).kernel_names == "wide" else 8

    def _lay_out(self, shape: tuple[int, int]) -> "_Layout":
        """How frames of a shape (rows, columns) are cut into bands."""
        radius, cfa, (rows, columns) = self.table.rule.radius, self.table.cfa, shape
        height = max(1, BAND_PIXELS // columns)
        source = mirrored_indices(rows, radius, cfa.shape[0])
        bands = []
        for first in range(0, rows, height):
            last = min(first + height, rows)
            seen = source[first : last + 2 * radius]
            raw_rows = slice(int(seen.min()), int(seen.max()) + 1)
            bands.append(_Band(slice(first, last), raw_rows, self._constant(seen - raw_rows.start)))
        return _Layout(shape, self._constant(mirrored_indices(columns, radius, cfa.shape[1])), tuple(bands))

    def _constant(self, array: NDArray) -> Any:
        cl = pyopencl()
        array = np.ascontiguousarray(array if array.size else np.zeros(1, array.dtype))  # no buffer may be empty
        return cl.Buffer(self._context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

    def _scratch(self, buffer: Any, size: int) -> Any:
        """The buffer if it has room for `size` bytes, else one that has."""
        if buffer is None or buffer.size < size:
            buffer = pyopencl().Buffer(self._context, pyopencl().mem_flags.READ_WRITE, size)
        return buffer

    @contextlib.contextmanager
    def _refusals(self) -> Iterator[None]:
        """What OpenCL refuses, as a DeviceError of one line."""
        cl = pyopencl()
        try:
            yield
        except cl.MemoryError as error:
            raise DeviceError(f"{self.device.name.strip()} has too little memory for this table and frame") from error
        except cl.Error as error:
            reason = " ".join(str(error).split())[:300]
            raise DeviceError(f"{self.device.name.strip()} failed: {reason}; choose another with --device") from error


class _Track:
    """A queue and the buffers of one band; buffers grow to what is asked of them."""

    def __init__(self, context: Any) -> None:
        cl = pyopencl()
        self.queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.raw: Any = None
        self.labels: Any = None
        self.result: Any = None

    def download(self, work: "_Work", buffer: Any, target: NDArray, offset: int = 0) -> None:
        """Copy `buffer` from byte `offset` on to the contiguous array `target`, without waiting."""
        copy = pyopencl().enqueue_copy(self.queue, target, buffer, src_offset=offset, is_blocking=False)
        work.add("download", copy)
        self.queue.flush()


class _Work:
    """What has been started for one frame: its events by stage, and the values that uploads still read."""

    def __init__(self) -> None:
        self.events: dict[str, list[Any]] = {stage: [] for stage in STAGES}
        self.sources: list[NDArray] = []

    def add(self, stage: str, event: Any) -> None:
        self.events[stage].append(event)


@dataclass(frozen=True)
class _Band:
    """Rows of a frame, the raw rows that their patches touch, and which of these each padded row repeats."""

    rows: slice
    raw_rows: slice
    row_source: Any


@dataclass(frozen=True)
class _Layout:
    """All bands of frames of one shape."""

    shape: tuple[int, int]
    column_source: Any
    bands: tuple[_Band, ...]
