"""Dark frames: what a camera gives in an exposure without light, taken off raw frames pixel by pixel."""

import hashlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import InputFileError
from l3cli.frames.frame import RawFrame
from l3cli.frames.shading import CLIPPED

HOT = 5.0  # standard deviations from which a pixel is no usual one
MAD = 1.4826  # of normal deviates: standard deviation / median absolute deviation


@dataclass(frozen=True)
class DarkFrame:
    """The mean of several raw frames that were exposed without light."""

    name: str
    level: float  # DN, mean over all pixels but the hot ones
    offset: NDArray[np.int32]  # (row, col) DN, what each pixel differs by from the mean
    phase: tuple[int, int]  # CFA row and column of pixel (0, 0)
    orientation: int
    exposure: float | None  # s; None: unknown

    @property
    def digest(self) -> str:
        """SHA-256 of all that it changes in a picture."""
        return hashlib.sha256(repr(self.level).encode() + self.offset.tobytes()).hexdigest()


def average_dark(frames: Iterable[RawFrame]) -> DarkFrame:
    """Return the dark frame of `frames` of one size, phase, orientation and exposure time; InputFileError if they differ.

    A mean of n frames still has 1/√n of their noise, which must not be put into every picture: what a pixel differs by from
    the mean, d, counts as d · max(0, 1 − σ²/d²), with σ the standard deviation of that noise (the non-negative garrote,
    Breiman 1995). So hot pixels are taken off whole however few the frames, and the finer pattern the better the more
    there are. σ comes from the differences of frames, of a single one from the spread of its pixels.
    """
    first, total, squares, count = None, np.zeros(1), 0.0, 0
    for frame in frames:
        values = frame.values.astype(np.float64)
        if first is None:
            first, total = frame, np.zeros_like(values)
            earlier = values
        elif _differs(frame, first):
            raise InputFileError(f"{frame.name} and {first.name} differ in size, phase or exposure; give darks of one kind")
        else:
            squares += _spread(values - earlier) ** 2 / 2  # of the noise of one frame
            earlier = values
        total += values
        count += 1
    if first is None:
        raise InputFileError("no dark frame was given")
    mean = total / count
    middle, spread = float(np.median(mean)), _spread(mean)
    level = float(mean[np.abs(mean - middle) <= HOT * spread + 0.5].mean())
    if not level < first.black_level + CLIPPED * (first.white_level - first.black_level):
        raise InputFileError(f"{first.name} is clipped nearly everywhere; give frames without light as ‹dark›")
    variance = squares / (count - 1) / count if count > 1 else spread**2
    deviation = mean - level
    with np.errstate(divide="ignore", invalid="ignore"):
        remaining = np.where(deviation**2 > variance, deviation - variance / deviation, 0.0)
    offset = np.rint(remaining).astype(np.int32)
    return DarkFrame(first.name, level, offset, first.phase, first.orientation, first.exposure)


def without_dark(frame: RawFrame, dark: DarkFrame) -> RawFrame:
    """Return the frame without what its pixels differ by in the dark; the mean of that is `RawFrame.dark`. Clipped pixels
    stay clipped. InputFileError if the dark frame is of another size or kind."""
    if dark.offset.shape != frame.values.shape or (dark.phase, dark.orientation) != (frame.phase, frame.orientation):
        raise InputFileError(
            f"{dark.name} of {_size(dark.offset)} is no dark frame of {frame.name} of {_size(frame.values)}; "
            "give one of the same camera, size and phase"
        )
    if dark.exposure and frame.exposure and not math.isclose(dark.exposure, frame.exposure, rel_tol=0.02):
        raise InputFileError(
            f"{dark.name} was exposed for {dark.exposure:.4g} s, {frame.name} for {frame.exposure:.4g} s; "
            "give dark frames of the same exposure time"
        )
    span = frame.white_level - frame.black_level
    mean = dark.level - frame.black_level
    if not mean < span:
        raise InputFileError(
            f"{dark.name} leaves no room below white level {frame.white_level:g}; are its levels those of the frame?"
        )
    clipped = frame.values >= frame.black_level + CLIPPED * span
    values = np.clip(frame.values.astype(np.int32) - dark.offset, 0, np.iinfo(np.uint16).max).astype(np.uint16)
    return replace(frame, values=np.where(clipped, frame.values, values), dark=mean, dark_measured=True)


def _spread(values: NDArray[np.float64]) -> float:
    """Return the standard deviation of the values, hot pixels aside."""
    return MAD * float(np.median(np.abs(values - np.median(values))))


def _differs(frame: RawFrame, first: RawFrame) -> bool:
    about = [(each.values.shape, each.phase, each.orientation, each.exposure) for each in (frame, first)]
    return about[0] != about[1]


def _size(values: NDArray) -> str:
    return "×".join(map(str, values.shape))
