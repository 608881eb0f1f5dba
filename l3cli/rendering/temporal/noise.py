"""The cells and blocks into which the filter divides a frame, and the camera's noise as integers of the filter.

Values are in units u = DN / 2^spare, where `spare` is the number of unused bits among 16. The recursion therefore preserves
fractions of a DN, and every camera uses the full range of 16 bits.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame

MIN_CELL, MIN_BLOCK = 4, 16  # pixels; shortest side of a cell and of a block
LANES = 8  # number of pixels that kernels process in parallel; the columns of a block are a multiple of it
DEEP = 16  # bits per value
LINEAR_FRACTION, UNEVEN_FRACTION = 8, 24  # number of fractional bits of the linear and of the quadratic term
NOISE_FRACTIONS = (1.0, 0.5, 0.25)  # fractions of a camera's noise for which there are class edges
MAX_UNEVEN, MAX_FIXED = 1 << 20, 1 << 28  # limits of the fixed-pattern terms: a quarter of the signal and of the range
ROW_PERIODS_PER_READ = 8  # the mean level of a frame is computed from every EVERY-th period of rows
TABULATED_LEVELS = 256  # number of levels for which the noise of a difference is tabulated


@dataclass(frozen=True)
class Grid:
    """The division of a frame into cells and blocks. Sizes are (rows, columns) in pixels."""

    period: tuple[int, int]
    cell: tuple[int, int]  # size of a cell, in whole CFA periods; each cell has its own blending weight
    block: tuple[int, int]  # size of a block, in whole cells; each block has its own motion vector
    blocks: tuple[int, int]  # number of blocks
    planes: int  # number of planes of means, each with half the resolution of the previous one

    @staticmethod
    def of(shape: tuple[int, ...], period: tuple[int, ...]) -> "Grid":
        """Return the grid for frames of the given shape and a CFA with the given period."""
        down, across = (_sides(side, lanes) for side, lanes in zip(period, (1, LANES), strict=True))
        blocks = (-(-shape[0] // down[2]), -(-shape[1] // across[2]))
        planes = 1
        while max(period) << planes <= MIN_BLOCK:
            planes += 1
        return Grid((down[0], across[0]), (down[1], across[1]), (down[2], across[2]), blocks, planes)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame, extended to whole blocks."""
        return self.blocks[0] * self.block[0], self.blocks[1] * self.block[1]

    @property
    def cells(self) -> tuple[int, int]:
        """Number of cells (rows, columns)."""
        return self.shape[0] // self.cell[0], self.shape[1] // self.cell[1]

    @property
    def sites(self) -> int:
        """Number of pixels in a cell."""
        return self.cell[0] * self.cell[1]

    def window(self, level: int) -> tuple[int, int]:
        """Return the rows and columns of the window for the search of a block in a plane.

        It is the block itself or, if the block is small, the block with two additional samples on each side.
        """
        units = (side // (period << level) for side, period in zip(self.block, self.period, strict=True))
        rows, cols = (count + 4 if count <= 4 else count for count in units)
        return rows, cols

    def padded(self, values: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return values (row, col) extended to whole blocks by repeating whole periods."""
        if values.shape == self.shape:
            return np.ascontiguousarray(values)
        (rows, cols), made = values.shape, np.empty(self.shape, np.uint16)
        made[:rows, :cols] = values
        made[:rows, cols:] = values[:, _repeated(cols, self.shape[1], self.period[1])[cols:]]
        made[rows:] = made[_repeated(rows, self.shape[0], self.period[0])[rows:]]
        return made


def _sides(period: int, lanes: int) -> tuple[int, int, int]:
    """Return the sides of a period, a cell and a block. The side of the block is a multiple of `lanes`."""
    cell = period * -(-MIN_CELL // period)
    block = next(side for side in range(cell, 8 * MIN_BLOCK, cell) if side >= MIN_BLOCK and side % lanes == 0)
    return period, cell, block


def _repeated(there: int, wanted: int, period: int) -> NDArray[np.intp]:
    """Return the source index of each of `wanted` samples. Beyond the end, the last period is repeated."""
    index = np.arange(wanted)
    beyond = index - there
    last = index - (beyond // period + 1) * period if there >= period else np.full(wanted, there - 1)
    return np.where(beyond < 0, index, last)


@dataclass(frozen=True, eq=False)
class NoiseTerms:
    """Noise of a pixel with signal S above black, in units u.

    The temporal variance is (linear · S >> LINEAR_FRACTION) + constant. The variance of the fixed pattern is fixed +
    (uneven · S² >> UNEVEN_FRACTION). The fixed pattern matters only if different pixels are compared because of motion.
    """

    protect: int  # number of bits by which a DN is shifted to the left to give u
    black: int  # u
    white: int  # u
    linear: int
    constant: int
    fixed: int
    uneven: int
    spread: NDArray[np.int32]  # (LEVELS) u; standard deviation of the difference between two frames' means over a period


def noise_of(camera: CameraModel, black_level: float, white_level: float, sites: int) -> NoiseTerms:
    """Return the noise of a camera's frames with the given levels, including dark current.

    `sites` is the number of pixels in a CFA period.
    """
    protect = DEEP - int(white_level).bit_length()
    unit = 2.0**protect * (white_level - black_level) / (camera.white_level - camera.black_level)
    constant, linear, uneven = camera.noise_terms()
    fixed = camera.gain**2 * camera.noise.fixed
    black = round(black_level * 2**protect)
    signal = np.maximum((np.arange(TABULATED_LEVELS) + 0.5) * 2 ** (DEEP - 8) - black, 0.0)
    variance = (constant - fixed) * unit**2 + linear * unit * signal
    return NoiseTerms(
        protect=protect,
        black=black,
        white=min(round(white_level * 2**protect), (1 << DEEP) - 1),
        linear=max(1, round(linear * unit * 2**LINEAR_FRACTION)),
        constant=max(1, round((constant - fixed) * unit**2)),
        fixed=min(round(fixed * unit**2), MAX_FIXED),
        uneven=min(round(uneven * 2**UNEVEN_FRACTION), MAX_UNEVEN),
        spread=np.maximum(np.rint(np.sqrt(2 * variance / sites)), 1).astype(np.int32),
    )


def share_left(camera: CameraModel, frame: RawFrame, left: float) -> float:
    """Return the fraction of a camera's noise variance that remains after a filter, at the mean level of a frame.

    `left` is the remaining fraction of the temporal variance. The fixed pattern is not reduced. The result is rounded up to
    one of SHARES.
    """
    stretch = (camera.white_level - camera.black_level) / (frame.white_level - frame.black_level)
    signal = max(_mean(frame.values, camera.cfa.shape[0]) - frame.black_level, 0.0) * stretch
    constant, linear, quadratic = camera.noise_terms()
    fixed = camera.gain**2 * camera.noise.fixed + quadratic * signal**2
    whole = constant + (linear + quadratic * signal) * signal
    share = (fixed + left * (whole - fixed)) / whole
    return min((each for each in NOISE_FRACTIONS if each >= share), default=1.0)


def _mean(values: NDArray[np.uint16], period: int) -> float:
    """Return the approximate mean of values (row, col), computed from every EVERY-th period of rows."""
    whole = values[: len(values) // (period * ROW_PERIODS_PER_READ) * period * ROW_PERIODS_PER_READ]
    sampled = whole.reshape(-1, period * ROW_PERIODS_PER_READ, values.shape[1])[:, :period] if whole.size else values
    return float(sampled.mean())


def to_units(values: NDArray[np.uint16], noise: NoiseTerms) -> NDArray[np.uint16]:
    """Convert DN to u. Values that do not fit into 16 bits become the largest value. All of them exceed the white level."""
    most = np.uint16((1 << DEEP - noise.protect) - 1)
    return np.minimum(values, most) << np.uint16(noise.protect)


def of_units(values: NDArray[np.uint16], noise: NoiseTerms) -> NDArray[np.uint16]:
    """Convert u to DN, rounded."""
    most = (1 << DEEP - noise.protect) - 1
    return np.minimum((values.astype(np.uint32) + (1 << noise.protect >> 1)) >> noise.protect, most).astype(np.uint16)


def kind_of(frame: RawFrame) -> tuple[object, ...]:
    """Return the properties that frames must share to be blended."""
    return frame.values.shape, frame.phase, frame.black_level, frame.white_level


def settings_of(frame: RawFrame) -> tuple[float, float | None]:
    """Return the analog gain and the exposure time of a frame, in s (None if unknown)."""
    return frame.gain, frame.exposure


def times_brighter(now: tuple[float, float | None], before: tuple[float, float | None]) -> float:
    """Return the ratio between the signals with the settings `now` and with the settings `before`, under the same light."""
    times = now[1] / before[1] if now[1] and before[1] else 1.0
    return times * now[0] / before[0]


def require_noise(camera: CameraModel | None) -> CameraModel:
    """Return the camera whose noise the filter uses. Raises RecipeError if the table does not contain it."""
    if camera is None:
        raise RecipeError(
            "‹temporal› needs the camera's noise, but the table does not hold its camera; train the table again"
        )
    return camera
