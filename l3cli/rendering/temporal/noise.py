"""Divide frames into cells and blocks for the temporal filter, and convert camera noise to integers.

The filter computes with integers in the unit u = 2^−`protect` DN, where `protect` is the number of bits that raw values
leave unused in a 16-bit word. For every camera, values therefore use all 16 bits, and the recursive filter preserves
fractions of a DN.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import SMOOTHED_LINES, CameraModel
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame

MIN_CELL, MIN_BLOCK = 4, 16  # smallest sides of a cell and a block, in pixels
LANES = 8  # kernels process this number of pixels in parallel, so the width of a block is a multiple of it
DEEP = 16  # bits per value
ONE = 1 << 10  # fixed-point representation of 1, for weights and noise fractions
MAX_SHARED = (1 << 31) - 1  # limit of `shared_in_cells` and `shared_nearby`, so that kernels need only 32 bits
LINEAR_FRACTION = 8  # fractional bits of the linear noise term
UNEVEN_FRACTION = 24  # fractional bits of the quadratic noise term
NOISE_FRACTIONS = (1.0, 0.5, 0.25)  # possible noise fractions of a filtered frame
MAX_UNEVEN = 1 << 20  # limit of the quadratic term, where the fixed pattern is a quarter of the signal
MAX_FIXED = 1 << 28  # limit of the constant fixed-pattern term, where the fixed pattern is a quarter of the range
ROW_PERIODS_PER_READ = 8  # a frame's mean level is computed from every eighth row of CFA periods
# Largest variance of row and column noise, relative to the pixel noise variance. At this limit, up to twice the noise
# remains in a static scene.
MAX_LINES = 1 / 3
TABULATED_LEVELS = 256  # number of levels at which the noise of frame differences is tabulated


@dataclass(frozen=True)
class Grid:
    """Division of a frame into cells and blocks. Each cell has a blending weight, and each block has a motion vector.

    Sizes are (rows, columns) in pixels.
    """

    period: tuple[int, int]  # size of the CFA period
    cell: tuple[int, int]  # size of a cell, a multiple of the CFA period
    block: tuple[int, int]  # size of a block, a multiple of the cell size
    blocks: tuple[int, int]  # numbers of block rows and block columns
    planes: int  # number of planes in the image pyramid of the motion search

    @staticmethod
    def of(shape: tuple[int, ...], period: tuple[int, ...]) -> "Grid":
        """Create the grid for frames of size `shape` with a CFA period of size `period`."""
        down, across = (_sides(side, lanes) for side, lanes in zip(period, (1, LANES), strict=True))
        blocks = (-(-shape[0] // down[2]), -(-shape[1] // across[2]))
        planes = 1
        while max(period) << planes <= MIN_BLOCK:
            planes += 1
        return Grid((down[0], across[0]), (down[1], across[1]), (down[2], across[2]), blocks, planes)

    @property
    def shape(self) -> tuple[int, int]:
        """Size of the frame after extension to whole blocks."""
        return self.blocks[0] * self.block[0], self.blocks[1] * self.block[1]

    @property
    def cells(self) -> tuple[int, int]:
        """Numbers of cell rows and cell columns."""
        return self.shape[0] // self.cell[0], self.shape[1] // self.cell[1]

    @property
    def sites(self) -> int:
        """Number of pixels in a cell."""
        return self.cell[0] * self.cell[1]

    def window(self, level: int) -> tuple[int, int]:
        """Return the size (rows, columns) of a block's window at one level of the image pyramid, in samples.

        The window is usually the block itself. If the block has at most four rows at this level, two rows are added on each
        side. The same applies to columns.
        """
        units = (side // (period << level) for side, period in zip(self.block, self.period, strict=True))
        rows, cols = (count + 4 if count <= 4 else count for count in units)
        return rows, cols

    def padded(self, values: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Extend a frame to whole blocks by repeating the last CFA period."""
        if values.shape == self.shape:
            return np.ascontiguousarray(values)
        (rows, cols), made = values.shape, np.empty(self.shape, np.uint16)
        made[:rows, :cols] = values
        made[:rows, cols:] = values[:, _repeated(cols, self.shape[1], self.period[1])[cols:]]
        made[rows:] = made[_repeated(rows, self.shape[0], self.period[0])[rows:]]
        return made


