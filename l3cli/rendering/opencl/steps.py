"""Steps on an OpenCL device that few frames need: shading (frames/shading.py), the share of single channels off the raw
values, that of all onto the outputs; and smoothed spectra (reference.py)."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import FRACTION, STEP, Shading, clipped_from
from l3cli.rendering.opencl.layout import Macros, joined_files
from l3cli.rendering.opencl.work import Band, Track, scratch
from l3cli.rendering.reference import SPECTRA_DARKEST

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
    def corrects(frame: RawFrame) -> bool:
        """Return whether a frame's channels are shaded unlike, so that its values on the device must be writable."""
        return frame.shading is not None and frame.shading.colour is not None

    def correct(self, frame: RawFrame, track: Track, band: Band) -> Any:
        """Enqueue the colour shading correction of a band's raw values, those of a frame at the table's levels which this
        `corrects`."""
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


FILES = {"processor": "cpu/spectra.cl", "graphics": "gpu/spectra.cl"}


class DeviceSpectra:
    """The kernel of a table that smooths spectra, made when the first frame comes."""

    def __init__(
        self, kernel: Callable[[str, Macros, str], Any], run: Callable[..., Any], table: TransformTable, variant: str
    ) -> None:
        """`kernel` makes a kernel of source, macros and name, `run` enqueues one on a track, over rows and columns."""
        assert table.spectra is not None
        self._make, self._run, self._variant = kernel, run, variant
        self._outputs, self._smoothing = len(table.outputs), table.spectra
        self._kernel: Any = None

    def room(self, track: Track, band: Band) -> Any:
        """The buffer of the track for what the last layer makes of a band."""
        size = 4 * self._outputs * (band.made.stop - band.made.start) * band.columns
        track.made = scratch(track.queue.context, track.made, size)
        return track.made

    def smooth(self, track: Track, band: Band, result: Any, frame_rows: int) -> Any:
        """Enqueue it for a band whose outputs lie in the track's `room`; its own rows go to the buffer `result`."""
        if self._kernel is None:
            macros: Macros = {
                "OUTPUTS": self._outputs,
                "WINDOW": self._smoothing.window,
                "RADIUS": self._smoothing.radius,
                "DARKEST": f"{SPECTRA_DARKEST!r}f",
            }
            source = joined_files("common/vectors.cl", "common/spectra.cl", FILES[self._variant])
            self._kernel = self._make(source, macros, "smooth_spectra")
        made, first = band.made, band.rows.start
        where = map(np.int32, (made.stop - made.start, made.start, first, frame_rows))
        reach = np.float32(self._smoothing.reach)
        return self._run(self._kernel, track, band.shape(-1), track.made, result, reach, *where)
