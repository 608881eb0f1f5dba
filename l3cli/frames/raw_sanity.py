"""Check whether the CFA, CFA phase and black level stated in a raw file are consistent with its pixels.

In a smooth block of a frame, all sites of a channel have nearly the same value. If they differ, the stated phase is probably
wrong. This test cannot detect a phase that swaps two channels with equal patterns, such as r and b in a Bayer CFA. A second
test detects such phases. It uses the signals of a grey object, which many files contain. The mean of a photo is roughly
grey, so it should be roughly proportional to these signals.

A super-pixel is one period of the CFA.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.frames.frame import RawFrame
from l3cli.physics.mosaic import shifted_cfa, tiled

# In the constants below, differences between sites are fractions of the signal.
BLOCK_SIDE, MAX_BLOCKS = 8, 32  # maximum side of a block in super-pixels; maximum number of blocks in each direction
MIN_SIGNAL = 1e-3  # fraction of full scale; frames with a lower mean are too dark to check
# A phase may be wrong if the sites of a channel differ by at least this value. In real frames, the difference is at most
# 0.007 at the correct phase, and at least 0.045 at wrong phases.
SITES_DIFFER = 0.02
# A phase may be wrong if the log ratio of two channel means, relative to a grey object, is at least this value. At the
# correct phase, it is at most 0.67 even in coloured scenes.
FAR_FROM_GREY = 0.75
BETTER = 0.4  # another phase is better only if its difference is at most this fraction of the stated phase's difference
ALIKE = 1.5  # two phases fit about equally well if the ratio of their differences is at most this value
BLACK_PERCENTILE = 0.1  # percentile of a channel's values that is close to black in most pictures
MIN_BLACK, MAX_BLACK = 1 / 64, 1 / 6  # range of real cameras' black levels, as fractions of the white level
# A frame may be decoded incorrectly if its roughness is at least the fraction ROUGH of full scale, and more than SMOOTHER
# times its roughness with another decoding.
ROUGH, SMOOTHER = 0.01, 3.0
MAX_BANDS = 32  # maximum number of bands, each two super-pixels high, in which roughness is measured
ARRAY_PERIODS_PIXELS, COMMON_PERIOD = (4, 6, 8), 24  # CFA periods that are considered, and a common multiple
TILE, TILES = 120, 8  # side of a tile in pixels, a multiple of all periods; maximum number of tiles in each direction
# The stated CFA is wrong if the mean difference between its sites is at least this value. If a Bayer CFA is stated, the
# difference is 0.001 to 0.02 in real Bayer frames, and 0.05 to 2 in frames with other CFAs.
ARRAYS_DIFFER = 0.05
# In addition, at least 30 % of the sites must differ by this value. Autofocus pixels affect fewer sites.
MOST_SITES_DIFFER = 0.03
# The scene has stripes if a factor per row or column explains all but this fraction of the differences.
STRIPED = 0.25
SLANTED = 0.03  # the same limit for slanted stripes, with a factor per slanted line
SLANTS = ((1, 1), (1, -1), (2, 1), (2, -1), (1, 2), (1, -2))  # lines on which row · first + column · second is constant
# Two limits distinguish a checkerboard in the scene from a different CFA. In the mean super-pixel, the largest and the
# smallest site must differ by at least CHECKED_SITES_DIFFER of the mean over all sites. The contrast of the checkerboard at
# each position must be at least LEAST_CHECK of its maximum contrast.
CHECKED_SITES_DIFFER = 0.15
LEAST_CHECK = 0.1
CHECK_FITS = 30  # number of alternating fits of super-pixel and checkerboard; needed if the squares have an odd size
TWO_GAINS = 2.0  # minimum ratio of the two gains of a sensor whose pairs of rows alternate between two gains
# Noise is measured in areas of this width in pixels. This percentile of the noise over all areas represents uniform areas.
NOISE_COLUMNS, NOISE_PERCENTILE = 8, 25
UNCLIPPED = 0.8  # fraction of full scale; noise is measured only in areas with a lower mean
MIN_NOISE = 0.5  # DN²; smaller variances are mainly rounding errors
# A difference between sites is evidence of a wrong CFA only if it is at least CONTROL times the difference at a period that
# no CFA has.
CONTROL = 3.0
FITS = 0.01  # sites that differ by less count as equal
SMALLEST_BLACK = 16.0  # DN; lower black levels are not checked
BELOW = 0.5  # fraction of a correct black level that even noisy dark pixels exceed
MIN_REPORTED_FRACTION = 0.05  # minimum fraction of too dark pixels that l3 reports
Phase = tuple[int, int]  # row and column


@dataclass(frozen=True)
class PhaseDoubt:
    """Evidence that a file states a wrong CFA phase."""

    stated: float  # mean difference between the sites of a channel at the stated phase, as a fraction of the signal
    least: float  # smallest mean difference at any phase
    phases: tuple[Phase, ...]  # phases with about the smallest difference, starting with the most likely one
    by_grey: bool = False  # whether the signals of a grey object are the only evidence


def phase_doubt(
    frame: RawFrame, cfa: NDArray[np.uint8], neutral: Sequence[float] | NDArray[np.floating] | None = None
) -> PhaseDoubt | None:
    """Return evidence that a frame's CFA phase is wrong. None if there is no evidence, or if the frame is too dark.

    Parameters
    ----------
    frame : RawFrame
        The frame, with the stated phase.
    cfa : ndarray, (cfa_row, cfa_col)
        Channel of each site.
    neutral : sequence of float, (channel,), optional
        Signals of a grey object, on any scale. Without them, a phase that swaps two channels with equal patterns is not
        detected.
    """
    blocks = block_means(frame, cfa.shape)
    if not blocks.size or not blocks.mean() > MIN_SIGNAL * (frame.white_level - frame.black_level):
        return None
    arrays: dict[bytes, Phase] = {}  # first phase that results in each shifted CFA, by the bytes of the CFA
    for phase in (frame.phase, *itertools.product(range(cfa.shape[0]), range(cfa.shape[1]))):
        arrays.setdefault(shifted_cfa(cfa, phase).tobytes(), phase)
    phases = {phase: shifted_cfa(cfa, phase) for phase in arrays.values()}
    grey = {phase: _far_from_grey(blocks, array, neutral) for phase, array in phases.items()}
    # Both tests are useful: blocks have stronger colours than the mean of the frame, but the mean is less noisy.
    for scale in (blocks, blocks.mean(axis=0, keepdims=True)):
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
    """Evidence that a mosaic has a different CFA than its file states."""

    differ: float  # mean difference between sites of the same channel in the stated CFA, as a fraction of the signal
    means: NDArray[np.float64]  # (row, col) DN; mean signal at each position in a period of COMMON_PERIOD pixels

    def likely(self, arrays: Mapping[str, NDArray[np.uint8]]) -> list[str]:
        """Return the names of the CFAs that fit the pixels best at any phase, sorted by the number of channels.

        `arrays` contains the candidates, (row, col), by name. Two types of candidates are ignored. Candidates with more than
        four sites, and a different channel at every site, would fit any pixels. Candidates with a period that does not
        divide COMMON_PERIOD cannot be tested.
        """
        judged = {name: cfa for name, cfa in arrays.items() if len(set(cfa.flat)) < cfa.size or cfa.size <= 4}
        misfits = {
            name: self._misfit(cfa) for name, cfa in judged.items() if not (COMMON_PERIOD % np.array(cfa.shape)).any()
        }
        limit = max(ALIKE * min(misfits.values()), FITS)
        fitting = [name for name, misfit in misfits.items() if misfit <= limit]
        return sorted(fitting, key=lambda name: (len(set(arrays[name].flat)), misfits[name]))

    def _misfit(self, cfa: NDArray[np.uint8]) -> float:
        """Return the mean difference between sites of a channel at a CFA's best phase, as a fraction of the signal."""
        phases = itertools.product(range(cfa.shape[0]), range(cfa.shape[1]))
        whole = [tiled(shifted_cfa(cfa, phase), self.means.shape) for phase in phases]
        return min(_sites_differ(self.means[None], array) for array in whole)