def _sides(period: int, lanes: int) -> tuple[int, int, int]:
    """Return the sides of a period, a cell and a block along one axis, in pixels. Blocks are multiples of `lanes`."""
    cell = period * -(-MIN_CELL // period)
    block = next(side for side in range(cell, 8 * MIN_BLOCK, cell) if side >= MIN_BLOCK and side % lanes == 0)
    return period, cell, block


def _repeated(there: int, wanted: int, period: int) -> NDArray[np.intp]:
    """Return the indices that extend an axis of `there` samples to `wanted` samples by repeating the last period."""
    index = np.arange(wanted)
    beyond = index - there
    last = index - (beyond // period + 1) * period if there >= period else np.full(wanted, there - 1)
    return np.where(beyond < 0, index, last)


@dataclass(frozen=True, eq=False)
class NoiseTerms:
    """Integer coefficients of the pixel noise, in units of u.

    At the signal S above black, the temporal noise variance is (linear · S >> LINEAR_FRACTION) + constant, and the variance
    of the fixed pattern is fixed + (uneven · S² >> UNEVEN_FRACTION). The fixed pattern is relevant only in moving blocks,
    because different pixels are compared there.
    """

    protect: int  # left shift that converts DN to u
    black: int  # black level in units of u
    white: int  # white level in units of u
    linear: int
    constant: int
    fixed: int
    uneven: int
    # Variances that the offsets of rows and columns add to the squared residual sums of cells and of 3 × 3 cells, in ONE u².
    # All pixels of a row have the same offset, so these variances are larger than for independent noise.
    shared_in_cells: int
    shared_nearby: int
    # (level) standard deviation, in units of u, of the difference between two frames that are averaged over the CFA period
    spread: NDArray[np.int32]


def noise_of(camera: CameraModel, black_level: float, white_level: float, grid: Grid) -> NoiseTerms:
    """Convert a camera's noise model to integers for frames with the given levels.

    Parameters
    ----------
    camera : CameraModel
        Camera that took the frames.
    black_level, white_level : float
        Black and white levels of the frames, in DN.
    grid : Grid
        Cells of the frames.

    Returns
    -------
    NoiseTerms
    """
    protect = DEEP - int(white_level).bit_length()
    unit = 2.0**protect * (white_level - black_level) / (camera.white_level - camera.black_level)
    constant, linear, uneven = camera.noise_terms()
    fixed = camera.gain**2 * camera.corrected_noise().fixed
    black = round(black_level * 2**protect)
    signal = np.maximum((np.arange(TABULATED_LEVELS) + 0.5) * 2 ** (DEEP - 8) - black, 0.0)
    variance = (constant - fixed) * unit**2 + linear * unit * signal
    in_cells, nearby = (
        min(round(each * (camera.gain * unit) ** 2 / ONE), MAX_SHARED) for each in _shared_variances(camera, grid)
    )
    return NoiseTerms(
        protect=protect,
        black=black,
        white=min(round(white_level * 2**protect), (1 << DEEP) - 1),
        linear=max(1, round(linear * unit * 2**LINEAR_FRACTION)),
        constant=max(1, round((constant - fixed) * unit**2)),
        fixed=min(round(fixed * unit**2), MAX_FIXED),
        uneven=min(round(uneven * 2**UNEVEN_FRACTION), MAX_UNEVEN),
        shared_in_cells=in_cells,
        shared_nearby=nearby,
        spread=np.maximum(np.rint(np.sqrt(2 * variance / (grid.period[0] * grid.period[1]))), 1).astype(np.int32),
    )


def _shared_variances(camera: CameraModel, grid: Grid) -> tuple[float, float]:
    """Return the variances that row and column noise adds to two measures of the difference between frames.

    The first measure is the sum of the squares of 9 cells, each summed over its pixels. The second measure is the square of
    the sum over 3 × 3 cells. The variances are in (e-)², in addition to the variance of independent noise in all pixels.
    If the offsets were estimated from the picture and subtracted, their slow part remains, which is the same in all rows of
    the cells.
    """
    corrected, noise = camera.corrected_noise(), camera.noise
    rows = corrected.row_temporal_noise**2, noise.row_temporal_noise**2, 0
    columns = corrected.column_temporal_noise**2, noise.column_temporal_noise**2, 1
    found = np.zeros(2)
    for left, before, axis in (rows, columns):
        slow = min(left, before / SMOOTHED_LINES) if camera.masked is None else 0.0
        for index, cells in enumerate((1, 3)):
            lines, pixels = cells * grid.cell[axis], cells * grid.cell[1 - axis]
            shared = (left - slow) * lines * pixels**2 + slow * (lines * pixels) ** 2 - left * lines * pixels
            found[index] += shared * (3 / cells) ** 2
    return float(found[0]), float(found[1])


def share_left(camera: CameraModel, frame: RawFrame, left: float) -> float:
    """Return the noise fraction of a filtered frame at its mean level, rounded up to one of `NOISE_FRACTIONS`.

    The filter reduces the temporal noise variance to the fraction `left`, but not the fixed pattern.
    """
    stretch = (camera.white_level - camera.black_level) / (frame.white_level - frame.black_level)
    signal = max(_mean(frame.values, camera.cfa.shape[0]) - frame.black_level, 0.0) * stretch
    constant, linear, quadratic = camera.noise_terms()
    fixed = camera.gain**2 * camera.corrected_noise().fixed + quadratic * signal**2
    whole = constant + (linear + quadratic * signal) * signal
    share = (fixed + left * (whole - fixed)) / whole
    return min((each for each in NOISE_FRACTIONS if each >= share), default=1.0)


def _mean(values: NDArray[np.uint16], period: int) -> float:
    """Estimate the mean of a frame from every eighth row of CFA periods."""
    whole = values[: len(values) // (period * ROW_PERIODS_PER_READ) * period * ROW_PERIODS_PER_READ]
    sampled = whole.reshape(-1, period * ROW_PERIODS_PER_READ, values.shape[1])[:, :period] if whole.size else values
    return float(sampled.mean())


def to_units(values: NDArray[np.uint16], noise: NoiseTerms) -> NDArray[np.uint16]:
    """Convert DN to the integer unit u, which is 2^-`protect` DN. Values that do not fit into 16 bits are clipped."""
    most = np.uint16((1 << DEEP - noise.protect) - 1)
    return np.minimum(values, most) << np.uint16(noise.protect)


def of_units(values: NDArray[np.uint16], noise: NoiseTerms) -> NDArray[np.uint16]:
    """Convert units of u to the nearest DN."""
    most = (1 << DEEP - noise.protect) - 1
    return np.minimum((values.astype(np.uint32) + (1 << noise.protect >> 1)) >> noise.protect, most).astype(np.uint16)


def kind_of(frame: RawFrame) -> tuple[object, ...]:
    """Return the properties that must be the same in all frames that the filter blends."""
    return frame.values.shape, frame.phase, frame.black_level, frame.white_level


def settings_of(frame: RawFrame) -> tuple[float, float | None]:
    """Return a frame's analog gain, and its exposure time in s (None if unknown)."""
    return frame.gain, frame.exposure


def times_brighter(now: tuple[float, float | None], before: tuple[float, float | None]) -> float:
    """Return the signal of a scene at the settings `now`, divided by its signal at the settings `before`.

    Settings are gain and exposure time from `settings_of`. If either exposure time is unknown, only the gains are compared.
    """
    times = now[1] / before[1] if now[1] and before[1] else 1.0
    return times * now[0] / before[0]


def require_noise(camera: CameraModel | None) -> CameraModel:
    """Return a table's camera, or raise a RecipeError if the temporal filter cannot be used with it.

    The table must contain its camera. The camera must not have strong row or column noise, because the filter could not
    distinguish such noise from motion. Noise that is removed before the filter is not counted.
    """
    if camera is None:
        raise RecipeError(
            "‹temporal› requires the camera's noise model, which this table does not contain; train the table again"
        )
    if camera.corrected_noise().lines > MAX_LINES * camera.pixel_variance():
        raise RecipeError(
            "‹temporal› would mistake the camera's row and column noise for motion, because after the correction of offsets "
            f"it exceeds {MAX_LINES**0.5:.2g} of the pixel noise; remove ‹temporal›, or use frames with masked pixels"
        )
    return camera
