"""White balance of frames: gains of the channels before a table renders them, adaptation of its outputs after
(docs/method.md#scene-white)."""

import functools
import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame, shifted_cfa
from l3cli.physics.display import adaptation_matrix, display_white

Array = NDArray[np.floating]
TIME_CONSTANT = 1.0  # s, in which log exposure and white go 63 % of the difference to those of a light that has changed


@dataclass(frozen=True)
class WhiteBalance:
    """Gains and adaptation that make the white of a scene neutral."""

    gains: NDArray[np.float64]  # (channel) of the signals, none below 1: what clips does so at the white level still
    adaptation: NDArray[np.float64]  # (3, 3) XYZ under D65 of a table's X, Y, Z, with the Y of white unchanged
    luminance: float  # Y of a grey without the gains / with them


def adaptation(white: Array) -> NDArray[np.float64]:
    """Bradford adaptation (3, 3) of outputs from a white (3)."""
    return np.asarray(adaptation_matrix(white, display_white()), np.float64)


def plain_balance(white: Array, channels: int) -> WhiteBalance:
    """Adaptation from a white (3) alone."""
    return WhiteBalance(np.ones(channels), adaptation(white), 1.0)


def balanced(frame: RawFrame, table: TransformTable, gains: Array) -> RawFrame:
    """A frame whose channels have been multiplied by their gains, up to the white level."""
    if (gains == 1).all():
        return frame
    curves = _curves(frame.black_level + frame.dark, frame.white_level, tuple(gains.tolist()))
    values, cfa = frame.values.copy(), shifted_cfa(table.cfa, frame.phase)
    for row, col in np.ndindex(cfa.shape):
        if gains[cfa[row, col]] != 1:
            site = np.s_[row :: cfa.shape[0], col :: cfa.shape[1]]
            values[site] = curves[cfa[row, col]].take(frame.values[site])
    return replace(frame, values=values)


def balanced_patches(patches: RawFrame, channel: NDArray[np.integer], gains: Array) -> RawFrame:
    """As `balanced`, of patches (patch, tap) whose taps are of the channels `channel` (tap)."""
    if (gains == 1).all():
        return patches
    curves = _curves(patches.black_level + patches.dark, patches.white_level, tuple(gains.tolist()))
    return replace(patches, values=curves[channel[None], patches.values])


@functools.lru_cache(maxsize=8)
def _curves(zero: float, white_level: float, gains: tuple[float, ...]) -> NDArray[np.uint16]:
    """Return the value that each of all 16-bit values becomes in each channel (channel, value); from the white level on
    they stay."""
    every = np.arange(1 << 16)
    raised = np.rint((every - zero) * np.array(gains)[:, None] + zero)
    return np.where(every < white_level, np.clip(raised, 0, np.ceil(white_level)), every).astype(np.uint16)


class SteadyWhite:
    """White balance of each frame of a sequence in its order.

    The first frame's is its own, later ones follow exponentially, as the exposure does. Only past frames count.
    """

    def __init__(self, rate: Fraction) -> None:
        self._share = followed_share(rate)
        self._now: WhiteBalance | None = None

    def balance(self, wanted: WhiteBalance | None) -> WhiteBalance | None:
        """Balance of the next frame; one that asks for none leaves it where it was (None at the beginning)."""
        if wanted is not None:
            self._now = wanted if self._now is None else _between(self._now, wanted, self._share)
        return self._now


def followed_share(rate: Fraction) -> float:
    """Share of a difference that is followed from one frame to the next."""
    return 1 - math.exp(-1 / (float(rate) * TIME_CONSTANT))


def _between(now: WhiteBalance, wanted: WhiteBalance, share: float) -> WhiteBalance:
    gains = now.gains * (wanted.gains / now.gains) ** share
    matrix = now.adaptation + share * (wanted.adaptation - now.adaptation)
    return WhiteBalance(gains, matrix, now.luminance * (wanted.luminance / now.luminance) ** share)
