"""Run the coarse chroma filter, and the correction of clipped areas, on an OpenCL device.

The reference implementations are in l3cli/classes/coarse_chroma.py and l3cli/classes/clipping.py.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from l3cli.artifacts.layers import CoarseChroma
from l3cli.artifacts.table import TransformTable
from l3cli.classes.clipping import MAPS, QUAD, block_sides, first_bright, spread_spacings
from l3cli.classes.coarse_chroma import BLOCK, SPACINGS, scales_of
from l3cli.classes.planes import LUMINANCE
from l3cli.frames.frame import RawFrame
from l3cli.rendering.opencl.devices import pyopencl
from l3cli.rendering.opencl.layout import COARSE_MACROS, COARSE_MARGIN, UNLIKE_ANY, clipping_macros, paired_source
from l3cli.rendering.opencl.work import Band, Track, scratch

BLOCK_MAPS = 8  # values per block, stored as a float8; the last one is not used
READ_AHEAD = 16  # vector loads may read this number of elements beyond the end of the data


class DeviceCoarseChroma:
    """Kernels and buffers of the coarse chroma filter. The kernels are compiled for the first frame."""

    def __init__(
        self, kernel: Callable[..., Any], run: Callable[..., Any], constant: Callable[..., Any], chroma: CoarseChroma,
        variant: str,
    ) -> None:  # fmt: skip
        """Store the arguments, without compiling the kernels.

        Parameters
        ----------
        kernel : callable
            Compiles a kernel from its source, macros and name.
        run : callable
            Enqueues a kernel for all pixels of an area.
        constant : callable
            Copies an array to a device buffer.
        chroma : CoarseChroma
            Settings of the filter.
        variant : str
            A key of layout.VARIANTS.
        """
        self._make, self._run, self._constant, self._chroma, self._variant = kernel, run, constant, chroma, variant
        self._kernels: list[Any] = []  # "average" and "soften"
        self._scales: dict[float, list[Any]] = {}  # noise fraction → scale of each filter pass

    def blocks(self, track: Track, band: Band, share: float) -> tuple[list[Any], tuple[Any, Any]]:
        """Enqueue the coarse chroma filter for a band of rows.

        Parameters
        ----------
        track : Track
            Command queue and buffers for the band.
        band : Band
            The band.
        share : float
            Noise variance of the frame, as a fraction of the camera's noise variance.

        Returns
        -------
        events : list
            Events of the enqueued kernels.
        blocks : tuple
            Buffers with the block means before and after the filter.
        """
        if not self._kernels:
            source = paired_source(self._variant, "coarse_chroma.cl")
            macros = {**COARSE_MACROS, "LUMINANCE": LUMINANCE}
            self._kernels = [self._make(source, macros, name) for name in ("average", "soften")]
        if share not in self._scales:
            self._scales = {share: [self._constant(each, np.float32) for each in scales_of(self._chroma, share)]}
        (average, soften), shape = self._kernels, band.shape(len(band.later) - 1)
        where, blocks_shape = tuple(map(np.int32, shape)), _blocks(shape)
        before, *others = self._room(track, shape)
        events, last = [self._run(average, track, blocks_shape, track.planes[-1], before, *where)], before
        for number, (scale, spacing) in enumerate(zip(self._scales[share], SPACINGS, strict=True)):
            made = others[number % 2]
            events.append(self._run(soften, track, blocks_shape, last, made, scale, np.int32(spacing), *where))
            last = made
        return events, (before, last)

    def _room(self, track: Track, shape: tuple[int, int]) -> list[Any]:
        """Return three device buffers with one value per block of a plane with the size `shape`.

        Their margins are filled with `UNLIKE_ANY`, so that the filter never averages across the edge of the frame.
        """
        if track.coarse is None or track.coarse[0] != shape:
            cl, context = pyopencl(), track.queue.context
            rows, columns = _blocks(shape)
            size = 4 * (3 * (rows + 2 * COARSE_MARGIN) * (columns + 2 * COARSE_MARGIN + READ_AHEAD) + READ_AHEAD)
            buffers = [cl.Buffer(context, cl.mem_flags.READ_WRITE, size) for _ in range(3)]
            for buffer in buffers:
                cl.enqueue_fill_buffer(track.queue, buffer, np.float32(UNLIKE_ANY), 0, size)
            track.coarse = shape, buffers
        return track.coarse[1]


class DeviceClipping:
    """Kernels and buffers for the correction of clipped areas. The kernels are compiled when the first frame is rendered."""

    def __init__(
        self, kernel: Callable[..., Any], run: Callable[..., Any], constant: Callable[..., Any], table: TransformTable,
        variant: str,
    ) -> None:  # fmt: skip
        """Store the arguments, without compiling the kernels.

        `table` contains the coefficients of the correction. The other arguments are as in `DeviceCoarseChroma`.
        """
        self._make, self._run, self._constant, self._table, self._variant = kernel, run, constant, table, variant
        self._kernels: list[Any] = []  # "measure_blocks", "map_blocks", "spread_estimates" and "read_maps"
        self._constants: list[Any] = []  # buffers with the CFA, and with the response followed by the white

    def maps(self, track: Track, band: Band, frame: RawFrame) -> tuple[list[Any], Any]:
        """Enqueue the kernels that compute the maps for correcting clipped areas (see `classes.clipping`).

        Parameters
        ----------
        track : Track
            Command queue and buffers for the band.
        band : Band
            The band.
        frame : RawFrame
            Frame at the table's black and white levels.

        Returns
        -------
        events : list
            Events of the enqueued kernels.
        quads : buffer
            Maps, with one value for each quad of 2 × 2 pixels.
        """
        table = self._table
        clipping = table.later[-1].clipping
        assert clipping is not None
        if not self._kernels:
            source = paired_source(self._variant, "clipping.cl", "common/quads.cl")
            names = ("measure_blocks", "map_blocks", "spread_estimates", "read_maps")
            self._kernels = [self._make(source, clipping_macros(table), name) for name in names]
            response = np.append(clipping.response, clipping.white)
            self._constants = [self._constant(table.cfa, np.uint8), self._constant(response, np.float32)]
        (measure, make_maps, spread, read), (cfa, response) = self._kernels, self._constants
        rows, columns = frame.values.shape
        blocks = tuple(-(-length // side) for length, side in zip((rows, columns), block_sides(table.cfa), strict=True))
        shape = band.shape(len(band.later) - 1)
        quads = -(-shape[0] // QUAD), -(-shape[1] // QUAD)
        context, size = track.queue.context, 4 * blocks[0] * blocks[1]
        track.means = scratch(context, track.means, size * (len(table.channels) + 1))
        track.maps = scratch(context, track.maps, size * BLOCK_MAPS)
        track.uniformity = scratch(context, track.uniformity, size)
        track.flags = scratch(context, track.flags, blocks[0] * blocks[1])  # at most one per block
        track.estimates = [scratch(context, each, size * (len(table.channels) + 1)) for each in track.estimates]
        row = quads[1] + READ_AHEAD  # padded to whole groups; there are at most as many flags
        track.quads = scratch(context, track.quads, 4 * (MAPS * quads[0] * row + READ_AHEAD) + quads[0] * row)
        bright, span = first_bright(frame.black_level, table.white_level), table.white_level - frame.black_level
        levels = np.int32(bright), np.float32(frame.black_level), np.float32(span)
        where = *frame.phase, band.raw_rows.start, band.raw_rows.stop - band.raw_rows.start, rows, columns
        events = [self._run(measure, track, blocks, track.raw, cfa, track.means, *levels, *map(np.int32, where))]
        (made, other), means, flags = track.estimates, track.means, track.flags
        events.append(self._run(make_maps, track, blocks, means, response, track.maps, track.uniformity, made, other, flags))
        steps = list(zip(*map(spread_spacings, block_sides(table.cfa)), strict=True))
        for number, spacing in enumerate(steps, 1):
            buffers, last = (means, response, track.uniformity, made, other, track.maps, flags), number == len(steps)
            events.append(self._run(spread, track, blocks, *buffers, *map(np.int32, (*spacing, last))))
            made, other = other, made
        where = band.reads[len(band.later) - 1].start, *blocks, *shape
        events.append(self._run(read, track, quads, track.maps, flags, track.quads, *map(np.int32, where)))
        return events, track.quads


def _blocks(shape: tuple[int, int]) -> tuple[int, int]:
    return -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
