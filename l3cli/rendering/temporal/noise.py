"""A camera's noise in the filter's whole numbers.

Values are in units u = DN / 2^spare, `spare` being the bits that a frame's values leave of 16: the recursion keeps fractions
of a DN, and the full range of any camera is 16 bits.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.camera import CameraModel
from l3cli.errors import RecipeError
from l3cli.frames.frame import RawFrame

DEEP = 16  # bits of a value
LINEAR_FRACTION, UNEVEN_FRACTION = 8, 24  # bits behind the point of the linear and the quadratic term
SHARES = (1.0, 0.5, 0.25)  # of a camera's noise, that classes are decided against
MOST_UNEVEN, MOST_FIXED = 1 << 20, 1 << 28  # of the terms of what pixels differ by: a quarter of a signal, of a range
EVERY = 8  # periods of rows, one of which a frame's mean level is taken of
LEVELS = 256  # of a period's mean, for which the noise of a difference is listed


@dataclass(frozen=True, eq=False)
class NoiseTerms:
    """Variance of a pixel over time, in u², of a signal of S u above black: (linear · S >> LINEAR_FRACTION) + constant. What
    pixels differ by, the same in every frame, is fixed + (uneven · S² >> UNEVEN_FRACTION): it counts where a vector brings
    one pixel to another."""

    protect: int  # bits of a DN
    black: int  # u
    linear: int
    constant: int
    fixed: int
    uneven: int
    spread: NDArray[np.int32]  # (LEVELS) standard deviation, u, of the difference of two frames' means over a period


def noise_of(camera: CameraModel, black_level: float, white_level: float, sites: int) -> NoiseTerms:
    """Return the noise of frames with these levels, dark current included, taken by a camera whose array has a period of
    `sites`."""
    protect = DEEP - int(white_level).bit_length()
    unit = 2.0**protect * (white_level - black_level) / (camera.white_level - camera.black_level)
    constant, linear, uneven = camera.noise_terms()
    fixed = camera.gain**2 * (camera.noise.dsnu**2 + camera.noise.column_noise**2)
    black = round(black_level * 2**protect)
    signal = np.maximum((np.arange(LEVELS) + 0.5) * 2 ** (DEEP - 8) - black, 0.0)
    variance = (constant - fixed) * unit**2 + linear * unit * signal
    return NoiseTerms(
        protect=protect,
        black=black,
        linear=max(1, round(linear * unit * 2**LINEAR_FRACTION)),
        constant=max(1, round((constant - fixed) * unit**2)),
        fixed=min(round(fixed * unit**2), MOST_FIXED),
        uneven=min(round(uneven * 2**UNEVEN_FRACTION), MOST_UNEVEN),
        spread=np.maximum(np.rint(np.sqrt(2 * variance / sites)), 1).astype(np.int32),
    )


def share_left(camera: CameraModel, frame: RawFrame, left: float) -> float:
    """The share of a camera's noise variance at a frame's mean level, what pixels always differ by included, if a share
    `left` remains of what varies in time: the least of SHARES that is not below it."""
    stretch = (camera.white_level - camera.black_level) / (frame.white_level - frame.black_level)
    signal = max(_mean(frame.values, camera.cfa.shape[0]) - frame.black_level, 0.0) * stretch
    constant, linear, quadratic = camera.noise_terms()
    fixed = camera.gain**2 * (camera.noise.dsnu**2 + camera.noise.column_noise**2) + quadratic * signal**2
    whole = constant + (linear + quadratic * signal) * signal
    share = (fixed + left * (whole - fixed)) / whole
    return min((each for each in SHARES if each >= share), default=1.0)


def _mean(values: NDArray[np.uint16], period: int) -> float:
    """About the mean of values (row, col): every so many periods of rows are taken."""
    whole = values[: len(values) // (period * EVERY) * period * EVERY]
    sampled = whole.reshape(-1, period * EVERY, values.shape[1])[:, :period] if whole.size else values
    return float(sampled.mean())


def to_units(values: NDArray[np.uint16], noise: NoiseTerms) -> NDArray[np.uint16]:
    """DN as u; beyond what 16 bits hold, all of it above the white level, the most of them."""
    most = np.uint16((1 << DEEP - noise.protect) - 1)
    return np.minimum(values, most) << np.uint16(noise.protect)


def of_units(values: NDArray[np.uint16], noise: NoiseTerms) -> NDArray[np.uint16]:
    """u as DN, rounded."""
    most = (1 << DEEP - noise.protect) - 1
    return np.minimum((values.astype(np.uint32) + (1 << noise.protect >> 1)) >> noise.protect, most).astype(np.uint16)


@dataclass(frozen=True)
class Kind:
    """Properties that frames must share to be blended."""

    shape: tuple[int, ...]
    phase: tuple[int, int]
    black_level: float
    white_level: float

    @staticmethod
    def of(frame: RawFrame) -> "Kind":
        return Kind(frame.values.shape, frame.phase, frame.black_level, frame.white_level)


def require_noise(camera: CameraModel | None) -> CameraModel:
    """The camera whose noise the filter goes by; RecipeError if an older table does not have it."""
    if camera is None:
        raise RecipeError(
            "‹temporal› needs the camera's noise, which tables of older versions do not hold; train the table again"
        )
    return camera
