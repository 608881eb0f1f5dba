"""Smooth spectra and chroma on an OpenCL device. The reference is in l3cli/rendering/reference.py."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame
from l3cli.rendering.opencl import layout
from l3cli.rendering.opencl.devices import pyopencl
from l3cli.rendering.opencl.layout import Macros, paired_source
from l3cli.rendering.opencl.programs import Compiler
from l3cli.rendering.opencl.work import Band, Track, scratch
from l3cli.rendering.reference import (
    CHROMA_NEIGHBOURS,
    CHROMA_REACH,
    FAR_CHROMA_NEIGHBOURS,
    FAR_LIKENESS,
    MAX_CONTRAST,
    SMOOTHING_DARKEST,
    least_black_level,
)

NEIGHBOURS = CHROMA_NEIGHBOURS + FAR_CHROMA_NEIGHBOURS
NEIGHBOUR_MACROS: Macros = {
    "CHROMA_REACH": CHROMA_REACH,
    "MAX_CONTRAST": f"{MAX_CONTRAST!r}f",
    "CHROMA_ROWS": ",".join(str(down) for down, _ in NEIGHBOURS),
    "CHROMA_COLUMNS": ",".join(str(right) for _, right in NEIGHBOURS),
    "NEIGHBOURS": len(NEIGHBOURS),
    "NEAR_NEIGHBOURS": len(CHROMA_NEIGHBOURS),
    "FAR_UNLIKE": f"{1 / FAR_LIKENESS**2!r}f",
}
DARKEST: Macros = {"DARKEST": f"{SMOOTHING_DARKEST!r}f"}


def room_for(track: Track, band: Band, outputs: int) -> Any:
    """Return the device buffer for the unsmoothed outputs of a band of rows, enlarged if necessary."""
    track.made = scratch(track.queue.context, track.made, 4 * outputs * (band.made.stop - band.made.start) * band.columns)
    return track.made


def place_of(band: Band, frame_rows: int) -> tuple[np.int32, ...]:
    """Return the last arguments of a smoothing kernel, which state the rows to read and to write.

    These are the number of rows to read, the first row to read, the first row to write, and the number of rows in the frame.
    The first rows are counted from the top of the frame.
    """
    made, first = band.made, band.rows.start
    return tuple(map(np.int32, (made.stop - made.start, made.start, first, frame_rows)))


class DeviceSpectra:
    """Kernel that smooths spectra. It is compiled for the first frame."""

    def __init__(
        self, kernel: Callable[[str, Macros, str], Any], run: Callable[..., Any], table: TransformTable, variant: str
    ) -> None:
        """Store the arguments, without compiling the kernel.

        Parameters
        ----------
        kernel : callable
            Compiles a kernel from its source, macros and name.
        run : callable
            Enqueues a kernel for all pixels of an area.
        table : TransformTable
            Table with spectral smoothing.
        variant : str
            A key of layout.VARIANTS.
        """
        assert table.spectra is not None
        self._make, self._run, self._variant = kernel, run, variant
        self._outputs, self._smoothing = len(table.outputs), table.spectra
        self._kernel: Any = None

    def room(self, track: Track, band: Band) -> Any:
        """Return the buffer for a band's outputs before smoothing."""
        return room_for(track, band, self._outputs)

    def smooth(self, track: Track, band: Band, result: Any, frame_rows: int) -> Any:
        """Enqueue the kernel that smooths the spectra of a band of rows, which are in the buffer that `room` returns.

        Parameters
        ----------
        track : Track
            Command queue and buffers for the band.
        band : Band
            The band.
        result : buffer
            Receives the smoothed outputs, without the margins above and below the band.
        frame_rows : int
            Number of rows in the frame.

        Returns
        -------
        event
            Event of the kernel.
        """
        if self._kernel is None:
            macros: Macros = {
                "OUTPUTS": self._outputs,
                "WINDOW": self._smoothing.window,
                "RADIUS": self._smoothing.radius,
                **DARKEST,
            }
            source = paired_source(self._variant, "spectra.cl", "common/mirrored.cl")
            self._kernel = self._make(source, macros, "smooth_spectra")
        where, reach = place_of(band, frame_rows), np.float32(self._smoothing.reach)
        return self._run(self._kernel, track, band.shape(-1), track.made, result, reach, *where)


class DeviceChroma:
    """Kernels that smooth chroma, raise the luminance of pixels that are too dark, and write outputs or pictures.

    Each kernel is compiled for the first frame that uses it.
    """

    def __init__(
        self,
        compiler: Compiler,
        run: Callable[..., Any],
        constant: Callable[..., Any],
        table: TransformTable,
        variant: str,
        lanes: int,
    ) -> None:
        """Store the arguments, without compiling the kernels.

        Parameters
        ----------
        compiler : Compiler
            Compiler for the device.
        run : callable
            Enqueues a kernel for all pixels of an area.
        constant : callable
            Copies an array to a device buffer.
        table : TransformTable
            Table with chroma smoothing.
        variant : str
            A key of layout.VARIANTS.
        lanes : int
            Vector length.
        """
        assert table.chroma_smoothing is not None
        self._compiler, self._run, self._variant = compiler, run, variant
        self._cut = replace(layout.VARIANTS[variant].chroma_cut, lanes=lanes)
        smoothing, white = table.chroma_smoothing, table.white_point / table.white_point[1]
        self._factors = tuple(map(np.float32, (1 / smoothing.reach, *1 / (smoothing.likeness * white[::2]))))
        self._kernels: dict[tuple[Any, ...], Any] = {}  # `ending` macros → kernel
        self._macros = layout.least_macros(table)
        self._scale = constant(layout.site_scale(table), np.float32) if self._macros else None
        self._least_black_level = np.float32(least_black_level(table))

    def room(self, track: Track, band: Band) -> Any:
        """Return the buffer for a band's outputs before smoothing."""
        return room_for(track, band, 3)

    def smooth(
        self, track: Track, band: Band, encoding: Any, result: Any, frame: RawFrame, gain: tuple[Any, ...], ending: Macros
    ) -> Any:
        """Enqueue the kernel that smooths the chroma of a band of rows, whose outputs are in the buffer that `room` returns.

        Parameters
        ----------
        track : Track
            Command queue and buffers for the band.
        band : Band
            The band.
        encoding : buffer
            Constants for encoding pictures (`layout.display_constants`).
        result : buffer
            Receives the outputs or pixels, without the margins above and below the band.
        frame : RawFrame
            Frame at the table's black and white levels.
        gain : tuple
            The buffer with the band's shading gains, or an empty tuple without shading.
        ending : dict
            Macros that select whether outputs or encoded pixels are written.

        Returns
        -------
        event
            Event of the kernel.
        """
        key = tuple(ending.items())
        if key not in self._kernels:
            macros = {**ending, **DARKEST, **NEIGHBOUR_MACROS, "OUTPUTS": 3, **self._macros, **self._cut.macros}
            source = layout.encoding_source(self._variant, "smoothed_chroma.cl", "common/mirrored.cl")
            self._kernels[key] = pyopencl().Kernel(self._compiler.build(source, macros), "smooth_chroma")
        least = (
            (track.raw, self._scale, self._least_black_level, *map(np.int32, (band.raw_rows.start, *frame.phase)))
            if self._macros
            else ()
        )
        place = place_of(band, len(frame.values))
        arguments = track.made, encoding, result, *gain, *least, *self._factors, *place
        return self._run(self._kernels[key], track, band.shape(-1), *arguments, cut=self._cut)
