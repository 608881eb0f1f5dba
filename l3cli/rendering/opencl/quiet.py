"""Which set of transforms pixels are rendered by, on an OpenCL device (noise_sets.py)."""

from typing import Any

import numpy as np

from l3cli.frames.frame import RawFrame
from l3cli.rendering.noise_sets import Sets, first_layer, later_layers, quiet_pixels
from l3cli.rendering.opencl import layout
from l3cli.rendering.opencl.devices import pyopencl
from l3cli.rendering.opencl.work import Band, Track, Work, scratch

BEYOND = 16  # bytes behind the last pixel, which a vector may read


def last_weights(sets: Sets) -> layout.Weights:
    """Return the weights of the last layer."""
    later = later_layers(sets)
    return layout.later_weights(later[-1]) if later else layout.first_weights(sets[0], first_layer(sets))


def bring(frame: RawFrame, table: Any, track: Track, band: Band, in_place: bool, work: Work) -> tuple[Any, ...]:
    """The buffer that tells of each pixel of a band whether the table's quiet set renders it, as kernels of two sets take
    it. `in_place`: where nothing need be copied."""
    rows = band.reads[0]
    pixels = np.empty((rows.stop - rows.start) * band.columns + BEYOND, np.uint8)
    pixels[:-BEYOND].reshape(-1, band.columns)[...] = quiet_pixels(frame, table)[rows]
    pixels[-BEYOND:] = 0
    if in_place:
        return (work.in_place(track.queue, pixels),)
    work.arrays.append(pixels)
    track.quiet = scratch(track.queue.context, track.quiet, pixels.nbytes)
    work.add("upload", pyopencl().enqueue_copy(track.queue, track.quiet, pixels, is_blocking=False))
    return (track.quiet,)
