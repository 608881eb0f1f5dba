"""Render frames on an OpenCL device (docs/method.md#rendering).

For each frame, the renderer uploads the raw values, runs one or two kernels per layer (opencl/*.cl), and downloads the
result.

Large frames are divided into horizontal bands, so that the required device memory does not grow with the size of the frame.
Bands alternate between two command queues with separate buffers (`Track`). While one queue computes, the other can upload
and download.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import FRACTION, NODE_SPACING_COLUMNS, Shading, clipped_from
from l3cli.rendering.conditions import NoiseSets
from l3cli.rendering.display import Display, require_known_layers, require_xyz
from l3cli.rendering.opencl import layout
from l3cli.rendering.opencl.coarse_chroma import DeviceClipping, DeviceCoarseChroma
from l3cli.rendering.opencl.devices import pyopencl, refusals
from l3cli.rendering.opencl.layout import Macros, joined_files
from l3cli.rendering.opencl.programs import Programs, chosen, compiler_of
from l3cli.rendering.opencl.smoothing import DeviceChroma, DeviceSpectra
from l3cli.rendering.opencl.work import (
    CHROMA,
    COARSE_CHROMA,
    SPECTRA,
    Band,
    Track,
    Work,
    bands,
    constant,
    scratch,
    shares_memory,
    stages_of,
)

LONG_RUN = 1 << 14  # pixels per work-item of the shading kernel on CPUs
GROUP = 64  # work-items per group of the shading kernel on GPUs; each work-item processes one pixel


class DeviceShading:
    """Kernel and buffers for correcting lens shading.

    The kernel is compiled for the first frame with colour shading. Buffers are reused while the shading remains the same.
    """

    def __init__(self, kernel: Callable[[str, Macros, str], Any], constant: Callable[[NDArray], Any], lanes: int) -> None:
        """Store the arguments, without compiling the kernel.

        Parameters
        ----------
        kernel : callable
            Compiles a kernel from its source, macros and name.
        constant : callable
            Copies an array to a device buffer.
        lanes : int
            Vector length.
        """
        self._make, self._constant, self._run = kernel, constant, LONG_RUN if lanes > 1 else 1
        self._kernel: Any = None
        self._shading: Shading | None = None
        self._buffers: dict[tuple[str, int, int], Any] = {}

    @staticmethod
    def macros(shading: Shading | None) -> Macros:
        """Return the macros for correcting the shading, if any, in the kernels of the last layer."""
        return {} if shading is None else {"SHADED": 1, "GAIN_STEP": NODE_SPACING_COLUMNS}

    def gain(self, shading: Shading | None, rows: slice) -> tuple[Any, ...]:
        """Return the buffer with the shading gains of `rows`, in a tuple. Without shading, the tuple is empty."""
        return () if shading is None else (self._buffer(shading, "gain", rows),)

    @staticmethod
    def corrects(frame: RawFrame) -> bool:
        """Whether a frame has colour shading. The kernel corrects it in a copy of the raw values."""
        return frame.shading is not None and frame.shading.colour is not None

    def correct(self, frame: RawFrame, track: Track, band: Band) -> Any:
        """Enqueue the colour shading correction for a band of rows, whose values have the table's black and white levels."""
        if self._kernel is None:
            macros: Macros = {"FRACTION": FRACTION, "RUN": self._run}
            self._kernel = self._make(
                joined_files("common/vectors.cl", "common/shading.cl"), macros, "correct_colour_shading"
            )
        pixels = (band.raw_rows.stop - band.raw_rows.start) * band.columns
        levels = round(frame.black_level), clipped_from(frame.black_level, frame.white_level), pixels
        assert frame.shading is not None
        colour = self._buffer(frame.shading, "colour", band.raw_rows)
        items, group = -(-pixels // self._run), GROUP if self._run == 1 else 1
        grid = (-(-items // group) * group,)
        return track.run(self._kernel, grid, (group,), track.raw, colour, *map(np.int32, levels))

    def _buffer(self, shading: Shading, name: str, rows: slice) -> Any:
        if shading is not self._shading:
            self._shading, self._buffers = shading, {}
        key = (name, rows.start, rows.stop)
        if key not in self._buffers:
            self._buffers[key] = self._constant(getattr(shading, name)[rows])
        return self._buffers[key]


@dataclass(frozen=True)
class Unread:
    """Outputs of a frame that are still on the device, so that they can be encoded without rendering again."""

    frame: RawFrame
    values: NDArray[np.uint16]  # copy of the frame's values, because the caller may change them
    track: Track
    result: Any  # buffer with the outputs

    def are_of(self, frame: RawFrame) -> bool:
        """Whether these are the outputs of `frame`, and its values have not changed since rendering."""
        return self.frame is frame and np.array_equal(self.values, frame.values)


TRACKS = 2
ENCODED_PIXELS = 1 << 22  # pixels per transfer in `encoded`
Labels = Mapping[int, NDArray]  # layer → array (row, col) that receives the class map
NO_LABELS: Labels = {}
READ_AHEAD = 16  # vector loads may read this number of elements beyond the last pixel


class OpenCLRenderer:
    """Renderer on an OpenCL device.

    Programs and buffers for the table are created once, and buffers for bands once per frame size. Only one thread at a time
    may use a renderer. Other threads can run while it waits for the device.

    Parameters
    ----------
    table : TransformTable
        Table that renders the frames.
    device : str, optional
        Number of the device, or part of its name. [default: the environment variable L3_DEVICE, otherwise the first GPU,
        otherwise the first device]
    variant : str, optional
        A key of layout.VARIANTS. [default: depends on the device type]
    lanes : int, optional
        Vector length of the variant "processor" (the CPU kernels). [default: the width of the device's registers]
    by_noise : bool
        As in `make_renderer`.

    Raises
    ------
    DeviceError
        If no device matches, or if the device fails.
    """

    def __init__(
        self, table: TransformTable, device: str | None = None, variant: str | None = None, lanes: int | None = None,
        by_noise: bool = False,
    ) -> None:  # fmt: skip
        require_known_layers(table)
        self.table, self.stages, self._sets = table, stages_of(table), NoiseSets(table, by_noise)
        self.device, self.variant = chosen(device, variant)
        self._corrects = bool(table.later and table.components)  # whether the last layer corrects the first layer's outputs
        with refusals(self.device):
            self._compiler = compiler_of(self.device)
            self._context = self._compiler.context
            self._constant, self._scratch = partial(constant, self._context), partial(scratch, self._context)
            self._programs = Programs(self._compiler, table, self.variant, lanes, len(self._sets))
            self._cut = self._programs.cut
            self._class_buffers, self._weights, self._layers = layout.table_buffers(
                self._sets, self.variant, self._cut.lanes, self._constant
            )
            if self._corrects:
                first = layout.VARIANTS[self.variant].pack(layout.first_weights(table, self._sets.first), self._cut.lanes)
                self._first_weights = self._constant(first)
            self._tracks = deque(Track(self._context, len(table.later)) for _ in range(TRACKS))
            self._frame_bands: tuple[tuple[int, ...], tuple[Band, ...]] | None = None
            self._unread: Unread | None = None
            self._in_place = shares_memory(self.device)
            self._joined = self._programs.joins  # whether one kernel computes both classes and transforms
            self._shading = DeviceShading(self._kernel, self._constant, self._cut.lanes)
            self._spectra = DeviceSpectra(self._kernel, self._run, table, self.variant) if table.spectra else None
            self._chroma = (
                DeviceChroma(self._compiler, self._run, self._constant, table, self.variant, self._cut.lanes)
                if table.chroma_smoothing
                else None
            )
            chroma = table.later[-1].coarse_chroma if table.later else None
            self._coarse = chroma and DeviceCoarseChroma(self._kernel, self._run, self._constant, chroma, self.variant)
            clips = table.later and table.later[-1].clipping
            self._clipping = clips and DeviceClipping(self._kernel, self._run, self._constant, table, self.variant)

    def labels(self, frame: RawFrame, layer: int = 0) -> NDArray[np.uint32]:
        """Return the class map (row, col) of a layer. Layer 0 reads the raw frame."""
        labels = np.empty(frame.values.shape, np.uint32)
        if self._layers and self._unread is not None and self._unread.are_of(frame):  # the classes are still on the device
            work, track = Work(self.device, self.stages), self._unread.track
            work.fetch(track.queue, track.refined_labels[layer - 1] if layer else track.labels, [labels])
        else:
            work = self._start(frame, [], None, labels={layer: labels})
        work.end()
        return labels

    def classified(self, frame: RawFrame) -> tuple[NDArray[np.float32], list[NDArray[np.uint32]]]:
        """Return the outputs and the class maps (row, col) of the first and last layers.

        A table with a single layer has a single class map.
        """
        labels = {layer: np.empty(frame.values.shape, np.uint32) for layer in {0, len(self._layers)}}
        joined, self._joined = self._joined, self._joined and bool(self._layers)  # a joined last layer stores no classes
        try:
            planes, work = self._start_outputs(frame, labels)
        finally:
            self._joined = joined
        return self._ended(planes, work, frame), [labels[layer] for layer in sorted(labels)]

    def outputs(self, frame: RawFrame) -> NDArray[np.float32]:
        """Render a frame to the outputs of the table, (output, row, col)."""
        planes, work = self._start_outputs(frame)
        if len(self._bands(frame.values.shape)) == 1:
            self._unread = Unread(frame, frame.values.copy(), self._tracks[-1], self._tracks[-1].result)
        return self._ended(planes, work, frame)

    @staticmethod
    def _ended(planes: NDArray[np.float32], work: Work, frame: RawFrame) -> NDArray[np.float32]:
        work.end()
        if frame.light_share != 1:
            planes *= np.float32(frame.light_share)
        return planes

    def picture(self, frame: RawFrame, display: Display) -> NDArray:
        """Render a frame to a picture (row, col, 3), which is encoded on the device.

        Raises RecipeError unless the table's outputs are X, Y and Z, only Y, or Stokes parameters.
        """
        picture, work = self._start_picture(frame, display)
        work.end()
        return picture

    def pictures(self, frames: Iterable[tuple[RawFrame, Display]]) -> Iterator[NDArray]:
        """Yield the picture of each frame, in order.

        The device computes the next picture while the caller processes the current one.
        """
        started: deque[tuple[NDArray, Work]] = deque()
        for frame, display in frames:
            started.append(self._start_picture(frame, display, borrow=False))
            if len(started) == TRACKS:
                picture, work = started.popleft()
                work.end()
                yield picture
        for picture, work in started:
            work.end()
            yield picture

    def encoded(self, outputs: NDArray[np.float32], display: Display) -> NDArray:
        """Encode the outputs (output, row, col) of a frame as a picture (row, col, 3)."""
        require_xyz(self.table.outputs)
        rows, columns = outputs.shape[1:]
        picture, self._unread = np.empty((rows, columns, 3), display.dtype), None
        for first in range(0, rows, step := max(ENCODED_PIXELS // columns, 1)):
            strip = slice(first, first + step)
            with refusals(self.device):
                buffer = self._constant(outputs[:, strip], np.float32)
            self._start_encoding(buffer, self._tracks[0], display, display.matrix, picture[strip]).end()
        return picture

    def stage_times(self, frame: RawFrame, display: Display | None) -> dict[str, float]:
        """Measure the device time of each of the `stages`.

        Classes and transforms of the first layer are timed separately, even if one kernel usually computes both.
        "transforms" is the time of a kernel without encoding, which writes one number per pixel. "encode" is the additional
        time of the kernel with encoding. Ignore the result of the first call, because it includes compilation.

        Parameters
        ----------
        frame : RawFrame
            Frame to render.
        display : Display or None
            Settings of the picture, or None for unencoded outputs.

        Returns
        -------
        dict of str to float
            Time per stage in ms.
        """
        self._unread = None
        joined, self._joined = self._joined, False
        try:
            _, work = self._start_outputs(frame) if display is None else self._start_picture(frame, display)
            times = work.end().milliseconds()
            if display is not None and not self._chroma:
                numbers = np.empty(frame.values.shape, np.float32)
                bare = self._start(frame, [numbers], layout.NOT_ENCODED).end().milliseconds()["transforms"]
                times["encode"] = max(0.0, times["transforms"] - bare)
                times["transforms"] = bare
        finally:
            self._joined = joined
        return times

    def _start_outputs(self, frame: RawFrame, labels: Labels = NO_LABELS) -> tuple[NDArray[np.float32], Work]:
        planes = np.empty((len(self.table.outputs), *frame.values.shape), np.float32)
        return planes, self._start(frame, list(planes), layout.OUTPUTS_AS_THEY_ARE, labels=labels)

    def _start_picture(self, frame: RawFrame, display: Display, borrow: bool = True) -> tuple[NDArray, Work]:
        require_xyz(self.table.outputs)
        picture = np.empty((*frame.values.shape, 3), display.dtype)
        if self._unread is not None and self._unread.are_of(frame):
            matrix = display.matrix * frame.light_share
            return picture, self._start_encoding(self._unread.result, self._unread.track, display, matrix, picture)
        matrix = display.matrix * frame.light_share
        return picture, self._start(frame, [picture], layout.display_macros(display), matrix, borrow=borrow)

    def _start(
        self, frame: RawFrame, results: Sequence[NDArray], ending: layout.Macros | None, matrix: NDArray | None = None,
        labels: Labels = NO_LABELS, borrow: bool = True,
    ) -> Work:  # fmt: skip
        """Enqueue all commands to render a frame.

        Parameters
        ----------
        frame : RawFrame
            Frame to render.
        results : sequence of ndarray, (row, …)
            Arrays that receive the results, which are consecutive in one buffer on the device.
        ending : dict or None
            Macros that select whether outputs or encoded pixels are written. None computes only class maps.
        matrix : ndarray, (3, 3), optional
            Matrix from outputs to the linear values of a picture.
        labels : dict of int to ndarray, (row, col)
            Arrays that receive the class maps, by layer. Other layers' class maps are not returned.
        borrow : bool
            Whether the caller leaves the frame unchanged until all commands have finished. Otherwise its values are copied.

        Returns
        -------
        Work
            The enqueued commands.
        """
        levelled = frame.rescaled(self.table.black_level, self.table.white_level, self.table.bits)
        work, values = Work(self.device, self.stages), np.ascontiguousarray(levelled.values)
        if not borrow and np.may_share_memory(values, frame.values):
            values = values.copy()
        self._unread = None
        with refusals(self.device):
            shaded = self._shading.macros(frame.shading)
            joined = self._joined and not self._layers
            transformed = layout.OUTPUTS_AS_THEY_ARE if ending is not None and self._chroma else ending
            kernel = None if transformed is None else self._programs.transforms({**transformed, **shaded}, joined)
            encoding = None
            for band in self._bands(values.shape):
                track = self._tracks[0]
                self._tracks.rotate()
                self._bring(values, levelled, track, band, work)
                if not self._joined or (kernel is None and not any(labels)):
                    arguments = (*self._decides(track, band), *self._site(band, levelled))
                    work.add("classes", self._run(self._programs.classes(0), track, band.shape(0), *arguments))
                if encoding is None:  # computed only now, while the device already runs the first kernel
                    encoding = self._constant(layout.display_constants(self.table, matrix), np.float32)
                for number in range(max(labels) if kernel is None else len(self._layers)):
                    self._classify_refinement(number, track, band, levelled, work)
                if kernel is not None and ending is not None:
                    parts = [result[band.rows] for result in results]
                    target = self._target(track, parts, work)
                    self._transform(kernel, encoding, track, band, target, levelled, work, ending)
                    work.fetch(track.queue, target, parts)
                for layer, array in labels.items():
                    classes = track.refined_labels[layer - 1] if layer else track.labels
                    offset = 4 * (band.rows.start - band.reads[layer].start) * band.columns
                    work.fetch(track.queue, classes, [array[band.rows]], offset)
        return work

    def _start_encoding(self, outputs: Any, track: Track, display: Display, matrix: NDArray, picture: NDArray) -> Work:
        """Enqueue the encoding of the outputs in a buffer. `matrix` converts them to linear values of the picture."""
        work = Work(self.device, self.stages)
        with refusals(self.device):
            kernel = self._programs.encoder(layout.display_macros(display))
            target = (
                work.in_place(track.queue, picture, written=True) if self._in_place else self._scratch(None, picture.nbytes)
            )
            shape, cut = (picture.shape[0], picture.shape[1]), self._programs.encoder_cut
            converts = self._constant(matrix, np.float32)
            work.add("encode", self._run(kernel, track, shape, outputs, converts, target, cut=cut))
            work.fetch(track.queue, target, [picture])
        return work

    def _bring(self, values: NDArray, frame: RawFrame, track: Track, band: Band, work: Work) -> None:
        """Enqueue the upload of the raw values for a band of rows and for its margins, which later steps need."""
        source, (rows, columns) = values[band.raw_rows], band.shape(0)
        track.labels = self._scratch(track.labels, 4 * rows * columns)
        if self._in_place and not self._shading.corrects(frame):
            track.raw = work.in_place(track.queue, source)
        else:
            track.uploaded = self._scratch(track.uploaded, source.nbytes)
            track.raw = work.upload(track.queue, source, track.uploaded)
        if len(self._sets) > 1:
            track.chosen = self._chosen(frame, track, band, work)
        if self._shading.corrects(frame):
            work.add("classes", self._shading.correct(frame, track, band))

    def _chosen(self, frame: RawFrame, track: Track, band: Band, work: Work) -> tuple[Any, ...]:
        """Enqueue the upload of the index of each pixel's set of transforms. Return the buffer in a tuple."""
        rows = band.reads[0]
        pixels = np.zeros((rows.stop - rows.start) * band.columns + READ_AHEAD, np.uint8)
        pixels[:-READ_AHEAD].reshape(-1, band.columns)[...] = self._sets.chosen(frame)[rows]
        if self._in_place:
            return (work.in_place(track.queue, pixels),)
        track.sets = self._scratch(track.sets, pixels.nbytes)
        return (work.upload(track.queue, pixels, track.sets),)

    def _decides(self, track: Track, band: Band) -> tuple[Any, ...]:
        """Return the buffer arguments of the kernel that classifies pixels for the first layer."""
        return track.raw, *band.mosaic_source, *self._class_buffers, *track.chosen, track.labels

    def _site(self, band: Band, frame: RawFrame) -> tuple[np.int32, np.int32]:
        """Return the CFA row and column of the first pixel in a band of rows."""
        return np.int32((frame.phase[0] + band.reads[0].start) % self.table.cfa.shape[0]), np.int32(frame.phase[1])

    def _classify_refinement(self, number: int, track: Track, band: Band, frame: RawFrame, work: Work) -> None:
        """Enqueue the kernels for the input planes and the class map of refinement layer `number` (from 0)."""
        step, (rows, columns), made = self._layers[number], band.shape(number), band.shape(number + 1)
        track.planes[number] = self._scratch(track.planes[number], 4 * layout.PLANES * rows * columns)
        kernel = self._programs.planes(number, self._joined and not number)
        reads, ends = self._reads(number, track, band, frame)
        buffers = (*reads, step.weights, step.nothing, track.planes[number], np.float32(0), *ends)
        work.add("planes", self._run(kernel, track, (rows, columns), *buffers))
        track.refined_labels[number] = self._scratch(track.refined_labels[number], 4 * made[0] * columns)
        buffers = (track.planes[number], track.labels, *band.later[number].classes, *step.rule, track.refined_labels[number])
        work.add("structures", self._run(self._programs.classes(number + 1), track, made, *buffers, np.int32(rows)))

    def _reads(self, number: int, track: Track, band: Band, frame: RawFrame) -> tuple[tuple[Any, ...], tuple[np.int32, ...]]:
        """Return two groups of arguments of the kernel that applies a layer's transforms.

        The first group consists of the raw values or planes, the index buffers for padding, and the class map. If the kernel
        also classifies the pixels, the first group includes the class rule. The second group consists of integers, which are
        the last arguments of the kernel.
        """
        if self._joined and not number:
            return self._decides(track, band), self._site(band, frame)
        if not number:
            return (track.raw, *band.mosaic_source, track.labels), (np.int32(0),)
        read = (track.planes[number - 1], *band.later[number - 1].transforms, track.refined_labels[number - 1])
        return read, (np.int32(band.shape(number - 1)[0]),)

    def _transform(
        self, kernel: Any, encoding: Any, track: Track, band: Band, result: Any, frame: RawFrame, work: Work,
        ending: layout.Macros,
    ) -> None:  # fmt: skip
        """Enqueue all steps of the last layer for a band of rows. They write to `result`.

        These are the transforms with the encoding. If the table uses them, coarse chroma and the correction of clipped areas
        precede the transforms, and the smoothing of spectra or chroma follows.
        """
        number = len(self._layers)
        smooths = self._spectra or self._chroma
        into = smooths.room(track, band) if smooths else result
        made = (into, *self._shading.gain(frame.shading, band.made))
        if self._coarse:
            events, blocks = self._coarse.blocks(track, band, self._sets.share(frame))
            made += blocks
            if self._clipping:
                further, maps = self._clipping.maps(track, band, frame)
                events, made = [*events, *further], (*made, maps)
            work.events[COARSE_CHROMA] += events
        if self._corrects:
            made += self._first_outputs(track, band, frame, work)
        reads, ends = self._reads(number, track, band, frame)
        arguments = (*reads, self._weights, encoding, *made, np.float32(frame.black_level), *ends)
        work.add("transforms", self._run(kernel, track, band.shape(number), *arguments))
        if self._spectra:
            work.add(SPECTRA, self._spectra.smooth(track, band, result, len(frame.values)))
        if self._chroma:
            gain, shaded = self._shading.gain(frame.shading, band.made), self._shading.macros(frame.shading)
            work.add(CHROMA, self._chroma.smooth(track, band, encoding, result, frame, gain, {**ending, **shaded}))

    def _first_outputs(self, track: Track, band: Band, frame: RawFrame, work: Work) -> tuple[Any, ...]:
        """Enqueue the kernel that computes the first layer's outputs, which the last layer corrects.

        Return the buffer of these outputs in a tuple.
        """
        (rows, columns), step = band.shape(0), self._layers[0]
        size = 4 * len(self.table.outputs) * rows * columns
        track.first = self._scratch(track.first, size + 4 * READ_AHEAD)
        reads, ends = (track.raw, *band.mosaic_source, track.labels), (np.float32(frame.black_level), np.int32(0))
        buffers = *reads, self._first_weights, step.nothing, track.first
        work.add("transforms", self._run(self._programs.first_outputs(), track, (rows, columns), *buffers, *ends))
        return (track.first,)

    def _target(self, track: Track, parts: list[NDArray], work: Work) -> Any:
        """Return the buffer for the results of a band of rows. If possible, it is the memory of the result array itself."""
        if self._in_place and len(parts) == 1:
            return work.in_place(track.queue, parts[0], written=True)
        track.result = self._scratch(track.result, sum(part.nbytes for part in parts))
        return track.result

    def _run(self, kernel: Any, track: Track, shape: tuple[int, int], *arguments: Any, cut: layout.Cut | None = None) -> Any:
        """Enqueue a kernel for all pixels of an area. The area's size (rows, columns) is appended to the arguments."""
        rows, columns = shape
        cut = cut or self._cut
        grid = (-(-columns // cut.tile) * cut.group[0], -(-rows // cut.band) * cut.group[1])
        return track.run(kernel, grid, cut.group, *arguments, np.int32(rows), np.int32(columns))

    def _kernel(self, source: str, macros: layout.Macros, name: str) -> Any:
        return pyopencl().Kernel(self._compiler.build(source, {**macros, **self._cut.macros}), name)

    def _bands(self, shape: tuple[int, ...]) -> tuple[Band, ...]:
        """Divide a frame of the size `shape` into bands of rows. The latest result is cached."""
        if self._frame_bands is None or self._frame_bands[0] != shape:
            self._frame_bands = shape, tuple(bands(self.table, shape, self._constant))
        return self._frame_bands[1]
