"""Raw frames: mosaics of digital numbers (DN) from a sensor, with the metadata needed to process them.

This module also converts frames to other black and white levels, rotates pictures, and pads mosaics.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.lens_warp import LensWarp
from l3cli.frames.shading import Shading, colour_corrected


@dataclass(frozen=True)
class Shot:
    """Camera, lens and exposure settings from a raw file. Missing settings are "" or 0."""

    make: str = ""
    model: str = ""
    lens: str = ""
    date: str = ""  # date of the exposure, "YYYY:MM:DD HH:MM:SS"
    f_number: float = 0.0
    focal_length: float = 0.0  # mm
    iso: float = 0.0


@dataclass(frozen=True)
class NoiseLeft:
    """Fraction of the noise variance that remains after a temporal filter, for each cell (a rectangle of pixels)."""

    shares: NDArray[np.uint16]  # (cell row, cell col) fraction of the camera's noise variance, times `whole`
    whole: int  # value in `shares` that represents a fraction of 1
    cell: tuple[int, int]  # rows and columns of pixels in a cell

    def below(self, limits: Sequence[float], shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Return how many of the `limits` are greater than or equal to the noise fraction of each pixel: (row, col).

        `shape` is the shape of the frame in pixels.
        """
        cells = np.sum([self.shares <= int(limit * self.whole) for limit in limits], axis=0, dtype=np.uint8)
        return cells.repeat(self.cell[1], 1)[:, : shape[1]].repeat(self.cell[0], 0)[: shape[0]]


@dataclass(frozen=True)
class RawFrame:
    """A mosaic with its black and white levels, the CFA site of its first pixel, and other metadata.

    Raises ValueError if the values are not a non-empty, two-dimensional array of uint16, or if the black level, with or
    without the dark current, is not below the white level.
    """

    name: str
    values: NDArray[np.uint16]  # (row, col) DN
    black_level: float  # DN
    white_level: float  # DN at which a pixel saturates
    phase: tuple[int, int] = (0, 0)  # CFA row and column of the first pixel
    orientation: int = 0  # LibRaw flip code that makes the picture upright (see `upright`)
    exposure: float | None = None  # exposure time in s; None if unknown
    dark: float = 0.0  # DN; mean signal of the dark current above the black level
    dark_measured: bool = False  # whether `dark` was measured in a dark frame instead of computed from the exposure time
    neutral: tuple[float, ...] | None = None  # (channel) relative signals of a grey object; None if unknown
    taken_by: tuple[str, ...] = ()  # make, model and other names of the camera; empty if unknown
    shot: Shot = Shot()
    shading: Shading | None = None  # lens shading that is still present in the values
    gain: float = 1.0  # analog gain, relative to the gain of the camera model
    baseline_exposure: float = 0.0  # EV; brightening of pictures that the file recommends
    noise_share: float = 1.0  # noise variance as a fraction of the camera's noise variance; below 1 after a temporal filter
    noise_left: NoiseLeft | None = None  # noise fraction of each cell after a temporal filter; None for 1 everywhere
    warps: tuple[LensWarp, ...] = ()  # lens corrections for the rendered picture, in order of application
    notes: tuple[str, ...] = ()  # warnings about processing that the file requests but l3 does not support
    exchangeable: bool = False  # whether a headerless file would also fit a frame with rows and columns exchanged
    misread: str = ""  # option that would decode the file to a plausible picture; "" unless the values look like noise

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.dtype != np.uint16 or self.values.size == 0:
            raise ValueError(f"{self.name}: a raw frame must be an array (row, column) of 16-bit values")
        if not self.black_level < self.white_level:
            raise ValueError(
                f"{self.name}: the black level of {self.black_level:g} DN is not below the white level of "
                f"{self.white_level:g} DN"
            )
        if not self.black_level + self.dark < self.white_level:
            raise ValueError(
                f"{self.name}: the dark signal of {self.dark:g} DN reaches the white level of {self.white_level:g} DN"
            )

    @property
    def light_share(self) -> float:
        """Fraction of the range from black to white that is left for light after the dark signal is subtracted."""
        return 1.0 - self.dark / (self.white_level - self.black_level)

    def at_levels(self, black_level: float, white_level: float, bits: int) -> "RawFrame":
        """Convert the frame linearly to other black and white levels, and subtract the dark current.

        The black level plus the dark current becomes `black_level`, and the white level becomes `white_level`. The values
        are limited to `bits` bits. Full scale of the result corresponds to the fraction `light_share` of this frame's full
        scale.

        The dark current is subtracted in whole DN, so that different values remain different. The remainder, at most half a
        DN, is converted to the new scale and added to the black level of the result.
        """
        levelled = self.rescaled(black_level, white_level, bits)
        if levelled.values is self.values and self.values.max() >= 2**bits:
            return replace(levelled, values=np.minimum(self.values, np.uint16(2**bits - 1)))
        return levelled

    def rescaled(self, black_level: float, white_level: float, bits: int) -> "RawFrame":
        """Convert the frame like `at_levels`, but return it unchanged if it already has these levels and no dark current.

        The values of an unchanged frame may exceed `bits` bits.
        """
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
        """Return the frame with its colour shading corrected (see `shading.colour_corrected`).

        The mean shading of all channels is not corrected, and remains in `shading`.
        """
        if self.shading is None or self.shading.colour is None:
            return self
        values = colour_corrected(self.values, self.shading.colour, self.black_level, self.white_level)
        return replace(self, values=values, shading=replace(self.shading, colour=None))


