"""Check of where a frame's colour filter array begins: sites of one channel see alike on average."""

import itertools

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.table import TransformTable
from l3cli.frames.frame import RawFrame, shifted_cfa

SAMPLES = 128  # super-pixels along either axis that are looked at, at most
LEAST_SIGNAL = 1e-3  # of full scale: the mean of a frame below which it is dark


def site_means(frame: RawFrame, cfa_shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Mean signal (row, col) in DN above black and dark current of each site of a super-pixel, the frame's first pixel being
    the first, over super-pixels evenly spread."""
    rows, cols = cfa_shape
    down, across = frame.values.shape[0] // rows, frame.values.shape[1] // cols
    whole = frame.values[: down * rows, : across * cols].reshape(down, rows, across, cols)
    some = whole[:: -(-down // SAMPLES)][:, :, :: -(-across // SAMPLES)] if whole.size else whole
    return np.asarray(some.mean(axis=(0, 2)) - frame.black_level - frame.dark) if some.size else np.zeros((rows, cols))


def disagreement(means: NDArray[np.float64], cfa: NDArray[np.uint8], phase: tuple[int, int]) -> float:
    """The largest difference between the means (row, col) of sites of one channel, over the channel's mean."""
    channel = shifted_cfa(cfa, phase)
    seen = [means[channel == each] for each in set(channel.flat)]
    return max(float(np.ptp(of_channel) / max(of_channel.mean(), 1e-9)) for of_channel in seen)


def best_phases(frame: RawFrame, table: TransformTable) -> tuple[float, float, list[tuple[int, int]]]:
    """The disagreement of a frame's sites, the least one that another phase would leave, and the phases that leave about as
    little; zeros and none of dark frames, and of arrays no channel of which has two sites."""
    means = site_means(frame, table.cfa.shape)
    if not means.mean() > LEAST_SIGNAL * (frame.white_level - frame.black_level):
        return 0.0, 0.0, []
    rows, cols = table.cfa.shape
    of_phase = {phase: disagreement(means, table.cfa, phase) for phase in itertools.product(range(rows), range(cols))}
    least = min(of_phase.values())
    return of_phase[frame.phase], least, [phase for phase, each in of_phase.items() if each <= least * 1.5]
