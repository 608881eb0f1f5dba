"""Temporal filter on an OpenCL device.

Each kernel in opencl/common/temporal*.cl implements one step of reference.py or motion.py.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.frame import NoiseLeft, RawFrame
from l3cli.rendering.opencl import layout
from l3cli.rendering.opencl.devices import pyopencl, refusals
from l3cli.rendering.opencl.programs import Compiler, chosen
from l3cli.rendering.opencl.work import Work, shares_memory
from l3cli.rendering.temporal import motion, reference
from l3cli.rendering.temporal.noise import (
    LINEAR_FRACTION,
    ONE,
    UNEVEN_FRACTION,
    Grid,
    NoiseTerms,
    kind_of,
    noise_of,
    settings_of,
    share_left,
    times_brighter,
)

STRIPS = {"processor": 32, "graphics": 1}  # variant → number of blocks, cells or CFA periods per work-item
MARGIN_PIXELS = 4  # width of the margin around a plane
PADDING_COLUMNS = 8  # number of additional columns after the margin
TILE_ROWS = 4  # number of window rows to read together
STAGES = ("upload", "download")
KERNELS = ("planes", "search", "evidence", "weigh", "blend")


class Device:
    """An OpenCL device with a queue and the kernels of the temporal filter.

    Parameters
    ----------
    period : tuple of int
        CFA period (rows, columns) in pixels.
    device, variant : str, optional
        As in `OpenCLRenderer`.

    Raises
    ------
    DeviceError
        If there is no such device, or if the device fails.
    """

    def __init__(self, period: tuple[int, ...], device: str | None = None, variant: str | None = None) -> None:
        cl = pyopencl()
        self.device, name = chosen(device, variant)
        self.strip, self.in_place = STRIPS[name], shares_memory(self.device)
        with refusals(self.device):
            self.context = cl.Context([self.device])
            self.queue = cl.CommandQueue(self.context)
            files = ("common/vectors.cl", "common/temporal.cl", "common/temporal_motion.cl", "common/temporal_blend.cl")
            source, macros = layout.joined_files(*files), _macros(period)
            lanes = 1 if self.strip == 1 else 16 if int(macros["BLOCK_COLUMNS"]) % 16 == 0 else 8
            program = Compiler(self.context, self.device).build(source, {**macros, "STRIP": self.strip, "LANES": lanes})
            self.kernels = {name: cl.Kernel(program, name) for name in KERNELS}
            self._typed: set[str] = set()

    def run(self, name: str, rows: int, columns: int, *arguments: Any) -> None:
        """Enqueue a kernel over `rows` × `columns` elements, `strip` columns per work-item.

        Integer arguments are passed as int32.
        """
        kernel, grid = self.kernels[name], (-(-columns // self.strip), rows)
        if name not in self._typed:  # declaring the types takes time, as in work.Track.run
            kernel.set_scalar_arg_dtypes([np.int32 if isinstance(each, int) else None for each in arguments])
            self._typed.add(name)
        kernel(self.queue, grid, (1, 1) if self.strip > 1 else None, *arguments)

    def buffer(self, size: int) -> Any:
        return pyopencl().Buffer(self.context, pyopencl().mem_flags.READ_WRITE, size)

    def cleared(self, size: int) -> Any:
        """Allocate a zero-filled device buffer of `size` bytes."""
        flags = pyopencl().mem_flags
        return pyopencl().Buffer(self.context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=np.zeros(size, np.uint8))


def _macros(period: tuple[int, ...]) -> layout.Macros:
    grid = Grid.of((1, 1), period)
    names = (
        "ONE",
        "LEAST_WEIGHT",
        "POWER_FREE",
        "POWER_FACTOR",
        "MEAN_FREE",
        "WIDE_FREE",
        "CLIPPED",
        "MOST_VARIANCE",
        "CUT",
        "FEW",
    )
    return {
        "PERIOD_ROWS": grid.period[0],
        "PERIOD_COLUMNS": grid.period[1],
        "CELL_DOWN": grid.block[0] // grid.cell[0],
        "CELL_ACROSS": grid.block[1] // grid.cell[1],
        "BLOCK_ROWS": grid.block[0],
        "BLOCK_COLUMNS": grid.block[1],
        "PLANES": grid.planes,
        "SHARE_BITS": ONE.bit_length() - 1,
        "LINEAR_FRACTION": LINEAR_FRACTION,
        "UNEVEN_FRACTION": UNEVEN_FRACTION,
        "MARGIN": MARGIN_PIXELS,
        "PADDING": PADDING_COLUMNS,
        "TILE_ROWS": TILE_ROWS,
        "MOST_BEYOND": f"{reference.MOST_BEYOND}L",
        "MOST_DIFFERENCE": motion.CLIPPED,
        "SETTLED": motion.SETTLED,
        "RELUCTANCE": motion.RELUCTANCE,
        "FARTHEST": motion.MAX_COARSE_DISPLACEMENT,
        **{name: getattr(reference, name) for name in names},
    }


class _Buffers:
    """Device buffers of a filter, for frames of the same size, phase and levels."""

    def __init__(self, device: Device, grid: Grid, noise: NoiseTerms) -> None:
        pixels, blocks = (int(np.prod(sides)) for sides in (grid.shape, grid.blocks))
        flags = pyopencl().mem_flags
        self.history = [device.buffer(2 * pixels) for _ in range(2)]  # filter state before and after this frame
        self.now, self.before = (device.buffer(2 * _units(grid)) for _ in range(2))
        self.vectors = [device.buffer(8 * blocks) for _ in range(2)]
        # Noise fractions of the cells, with a margin.
        self.host_left = np.empty((grid.cells[0] + 2, grid.cells[1] + 2 * PADDING_COLUMNS), np.uint16)
        self.left = [device.cleared(self.host_left.nbytes) for _ in range(2)]
        self.weights = device.cleared(self.host_left.nbytes)
        self.found = [device.cleared(4 * self.host_left.size) for _ in ("power", "sum", "variance")]
        self.strips = grid.blocks[0] * -(-grid.blocks[1] // device.strip)
        self.cuts = device.buffer(4 * self.strips)
        read_only = flags.READ_ONLY | flags.COPY_HOST_PTR
        self.spread = pyopencl().Buffer(device.context, read_only, hostbuf=noise.spread)
        # A device that shares host memory reads and writes the host arrays of a frame directly.
        self.borders = None if device.in_place else (device.buffer(2 * pixels), device.buffer(2 * pixels))


class OpenCLFilter:
    """Temporal filter on an OpenCL device.

    Parameters
    ----------
    device : Device
        Device with the kernels. Several filters may share it.
    period : tuple of int
        CFA period (rows, columns) in pixels.
    camera : CameraModel
        Camera that took the frames.
    """

    def __init__(self, device: Device, period: tuple[int, ...], camera: CameraModel) -> None:
        self._device, self._period, self._camera = device, period, camera
        self._kind: tuple[object, ...] | None = None
        self._settings: tuple[float, float | None] = (1.0, None)  # gain and exposure time of the previous frame

    def filtered(self, frame: RawFrame) -> RawFrame:
        """Blend the next frame with the previous frames, and return the result with the noise fraction of each cell.

        If the size, phase or levels of the frame have changed, the filter restarts. If the gain or exposure time has
        changed, the filter first converts its state.
        """
        with refusals(self._device.device):
            first = kind_of(frame) != self._kind
            if first:
                self._kind, self._grid = kind_of(frame), Grid.of(frame.values.shape, self._period)
                self._noise = self._noise_of(frame)
                self._buffers = _Buffers(self._device, self._grid, self._noise)
            elif settings_of(frame) != self._settings:
                self._rescale(frame)
            self._settings = settings_of(frame)
            device, buffers, grid, work = self._device, self._buffers, self._grid, Work(self._device.device, STAGES)
            values, made = grid.padded(frame.values), np.empty(grid.shape, np.uint16)
            raw, target = self._borders(work, values, made)
            if not first:
                self._weigh(raw, self._search(raw))
            levels = (self._noise.protect, int(first), buffers.strips, int(np.prod(grid.cells)), *grid.blocks)
            device.run(
                "blend", *grid.blocks, raw, buffers.history[0], buffers.vectors[0], buffers.weights, buffers.cuts,
                buffers.history[1], buffers.left[1], target, buffers.before, *levels,
            )  # fmt: skip
            pyopencl().enqueue_copy(device.queue, buffers.host_left, buffers.left[1], is_blocking=False)
            work.fetch(device.queue, target, [made])
            work.end()
            for pair in (buffers.history, buffers.left):
                pair.reverse()
            rows, cols = frame.values.shape
            left = int(buffers.host_left.sum(dtype=np.int64)) / (int(np.prod(grid.cells)) * ONE)
            share = share_left(self._camera.at_gain(frame.gain), frame, left)
            of_cells = NoiseLeft(buffers.host_left[1:-1, PADDING_COLUMNS:-PADDING_COLUMNS].copy(), ONE, grid.cell)
            return replace(frame, values=made[:rows, :cols], noise_share=share, noise_left=of_cells)

    def history(self) -> NDArray[np.uint16]:
        """Return the filtered values (row, col) after the latest frame, in units of u (see the module `noise`)."""
        values = np.empty(self._grid.shape, np.uint16)
        pyopencl().enqueue_copy(self._device.queue, values, self._buffers.history[0])
        return values

    def _noise_of(self, frame: RawFrame) -> NoiseTerms:
        return noise_of(self._camera.at_gain(frame.gain), frame.black_level, frame.white_level, self._grid)

    def _rescale(self, frame: RawFrame) -> None:
        """Convert the filter state to a new gain or exposure time. This is rare and therefore done on the host."""
        device, buffers, grid, noises = self._device, self._buffers, self._grid, (self._noise, self._noise_of(frame))
        left = buffers.host_left[1:-1, PADDING_COLUMNS:-PADDING_COLUMNS]
        before = reference.Blend(self.history(), left.astype(np.int64))
        made = reference.rescaled(before, times_brighter(settings_of(frame), self._settings), grid, noises)
        left[:], self._noise = made.left, noises[1]
        targets = buffers.history[0], buffers.left[0], buffers.spread
        for target, values in zip(targets, (made.values, buffers.host_left, self._noise.spread), strict=True):
            pyopencl().enqueue_copy(device.queue, target, values)
        self._planes(buffers.history[0], buffers.before, buffers.now, 0)

    def _planes(self, values: Any, made: Any, before: Any, free_bits: int) -> None:
        """Compute the image pyramids of the new frame and of the previous frame.

        The new frame's pyramid is computed from `values`, and stored in `made`. The previous frame's pyramid is in `before`,
        which already contains the finest plane.
        """
        grid = self._grid
        parts = -(-grid.shape[0] // (grid.period[0] << grid.planes - 1))
        self._device.run("planes", 2 * parts, grid.blocks[1], values, made, before, free_bits, *grid.blocks)

    def _borders(self, work: Work, values: NDArray[np.uint16], made: NDArray[np.uint16]) -> tuple[Any, Any]:
        """Return the device buffers for the raw values and for the filtered values."""
        device, buffers = self._device, self._buffers
        if buffers.borders is None:
            return work.in_place(device.queue, values), work.in_place(device.queue, made, written=True)
        return work.upload(device.queue, values, buffers.borders[0]), buffers.borders[1]

    def _search(self, raw: Any) -> Any:
        """Compute the motion vectors, and return their buffer. Vectors are in CFA periods."""
        device, buffers, grid = self._device, self._buffers, self._grid
        self._planes(raw, buffers.now, buffers.before, self._noise.protect)
        for level in reversed(range(grid.planes)):
            buffers.vectors.reverse()
            window = grid.window(level)
            device.run(
                "search", *grid.blocks, buffers.now, buffers.before, buffers.vectors[1], buffers.vectors[0], buffers.spread,
                level, *window, motion.root_of(window), *grid.blocks,
            )  # fmt: skip
        return buffers.vectors[0]

    def _weigh(self, raw: Any, vectors: Any) -> None:
        device, buffers, grid, noise = self._device, self._buffers, self._grid, self._noise
        constant = min(grid.sites * noise.constant, reference.MOST_VARIANCE)
        terms = (noise.protect, noise.black, noise.linear, constant, noise.fixed, noise.uneven)
        device.run(
            "evidence", *grid.blocks, raw, buffers.history[0], vectors, buffers.left[0], *buffers.found, buffers.weights,
            *terms, grid.blocks[1],
        )  # fmt: skip
        device.run(
            "weigh", *grid.blocks, *buffers.found, buffers.weights, buffers.left[1], buffers.cuts, noise.shared_in_cells,
            noise.shared_nearby, grid.blocks[1],
        )  # fmt: skip


def _units(grid: Grid) -> int:
    """Return the number of samples in an image pyramid, including margins for windows that extend beyond the frame."""
    rows, cols = (side // period for side, period in zip(grid.shape, grid.period, strict=True))
    planes = ((rows >> level, cols >> level) for level in range(grid.planes))
    return sum(
        (down + 2 * MARGIN_PIXELS + TILE_ROWS) * (across + 2 * MARGIN_PIXELS + PADDING_COLUMNS) for down, across in planes
    )


def opencl_filters(
    period: tuple[int, ...], camera: CameraModel, device: str | None = None, variant: str | None = None
) -> Callable[[], OpenCLFilter]:
    """Return a function that creates temporal filters on a device. Parameters are as in `Device` and `OpenCLFilter`.

    The filters share their kernels, so they must all be used in the same thread.
    """
    shared = Device(period, device, variant)
    # PoCL compiles a kernel when it is first run. Two tiny frames are filtered now, so that all kernels are compiled before
    # a renderer in another thread compiles its kernels.
    first, tiny = OpenCLFilter(shared, period, camera), Grid.of((1, 1), period).shape
    for _ in range(2):
        first.filtered(RawFrame("none", np.zeros(tiny, np.uint16), camera.black_level, camera.white_level))
    return lambda: OpenCLFilter(shared, period, camera)
