"""Temporal filter in numpy. The kernels in opencl/common/temporal*.cl compute exactly the same results."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.frames.frame import NoiseLeft, RawFrame
from l3cli.rendering.temporal.motion import Vectors, planes_of, vectors_of
from l3cli.rendering.temporal.noise import (
    DEEP,
    LINEAR_FRACTION,
    ONE,
    UNEVEN_FRACTION,
    Grid,
    NoiseTerms,
    kind_of,
    noise_of,
    of_units,
    settings_of,
    share_left,
    times_brighter,
    to_units,
)

# All values are integers in units of u, a power-of-two fraction of a DN (see the module `noise`). Frames are padded to a
# whole number of blocks. A residual is a value in the new frame minus the filtered value in the previous frame.
#
# The sum of squared residuals over 3 × 3 cells indicates motion only above 5/4 of its expected value. The excess is
# multiplied by 4.
POWER_FACTOR, POWER_FREE = 4, 5
MEAN_FREE = 2  # the square of a cell's residual sum indicates motion only above this multiple of its expected value
WIDE_FREE = 6  # the same multiple for the square of the residual sum over 3 × 3 cells
CUT = 8  # the scene has changed in a cell if the sum of its squared residuals exceeds the expected value by this factor
CLIPPED = (1 << 14) - 1  # limit of residuals in units of u, so that kernels sum their squares in 32 bits
MOST_POWER = (1 << 32) - 1  # limit of a cell's sum of squared residuals in u², so that kernels need only 32 bits
MOST_VARIANCE = (1 << 29) - 1  # limit of a cell's noise variance in u², so that kernels need only 32 bits
MOST_BEYOND = 1 << 42  # limit of the motion evidence in u², so that all sums are exact in float64 (below 2^53)
FEW = 2  # the filter restarts if the scene has changed in more than 1/FEW of the cells


Cells = NDArray[np.int64]

LEAST_WEIGHT = ONE // 12  # smallest weight of the new frame


@dataclass(frozen=True)
class Blend:
    """State of the temporal filter after a frame."""

    values: NDArray[np.uint16]  # (row, col) filtered values in units of u, padded to a whole number of blocks
    left: Cells  # (cell row, cell col) noise variance of `values`, relative to a single frame, times ONE


def first_blend(values: NDArray[np.uint16], grid: Grid) -> Blend:
    """Return the filter state after the first frame of a scene.

    `values` (row, col) is the frame in units of u (see the module `noise`), padded to a whole number of blocks.
    """
    return Blend(values, np.full(grid.cells, ONE, np.int64))


def rescaled(before: Blend, times: float, grid: Grid, noises: tuple[NoiseTerms, NoiseTerms]) -> Blend:
    """Convert the filter state to a new gain or exposure time (docs/method.md#temporal).

    Parameters
    ----------
    before : Blend
        State at the old gain and exposure time.
    times : float
        Signal at the new settings, divided by the signal at the old settings.
    grid : Grid
        Cells and blocks of the frame.
    noises : tuple of NoiseTerms
        Noise before and after the change.

    Returns
    -------
    Blend
        State at the new settings. Its noise fractions (`left`) are at most ONE.
    """
    was, now = noises
    scale = np.rint(now.black + (np.arange(1 << DEEP) - was.black) * times)
    values = np.clip(scale, 0, now.white).astype(np.uint16)[before.values]
    variances = [
        np.maximum(_sums(of.astype(np.int64), grid) - grid.sites * noise.black, 0) * noise.linear / 2**LINEAR_FRACTION
        + grid.sites * noise.constant
        for of, noise in ((before.values, was), (values, now))
    ]
    left = np.rint(before.left * (times**2 * variances[0] / variances[1]))
    return replace(before, values=values, left=np.clip(left, 1, ONE).astype(np.int64))


def blended(values: NDArray[np.uint16], before: Blend, vectors: Vectors, grid: Grid, noise: NoiseTerms) -> Blend:
    """Blend a frame with the motion-compensated filter state.

    Parameters
    ----------
    values : ndarray, (row, col)
        Values of the frame in units of u (see the module `noise`), padded to a whole number of blocks.
    before : Blend
        State after the previous frame.
    vectors : ndarray, (block row, block col, 2)
        Motion vectors in pixels.
    grid : Grid
        Cells and blocks of the frame.
    noise : NoiseTerms
        Noise of the frames.

    Returns
    -------
    Blend
        State after this frame.
    """
    rows, cols = np.indices(grid.shape, sparse=True)
    of_pixel = vectors.repeat(grid.block[0], 0).repeat(grid.block[1], 1)
    history = before.values[rows + of_pixel[..., 0], cols + of_pixel[..., 1]].astype(np.int64)
    residual = values - history
    left = _moved_left(before.left, vectors, grid)
    power, mean, wide, expected = _evidence(values, residual, left, vectors, grid, noise)
    if np.count_nonzero(power > CUT * expected) * FEW > power.size:
        return first_blend(values, grid)
    beyond = np.maximum(power * POWER_FACTOR - expected * POWER_FREE, 0)
    beyond += np.maximum(mean - (expected + noise.shared_in_cells * (ONE + left)) * MEAN_FREE, 0)
    beyond += np.maximum(wide - (expected + noise.shared_nearby * (ONE + left)) * WIDE_FREE, 0)
    whole = expected * (ONE + left) + np.minimum(beyond, MOST_BEYOND) * ONE
    weight = np.maximum(ONE - expected * ONE**2 // whole, LEAST_WEIGHT)
    left = np.minimum(((ONE - weight) ** 2 * left + weight**2 * ONE) // ONE**2 + 1, ONE)
    of_pixel = weight.repeat(grid.cell[0], 0).repeat(grid.cell[1], 1)
    new = history + ((of_pixel * residual + ONE // 2) // ONE)
    return Blend(new.astype(np.uint16), left)


def _moved_left(left: Cells, vectors: Vectors, grid: Grid) -> Cells:
    """Return the noise fraction of each cell in the previous state, read at the cell's centre after its displacement."""
    rows, cols = (
        (np.arange(count) * side + side // 2 + _by_cell(vectors[..., axis], grid).swapaxes(0, axis).swapaxes(0, 1)) // side
        for axis, (count, side) in enumerate(zip(grid.cells, grid.cell, strict=True))
    )
    return left[rows.swapaxes(0, 1), cols]


def _by_cell(of_block: NDArray, grid: Grid) -> NDArray:
    """Repeat values of blocks for all their cells."""
    down, across = (block // cell for block, cell in zip(grid.block, grid.cell, strict=True))
    return of_block.repeat(down, 0).repeat(across, 1)


def _evidence(
    values: NDArray[np.uint16], residual: Cells, left: Cells, vectors: Vectors, grid: Grid, noise: NoiseTerms
) -> tuple[Cells, Cells, Cells, Cells]:
    """Compute three measures of motion in the 3 × 3 cells around each cell, and their expected value without motion.

    Returns
    -------
    pixels : ndarray, (cell row, cell col)
        Sum of the squared residuals of all pixels, in u².
    cells : ndarray, (cell row, cell col)
        The residuals are summed in each of the 3 × 3 cells. The result is the sum of the squares of these nine sums, in u².
    neighbourhood : ndarray, (cell row, cell col)
        Square of the sum of the residuals of all pixels, in u².
    expected : ndarray, (cell row, cell col)
        Expected value of each of the three measures if the residuals are independent noise, in u².
    """
    signal = np.maximum(_sums(values.astype(np.int64), grid) - grid.sites * noise.black, 0)
    variance = np.minimum((signal * noise.linear >> LINEAR_FRACTION) + grid.sites * noise.constant, MOST_VARIANCE)
    level = signal // grid.sites
    fixed = 2 * grid.sites * (noise.fixed + (level * level * noise.uneven >> UNEVEN_FRACTION))
    variance = variance * (ONE + left) // ONE + np.where(_by_cell((vectors != 0).any(axis=2), grid), fixed, 0)
    variance = np.minimum(variance, MOST_VARIANCE)
    clipped = np.clip(residual, -CLIPPED, CLIPPED)
    sums = _sums(clipped, grid)
    power = np.minimum(_sums(clipped * clipped, grid), MOST_POWER)
    return _nearby(power), _nearby(sums * sums), _nearby(sums) ** 2, _nearby(variance)


def _sums(values: Cells, grid: Grid) -> Cells:
    """Sum pixel values (row, col) over each cell."""
    (down, across), (tall, wide) = grid.cells, grid.cell
    return values.reshape(down, tall, across, wide).sum(axis=(1, 3))


def _nearby(cells: Cells) -> Cells:
    """Sum values over the 3 × 3 cells around each cell, with zeros outside the frame."""
    padded = np.pad(cells, 1)
    tall = padded[:-2] + padded[1:-1] + padded[2:]
    return tall[:, :-2] + tall[:, 1:-1] + tall[:, 2:]


class ReferenceFilter:
    """Temporal filter in numpy.

    Parameters
    ----------
    period : tuple of int
        CFA period (rows, columns) in pixels.
    camera : CameraModel
        Camera that took the frames.
    """

    def __init__(self, period: tuple[int, ...], camera: CameraModel) -> None:
        self._period, self._camera = period, camera
        self._kind: tuple[object, ...] | None = None
        self._before: tuple[tuple[float, float | None], NoiseTerms] | None = None  # settings and noise of the previous frame
        self.history: Blend | None = None
        self.vectors: Vectors | None = None  # motion vectors of the latest frame, or None for the first frame

    def filtered(self, frame: RawFrame) -> RawFrame:
        """Blend the next frame with the previous frames, and return the result with the noise fraction of each cell.

        If the size, phase or levels of the frame have changed, the filter restarts. If the gain or exposure time has
        changed, the filter first converts its state.
        """
        kind = kind_of(frame)
        grid = Grid.of(frame.values.shape, self._period)
        noise = noise_of(self._camera.at_gain(frame.gain), frame.black_level, frame.white_level, grid)
        values = grid.padded(to_units(frame.values, noise))
        settings, before = settings_of(frame), self._before
        if self.history is None or before is None or kind != self._kind:
            self._kind, self.history, self.vectors = kind, first_blend(values, grid), None
        else:
            if settings != before[0]:
                self.history = rescaled(self.history, times_brighter(settings, before[0]), grid, (before[1], noise))
            self.vectors = vectors_of(planes_of(values, grid), planes_of(self.history.values, grid), grid, noise)
            self.history = blended(values, self.history, self.vectors, grid, noise)
        self._before = settings, noise
        rows, cols = frame.values.shape
        made = of_units(self.history.values[:rows, :cols], noise)
        share = share_left(
            self._camera.at_gain(frame.gain), frame, int(self.history.left.sum()) / (self.history.left.size * ONE)
        )
        left = NoiseLeft(self.history.left.astype(np.uint16), ONE, grid.cell)
        return replace(frame, values=made, noise_share=share, noise_left=left)


def reference_filters(period: tuple[int, ...], camera: CameraModel) -> Callable[[], ReferenceFilter]:
    """Return a function without parameters that creates a `ReferenceFilter`."""
    return lambda: ReferenceFilter(period, camera)
