"""Channels that are exposed or amplified apart: rows of two exposures, of two gains (docs/method.md#exposures)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.schema import data

SHORTEST, MOST_GAIN = 1e-4, 1e3  # of a channel's exposure and gain, relative to the camera's


@dataclass(frozen=True)
class Readout:
    """Readout of each channel: two channels behind one filter may differ in exposure time and gain."""

    channel_exposure: NDArray[np.float64] = data(
        "float64", "channel", doc="exposure time over that of the frame, the longest"
    )
    channel_gain: NDArray[np.float64] = data("float64", "channel", doc="conversion gain over that of the camera")
    channel_read_noise: NDArray[np.float64] = data(
        "float64", "channel", unit="e-", doc="standard deviation of one reading in the dark, at the channel's gain"
    )
    same_filter: NDArray[np.int64] = data("int64", "channel", doc="first channel with the same filter")

    def __post_init__(self) -> None:
        exposure, gain, first = self.channel_exposure, self.channel_gain, self.same_filter
        if not (exposure.min() >= SHORTEST and exposure.max() == 1.0):
            raise ValueError(f"exposures of channels must lie in {SHORTEST:g}…1, and the longest be 1")
        if not (gain.min() >= 1.0 and gain.max() <= MOST_GAIN):
            raise ValueError(f"gains of channels must lie in 1…{MOST_GAIN:g}")
        if not (self.channel_read_noise.min() >= 0 and np.isfinite(self.channel_read_noise).all()):
            raise ValueError("read noise of channels must not be negative")
        if not ((first >= 0) & (first <= np.arange(first.size))).all() or not (first[first] == first).all():
            raise ValueError("same_filter must name first channels of a filter")

    @property
    def sensitivity(self) -> NDArray[np.float64]:
        """(channel) DN of light over those of the channel whose exposure times gain is largest."""
        product = self.channel_exposure * self.channel_gain
        return np.asarray(product / product.max())
