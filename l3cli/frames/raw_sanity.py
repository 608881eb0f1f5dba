"""Checks of what a raw file states against its pixels: the position of the array, the array itself, the black level.

In a smooth block all sites of one channel read nearly the same. If they do not, the stated CFA phase is probably wrong.
Another phase may only exchange channels with equal patterns, such as r and b of a Bayer array. Then the phase follows from
the signals of a grey, which many files state, because the mean over a photo is roughly grey.
"""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.frame import RawFrame
from l3cli.physics.mosaic import shifted_cfa, tiled

SIDE, MOST = 8, 32  # largest number of super-pixels along a block, and of blocks along a frame
MIN_SIGNAL = 1e-3  # of full scale; frames with a lower mean are too dark to judge
SITES_DIFFER = 0.02  # of the signal; arrays at the stated phase reach 0.003 to 0.007, one row or column off 0.045 to 0.18
FAR_FROM_GREY = 0.75  # natural logarithm of the ratio of two channels, relative to a grey; coloured scenes reach 0.67
BETTER = 0.4  # ratio to the stated phase's difference, below which another phase is accepted
ALIKE = 1.5  # ratio to the least difference, up to which phases fit about equally well
DARKEST = 0.1  # percentile of a channel's values that is close to black in most pictures
MIN_BLACK, MAX_BLACK = 1 / 64, 1 / 6  # of the white level; range of the black levels of real cameras
ROUGH, SMOOTHER = 0.01, 3.0  # least roughness of a misread frame, of full scale; its ratio to that of the right reading
MAX_BANDS = 32  # of a frame, each two super-pixels high, on which roughness is measured
PERIODS, PERIOD = (4, 6, 8), 24  # rows and columns of the arrays that are looked for; their common multiple
TILE, TILES = 120, 8  # pixels along a tile, a multiple of all periods; largest number of tiles along a frame
# Mean difference of sites, of the signal. Real Bayer frames reach 0.001 to 0.02, other arrays 0.05 to 2.
ARRAYS_DIFFER = 0.05
MOST_SITES_DIFFER = 0.03  # of the signal, exceeded by 30 % of the sites of another array, but only by autofocus pixels here
STRIPED = 0.25  # fraction of the differences that remains at most for stripes, with one factor per row or column
TWO_GAINS = 2.0  # least ratio of the gains of sensors whose pairs of rows alternate between two gains
CONTROL = 3.0  # ratio to the difference modulo a period that no array has, from which a difference is evidence
FITS = 0.01  # of the signal; sites of one channel that differ less fit an array
SMALLEST_BLACK = 16.0  # DN; lower black levels are not checked
BELOW = 0.5  # of the black level; pixels without light lie above, because a black level leaves room for their noise
FEW = 0.05  # fraction of the pixels, below which nothing is reported
Phase = tuple[int, int]


@dataclass(frozen=True)
class PhaseDoubt:
    """Evidence that an array does not begin where the file states."""

    stated: float  # difference between sites of one channel, as a fraction of the signal
    least: float  # the same for the best phase
    phases: tuple[Phase, ...]  # phases that fit about as well as the best, the most likely first
    by_grey: bool = False  # whether the evidence is only the signals of a grey


def phase_doubt(
    frame: RawFrame, cfa: NDArray[np.uint8], neutral: Sequence[float] | NDArray[np.floating] | None = None
) -> PhaseDoubt | None:
    """Return evidence that the array does not begin where the frame states, or None.

    Parameters
    ----------
    frame : RawFrame
        Its `phase` is the stated one.
    cfa : ndarray, (cfa_row, cfa_col)
    neutral : sequence of float, (channel,), optional
        Signals of a grey. Without them only sites of one channel are compared.
    """
    blocks = block_means(frame, cfa.shape)
    if not blocks.size or not blocks.mean() > MIN_SIGNAL * (frame.white_level - frame.black_level):
        return None
    arrays: dict[bytes, Phase] = {}  # the first phase of each distinct array
    for phase in (frame.phase, *itertools.product(range(cfa.shape[0]), range(cfa.shape[1]))):
        arrays.setdefault(shifted_cfa(cfa, phase).tobytes(), phase)
    phases = {phase: shifted_cfa(cfa, phase) for phase in arrays.values()}
    grey = {phase: _far_from_grey(blocks, array, neutral) for phase, array in phases.items()}
    for scale in (blocks, blocks.mean(axis=0, keepdims=True)):  # blocks, where colours differ; the frame, with less noise
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


