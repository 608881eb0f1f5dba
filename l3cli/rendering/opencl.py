"""Rendering on an OpenCL device: upload, two kernels (opencl/*.cl), download (docs/method.md#rendering).

A frame is taken in horizontal bands, so that the device's memory is bounded whatever the frame's size; a usual frame is one
band. Two tracks, each a queue with buffers of its own, take the bands in turn, of this frame and the next: while one
computes, the other may upload and download.
"""

import contextlib
import os
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.errors import DeviceError, RecipeError
from l3cli.frame import RawFrame, mirrored_indices
from l3cli.rendering import kernels, layout
from l3cli.rendering.display import Display, require_xyz
from l3cli.rendering.opencl_devices import choose_device, pyopencl

BAND_PIXELS = 1 << 22  # of a band, margins aside
TRACKS = 2
STAGES = ("upload", "classes", "transforms", "encode", "download")
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
        self._kept = True  # whether kernels.keep() has seen all that was compiled
        cl = pyopencl()
        self.variant = variant or ("graphics" if self.device.type & cl.device_type.GPU else "processor")
        if self.variant not in layout.VARIANTS:
            raise RecipeError(f'variant "{self.variant}" is unknown; use one of {", ".join(layout.VARIANTS)}')
        with self._refusals():
            self._context = cl.Context([self.device])
            self._cut = layout.VARIANTS[self.variant].cut(table, lanes or self._register_lanes())
            self._transforms: dict[tuple[tuple[str, int | str], ...], Any] = {}
            self._classes = cl.Kernel(self._build(layout.OUTPUTS_AS_THEY_ARE), "classes")
            self._class_buffers = [self._constant(array) for array in layout.class_arrays(table)]
            self._weights = self._constant(layout.VARIANTS[self.variant].pack(table, self._cut.lanes))
            self._tracks = deque(_Track(self._context) for _ in range(TRACKS))
            self._frame_bands: tuple[tuple[int, ...], tuple[_Band, ...]] | None = None

    def labels(self, frame: RawFrame) -> NDArray[np.uint32]:
        """Class (row, col) of every pixel."""
        labels = np.empty(frame.values.shape, np.uint32)
        self._wait(self._start(frame, [labels], None))
        return labels

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Outputs of the table, (output, row, col)."""
        planes, work = self._start_outputs(frame)
        self._wait(work)
        if frame.light_share != 1:
            planes *= np.float32(frame.light_share)
        return planes

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """The frame as the display shows it (row, col, 3), encoded on the device; RecipeError unless the table's outputs are
        X, Y, Z."""
        picture, work = self._start_picture(frame, display)
        self._wait(work)
        return picture

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """The picture of each frame, in order. While the caller looks at one the next is at work."""
        started: deque[tuple[NDArray, _Work]] = deque()
        for frame, display in frames:
            started.append(self._start_picture(frame, display))
            if len(started) == TRACKS:
                picture, work = started.popleft()
                self._wait(work)
                yield picture
        for picture, work in started:
            self._wait(work)
            yield picture

    def stage_times(self, frame: RawFrame, display: Display | None) -> dict[str, float]:
        """Milliseconds that the device spent in each of STAGES for one picture, or without a display for the outputs.

        Transforms and encoding are one kernel: "transforms" is the time of that kernel built without the encoding, which
        writes one number a pixel instead; "encode" what the whole kernel takes beyond that. Call it twice: the first run
        warms up.
        """
        _, work = self._start_outputs(frame) if display is None else self._start_picture(frame, display)
        times = self._wait(work)
        if display is not None:
            numbers = np.empty(frame.values.shape, np.float32)
            bare = self._wait(self._start(frame, [numbers], layout.NOT_ENCODED))["transforms"]
            times["encode"] = max(0.0, times["transforms"] - bare)
            times["transforms"] = bare
        return times

    def _start_outputs(self, frame: RawFrame) -> tuple[NDArray[np.float32], "_Work"]:
        planes = np.empty((len(self.table.outputs), *frame.values.shape), np.float32)
        return planes, self._start(frame, list(planes), layout.OUTPUTS_AS_THEY_ARE)

    def _start_picture(self, frame: RawFrame, display: Display) -> tuple[NDArray, "_Work"]:
        require_xyz(self.table.outputs)
        picture = np.empty((*frame.values.shape, 3), display.dtype)
        return picture, self._start(frame, [picture], layout.display_macros(display), display.matrix * frame.light_share)

    def _start(
        self, frame: RawFrame, results: Sequence[NDArray], ending: layout.Macros | None, matrix: NDArray | None = None
    ) -> "_Work":
        """Start to fill `results`, one or several arrays (row, …) that follow one another on the device, with what the
        kernel `transform` with this ending writes, or without one with the labels."""
        levelled, work = frame.at_levels(self.table.black, self.table.white, self.table.bits), _Work()
        values = np.ascontiguousarray(levelled.values)
        with self._refusals():
            kernel = None if ending is None else self._transform_kernel(ending)
            encoding = self._constant(np.zeros(9) if matrix is None else matrix, np.float32)
            for band in self._bands(values.shape):
                track = self._tracks[0]
                self._tracks.rotate()
                self._classify(values, frame.phase, track, band, work)
                offset, sizes = 0, [result[band.rows].nbytes for result in results]
                if kernel is not None:
                    self._transform(kernel, encoding, track, band, sum(sizes), levelled.black, work)
                for result, size in zip(results, sizes, strict=True):
                    source = track.labels if kernel is None else track.result
                    work.add("download", track.download(source, result[band.rows], offset))
                    offset += size
        return work

    def _wait(self, work: "_Work") -> dict[str, float]:
        """Milliseconds of each stage, once the work is done. Other threads run on meanwhile."""
        with self._refusals():
            for event in work.events["download"]:
                event.wait()
            if not self._kept:  # only now that they have run all of them are compiled
                kernels.keep()
                self._kept = True
            return work.milliseconds()

    def _classify(self, values: NDArray, phase: tuple[int, int], track: "_Track", band: "_Band", work: "_Work") -> None:
        """Upload and classes of a band."""
        source = values[band.raw_rows]
        track.raw = self._scratch(track.raw, source.nbytes)
        track.labels = self._scratch(track.labels, 4 * (band.rows.stop - band.rows.start) * values.shape[1])
        work.sources.append(source)
        work.add("upload", pyopencl().enqueue_copy(track.queue, track.raw, source, is_blocking=False))
        site = ((phase[0] + band.rows.start) % self.table.cfa.shape[0], phase[1])
        buffers = (track.raw, band.row_source, band.column_source, *self._class_buffers, track.labels)
        work.add("classes", self._run(self._classes, track, band, *buffers, *map(np.int32, site)))

    def _transform(
        self, kernel: Any, encoding: Any, track: "_Track", band: "_Band", size: int, black: float, work: "_Work"
    ) -> None:
        """Transforms and encoding of a classified band above its black level into the track's result, `size` bytes."""
        track.result = self._scratch(track.result, size)
        buffers = (track.raw, band.row_source, band.column_source, track.labels, self._weights, encoding, track.result)
        work.add("transforms", self._run(kernel, track, band, *buffers, np.float32(black)))

    def _run(self, kernel: Any, track: "_Track", band: "_Band", *arguments: Any) -> Any:
        """Enqueue a kernel over a band; rows and columns are the last arguments of each."""
        rows, columns, cut = band.rows.stop - band.rows.start, band.columns, self._cut
        grid = (-(-columns // cut.tile) * cut.group[0], -(-rows // cut.band) * cut.group[1])
        return kernel(track.queue, grid, cut.group, *arguments, np.int32(rows), np.int32(columns))

    def _transform_kernel(self, ending: layout.Macros) -> Any:
        """The kernel `transform` with one ending: some display's encoding, say. Built when first asked for."""
        key = tuple(ending.items())
        if key not in self._transforms:
            self._transforms[key] = pyopencl().Kernel(self._build(ending), "transform")
        return self._transforms[key]

    def _build(self, ending: layout.Macros) -> Any:
        shapes = {**layout.table_macros(self.table), **self._cut.macros, **ending}
        options = [*BUILD_OPTIONS, *(f"-D{name}={value}" for name, value in shapes.items())]
        return self._compile(layout.program_source(self.variant, self.table.rule), options)

    def _compile(self, source: str, options: list[str]) -> Any:
        device = self.device
        identity = (device.platform.name, device.platform.version, device.name, device.version, device.driver_version)
        with kernels.building("\0".join([*identity, *options, source])), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pyopencl warns of every word a compiler says
            self._kept = False
            return pyopencl().Program(self._context, source).build(options)

    def _register_lanes(self) -> int:
        """Floats in a vector register, as far as the device's compiler knows its processor: PoCL 3.0 takes processors
        younger than itself for older ones, and 16 lanes in registers of 8 are slower than 8 lanes."""
        probe = "__kernel void\n#ifdef __AVX512F__\nwide\n#else\nnarrow\n#endif\n() {}"
        return 16 if self._compile(probe, list(BUILD_OPTIONS)).kernel_names == "wide" else 8

    def _bands(self, shape: tuple[int, ...]) -> tuple["_Band", ...]:
        """The bands of frames of a shape (row, col), kept until a frame of another shape comes."""
        if self._frame_bands is None or self._frame_bands[0] != shape:
            self._frame_bands = shape, tuple(self._cut_into_bands(*shape))
            self._kept = False  # the driver may compile a kernel once more for grids of another size
        return self._frame_bands[1]

    def _cut_into_bands(self, rows: int, columns: int) -> Iterator["_Band"]:
        radius, cfa = self.table.rule.radius, self.table.cfa
        row_source = mirrored_indices(rows, radius, cfa.shape[0])
        column_source = self._constant(mirrored_indices(columns, radius, cfa.shape[1]), np.int32)
        height = max(1, BAND_PIXELS // columns)
        for first in range(0, rows, height):
            last = min(first + height, rows)
            seen = row_source[first : last + 2 * radius]
            raw_rows = slice(int(seen.min()), int(seen.max()) + 1)
            relative = self._constant(seen - raw_rows.start, np.int32)
            yield _Band(slice(first, last), raw_rows, columns, relative, column_source)

    def _constant(self, array: NDArray, dtype: Any = None) -> Any:
        cl = pyopencl()
        array = np.ascontiguousarray(array if array.size else np.zeros(1, array.dtype), dtype)  # no buffer may be empty
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

    def download(self, buffer: Any, target: NDArray, offset: int) -> Any:
        """Copy `buffer` from byte `offset` on to the contiguous array `target`, without waiting."""
        copy = pyopencl().enqueue_copy(self.queue, target, buffer, src_offset=offset, is_blocking=False)
        self.queue.flush()
        return copy


class _Work:
    """What has been started for one frame: its events by stage, and the values that uploads may still be reading."""

    def __init__(self) -> None:
        self.events: dict[str, list[Any]] = {stage: [] for stage in STAGES}
        self.sources: list[NDArray] = []

    def add(self, stage: str, event: Any) -> None:
        self.events[stage].append(event)

    def milliseconds(self) -> dict[str, float]:
        """What the device spent in each stage, once all is done."""
        return {
            stage: sum((event.profile.end - event.profile.start) * 1e-6 for event in events)
            for stage, events in self.events.items()
        }


@dataclass(frozen=True)
class _Band:
    """Rows of a frame, and the raw rows that their patches touch; row_source (padded row) and column_source (padded col)
    name which of these each padded one repeats."""

    rows: slice
    raw_rows: slice
    columns: int
    row_source: Any
    column_source: Any
