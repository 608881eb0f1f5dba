"""A raw frame, which is a mosaic of digital numbers (DN) from a camera, and its conversion to other levels."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.lens_warp import LensWarp
from l3cli.frames.shading import Shading, colour_corrected


@dataclass(frozen=True)
class Shot:
    """Settings of an exposure according to its file. A setting that the file does not state is "" or 0."""

    make: str = ""
    model: str = ""
    lens: str = ""
    date: str = ""  # date of the exposure, "YYYY:MM:DD HH:MM:SS"
    f_number: float = 0.0
    focal_length: float = 0.0  # mm
    iso: float = 0.0


@dataclass(frozen=True)
class NoiseLeft:
    """The fraction of the temporal noise that remains after a temporal filter, for each cell of a frame."""

    shares: NDArray[np.uint16]  # (cell row, cell col) fraction of the camera's noise variance, in units of 1/whole
    whole: int  # value of `shares` that stands for a fraction of 1
    cell: tuple[int, int]  # rows and columns of a cell

    def below(self, limits: Sequence[float], shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Return, for each pixel (row, col) of a frame, the number of `limits` that the fraction does not exceed."""
        cells = np.sum([self.shares <= int(limit * self.whole) for limit in limits], axis=0, dtype=np.uint8)
        return cells.repeat(self.cell[1], 1)[:, : shape[1]].repeat(self.cell[0], 0)[: shape[0]]


@dataclass(frozen=True)
class RawFrame:
    """A mosaic with its black and white level, and the CFA site of its first pixel."""

    name: str
    values: NDArray[np.uint16]  # (row, col) DN
    black_level: float  # DN
    white_level: float  # DN at which a pixel saturates
    phase: tuple[int, int] = (0, 0)  # CFA row and column of the first pixel
    orientation: int = 0  # orientation of the camera as a flip code of LibRaw (see `upright`)
    exposure: float | None = None  # exposure time in s; None if unknown
    dark: float = 0.0  # DN; mean signal of the dark current above the black level
    dark_measured: bool = False  # whether `dark` comes from a dark frame rather than from the exposure time
    neutral: tuple[float, ...] | None = None  # (channel) signals of a grey object at any scale, if the file states them
    taken_by: tuple[str, ...] = ()  # make, model and other names of the camera, if the file states them
    shot: Shot = Shot()
    shading: Shading | None = None  # lens shading that has not been corrected in the values
    gain: float = 1.0  # analog gain, relative to the gain of the camera model
    baseline_exposure: float = 0.0  # EV by which pictures should be brightened according to the file
    noise_share: float = 1.0  # fraction of the camera's noise variance; below 1 after a temporal filter
    noise_left: NoiseLeft | None = None  # the same fraction for each cell; None means 1 everywhere
    warps: tuple[LensWarp, ...] = ()  # lens corrections to apply to the picture, in this order
    notes: tuple[str, ...] = ()  # warnings about processing that the file requests but l3 does not do
    exchangeable: bool = False  # whether the numbers of rows and columns may be swapped, because the file states no size
    misread: str = ""  # if the values look like noise: option that would decode the bytes to a plausible picture

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.dtype != np.uint16 or self.values.size == 0:
            raise ValueError(f"{self.name}: a raw frame must be an array (row, column) of 16-bit values")
        if not self.black_level < self.white_level:
            raise ValueError(
                f"{self.name}: the black level {self.black_level:g} is not below the white level {self.white_level:g}"
            )
        if not self.black_level + self.dark < self.white_level:
            raise ValueError(
                f"{self.name}: the dark current of {self.dark:g} DN reaches the white level {self.white_level:g}"
            )

    @property
    def light_share(self) -> float:
        """Fraction of full scale that dark current leaves for light."""
        return 1.0 - self.dark / (self.white_level - self.black_level)

    def at_levels(self, black_level: float, white_level: float, bits: int) -> "RawFrame":
        """Convert the frame to other black and white levels, and subtract the dark current.

        The conversion is linear. The black level plus the dark current becomes `black_level`, and the white level becomes
        `white_level`. The result is clamped to `bits` bits. Full scale of the result corresponds to the fraction
        `light_share` of the previous full scale.

        The dark current is subtracted in whole DN, so that no values merge. The remainder, which is less than half a DN, is
        added to the black level of the result.
        """
        levelled = self.rescaled(black_level, white_level, bits)
        if levelled.values is self.values and self.values.max() >= 2**bits:
            return replace(levelled, values=np.minimum(self.values, np.uint16(2**bits - 1)))
        return levelled

    def rescaled(self, black_level: float, white_level: float, bits: int) -> "RawFrame":
        """Do the same as `at_levels`, but do not clamp to `bits` if the levels stay the same."""
        if (self.black_level, self.white_level, self.dark) == (black_level, white_level, 0):
            return self
        whole = round(self.dark)
        scale = (white_level - black_level) / (self.white_level - self.black_level - self.dark)
        values = self.values
        table = _level_table(self.black_level + whole, black_level, scale, 2**bits - 1)
        if table is not None:
            values = table.take(values)
        black_level += (self.dark - whole) * scale
        return replace(self, values=values, black_level=black_level, white_level=white_level, dark=0.0)

    def shading_corrected(self) -> "RawFrame":
        """Return the frame with its colour shading corrected (`shading.colour_corrected`)."""
        if self.shading is None or self.shading.colour is None:
            return self
        values = colour_corrected(self.values, self.shading.colour, self.black_level, self.white_level)
        return replace(self, values=values, shading=replace(self.shading, colour=None))


