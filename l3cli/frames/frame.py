"""A raw frame: one mosaic of digital numbers from a camera, and its mapping to the levels of a table."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.shading import Shading, colour_corrected


@dataclass(frozen=True)
class Shot:
    """Settings of an exposure as its file states them; empty or 0 if it does not."""

    make: str = ""
    model: str = ""
    lens: str = ""
    date: str = ""  # of the exposure, "YYYY:MM:DD HH:MM:SS"
    f_number: float = 0.0
    focal_length: float = 0.0  # mm
    iso: float = 0.0


@dataclass(frozen=True)
class NoiseLeft:
    """The fraction of a frame's temporal noise that a temporal filter has left, cell by cell."""

    shares: NDArray[np.uint16]  # (cell row, cell col) fraction of the camera's noise variance, in units of 1/whole
    whole: int  # value that stands for 1
    cell: tuple[int, int]  # rows and columns of a cell

    def below(self, limits: Sequence[float], shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Return, for each pixel (row, col) of a frame of this shape, how many of the `limits` are not exceeded."""
        cells = np.sum([self.shares <= int(limit * self.whole) for limit in limits], axis=0, dtype=np.uint8)
        return cells.repeat(self.cell[1], 1)[:, : shape[1]].repeat(self.cell[0], 0)[: shape[0]]


@dataclass(frozen=True)
class RawFrame:
    """A mosaic with its black and white level, and the CFA site of its first pixel."""

    name: str
    values: NDArray[np.uint16]  # (row, col) DN
    black_level: float  # DN
    white_level: float  # DN at which a pixel saturates
    phase: tuple[int, int] = (0, 0)  # CFA row and column of pixel (0, 0)
    orientation: int = 0  # how the camera was held, as LibRaw's flip code (see `upright`)
    exposure: float | None = None  # s; None: unknown
    dark: float = 0.0  # DN above black, mean signal of the dark current
    dark_measured: bool = False  # whether `dark` comes from a dark frame, not from the exposure time
    neutral: tuple[float, ...] | None = None  # (channel) signals of a grey on any scale, if the file states them
    taken_by: tuple[str, ...] = ()  # make, model and other names of the camera, if the file states them
    shot: Shot = Shot()
    shading: Shading | None = None  # shading of the lens that is still in the values
    gain: float = 1.0  # analog gain, relative to the camera's
    baseline_exposure: float = 0.0  # EV by which the file asks for brighter pictures
    noise_share: float = 1.0  # fraction of the camera's noise variance, below 1 after a temporal filter
    noise_left: NoiseLeft | None = None  # the same fraction cell by cell; None: all of the noise everywhere
    notes: tuple[str, ...] = ()  # processing that the file asks for and l3 does not do
    exchangeable: bool = False  # whether the file states no size, and rows and columns could also be exchanged
    misread: str = ""  # if the values look like noise: the option with which the file's bytes look like a picture

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.dtype != np.uint16 or self.values.size == 0:
            raise ValueError(f"{self.name}: a raw frame is rows × columns of 16-bit values")
        if not self.black_level < self.white_level:
            raise ValueError(f"{self.name}: black level {self.black_level:g} is not below white level {self.white_level:g}")
        if not self.black_level + self.dark < self.white_level:
            raise ValueError(
                f"{self.name}: dark current of {self.dark:g} DN leaves no room below white level {self.white_level:g}"
            )

    @property
    def light_share(self) -> float:
        """Fraction of full scale that dark current leaves for light."""
        return 1.0 - self.dark / (self.white_level - self.black_level)

    def at_levels(self, black_level: float, white_level: float, bits: int) -> "RawFrame":
        """Return the frame on another scale, without dark current.

        DN are mapped linearly, such that black level plus dark current becomes `black_level` and the white level becomes
        `white_level`, clamped to `bits`. Full scale then stands for `light_share` of the previous full scale.

        Values are shifted by whole DN, so that no level is lost. The remaining dark current, below half a DN, is added to
        the black level of the result.
        """
        levelled = self.rescaled(black_level, white_level, bits)
        if levelled.values is self.values and self.values.max() >= 2**bits:
            return replace(levelled, values=np.minimum(self.values, np.uint16(2**bits - 1)))
        return levelled

    def rescaled(self, black_level: float, white_level: float, bits: int) -> "RawFrame":
        """Return the same as `at_levels`, but without clamping values to `bits` if both scales are equal."""
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
        """Return the frame without colour shading (`shading.colour_corrected`)."""
        if self.shading is None or self.shading.colour is None:
            return self
        values = colour_corrected(self.values, self.shading.colour, self.black_level, self.white_level)
        return replace(self, values=values, shading=replace(self.shading, colour=None))


@functools.lru_cache(maxsize=8)
def _level_table(black_level: float, new_black_level: float, scale: float, top: int) -> NDArray[np.uint16] | None:
    """Return the new value of every 16-bit value, at most `top`, or None if no value up to `top` changes."""
    every = np.arange(1 << 16)
    table = np.clip(np.rint((every - black_level) * scale + new_black_level), 0, top).astype(np.uint16)
    return None if np.array_equal(table[: top + 1], every[: top + 1]) else table


def with_one_black_level(
    values: NDArray[np.uint16], black_level: NDArray[np.floating], white_level: NDArray[np.floating]
) -> tuple[NDArray[np.uint16], float, float]:
    """Return values of pixels with different black and white levels, shifted to a common black level, and the common levels.

    Parameters
    ----------
    values : ndarray, (row, col)
    black_level, white_level : ndarray
        Levels in DN, which broadcast against the values.

    Returns
    -------
    values : ndarray, (row, col)
    black_level, white_level : float
        The black level is the rounded mean. The white level is that of the pixel with the smallest range, so that saturated
        pixels are never taken for bright ones.
    """
    room = float((white_level - black_level).min())
    if np.ptp(black_level) == 0:
        common = float(black_level.flat[0])
        return values, common, common + room
    common = float(np.rint(black_level.mean()))
    shift = np.broadcast_to(np.rint(common - black_level).astype(np.int32), values.shape)
    return np.clip(values + shift, 0, np.iinfo(np.uint16).max).astype(np.uint16), common, common + room


def upright(pixels: NDArray, orientation: int) -> NDArray:
    """Return pixels (row, col, …) in upright orientation, by LibRaw's flip code.

    Code 1 mirrors columns, 2 mirrors rows, and 4 then transposes. So 3 is a half turn, 5 a quarter turn to the left and 6 a
    quarter turn to the right.
    """
    if orientation & 1:
        pixels = pixels[:, ::-1]
    if orientation & 2:
        pixels = pixels[::-1]
    return pixels.swapaxes(0, 1) if orientation & 4 else pixels


def mirrored_indices(length: int, margin: int, period: int) -> NDArray[np.int32]:
    """Return the source index of each of `length` + 2 · `margin` padded samples.

    Inside, a sample is its own source. Outside, the source is the sample with the same CFA phase that is nearest to the
    mirror image, so that padding preserves the mosaic (docs/method.md#rendering). If the mosaic is shorter than the period,
    the nearest sample is the source.
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
    """Return values (row, col) padded by `margin` samples on every side, as `mirrored_indices` describes."""
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
