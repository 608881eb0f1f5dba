"""Statistics of frames: histograms, means, temporal variances and weighted sums of captures, by CFA site or channel.

Hot and dead pixels stay out. Where a function goes through many captures, `each` is the map that does so: the built-in one,
or one that keeps several processes busy.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.calibration.defects import Defects
from l3cli.errors import InputFileError
from l3cli.frames.measurement import Body, Capture

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Each = Callable[[Callable, Iterable], Iterator]


@dataclass(frozen=True)
class Level:
    """Statistics of the frames of one exposure."""

    exposure: float  # s
    lit: float  # s of the measured light
    trials: int
    counts: Counts  # (channel, value) pixels of all frames
    variance: Array  # (channel) DN², temporal


def by_site(values: NDArray, cfa: NDArray[np.uint8]) -> Iterator[tuple[int, NDArray]]:
    """(channel, the pixels of one site of the super-pixel as a picture), site by site."""
    rows, cols = cfa.shape
    for row in range(rows):
        for col in range(cols):
            yield int(cfa[row, col]), values[row::rows, col::cols]


def pooled(per_site: Sequence[float], cfa: NDArray[np.uint8]) -> Array:
    """(channel) mean over its sites of one figure a site, sites in the order of `by_site`."""
    count = np.bincount(cfa.ravel())
    return np.bincount(cfa.ravel(), weights=np.asarray(per_site, dtype=np.float64)) / count


def histogram(values: NDArray[np.uint16], body: Body, defects: Defects) -> Counts:
    """(channel, value) how many pixels of each channel have each value, defects left out."""
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    for channel, site in by_site(values, body.cfa):
        counts[channel] += np.bincount(site.ravel(), minlength=2**body.bits)
    row, col = defects.T
    channels = body.cfa[row % body.cfa.shape[0], col % body.cfa.shape[1]]
    np.subtract.at(counts, (channels, values[row, col]), 1)
    return counts


def count_values(capture: Capture, body: Body, defects: Defects) -> Counts:
    """Return the histogram (channel, value) of all frames of a capture, defects left out."""
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    for frame in capture.frames:
        counts += histogram(frame, body, defects)
    return counts


def mean_value(counts: Counts) -> Array:
    """(channel) mean DN of a histogram (channel, value)."""
    return counts @ np.arange(counts.shape[1]) / counts.sum(axis=1)


def share_from(counts: Counts, value: float) -> Array:
    """Return the share (channel) of the pixels that lie at `value` DN or above."""
    return counts[:, int(np.ceil(value)) :].sum(axis=1) / counts.sum(axis=1)


def measure_level(capture: Capture, body: Body, defects: Defects) -> Level:
    """Histogram and temporal variance of a capture of even light or none; InputFileError if it is a single frame.

    The variance is half that of the difference of two frames, centred, so that neither fixed pattern nor a drift of the
    lamp or of the black level enters; frames 1 and 2 make a pair, 3 and 4 the next.
    """
    counts = np.zeros((len(body.channels), 2**body.bits), dtype=np.int64)
    variances, trials = [], 0
    previous = None
    for frame in capture.frames:
        counts += histogram(frame, body, defects)
        trials += 1
        if previous is None:
            previous = frame.astype(np.int32)
            continue
        difference = previous - frame
        difference[defects[:, 0], defects[:, 1]] = 0
        variances.append(pooled([site.var(dtype=np.float64) / 2 for _, site in by_site(difference, body.cfa)], body.cfa))
        previous = None
    if not variances:
        raise InputFileError(f"{capture.name} is a single frame; noise needs two or more of each exposure")
    return Level(capture.exposure, capture.lit, trials, counts, np.mean(variances, axis=0))


def weighted_sums(captures: Sequence[Capture], weights: Array, body: Body, each: Each = map) -> Array:
    """Pictures (sum, row, col): Σ over captures of weights (sum, capture, channel) × mean frame, read one by one."""
    total = np.zeros((len(weights), body.rows, body.cols))
    used = [index for index in range(len(captures)) if weights[:, index].any()]
    means = each(mean_frame, [captures[index] for index in used])
    for index, mean in zip(used, means, strict=True):
        for channel, weight in zip(_channels(body), weights[:, index].T, strict=True):
            for site in channel:
                total[:, site[0], site[1]] += weight[:, None, None] * mean[site]
    return total


def _channels(body: Body) -> list[list[tuple[slice, slice]]]:
    """Return, for each channel, the slices that take its sites out of a frame."""
    rows, cols = body.cfa.shape
    sites: list[list[tuple[slice, slice]]] = [[] for _ in body.channels]
    for row in range(rows):
        for col in range(cols):
            sites[body.cfa[row, col]].append((slice(row, None, rows), slice(col, None, cols)))
    return sites


def mean_frame(capture: Capture) -> NDArray[np.float32]:
    """Return the mean (row, col) DN of the frames of a capture."""
    total: NDArray | None = None
    trials = 0
    for frame in capture.frames:
        total = frame.astype(np.uint32) if total is None else total + frame
        trials += 1
    assert total is not None
    return (total / trials).astype(np.float32)


def channel_shares(body: Body) -> Array:
    """Return the share (channel) of the pixels."""
    return np.bincount(body.cfa.ravel(), minlength=len(body.channels)) / body.cfa.size
