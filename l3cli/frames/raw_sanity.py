"""Doubts about what a raw file states of its mosaic, by what its pixels show: where its array begins, where black lies.

Sites of one channel answer nearly alike, on the mean over a small block, wherever the array is where it is taken to be; else
they have different filters. Where another phase merely exchanges channels of equal patterns, such as r and b of a Bayer
array, only the signals of a grey, which many files state, tell them apart: the mean over a photo is about grey.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.frame import RawFrame, shifted_cfa, tiled

SIDE, MOST = 8, 32  # super-pixels along a block, at most; blocks along a frame, at most
LEAST_SIGNAL = 1e-3  # of full scale: the mean of a frame below which it is dark
SITES_DIFFER = 0.02  # of the signal: real arrays in place leave 0.003 to 0.007, one row or column off 0.045 to 0.18
FAR_FROM_GREY = 0.75  # of a natural logarithm: distance of two channels from a grey; coloured scenes reach 0.67
BETTER = 0.4  # of the stated phase's figure, if another leaves no more, the array is there
ALIKE = 1.5  # times the least figure: phases that leave about as little
DARKEST = 0.1  # percentile of the values of a channel: about black in most pictures
LEAST_BLACK, HIGHEST_BLACK = 1 / 64, 1 / 6  # of the white level: where black levels of real cameras lie
Phase = tuple[int, int]


@dataclass(frozen=True)
class PhaseDoubt:
    """Evidence that an array begins elsewhere than it is said to."""

    stated: float  # how much the sites of one channel differ, as a share of the signal
    least: float  # the same in the best phase
    phases: tuple[Phase, ...]  # that leave about as little, the likeliest first
    by_grey: bool = False  # whether only the signals of a grey tell


def phase_doubt(
    frame: RawFrame, cfa: NDArray[np.uint8], neutral: Sequence[float] | NDArray[np.floating] | None = None
) -> PhaseDoubt | None:
    """Return the doubt that the array `cfa` (row, col) of channels, from its site `frame.phase` on, lies where a frame says;
    None without. `neutral` (channel): signals of a grey; None: only sites of one channel are compared."""
    blocks = block_means(frame, cfa.shape)
    if not blocks.size or not blocks.mean() > LEAST_SIGNAL * (frame.white_level - frame.black_level):
        return None
    arrays: dict[bytes, Phase] = {}  # the first phase of each array that differs from the others
    for phase in (frame.phase, *itertools.product(range(cfa.shape[0]), range(cfa.shape[1]))):
        arrays.setdefault(shifted_cfa(cfa, phase).tobytes(), phase)
    phases = {phase: shifted_cfa(cfa, phase) for phase in arrays.values()}
    grey = {phase: _far_from_grey(blocks, array, neutral) for phase, array in phases.items()}
    for scale in (blocks, blocks.mean(axis=0, keepdims=True)):  # colours differ locally; noise and structure locally, too
        sites = {phase: _sites_differ(scale, array) for phase, array in phases.items()}
        stated, least = sites[frame.phase], min(sites.values())
        if stated >= SITES_DIFFER and least <= BETTER * stated:
            fitting = [phase for phase in phases if sites[phase] <= ALIKE * least]
            return PhaseDoubt(stated, least, tuple(sorted(fitting, key=lambda phase: grey[phase])))
    names = [phase for phase in phases if _same_sites(phases[phase], phases[frame.phase])]
    best = min(names, key=lambda phase: grey[phase])
    if grey[frame.phase] >= FAR_FROM_GREY and grey[best] <= BETTER * grey[frame.phase]:
        return PhaseDoubt(stated, least, (best,), by_grey=True)
    return None


def block_means(frame: RawFrame, period: tuple[int, ...]) -> NDArray[np.float64]:
    """Return mean signals (block, row, col) in DN above black and dark current of each site of a super-pixel, the frame's
    first pixel being the first, over blocks of super-pixels evenly spread."""
    rows, cols = period
    side = int(np.clip(min(frame.values.shape[0] // rows, frame.values.shape[1] // cols) // SIDE, 1, SIDE))
    down, across = frame.values.shape[0] // (rows * side), frame.values.shape[1] // (cols * side)
    if not down * across:
        return np.zeros((0, rows, cols))
    whole = frame.values[: down * side * rows].reshape(down, side * rows, -1)[:: -(-down // MOST)]
    whole = whole[..., : across * side * cols].reshape(-1, side, rows, across, side, cols)[:, :, :, :: -(-across // MOST)]
    means = whole.mean(axis=(1, 4)).transpose(0, 2, 1, 3).reshape(-1, rows, cols)
    return np.asarray(means - frame.black_level - frame.dark)


def _sites_differ(blocks: NDArray[np.float64], array: NDArray[np.uint8]) -> float:
    """Return the mean difference between a site of a block and the mean of its channel's sites, over the signal."""
    of_channels = (blocks[:, array == channel] for channel in sorted(set(array.flat)))
    return float(sum(np.abs(each - each.mean(axis=1, keepdims=True)).sum() for each in of_channels) / blocks.sum())


def _same_sites(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Return whether two arrays have one channel at the same sites, be it by another name."""
    pairs = set(zip(one.flat, other.flat, strict=True))
    return len(pairs) == len(set(one.flat))


def _far_from_grey(
    blocks: NDArray[np.float64], array: NDArray[np.uint8], neutral: Sequence[float] | NDArray[np.floating] | None
) -> float:
    """Return the distance of a frame's mean from a grey: of the natural logarithms of its channels over those of the grey,
    from the least to the most; 0 where no grey is stated."""
    if neutral is None or min(neutral) <= 0:
        return 0.0
    means = np.array([blocks[:, array == channel].mean() for channel in range(len(neutral))])
    return float(np.ptp(np.log(np.maximum(means, blocks.mean() / 100) / neutral)))


def black_doubt(frame: RawFrame, cfa: NDArray[np.uint8]) -> float | None:
    """Return where a frame's black seems to lie (DN), if it states a black level of 0; None without a doubt.

    The darkest values of its channels lie at one level, far from 0, and nearer to one another than the channels' medians
    do: of light alone they would have the ratios of what the filters pass.
    """
    if frame.black_level > 0:
        return None
    sites = tiled(cfa, frame.values.shape)
    levels = np.array([np.percentile(frame.values[sites == each], (DARKEST, 50)) for each in np.unique(cfa)])
    darkest, usual = levels.T
    if not LEAST_BLACK * frame.white_level <= darkest.min() <= darkest.max() <= HIGHEST_BLACK * frame.white_level:
        return None
    ratios = [np.ptp(each) / each.mean() for each in (darkest, usual)]
    return float(darkest.mean()) if ratios[0] <= BETTER * ratios[1] else None