def array_doubt(frame: RawFrame, cfa: NDArray[np.uint8]) -> ArrayDoubt | None:
    """Return evidence that a frame's CFA differs from `cfa`, (row, col).

    If the CFA is correct, sites at the same position in the super-pixel have the same mean over the frame. If the phase is
    also correct (see `phase_doubt`), so do all sites of a channel. Three types of differences are no evidence of a different
    CFA:

    1. differences at single pixels, such as autofocus pixels
    2. differences not much larger than the differences for a period that no CFA has
    3. stripes and checkerboards in the scene, which change all channels by the same factor

    Returns
    -------
    ArrayDoubt or None
        None if there is no evidence, or if the frame is too small or too dark to check.
    """
    tiles = _tiles(frame)
    tile, control = tiles.mean(axis=(0, 1)), (5 * cfa.shape[0], 5 * cfa.shape[1])  # `control` is a period that no CFA has
    if min(np.array(tile.shape) // control) < 2 or any(TILE % period for period in control):
        return None
    if not tile.mean() > MIN_SIGNAL * (frame.white_level - frame.black_level):
        return None
    places = np.arange(cfa.size).reshape(cfa.shape)
    _, usual = _differences(_means(tile, control), places)
    quarters = [part.mean(axis=(0, 1)) for half in _halves(tiles, 0) for part in _halves(half, 1)]
    found, two_gains = [], functools.partial(_noise_shows_two_gains, frame, tiles, cfa.shape)
    for period in (tuple(np.lcm(cfa.shape, each)) for each in ARRAY_PERIODS_PIXELS):
        means = _means(tile, period)
        parts = [_means(each, period) for each in quarters]
        if not (_are_stripes(means, cfa.shape, parts, two_gains) or _are_checks(means, cfa.shape)):
            found.append(_differences(means, places))
    if phase_doubt(frame, cfa) is None:
        found.append(_differences(_means(tile, cfa.shape), shifted_cfa(cfa, frame.phase)))
    limit = max(ARRAYS_DIFFER, CONTROL * usual)
    differ = max((mean for most, mean in found if most >= MOST_SITES_DIFFER and mean >= limit), default=0.0)
    return ArrayDoubt(differ, _means(tile, (COMMON_PERIOD, COMMON_PERIOD))) if differ else None


def _tiles(frame: RawFrame) -> NDArray[np.float64]:
    """Return the signals in tiles that are evenly spaced over a frame: (tile row, tile col, row, col).

    Signals are in DN above black and dark current. If the CFA period divides TILE, all tiles start at the same CFA site.
    """
    tops, lefts = (
        sorted({TILE * int(place) for place in np.linspace(0, max(length // TILE - 1, 0), TILES)})
        for length in frame.values.shape
    )
    tiles = [[frame.values[top : top + TILE, left : left + TILE] for left in lefts] for top in tops]
    return np.asarray(tiles, np.float64) - frame.black_level - frame.dark


def _halves(tiles: NDArray[np.float64], axis: int) -> list[NDArray[np.float64]]:
    """Divide tiles along an axis into two halves. If the number of tiles is odd, the middle tile is in both halves."""
    length = tiles.shape[axis]
    return [tiles.take(range((length + 1) // 2), axis), tiles.take(range(length // 2, length), axis)]


def _means(tile: NDArray[np.float64], period: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the mean signal in a tile at each position within a period, (row, col)."""
    down, across = tile.shape[0] // period[0], tile.shape[1] // period[1]
    whole = tile[: down * period[0], : across * period[1]].reshape(down, period[0], across, period[1])
    return np.asarray(whole.mean(axis=(0, 2)))


def _are_stripes(
    means: NDArray[np.float64], period: tuple[int, ...], parts: list[NDArray[np.float64]], two_gains: Callable[[], bool]
) -> bool:
    """Return whether the super-pixels in `means` differ only by a factor per row, per column or per slanted line.

    The exception is a sensor with two gains: if pairs of rows alternate between two factors in all `parts` of the frame, and
    if `two_gains` returns True, the result is False.
    """
    blocks = _super_pixels(means, period)
    sites = blocks.mean(axis=(0, 2), keepdims=True)  # mean super-pixel
    differ = np.abs(blocks - sites).mean()
    for along in ((2, 3), (0, 1)):  # rows, and columns
        if np.abs(blocks - sites * _factors(blocks, along)).mean() <= STRIPED * differ:
            rows = [_factors(_super_pixels(each, period), along).ravel() for each in (means, *parts)]
            return along == (0, 1) or not (all(map(_has_two_gains, rows)) and two_gains())
    return any(_are_slanted(means, sites, slant) for slant in SLANTS)


def _super_pixels(means: NDArray[np.float64], period: tuple[int, ...]) -> NDArray[np.float64]:
    """Divide means, (row, col), into super-pixels: (down, row, across, col)."""
    return means.reshape(means.shape[0] // period[0], period[0], means.shape[1] // period[1], period[1])


def _factors(blocks: NDArray[np.float64], along: tuple[int, int]) -> NDArray[np.float64]:
    """Return the mean of each row or column, relative to all lines at the same position in the super-pixel.

    `along` contains the axes of `blocks` to average over: (2, 3) for rows, or (0, 1) for columns.
    """
    lines = blocks.mean(axis=along, keepdims=True)
    mean = lines.mean(axis=0 if along == (2, 3) else 2, keepdims=True)
    return np.asarray(lines / np.maximum(mean, MIN_SIGNAL))


def _are_checks(means: NDArray[np.float64], period: tuple[int, ...]) -> bool:
    """Return whether `means` is the mean super-pixel multiplied by a checkerboard, 1 + f(row) · g(col).

    If the frame has a CFA with a different period, the result is False. Such a CFA is recognised in two ways: the sites of
    the mean super-pixel are nearly equal (quad Bayer, for example), or some sites in `means` equal the mean super-pixel.
    """
    sites = _super_pixels(means, period).mean(axis=(0, 2))
    if np.ptp(sites) < CHECKED_SITES_DIFFER * sites.mean() or sites.min() <= 0:
        return False
    for _ in range(CHECK_FITS):  # squares of odd size also affect the mean super-pixel
        left, sizes, right = np.linalg.svd(means / tiled(sites, means.shape) - 1.0)
        factors = 1.0 + sizes[0] * np.outer(left[:, 0], right[0])
        sums = [_super_pixels(each, period).sum(axis=(0, 2)) for each in (means * factors, factors**2)]
        sites = np.maximum(sums[0] / sums[1], MIN_SIGNAL)
    checks = means / tiled(sites, means.shape) - 1.0
    lines = max(np.abs(checks.mean(axis=axis)).max() for axis in (0, 1))  # 0 for a checkerboard, and large for stripes
    largest, second = np.linalg.svd(checks, compute_uv=False)[:2]
    contrast = np.abs(checks).max()
    return bool(second <= SLANTED * largest and lines <= LEAST_CHECK * contrast <= np.abs(checks).min())


def _are_slanted(means: NDArray[np.float64], sites: NDArray[np.float64], slant: tuple[int, int]) -> bool:
    """Return whether `means` is the product of the mean super-pixel `sites` and a factor per slanted line.

    The limit SLANTED is strict, because a CFA with diagonals of a single channel, such as RGBW, almost meets this condition.
    """
    usual = np.maximum(tiled(sites[0, :, 0], means.shape), MIN_SIGNAL)
    row, col = np.indices(means.shape)
    line = (slant[0] * row + slant[1] * col) % np.gcd(*means.shape)
    factors = np.bincount(line.ravel(), (means / usual).ravel()) / np.bincount(line.ravel())
    return bool(np.abs(means - usual * factors[line]).mean() <= SLANTED * np.abs(means - usual).mean())


def _has_two_gains(factors: NDArray[np.float64]) -> bool:
    """Return whether the gain alternates between two values from one pair of rows to the next.

    `factors` contains the gain of each row.
    """
    pairs = [np.roll(factors, shift).reshape(-1, 2) for shift in (0, 1)]
    return any(
        np.ptp(each, axis=1).max() <= FITS
        and max(np.ptp(each[::2]), np.ptp(each[1::2])) <= FITS
        and each.max() >= TWO_GAINS * each.min()
        for each in pairs
    )


def _noise_shows_two_gains(frame: RawFrame, tiles: NDArray[np.float64], period: tuple[int, ...]) -> bool:
    """Return whether the noise shows that, in each group of four rows, the two bright rows have a higher gain than the
    others.

    The gain in DN/e- is the ratio of noise variance to signal. If all rows have the same gain, this ratio is the same in
    bright and dark rows. If the noise is too small to be measured, the result is True.
    """
    cols = (tiles.shape[3] - period[1]) // NOISE_COLUMNS * NOISE_COLUMNS
    near, far = tiles[..., :cols], tiles[..., period[1] :][..., :cols]  # pairs of pixels of the same channel
    parts = [each.reshape(*each.shape[:3], -1, NOISE_COLUMNS) for each in ((near - far) ** 2 / 2, (near + far) / 2)]
    variance, signal = (each.mean(axis=-1) for each in parts)
    share = signal / (frame.white_level - frame.black_level)
    usable = (share > MIN_SIGNAL) & (share < UNCLIPPED)
    gains, levels = [], []
    for row in range(4):
        kept = usable[:, :, row::4]
        if not kept.any():
            return True
        here, bright = variance[:, :, row::4][kept], signal[:, :, row::4][kept]
        if np.percentile(here, NOISE_PERCENTILE) < MIN_NOISE:
            return True
        gains.append(np.percentile(here / bright, NOISE_PERCENTILE))
        levels.append(signal[:, :, row::4].mean())
    (dark, light), noise = np.argsort(levels).reshape(2, 2), np.array(gains)
    ratio = np.array(levels)[light].mean() / np.array(levels)[dark].mean()
    return bool(noise[light].mean() >= noise[dark].mean() * np.sqrt(ratio))


def _differences(means: NDArray[np.float64], array: NDArray[np.integer]) -> tuple[float, float]:
    """Return by how much sites deviate from the median over all sites with the same entry in `array`.

    Only the entry with the largest mean deviation is considered.

    Returns
    -------
    exceeded : float
        Deviation that 30 % of the sites exceed, as a fraction of the signal.
    mean : float
        Mean deviation, as a fraction of the signal.
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
    """Return the median without np.median, which imports numpy.ma and adds 5 % to the rendering time."""
    in_order = np.sort(values)
    return float(in_order[(values.size - 1) // 2] + in_order[values.size // 2]) / 2


def block_means(frame: RawFrame, period: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the mean signal at each site of the super-pixel, in evenly spaced blocks of a frame.

    Parameters
    ----------
    frame : RawFrame
        Frame to measure.
    period : tuple of int
        Number of rows and columns in the CFA.

    Returns
    -------
    ndarray, (block, row, col)
        Signals in DN above black and dark current, starting with the CFA site of the frame's first pixel. There are no
        blocks if the frame is smaller than the CFA period.
    """
    rows, cols = period
    side = int(np.clip(min(frame.values.shape[0] // rows, frame.values.shape[1] // cols) // BLOCK_SIDE, 1, BLOCK_SIDE))
    down, across = frame.values.shape[0] // (rows * side), frame.values.shape[1] // (cols * side)
    if not down * across:
        return np.zeros((0, rows, cols))
    whole = frame.values[: down * side * rows].reshape(down, side * rows, -1)[:: -(-down // MAX_BLOCKS)]
    whole = whole[..., : across * side * cols].reshape(-1, side, rows, across, side, cols)[
        :, :, :, :: -(-across // MAX_BLOCKS)
    ]
    means = whole.mean(axis=(1, 4)).transpose(0, 2, 1, 3).reshape(-1, rows, cols)
    return np.asarray(means - frame.black_level - frame.dark)


def _sites_differ(blocks: NDArray[np.float64], array: NDArray[np.uint8]) -> float:
    """Return the mean absolute deviation of sites from the mean of their channel in the same block.

    The deviation is a fraction of the signal.
    """
    of_channels = (blocks[:, array == channel] for channel in sorted(set(array.flat)))
    return float(sum(np.abs(each - each.mean(axis=1, keepdims=True)).sum() for each in of_channels) / blocks.sum())


def _same_sites(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Return whether two CFAs differ only in the numbering of their channels."""
    pairs = set(zip(one.flat, other.flat, strict=True))
    return len(pairs) == len(set(one.flat))


def _far_from_grey(
    blocks: NDArray[np.float64], array: NDArray[np.uint8], neutral: Sequence[float] | NDArray[np.floating] | None
) -> float:
    """Return a frame's deviation from grey: the range of ln(mean signal / signal of grey) over the channels.

    Returns 0 if `neutral` is None or contains values that are not positive.
    """
    if neutral is None or min(neutral) <= 0:
        return 0.0
    means = np.array([blocks[:, array == channel].mean() for channel in range(len(neutral))])
    return float(np.ptp(np.log(np.maximum(means, blocks.mean() / 100) / neutral)))


def share_below_black(frame: RawFrame) -> float:
    """Return the fraction of pixels that are so far below the black level that this level must be wrong.

    These pixels are below BELOW times the black level. If the fraction is too small to report, or if the black level is
    below SMALLEST_BLACK, the result is 0.
    """
    if frame.black_level < SMALLEST_BLACK:
        return 0.0
    share = float((frame.values < BELOW * frame.black_level).mean())
    return share if share >= MIN_REPORTED_FRACTION else 0.0


def black_doubt(frame: RawFrame, cfa: NDArray[np.uint8]) -> float | None:
    """Return the probable black level, in DN, of a frame with a stated black level of 0.

    If the stated level is wrong, the darkest values of all channels are close to the true black level, far above 0. They are
    then more similar in all channels than the medians are. Dark values due to light would instead differ between channels
    as much as the medians, in proportion to the filters' transmittances.

    Returns
    -------
    float or None
        None if the stated level is above 0, or if 0 is plausible.
    """
    if frame.black_level > 0:
        return None
    sites = tiled(cfa, frame.values.shape)
    levels = np.array([np.percentile(frame.values[sites == each], (BLACK_PERCENTILE, 50)) for each in np.unique(cfa)])
    darkest, usual = levels.T
    if not MIN_BLACK * frame.white_level <= darkest.min() <= darkest.max() <= MAX_BLACK * frame.white_level:
        return None
    ratios = [np.ptp(each) / each.mean() for each in (darkest, usual)]
    return float(darkest.mean()) if ratios[0] <= BETTER * ratios[1] else None


# ------------------------------------------------------------------------------- frames decoded with a wrong layout


def smoother_reading(readings: Iterable[tuple[str, NDArray[np.uint16], int]], cfa: NDArray[np.uint8]) -> str:
    """Find a decoding of a headerless file that results in a far smoother frame than the current decoding.

    If low bits are mistaken for high bits, neighbouring pixels of the same channel differ by a large fraction of full scale,
    even in uniform, dark or noisy frames. A wrong decoding never makes a frame smoother.

    Parameters
    ----------
    readings : iterable of (str, ndarray of uint16 (row, col), int)
        Option, pixels and bits per pixel of each decoding of the same bytes. The first one is the current decoding. The
        others are computed only if it results in a rough frame.
    cfa : ndarray of uint8, (row, col)
        Channel of each site, starting with the site of the first pixel.

    Returns
    -------
    str
        Option that selects the smoothest decoding. "" if the current decoding is plausible, or if no other is much smoother.
    """
    each = iter(readings)
    _, values, bits = next(each)
    rough = roughness(values, bits, cfa)
    if rough < ROUGH:
        return ""
    # Ignore swapped 16-bit values that all fit into 8 bits. They result in a smoother frame even if the order was correct.
    found = [(roughness(other, bits, cfa), name) for name, other, bits in each if bits < 16 or other.max() >= 256]
    least, name = min(found, default=(rough, ""))
    return name if least * SMOOTHER < rough else ""


def roughness(values: NDArray[np.uint16], bits: int, cfa: NDArray[np.uint8]) -> float:
    """Return the mean difference between neighbouring pixels of the same channel, as a fraction of full scale.

    It is measured in evenly spaced bands of a frame, (row, col). `cfa` starts with the site of the first pixel. If the frame
    has fewer than two super-pixels in one of the directions, the result is 0.
    """
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
    """Return the offset (down, right) to the nearest site of the same channel, to the right or in a lower row."""
    rows, cols = cfa.shape
    steps = [
        (down, right)
        for down in range(rows + 1)
        for right in range(-cols, cols + 1)
        if (down or right > 0) and cfa[(row + down) % rows, (col + right) % cols] == cfa[row, col]
    ]
    return min(steps, key=lambda step: (step[0] ** 2 + step[1] ** 2, step))
