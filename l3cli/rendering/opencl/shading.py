"""Shading on an OpenCL device: single channels' share off the raw values, all channels' onto the outputs (shading.py)."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import FRACTION, STEP, Shading, clipped_from
from l3cli.rendering.opencl.layout import Macros, joined_files
from l3cli.rendering.opencl.work import Band, Track

LONG_RUN = 1 << 14  # pixels of a work-item with vectors
GROUP = 64  # work-items of one pixel each


class DeviceShading:
    """Kernel and buffers, made when the first frame with a shading comes; buffers are kept while frames share theirs."""

    def __init__(self, kernel: Callable[[str, Macros, str], Any], constant: Callable[[NDArray], Any], lanes: int) -> None:
        """`kernel` makes a kernel of source, macros and name, `constant` puts an array on the device; `lanes`: of its
        vectors."""
        self._make, self._constant, self._run = kernel, constant, LONG_RUN if lanes > 1 else 1
        self._kernel: Any = None
        self._shading: Shading | None = None
        self._buffers: dict[tuple[str, int, int], Any] = {}

    @staticmethod
    def macros(shading: Shading | None) -> Macros:
        """Return the macros with which a kernel of the last layer is built."""
        return {} if shading is None else {"SHADED": 1, "GAIN_STEP": STEP}

    def gain(self, shading: Shading | None, rows: slice) -> tuple[Any, ...]:
        """The buffer of a band's gains, which kernels take that are built so."""
        return () if shading is None else (self._buffer(shading, "gain", rows),)

    @staticmethod
    def evens(frame: RawFrame) -> bool:
        """Return whether a frame's channels are shaded unlike, so that its values on the device must be writable."""
        return frame.shading is not None and frame.shading.tint is not None

    def even(self, frame: RawFrame, track: Track, band: Band) -> Any:
        """Enqueue the evening of a band's raw values on the device, which are those of a frame at the table's levels and
        `evens`."""
        if self._kernel is None:
            macros: Macros = {"FRACTION": FRACTION, "RUN": self._run}
            self._kernel = self._make(joined_files("common/vectors.cl", "common/shading.cl"), macros, "even_channels")
        pixels = (band.raw_rows.stop - band.raw_rows.start) * band.columns
        levels = round(frame.black_level), clipped_from(frame.black_level, frame.white_level), pixels
        assert frame.shading is not None
        tint = self._buffer(frame.shading, "tint", band.raw_rows)
        items, group = -(-pixels // self._run), GROUP if self._run == 1 else 1
        grid = (-(-items // group) * group,)
        return track.run(self._kernel, grid, (group,), track.raw, tint, *map(np.int32, levels))

    def _buffer(self, shading: Shading, name: str, rows: slice) -> Any:
        if shading is not self._shading:
            self._shading, self._buffers = shading, {}
        key = (name, rows.start, rows.stop)
        if key not in self._buffers:
            self._buffers[key] = self._constant(getattr(shading, name)[rows])
        return self._buffers[key]