@dataclass(frozen=True)
class ArrayDoubt:
    """Evidence that a mosaic has another array than stated."""

    differ: float  # difference between sites of one stated colour, as a fraction of the signal
    means: NDArray[np.float64]  # (row, col) mean signals modulo PERIOD, in DN

    def likely(self, arrays: Mapping[str, NDArray[np.uint8]]) -> list[str]:
        """Return the names of the arrays (row, col) that fit the pixels best in some phase, those with the fewest channels
        first.

        Large arrays whose sites all have different channels fit any pixels, and are left out.
        """
        judged = {name: cfa for name, cfa in arrays.items() if len(set(cfa.flat)) < cfa.size or cfa.size <= 4}
        misfits = {name: self._misfit(cfa) for name, cfa in judged.items() if not (PERIOD % np.array(cfa.shape)).any()}
        limit = max(ALIKE * min(misfits.values()), FITS)
        fitting = [name for name, misfit in misfits.items() if misfit <= limit]
        return sorted(fitting, key=lambda name: (len(set(arrays[name].flat)), misfits[name]))

    def _misfit(self, cfa: NDArray[np.uint8]) -> float:
        """Return the mean difference between a site and its channel's sites in the best phase, as a fraction of the
        signal.
        """
        phases = itertools.product(range(cfa.shape[0]), range(cfa.shape[1]))
        whole = [tiled(shifted_cfa(cfa, phase), self.means.shape) for phase in phases]
        return min(_sites_differ(self.means[None], array) for array in whole)


