"""Coarse chroma on an OpenCL device: the means that a last layer reads (l3cli/classes/coarse_chroma.py is the truth)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from l3cli.artifacts.table import CoarseChroma
from l3cli.classes.coarse_chroma import BIN, SPACINGS, scales_of
from l3cli.classes.planes import LUMINANCE
from l3cli.rendering.opencl.devices import pyopencl
from l3cli.rendering.opencl.layout import COARSE_MACROS, COARSE_MARGIN, FAR, joined_files
from l3cli.rendering.opencl.work import Band, Track

FILES = {"processor": "cpu/coarse_chroma.cl", "graphics": "gpu/coarse_chroma.cl"}
BEYOND = 16  # means behind the last of a row, which vectors may read


class DeviceCoarseChroma:
    """Kernels and buffers of a table whose last layer takes chroma from far around, made when the first frame comes."""

    def __init__(
        self, kernel: Callable[..., Any], run: Callable[..., Any], constant: Callable[..., Any], chroma: CoarseChroma,
        variant: str,
    ) -> None:  # fmt: skip
        """`kernel` makes a kernel of source, macros and name, `run` enqueues one on a track, over rows and columns,
        `constant` puts an array on the device."""
        self._make, self._run, self._constant, self._chroma, self._variant = kernel, run, constant, chroma, variant
        self._bin: Any = None
        self._soften: Any = None
        self._scales: dict[float, list[Any]] = {}  # by share of the noise, each comparison's

    def means(self, track: Track, band: Band, share: float) -> tuple[Any, tuple[Any, ...]]:
        """Enqueue what makes the means of the planes that a band's last layer reads: the last event, and the buffers that
        the layer reads beside. `share`: of the camera's noise."""
        if self._bin is None:
            source = joined_files("common/vectors.cl", "common/coarse_chroma.cl", FILES[self._variant])
            macros = {**COARSE_MACROS, "LUMINANCE": LUMINANCE}
            self._bin, self._soften = (self._make(source, macros, name) for name in ("bin_planes", "soften"))
        if share not in self._scales:
            self._scales = {share: [self._constant(each, np.float32) for each in scales_of(self._chroma, share)]}
        scales, planes = self._scales[share], band.shape(len(band.later) - 1)
        shape = -(-planes[0] // BIN), -(-planes[1] // BIN)
        where = tuple(map(np.int32, planes))
        from_planes, first, other = self._room(track, shape)
        self._run(self._bin, track, shape, track.planes[-1], from_planes, *where)
        steps = ((from_planes, first), (first, from_planes), (from_planes, other), (other, from_planes))
        for (before, after), scale, spacing in zip(steps, scales, SPACINGS, strict=False):
            event = self._run(self._soften, track, shape, before, after, scale, np.int32(spacing), *where)
        return event, (first, steps[-1][1], scales[-1])

    def _room(self, track: Track, shape: tuple[int, int]) -> list[Any]:
        """The buffers of a track for means of a shape, within margins that are FAR from all."""
        if track.means is None or track.means[0] != shape:
            cl, context = pyopencl(), track.queue.context
            stride = shape[1] + 2 * COARSE_MARGIN + BEYOND
            size = 4 * (3 * (shape[0] + 2 * COARSE_MARGIN) * stride + BEYOND)
            buffers = [cl.Buffer(context, cl.mem_flags.READ_WRITE, size) for _ in range(3)]
            for buffer in buffers:
                cl.enqueue_fill_buffer(track.queue, buffer, np.float32(FAR), 0, size)
            track.means = shape, buffers
        return list(track.means[1])
