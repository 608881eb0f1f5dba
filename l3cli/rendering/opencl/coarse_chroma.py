"""Coarse chroma on an OpenCL device: what a last layer reads of far pixels (l3cli/classes/coarse_chroma.py is the truth)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from l3cli.artifacts.table import CoarseChroma
from l3cli.classes.coarse_chroma import BLOCK, SPACINGS, scales_of
from l3cli.classes.planes import LUMINANCE
from l3cli.rendering.opencl.devices import pyopencl
from l3cli.rendering.opencl.layout import COARSE_MACROS, COARSE_MARGIN, FAR, joined_files
from l3cli.rendering.opencl.work import Band, Track

FILES = {"processor": "cpu/coarse_chroma.cl", "graphics": "gpu/coarse_chroma.cl"}
BEYOND = 16  # behind the last of a row, which vectors may read


class DeviceCoarseChroma:
    """Kernels and buffers of a table whose last layer takes chroma from far around, made when the first frame comes."""

    def __init__(
        self, kernel: Callable[..., Any], run: Callable[..., Any], constant: Callable[..., Any], chroma: CoarseChroma,
        variant: str,
    ) -> None:  # fmt: skip
        """Build the kernels. `kernel` makes a kernel of source, macros and name, `run` enqueues one on a track, over rows
        and columns, `constant` puts an array on the device."""
        self._make, self._run, self._constant, self._chroma, self._variant = kernel, run, constant, chroma, variant
        self._kernels: list[Any] = []  # average, soften
        self._scales: dict[float, list[Any]] = {}  # by share of the noise, each step's

    def blocks(self, track: Track, band: Band, share: float) -> tuple[list[Any], tuple[Any, Any]]:
        """Enqueue what makes coarse chroma of the planes that a band's last layer reads: the events, and the buffers of
        blocks before and after, which the layer reads beside. `share`: of the camera's noise."""
        if not self._kernels:
            source = joined_files("common/vectors.cl", "common/coarse_chroma.cl", FILES[self._variant])
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
        """Return the buffers of a track for planes of a shape; blocks lie within margins that are FAR from all."""
        if track.coarse is None or track.coarse[0] != shape:
            cl, context = pyopencl(), track.queue.context
            rows, columns = _blocks(shape)
            size = 4 * (3 * (rows + 2 * COARSE_MARGIN) * (columns + 2 * COARSE_MARGIN + BEYOND) + BEYOND)
            buffers = [cl.Buffer(context, cl.mem_flags.READ_WRITE, size) for _ in range(3)]
            for buffer in buffers:
                cl.enqueue_fill_buffer(track.queue, buffer, np.float32(FAR), 0, size)
            track.coarse = shape, buffers
        return track.coarse[1]


def _blocks(shape: tuple[int, int]) -> tuple[int, int]:
    return -(-shape[0] // BLOCK), -(-shape[1] // BLOCK)