@functools.lru_cache(maxsize=8)
def _level_table(black_level: float, new_black_level: float, scale: float, top: int) -> NDArray[np.uint16] | None:
    """Return a look-up table for 16-bit values, clamped to `top`, or None if the table would not change any value."""
    every = np.arange(1 << 16)
    table = np.clip(np.rint((every - black_level) * scale + new_black_level), 0, top).astype(np.uint16)
    return None if np.array_equal(table[: top + 1], every[: top + 1]) else table


def with_one_black_level(
    values: NDArray[np.uint16], black_level: NDArray[np.floating], white_level: NDArray[np.floating]
) -> tuple[NDArray[np.uint16], float, float]:
    """Shift the values of pixels with different black levels to a single black level.

    Parameters
    ----------
    values : ndarray, (row, col)
        Values in DN.
    black_level, white_level : ndarray
        Levels of each pixel in DN, in a shape that can be broadcast to the shape of the values.

    Returns
    -------
    values : ndarray, (row, col)
        Shifted values.
    black_level, white_level : float
        The common black level is the rounded mean. The common white level is the white level of the pixel with the smallest
        range, so that a saturated pixel never looks like a bright pixel that is not saturated.
    """
    room = float((white_level - black_level).min())
    if np.ptp(black_level) == 0:
        common = float(black_level.flat[0])
        return values, common, common + room
    common = float(np.rint(black_level.mean()))
    shift = np.broadcast_to(np.rint(common - black_level).astype(np.int32), values.shape)
    return np.clip(values + shift, 0, np.iinfo(np.uint16).max).astype(np.uint16), common, common + room


def upright(pixels: NDArray, orientation: int) -> NDArray:
    """Turn pixels (row, col, …) upright. `orientation` is a LibRaw flip code.

    The code is a sum of flags: 1 reverses the columns, 2 reverses the rows, and 4 then transposes the result. For example,
    code 3 rotates by 180°, code 5 by 90° to the left, and code 6 by 90° to the right.
    """
    if orientation & 1:
        pixels = pixels[:, ::-1]
    if orientation & 2:
        pixels = pixels[::-1]
    return pixels.swapaxes(0, 1) if orientation & 4 else pixels


def mirrored_indices(length: int, margin: int, period: int) -> NDArray[np.int32]:
    """Return the index of the source sample for each of `length` + 2 · `margin` padded samples.

    A sample within the frame is its own source. For a sample in the margin, the source is the sample of the same CFA phase
    that is nearest to the mirror image, so that padding preserves the mosaic (docs/method.md#rendering). If the frame is
    shorter than the period, the source is the nearest sample.
    """
    wanted = np.arange(-margin, length + margin)
    if length < period:
        return np.clip(wanted, 0, length - 1).astype(np.int32)
    mirror = np.where(wanted < 0, -wanted, np.where(wanted >= length, 2 * (length - 1) - wanted, wanted))
    mirror = np.clip(mirror, 0, length - 1)
    offset = (wanted - mirror) % period
    below, above = mirror + offset - period, mirror + offset
    prefer_below = (above >= length) | ((below >= 0) & (mirror - below <= above - mirror) & (offset > 0))
    return np.where(prefer_below, below, above).astype(np.int32)


def pad_mosaic(values: NDArray, margin: int, cfa_shape: tuple[int, int]) -> NDArray:
    """Pad values (row, col) by `margin` samples on every side, as described in `mirrored_indices`."""
    rows = mirrored_indices(values.shape[0], margin, cfa_shape[0])
    cols = mirrored_indices(values.shape[1], margin, cfa_shape[1])
    return values[np.ix_(rows, cols)]


def as_taken(pixels: NDArray, orientation: int) -> NDArray:
    """Undo `upright` for pixels (row, col, …)."""
    if orientation & 4:
        pixels = pixels.swapaxes(0, 1)
    if orientation & 2:
        pixels = pixels[::-1]
    return pixels[:, ::-1] if orientation & 1 else pixels