@functools.lru_cache(maxsize=8)
def _level_table(black_level: float, new_black_level: float, scale: float, top: int) -> NDArray[np.uint16] | None:
    """Return a look-up table that rescales 16-bit values, or None if values up to `top` would not change."""
    every = np.arange(1 << 16)
    table = np.clip(np.rint((every - black_level) * scale + new_black_level), 0, top).astype(np.uint16)
    return None if np.array_equal(table[: top + 1], every[: top + 1]) else table


def with_one_black_level(
    values: NDArray[np.uint16], black_level: NDArray[np.floating], white_level: NDArray[np.floating]
) -> tuple[NDArray[np.uint16], float, float]:
    """Shift pixel values with different black levels to a common black level.

    Parameters
    ----------
    values : ndarray, (row, col)
        Values in DN.
    black_level, white_level : ndarray
        Levels of each pixel in DN, in a shape that can be broadcast to the shape of `values`.

    Returns
    -------
    values : ndarray, (row, col)
        Shifted values.
    black_level, white_level : float
        The common levels in DN. The black level is the rounded mean of all black levels. The white level exceeds it by the
        smallest full scale of any pixel, so that every saturated pixel is recognised.
    """
    room = float((white_level - black_level).min())
    if np.ptp(black_level) == 0:
        common = float(black_level.flat[0])
        return values, common, common + room
    common = float(np.rint(black_level.mean()))
    shift = np.broadcast_to(np.rint(common - black_level).astype(np.int32), values.shape)
    return np.clip(values + shift, 0, np.iinfo(np.uint16).max).astype(np.uint16), common, common + room


def upright(pixels: NDArray, orientation: int) -> NDArray:
    """Rotate or mirror an array of pixels, (row, col, …), so that the picture is upright.

    `orientation` is a LibRaw flip code, a sum of flags: 1 reverses the columns, 2 reverses the rows, and 4 then transposes
    the result. For example, code 3 rotates by 180°, code 5 by 90° to the left, and code 6 by 90° to the right.
    """
    if orientation & 1:
        pixels = pixels[:, ::-1]
    if orientation & 2:
        pixels = pixels[::-1]
    return pixels.swapaxes(0, 1) if orientation & 4 else pixels


def mirrored_indices(length: int, margin: int, period: int) -> NDArray[np.int32]:
    """Return the indices of the samples in a row or column that is padded by mirroring on both sides.

    The result has `length` + 2 · `margin` elements. So that the padding continues the mosaic, a sample in the margin is
    copied from the sample with the same CFA phase that is nearest to its mirror image (docs/method.md#rendering). If the
    row or column is shorter than the CFA period, samples in the margin are copied from the nearest sample.
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
    """Pad a mosaic, (row, col), by `margin` mirrored pixels on every side (see `mirrored_indices`)."""
    rows = mirrored_indices(values.shape[0], margin, cfa_shape[0])
    cols = mirrored_indices(values.shape[1], margin, cfa_shape[1])
    return values[np.ix_(rows, cols)]


def as_taken(pixels: NDArray, orientation: int) -> NDArray:
    """Rotate or mirror upright pixels, (row, col, …), back to the sensor orientation. This is the inverse of `upright`."""
    if orientation & 4:
        pixels = pixels.swapaxes(0, 1)
    if orientation & 2:
        pixels = pixels[::-1]
    return pixels[:, ::-1] if orientation & 1 else pixels
