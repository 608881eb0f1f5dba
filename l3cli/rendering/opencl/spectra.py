"""Smoothed spectra on an OpenCL device: what the last layer makes of a band → its rows (rendering/smoothing.py)."""

from collections.abc import Callable
from typing import Any

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.rendering.opencl.layout import Macros, joined_files
from l3cli.rendering.opencl.work import Band, Track, scratch
from l3cli.rendering.smoothing import DARKEST

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
                "DARKEST": f"{DARKEST!r}f",
            }
            source = joined_files("common/vectors.cl", "common/spectra.cl", FILES[self._variant])
            self._kernel = self._make(source, macros, "smooth_spectra")
        made, first = band.made, band.rows.start
        where = map(np.int32, (made.stop - made.start, made.start, first, frame_rows))
        reach = np.float32(self._smoothing.reach)
        return self._run(self._kernel, track, band.shape(-1), track.made, result, reach, *where)