def array_doubt(frame: RawFrame, cfa: NDArray[np.uint8]) -> ArrayDoubt | None:
    """Return evidence that a frame has another array than `cfa` (row, col), or None.

    If the array is right, sites at the same place of the super-pixel have the same mean over a frame. Sites of one channel
    do, too, unless the phase is wrong (`phase_doubt`). Three kinds of difference are no evidence of another array: single
    pixels, such as autofocus pixels; differences that are as large modulo a period which no sensor has; and stripes of the
    scene along rows or columns, which change all channels by the same factor.
    """
    tile, control = _mean_tile(frame), (5 * cfa.shape[0], 5 * cfa.shape[1])  # no array has that period
    if min(np.array(tile.shape) // control) < 2 or any(TILE % period for period in control):
        return None
    if not tile.mean() > MIN_SIGNAL * (frame.white_level - frame.black_level):
        return None
    places = np.arange(cfa.size).reshape(cfa.shape)
    _, usual = _differences(_means(tile, control), places)
    modulo = [_means(tile, tuple(np.lcm(cfa.shape, each))) for each in PERIODS]
    found = [_differences(means, places) for means in modulo if not _are_stripes(means, cfa.shape)]
    if phase_doubt(frame, cfa) is None:
        found.append(_differences(_means(tile, cfa.shape), shifted_cfa(cfa, frame.phase)))
    limit = max(ARRAYS_DIFFER, CONTROL * usual)
    differ = max((mean for most, mean in found if most >= MOST_SITES_DIFFER and mean >= limit), default=0.0)
    return ArrayDoubt(differ, _means(tile, (PERIOD, PERIOD))) if differ else None


def _mean_tile(frame: RawFrame) -> NDArray[np.float64]:
    """Return the mean signal (row, col) in DN above black of tiles that are evenly spaced over a frame.

    All tiles begin at the same CFA site, for any array whose period divides the side of a tile.
    """
    tops, lefts = (
        sorted({TILE * int(place) for place in np.linspace(0, max(length // TILE - 1, 0), TILES)})
        for length in frame.values.shape
    )
    tiles = [frame.values[top : top + TILE, left : left + TILE] for top in tops for left in lefts]
    return np.asarray(np.sum(tiles, axis=0, dtype=np.float64) / len(tiles) - frame.black_level - frame.dark)


def _means(tile: NDArray[np.float64], period: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the mean signal (row, col) of a tile modulo a period."""
    down, across = tile.shape[0] // period[0], tile.shape[1] // period[1]
    whole = tile[: down * period[0], : across * period[1]].reshape(down, period[0], across, period[1])
    return np.asarray(whole.mean(axis=(0, 2)))


def _are_stripes(means: NDArray[np.float64], period: tuple[int, ...]) -> bool:
    """Return whether super-pixels of a `period` differ only by one factor per row, or one per column.

    Pairs of rows that alternate between two factors do not count, because sensors with two gains have them.
    """
    rows, cols = period
    blocks = means.reshape(means.shape[0] // rows, rows, means.shape[1] // cols, cols)
    sites = blocks.mean(axis=(0, 2), keepdims=True)  # mean super-pixel
    differ = np.abs(blocks - sites).mean()
    for along in ((2, 3), (0, 1)):  # rows, and columns
        lines = blocks.mean(axis=along, keepdims=True)
        factors = lines / np.maximum(lines.mean(axis=0 if along == (2, 3) else 2, keepdims=True), MIN_SIGNAL)
        if np.abs(blocks - sites * factors).mean() <= STRIPED * differ:
            return along == (0, 1) or not _has_two_gains(factors.ravel())
    return False


def _has_two_gains(factors: NDArray[np.float64]) -> bool:
    """Return whether the factors of rows alternate, in pairs, between two gains."""
    pairs = [np.roll(factors, shift).reshape(-1, 2) for shift in (0, 1)]
    return any(
        np.ptp(each, axis=1).max() <= FITS
        and max(np.ptp(each[::2]), np.ptp(each[1::2])) <= FITS
        and each.max() >= TWO_GAINS * each.min()
        for each in pairs
    )


def _differences(means: NDArray[np.float64], array: NDArray[np.integer]) -> tuple[float, float]:
    """Return the difference of sites from the median of the sites with the same entry of `array`, as a fraction of the
    signal.

    The two numbers are what 30 % of the sites exceed, and the mean, for the entry whose sites differ most.
    """
    entries = tiled(array, means.shape)
    off = [
        np.abs(same - _median(same))
        for same in (means[entries == each] for each in range(int(array.max()) + 1))
        if same.size
    ]
    worst = max(off, key=lambda each: float(each.mean()))
    return float(np.sort(worst)[int(0.7 * (worst.size - 1))] / means.mean()), float(worst.mean() / means.mean())


def _median(values: NDArray[np.float64]) -> float:
    """Return the median. (np.median imports numpy.ma, which takes a twentieth of the time of a picture.)"""
    in_order = np.sort(values)
    return float(in_order[(values.size - 1) // 2] + in_order[values.size // 2]) / 2


def block_means(frame: RawFrame, period: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the mean signal (block, row, col) of each site of a super-pixel in evenly spaced blocks, in DN above black and
    dark current. The first site is that of the frame's first pixel.
    """
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
    """Return the mean difference between a site and the mean of its channel's sites, within blocks, as a fraction of the
    signal.
    """
    of_channels = (blocks[:, array == channel] for channel in sorted(set(array.flat)))
    return float(sum(np.abs(each - each.mean(axis=1, keepdims=True)).sum() for each in of_channels) / blocks.sum())


def _same_sites(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Return whether two arrays group the sites into channels in the same way, whatever the channels' names."""
    pairs = set(zip(one.flat, other.flat, strict=True))
    return len(pairs) == len(set(one.flat))


def _far_from_grey(
    blocks: NDArray[np.float64], array: NDArray[np.uint8], neutral: Sequence[float] | NDArray[np.floating] | None
) -> float:
    """Return the distance of a frame's mean from a grey, or 0 if no grey is stated.

    It is the range, over the channels, of the natural logarithm of signal / grey.
    """
    if neutral is None or min(neutral) <= 0:
        return 0.0
    means = np.array([blocks[:, array == channel].mean() for channel in range(len(neutral))])
    return float(np.ptp(np.log(np.maximum(means, blocks.mean() / 100) / neutral)))


def share_below_black(frame: RawFrame) -> float:
    """Return the fraction of pixels further below the black level than noise explains, or 0 if they are few."""
    if frame.black_level < SMALLEST_BLACK:
        return 0.0
    share = float((frame.values < BELOW * frame.black_level).mean())
    return share if share >= FEW else 0.0


def black_doubt(frame: RawFrame, cfa: NDArray[np.uint8]) -> float | None:
    """Return the probable black level of a frame that states a black level of 0, in DN, or None if there is no doubt.

    The darkest values of all channels then lie at about the same level, far above 0. Relative to their level they differ
    less between channels than the medians do. Dark values due to light would have the ratios of the filters'
    transmittances.
    """
    if frame.black_level > 0:
        return None
    sites = tiled(cfa, frame.values.shape)
    levels = np.array([np.percentile(frame.values[sites == each], (DARKEST, 50)) for each in np.unique(cfa)])
    darkest, usual = levels.T
    if not MIN_BLACK * frame.white_level <= darkest.min() <= darkest.max() <= MAX_BLACK * frame.white_level:
        return None
    ratios = [np.ptp(each) / each.mean() for each in (darkest, usual)]
    return float(darkest.mean()) if ratios[0] <= BETTER * ratios[1] else None


# ------------------------------------------------------------------------------------- bytes read in a wrong way


def smoother_reading(readings: Iterable[tuple[str, NDArray[np.uint16], int]], cfa: NDArray[np.uint8]) -> str:
    """Return the name of a reading of a frame's bytes that is far smoother than the first one, or "" if there is none.

    If low bits are taken for high ones, neighbours of one channel differ by a large part of full scale. A wrong reading can
    only add such differences, in flat, dark and noisy frames, too.

    Parameters
    ----------
    readings : iterable of (str, ndarray of uint16 (row, col), int)
        Name, pixels and bits of each way to read the same bytes, first the one in use. The others are only tried if that
        one is rough.
    cfa : ndarray of uint8, (row, col)
        Channels of the colour filter array from the first pixel on.
    """
    each = iter(readings)
    _, values, bits = next(each)
    rough = roughness(values, bits, cfa)
    if rough < ROUGH:
        return ""
    # If one byte of all 16-bit words is zero, exchanged bytes always look smoother, so they are no evidence.
    found = [(roughness(other, bits, cfa), name) for name, other, bits in each if bits < 16 or other.max() >= 256]
    least, name = min(found, default=(rough, ""))
    return name if least * SMOOTHER < rough else ""


def roughness(values: NDArray[np.uint16], bits: int, cfa: NDArray[np.uint8]) -> float:
    """Return the mean difference between nearest pixels of one channel as a fraction of full scale; 0 of a frame that is
    smaller than two super-pixels."""
    rows, cols = cfa.shape
    bands = len(values) // rows - 1
    if bands < 1 or values.shape[1] < 2 * cols:
        return 0.0
    starts = np.unique(np.linspace(0, bands - 1, min(bands, MAX_BANDS)).astype(int)) * rows
    taken = values[starts[:, None] + np.arange(2 * rows)].astype(np.int32)  # (band, row, col)
    differences = []
    for row, col in np.ndindex(rows, cols):
        down, right = _nearest_of_channel(cfa, row, col)
        start = col if col + right >= 0 else col + cols
        first, second = taken[:, row, start::cols], taken[:, row + down, start + right :: cols]
        length = min(first.shape[1], second.shape[1])
        differences.append(np.abs(first[:, :length] - second[:, :length]).mean())
    return float(np.mean(differences)) / 2**bits


def _nearest_of_channel(cfa: NDArray[np.uint8], row: int, col: int) -> Phase:
    """Return how far down and right of a site the nearest other one of its channel lies; never up."""
    rows, cols = cfa.shape
    steps = [
        (down, right)
        for down in range(rows + 1)
        for right in range(-cols, cols + 1)
        if (down or right > 0) and cfa[(row + down) % rows, (col + right) % cols] == cfa[row, col]
    ]
    return min(steps, key=lambda step: (step[0] ** 2 + step[1] ** 2, step))
