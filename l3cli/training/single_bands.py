"""Plain areas of any spectrum: where the outputs are the camera's channels, plain classes are taught that each band may
differ by itself (docs/method.md#single-bands).

Training surfaces are smooth spectra and plain patches of bright leaves are few, so that a plain class sees a handful of
colours, and takes for noise whatever of a spectrum these do not span: a cast on all areas of another material. Noise is what
differs from pixel to pixel; what a whole neighbourhood has in common is spectrum.
"""

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.class_rule import ClassRule

Array = NDArray[np.float64]
SPREAD = 0.1  # standard deviation of one band by itself, of its mean


def output_gains(moments: Array, window: NDArray[np.int64]) -> Array | None:
    """Return the gain (channel) from a flat patch of one channel to the output of that channel, by regression over plain
    patches of summed `moments` (column, column); None if a channel has no signal there. `window` (tap) names channels."""
    taps, means = window.size, _membership(window) / np.bincount(window)
    signal, both = means.T @ moments[:taps, :taps] @ means, means.T @ moments[:taps, taps + 1 :]
    return np.asarray(both.diagonal() / signal.diagonal()) if signal.diagonal().min() > 0 else None


def single_bands(moments: Array, window: NDArray[np.int64], gains: Array) -> Array:
    """Moments (column, column) of flat patches, as many as make up those of a class, `moments`: they differ from the mean
    colour of these in each band by itself, by SPREAD of it. `gains` as from `output_gains`."""
    taps, member = window.size, _membership(window)
    mean = moments[:taps, taps] @ member / np.bincount(window)  # times the number of patches, as weighed
    columns = np.concatenate([member, np.zeros((1, gains.size)), np.diag(gains)])
    power = (SPREAD * mean) ** 2 / max(moments[taps, taps], 1e-12)
    return np.asarray((columns * power) @ columns.T)


def teaches(rule: ClassRule, index: int) -> bool:
    """Return whether patches of a class are plain: of the lowest of several contrasts, and nothing saturated."""
    place = rule.split(index)
    return bool(rule.contrasts > 1 and place.contrast == 0 and not rule.case(place.kind))


def _membership(window: NDArray[np.int64]) -> Array:
    """1 where a tap is of a channel (tap, channel)."""
    return (window[:, None] == np.arange(window.max() + 1)).astype(np.float64)
