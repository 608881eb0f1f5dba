"""Shading on an OpenCL device: single channels' share off the raw values, all channels' onto the outputs (shading.py)."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frame import RawFrame
from l3cli.rendering.layout import Macros, texts
from l3cli.rendering.opencl_devices import pyopencl
from l3cli.rendering.opencl_work import Band, Track
from l3cli.shading import FRACTION, STEP, Shading, clipped_from

LONG_RUN = 1 << 14  # pixels of a work-item with vectors
GROUP = 64  # work-items of one pixel each


class DeviceShading:
    """Kernel and buffers, made when the first frame with a shading comes; buffers are kept while frames share theirs."""

    def __init__(self, build: Callable[[str, Macros], Any], constant: Callable[[NDArray], Any], lanes: int) -> None:
        """`build` makes a program of source and macros, `constant` puts an array on the device; `lanes`: of its vectors."""
        self._build, self._constant, self._run = build, constant, LONG_RUN if lanes > 1 else 1
        self._kernel: Any = None
        self._shading: Shading | None = None
        self._buffers: dict[tuple[str, int, int], Any] = {}

    @staticmethod
    def macros(shading: Shading | None) -> Macros:
        """What a kernel of the last layer is to be built with."""
        return {} if shading is None else {"SHADED": 1, "GAIN_STEP": STEP}

    def gain(self, shading: Shading | None, rows: slice) -> tuple[Any, ...]:
        """The buffer of a band's gains, which kernels take that are built so."""
        return () if shading is None else (self._buffer(shading, "gain", rows),)

    def even(self, frame: RawFrame, track: Track, band: Band) -> Any:
        """Enqueue the evening of a band's raw values on the device, which are those of a frame at the table's levels; None
        if its channels are shaded alike."""
        if frame.shading is None or frame.shading.tint is None:
            return None
        if self._kernel is None:
            program = self._build(texts(("vectors.cl", "shading.cl")), {"FRACTION": FRACTION, "RUN": self._run})
            self._kernel = pyopencl().Kernel(program, "even_channels")
        pixels = (band.raw_rows.stop - band.raw_rows.start) * band.columns
        levels = round(frame.black_level), clipped_from(frame.black_level, frame.white_level), pixels
        tint = self._buffer(frame.shading, "tint", band.raw_rows)
        items, group = -(-pixels // self._run), GROUP if self._run == 1 else 1
        grid = (-(-items // group) * group,)
        return self._kernel(track.queue, grid, (group,), track.raw, tint, *map(np.int32, levels))

    def _buffer(self, shading: Shading, name: str, rows: slice) -> Any:
        if shading is not self._shading:
            self._shading, self._buffers = shading, {}
        key = (name, rows.start, rows.stop)
        if key not in self._buffers:
            self._buffers[key] = self._constant(getattr(shading, name)[rows])
        return self._buffers[key]
