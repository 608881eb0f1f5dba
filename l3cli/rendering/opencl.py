"""Rendering on an OpenCL device: upload, two kernels a layer (opencl/*.cl), download (docs/method.md#rendering).

A frame is taken in horizontal bands, so that the device's memory is bounded whatever the frame's size; a usual frame is one
band. Two tracks, each a queue with its buffers, take the bands in turn, of this frame and the next: while one
computes, the other may upload and download.
"""

import os
import warnings
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PlaneLayer
from l3cli.artifacts.table import TransformTable
from l3cli.classes.planes import fixed_point, later_fixed_point, opponent_basis
from l3cli.errors import RecipeError
from l3cli.frame import RawFrame
from l3cli.rendering import kernels, layout
from l3cli.rendering.display import Display, require_known_layers, require_xyz
from l3cli.rendering.opencl_bands import bands
from l3cli.rendering.opencl_devices import choose_device, pyopencl, refusals
from l3cli.rendering.opencl_shading import DeviceShading
from l3cli.rendering.opencl_work import Band, PlaneStep, Track, Work

TRACKS = 2
STAGES = ("upload", "classes", "transforms", "encode", "download")
LATER_STAGES = ("upload", "classes", "planes", "structures", "transforms", "encode", "download")
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
        require_known_layers(table)
        self.table = table
        self.device = choose_device(os.environ.get("L3_DEVICE", "") if device is None else device)
        self._kept = True  # whether kernels.keep() has seen all that was compiled
        cl = pyopencl()
        self.variant = variant or ("graphics" if self.device.type & cl.device_type.GPU else "processor")
        if self.variant not in layout.VARIANTS:
            raise RecipeError(f'variant "{self.variant}" is unknown; use one of {", ".join(layout.VARIANTS)}')
        with refusals(self.device):
            self._context = cl.Context([self.device])
            variant_layout = layout.VARIANTS[self.variant]
            self._cut = variant_layout.cut(table, lanes or self._register_lanes())
            self._transforms: dict[tuple[tuple[str, int | str], ...], Any] = {}
            first = self._build_first(layout.TO_PLANES if table.later else layout.OUTPUTS_AS_THEY_ARE)
            self._classes = cl.Kernel(first, "classes")
            self._class_buffers = [self._constant(array) for array in layout.class_arrays(table)]
            last = layout.later_weights(table.later[-1]) if table.later else layout.first_weights(table)
            self._weights = self._constant(variant_layout.pack(last, self._cut.lanes))
            self._later = [self._plane_step(number, first) for number in range(len(table.later))]
            self._tracks = deque(Track(self._context, len(table.later)) for _ in range(TRACKS))
            self._frame_bands: tuple[tuple[int, ...], tuple[Band, ...]] | None = None
            self._shading = DeviceShading(self._build, self._constant, self._cut.lanes)

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages of `stage_times`."""
        return LATER_STAGES if self.table.later else STAGES

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.uint32]:
        """Class (row, col) of every pixel in a layer of the table."""
        labels = np.empty(frame.values.shape, np.uint32)
        self._wait(self._start(frame, [labels], None, layer=layer))
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
        """The picture of each frame, in order. While the caller uses one the next is computed."""
        started: deque[tuple[NDArray, Work]] = deque()
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
        """Milliseconds that the device spent in each of `stages` for one picture, or without a display for the outputs.

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

    def _start_outputs(self, frame: RawFrame) -> tuple[NDArray[np.float32], Work]:
        planes = np.empty((len(self.table.outputs), *frame.values.shape), np.float32)
        return planes, self._start(frame, list(planes), layout.OUTPUTS_AS_THEY_ARE)

    def _start_picture(self, frame: RawFrame, display: Display) -> tuple[NDArray, Work]:
        require_xyz(self.table.outputs)
        picture = np.empty((*frame.values.shape, 3), display.dtype)
        return picture, self._start(frame, [picture], layout.display_macros(display), display.matrix * frame.light_share)

    def _start(
        self, frame: RawFrame, results: Sequence[NDArray], ending: layout.Macros | None, matrix: NDArray | None = None,
        layer: int = 0,
    ) -> Work:  # fmt: skip
        """Start to fill `results`, one or several arrays (row, …) that follow one another on the device, with what the
        kernel `transform` with this ending writes, or without one with the labels of `layer`."""
        levelled, work = frame.at_levels(self.table.black_level, self.table.white_level, self.table.bits), Work(self.stages)
        values = np.ascontiguousarray(levelled.values)
        with refusals(self.device):
            kernel = None if ending is None else self._transform_kernel({**ending, **self._shading.macros(frame.shading)})
            encoding = self._constant(np.zeros(9) if matrix is None else matrix, np.float32)
            for band in self._bands(values.shape):
                track = self._tracks[0]
                self._tracks.rotate()
                self._classify(values, levelled, track, band, work)
                for number in range(layer if kernel is None else len(self._later)):
                    self._classify_later(number, track, band, work)
                offset, sizes = 0, [result[band.rows].nbytes for result in results]
                if kernel is not None:
                    self._transform(kernel, encoding, track, band, sum(sizes), levelled, work)
                    source = track.result
                else:
                    source = track.later_labels[layer - 1] if layer else track.labels
                    offset = 4 * (band.rows.start - band.reads[layer].start) * band.columns
                for result, size in zip(results, sizes, strict=True):
                    work.add("download", track.download(source, result[band.rows], offset))
                    offset += size
        return work

    def _wait(self, work: Work) -> dict[str, float]:
        """Milliseconds of each stage, once the work is done. Other threads run on meanwhile."""
        with refusals(self.device):
            for event in work.events["download"]:
                event.wait()
            if not self._kept:  # only now that they have run all of them are compiled
                kernels.keep()
                self._kept = True
            return work.milliseconds()

    def _classify(self, values: NDArray, frame: RawFrame, track: Track, band: Band, work: Work) -> None:
        """Upload and classes of a band, with the rows beside it that a later layer reads."""
        source, (rows, columns) = values[band.raw_rows], band.shape(0)
        track.raw = self._scratch(track.raw, source.nbytes)
        track.labels = self._scratch(track.labels, 4 * rows * columns)
        work.sources.append(source)
        work.add("upload", pyopencl().enqueue_copy(track.queue, track.raw, source, is_blocking=False))
        if evening := self._shading.even(frame, track, band):
            work.add("classes", evening)
        site = ((frame.phase[0] + band.reads[0].start) % self.table.cfa.shape[0], frame.phase[1])
        buffers = (track.raw, *band.mosaic_source, *self._class_buffers, track.labels)
        work.add("classes", self._run(self._classes, track, (rows, columns), *buffers, *map(np.int32, site)))

    def _classify_later(self, number: int, track: Track, band: Band, work: Work) -> None:
        """What later layer `number` reads of a band: the planes of the layer before it, and the classes they give."""
        step, (rows, columns), made = self._later[number], band.shape(number), band.shape(number + 1)
        track.planes[number] = self._scratch(track.planes[number], 4 * layout.PLANES * rows * columns)
        buffers = (*self._reads(number, track, band), step.weights, step.nothing, track.planes[number], np.float32(0))
        work.add("planes", self._run(step.planes, track, (rows, columns), *buffers, self._source_rows(number, band)))
        track.later_labels[number] = self._scratch(track.later_labels[number], 4 * made[0] * columns)
        buffers = (track.planes[number], track.labels, *band.later[number].classes, *step.rule, track.later_labels[number])
        work.add("structures", self._run(step.classes, track, made, *buffers, np.int32(rows)))

    def _reads(self, number: int, track: Track, band: Band) -> tuple[Any, ...]:
        """What the transforms of a layer read, 0 being the first: source, where its padded rows and columns lie, classes."""
        if not number:
            return track.raw, *band.mosaic_source, track.labels
        return track.planes[number - 1], *band.later[number - 1].transforms, track.later_labels[number - 1]

    def _source_rows(self, number: int, band: Band) -> np.int32:
        return np.int32(band.shape(number - 1)[0] if number else 0)

    def _transform(
        self, kernel: Any, encoding: Any, track: Track, band: Band, size: int, frame: RawFrame, work: Work
    ) -> None:
        """Transforms of the last layer and encoding of a classified band into the track's result, `size` bytes."""
        track.result = self._scratch(track.result, size)
        number = len(self._later)
        made = (track.result, *self._shading.gain(frame.shading, band.rows))
        last = (self._weights, encoding, *made, np.float32(frame.black_level), self._source_rows(number, band))
        work.add("transforms", self._run(kernel, track, band.shape(number), *self._reads(number, track, band), *last))

    def _run(self, kernel: Any, track: Track, shape: tuple[int, int], *arguments: Any) -> Any:
        """Enqueue a kernel over rows and columns, which are the last arguments of each."""
        rows, columns = shape
        cut = self._cut
        grid = (-(-columns // cut.tile) * cut.group[0], -(-rows // cut.band) * cut.group[1])
        return kernel(track.queue, grid, cut.group, *arguments, np.int32(rows), np.int32(columns))

    def _transform_kernel(self, ending: layout.Macros) -> Any:
        """The kernel `transform` of the last layer with one ending: some display's encoding, say. Built when first asked
        for."""
        key = tuple(ending.items())
        if key not in self._transforms:
            self._transforms[key] = pyopencl().Kernel(self._build_last(ending), "transform")
        return self._transforms[key]

    def _build_last(self, ending: layout.Macros) -> Any:
        """The program of the last layer."""
        return self._build_later(self.table.later[-1], ending) if self.table.later else self._build_first(ending)

    def _plane_step(self, number: int, first: Any) -> PlaneStep:
        """How a later layer comes to its planes and classes; `first` is the program of the first layer."""
        cl, table = pyopencl(), self.table
        layer, before = table.later[number], table.later[number - 1] if number else None
        if before is None:
            weights, maker = layout.first_plane_weights(fixed_point(table), table.bits), first
        else:
            weights = layout.later_plane_weights(later_fixed_point(before, opponent_basis(table.white_point)))
            maker = self._build_later(before, layout.TO_PLANES)
        program = self._build_later(layer, layout.OUTPUTS_AS_THEY_ARE if layer is table.later[-1] else layout.TO_PLANES)
        kernels = cl.Kernel(maker, "transform"), cl.Kernel(program, "structures")
        rule = tuple(self._constant(array) for array in layout.rule_arrays(table, layer.rule, self.variant))
        nothing = self._constant(np.zeros(9, np.float32))
        packed = layout.VARIANTS[self.variant].pack_whole(weights, self._cut.lanes)
        return PlaneStep(*kernels, self._constant(packed), rule, nothing)

    def _build_later(self, layer: PlaneLayer, ending: layout.Macros) -> Any:
        """The program of a layer that reads planes."""
        return self._build(
            layout.later_source(self.variant, layer.rule), {**layout.later_macros(self.table, layer), **ending}
        )

    def _build_first(self, ending: layout.Macros) -> Any:
        """The program of the layer that reads the mosaic."""
        source = layout.first_source(self.variant, self.table.first.rule)
        return self._build(source, {**layout.table_macros(self.table), **ending})

    def _build(self, source: str, shapes: layout.Macros) -> Any:
        options = [*BUILD_OPTIONS, *(f"-D{name}={value}" for name, value in {**shapes, **self._cut.macros}.items())]
        return self._compile(source, options)

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

    def _bands(self, shape: tuple[int, ...]) -> tuple[Band, ...]:
        """The bands of frames of a shape (row, col), kept until a frame of another shape comes."""
        if self._frame_bands is None or self._frame_bands[0] != shape:
            self._frame_bands = shape, tuple(bands(self.table, shape, self._constant))
            self._kept = False  # the driver may compile a kernel once more for grids of another size
        return self._frame_bands[1]

    def _constant(self, array: NDArray, dtype: Any = None) -> Any:
        cl = pyopencl()
        array = np.ascontiguousarray(array if array.size else np.zeros(1, array.dtype), dtype)  # no buffer may be empty
        return cl.Buffer(self._context, cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

    def _scratch(self, buffer: Any, size: int) -> Any:
        """The buffer if it has room for `size` bytes, else one that has."""
        if buffer is None or buffer.size < size:
            buffer = pyopencl().Buffer(self._context, pyopencl().mem_flags.READ_WRITE, size)
        return buffer
