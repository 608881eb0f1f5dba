"""The colour filter array that monochromatic steps show: sites that answer all of them alike are of one channel."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.draft.sorting import Group, Scale

ALIKE = 0.05  # of a site's largest response: sites of one channel differ by less
LEAST_STEPS = 5
Array = NDArray[np.floating]


@dataclass(frozen=True)
class GuessedArray:
    """Channels and array by what the sites respond to."""

    channels: tuple[str, ...]
    pattern: tuple[str, ...]  # rows of names


def guess_array(steps: Sequence[Group], scale: Scale, period: tuple[int, int]) -> GuessedArray | None:
    """Return the array of `period` rows and columns; None if too few steps have a known wavelength, or no light is seen."""
    steps = [step for step in steps if step.first.name.nm is not None and not scale.clipped(step)]
    if len(steps) < LEAST_STEPS:
        return None
    # Exposures differ from step to step: shares of a step's light, weighed by its brightest site.
    signal = np.array([scale.signal(step) for step in steps])
    weight = signal.max(axis=1, keepdims=True)
    seen = weight[:, 0] > 0.05 * weight.max()
    shares = signal[seen] / weight[seen]
    wavelength = np.array([step.first.name.nm for step in steps], dtype=np.float64)[seen]
    channel_of: list[int] = []
    curves: list[Array] = []
    for curve in shares.T:
        alike = [number for number, other in enumerate(curves) if np.abs(curve - other).max() < ALIKE]
        if not alike:
            curves.append(curve)
        channel_of.append(alike[0] if alike else len(curves) - 1)
    if len(wavelength) < LEAST_STEPS or max(curve.max() for curve in curves) <= 0:
        return None
    peaks = [float(wavelength[curve > 0.5 * curve.max()].mean()) for curve in curves]
    names = _names(peaks)
    order = np.argsort([-peak for peak in peaks]) if len(peaks) == 3 else np.arange(len(peaks))
    rows, cols = period
    pattern = [" ".join(names[channel_of[row * cols + col]] for col in range(cols)) for row in range(rows)]
    return GuessedArray(tuple(names[number] for number in order), tuple(pattern))


def _names(peaks: Sequence[float]) -> list[str]:
    """Return a name for each channel: r g b where there are three, w for one, else the wavelength that it responds to."""
    if len(peaks) == 1:
        return ["w"]
    if len(peaks) == 3:
        letters = dict(zip(np.argsort(peaks).tolist(), "bgr", strict=True))
        return [letters[number] for number in range(3)]
    names = [f"nm{peak:.0f}" for peak in peaks]
    return [name if names.count(name) == 1 else f"{name}_{number + 1}" for number, name in enumerate(names)]
