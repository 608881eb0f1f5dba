"""The filter by numpy: the truth that the kernels of opencl/temporal*.cl agree with, value by value."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.frame import NoiseLeft, RawFrame
from l3cli.rendering.temporal.blend import ONE, Blend, blended, first_blend
from l3cli.rendering.temporal.grid import Grid
from l3cli.rendering.temporal.motion import Vectors, planes_of, vectors_of
from l3cli.rendering.temporal.noise import Kind, noise_of, of_units, share_left, to_units


class ReferenceFilter:
    """Filters frames of an array with a `period` of rows and columns."""

    def __init__(self, period: tuple[int, ...], camera: CameraModel) -> None:
        self._period, self._camera = period, camera
        self._kind: Kind | None = None
        self.kept: Blend | None = None
        self.vectors: Vectors | None = None  # of the last frame, if it was not a first one

    def filtered(self, frame: RawFrame) -> RawFrame:
        """The next frame, blended with those before it, if they are of its size and levels."""
        kind = Kind.of(frame)
        grid = Grid.of(frame.values.shape, self._period)
        noise = noise_of(self._camera, frame.black_level, frame.white_level, grid.period[0] * grid.period[1])
        values = grid.padded(to_units(frame.values, noise))
        if self.kept is None or kind != self._kind:
            self._kind, self.kept, self.vectors = kind, first_blend(values, grid), None
        else:
            self.vectors = vectors_of(planes_of(values, grid), planes_of(self.kept.values, grid), grid, noise)
            self.kept = blended(values, self.kept, self.vectors, grid, noise)
        rows, cols = frame.values.shape
        made = of_units(self.kept.values[:rows, :cols], noise)
        share = share_left(self._camera, frame, int(self.kept.left.sum()) / (self.kept.left.size * ONE))
        left = NoiseLeft(self.kept.left.astype(np.uint16), ONE, grid.cell)
        return replace(frame, values=made, noise_share=share, noise_left=left)


def reference_filters(period: tuple[int, ...], camera: CameraModel) -> Callable[[], ReferenceFilter]:
    """Return a function that makes reference filters."""
    return lambda: ReferenceFilter(period, camera)
