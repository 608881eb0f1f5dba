"""Determine the class rule of a refinement layer.

The rule classifies pixels by structure (docs/method.md#structure) or by a decision tree (docs/method.md#trees).

A tree is grown from a random subset of the samples. Each step makes the split that reduces the squared error most. To
evaluate a split, l3 fits one filter to the samples on each side of the threshold. Two filters always fit the samples better
than one, because they have twice as many taps. l3 therefore subtracts the error reduction expected from a random split, and
splits the leaf only if the remaining reduction is statistically significant. All sites share one tree, but each site has its
own filters.
"""

import heapq
import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.layers import PLANE_STEP, PLANES
from l3cli.artifacts.plane_rules import MAX_DEPTH, SMALLEST, TESTS, GradientScale, StructureRule, TreeRule
from l3cli.artifacts.training_set import TrainingPair
from l3cli.classes import structure
from l3cli.classes.planes import LUMINANCE
from l3cli.classes.refinement import plane_evidence
from l3cli.classes.tree import EVERY, Evidence, turned_tests
from l3cli.training.layers.learn import LayerPass
from l3cli.training.layers.mosaics import Floats, mosaics_of, sheets_of
from l3cli.training.layers.samples import sample_weights
from l3cli.training.symmetry import orientations

# A test compares a quotient with a threshold. Each test is tried with several thresholds, at quantiles of the quotient.
THRESHOLDS_PER_TEST = 5
QUOTIENT_SAMPLES = 1 << 13  # the quantiles are computed from about this number of samples per site
TREE_SIDE_PIXELS = 64  # largest side of the mosaics, in pixels; small, because a tree needs only a few samples per mosaic
SPLIT_SIDE_PIXELS = 3  # largest side, in pixels, of the windows for evaluating splits, when training on noise-free frames
SAMPLES_PER_TAP = 4  # smallest number of samples per tap in a leaf, at every site
# A column's maximum is between 2^15 and 2^16 rounding steps. Sums of products over a million samples are then exact.
COLUMN_STEPS = 2.0**16
TAP_RIDGE = 1e-6  # ridge of the least-squares fit, relative to the mean power of the taps
OUTPUT_RIDGE = 1e-10  # ridge relative to the mean power of the outputs, which keeps the matrix positive definite
OUTPUTS = 3  # number of target values per sample
# A split is significant if its gain exceeds this many standard deviations of a random split's gain. The limit is high,
# because the best of many splits is chosen.
CHANCE_DEVIATIONS = 3.0

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class TreeSamples:
    """Samples for growing a tree, from all sites that share a canonical site."""

    # (sample, column) weighted taps of the noisy planes, then weighted targets, converted by `_perceptual_basis`
    columns: Floats | Array
    numerators: Floats  # (test, sample) numerators of the quotients that the tests compare with thresholds
    denominators: Floats  # (denominator, sample) denominators of the quotients; several tests share a denominator

    @classmethod
    def concatenated(cls, parts: Sequence["TreeSamples"]) -> "TreeSamples":
        axes = {"columns": 0, "numerators": 1, "denominators": 1}
        return cls(*(np.concatenate([getattr(part, name) for part in parts], axis) for name, axis in axes.items()))

    def on_grid(self) -> "TreeSamples":
        """Round each column to multiples of a power of two, so that sums of products are exact in any order."""
        _, power = np.frexp(np.abs(self.columns).max(axis=0, initial=SMALLEST))
        step = np.ldexp(1 / COLUMN_STEPS, power).astype(np.float32)
        return replace(self, columns=np.rint(self.columns / step) * step.astype(np.float64))

    def compared(self, test: int, chosen: Indices) -> tuple[Floats, Floats]:
        """Return a test's numerators and denominators for the chosen samples."""
        return self.numerators[test].take(chosen), self.denominators[EVERY[test].denominator].take(chosen)

    def passed(self, test: int, cuts: Floats, chosen: Indices) -> NDArray[np.int8]:
        """Count, for each chosen sample, how many thresholds in `cuts` the test's quotient exceeds."""
        numerator, denominator = self.compared(test, chosen)
        return np.asarray(np.add.reduce([(numerator > cut * denominator).view(np.int8) for cut in cuts]))


def turned_evidence(seen: Evidence, turn: int, pixels: Indices) -> tuple[Floats, Floats]:
    """Convert the numerators and denominators of tree tests to another window orientation.

    Parameters
    ----------
    seen : Evidence
        Numerators and denominators for all pixels, in the original orientation.
    turn : int
        Index of the new orientation in `symmetry.orientations`.
    pixels : ndarray, (pixel)
        Indices of the pixels.

    Returns
    -------
    numerators : ndarray, (test, pixel)
        Numerators for the turned windows.
    denominators : ndarray, (denominator, pixel)
        Denominators, which do not depend on the orientation.
    """
    test, sign = turned_tests(turn)
    numerators = seen.numerators.reshape(TESTS, -1)[:, pixels][test] * np.array(sign)[:, None]
    return numerators, seen.denominators.reshape(len(seen.denominators), -1)[:, pixels]


class Tree(NamedTuple):
    """Nodes of a decision tree, with the fields of `TreeRule`."""

    test: NDArray[np.uint8]
    threshold: NDArray[np.float32]
    branch: NDArray[np.int32]


class _Split(NamedTuple):
    gain: float
    test: int
    threshold: np.float32


Mapped = Callable[[Callable[[int], tuple[Floats, Array]], Iterable[int]], Iterable[tuple[Floats, Array]]]


def grow(sites: Sequence[TreeSamples], leaves: int, mapped: Mapped = map) -> Tree:
    """Grow a decision tree from the samples of all canonical sites.

    Parameters
    ----------
    sites : sequence of TreeSamples
        Samples of each canonical site. A canonical site represents all CFA sites that are symmetric to it. If the sequence
        is empty, the tree has a single leaf.
    leaves : int
        Maximum number of leaves.
    mapped : callable
        `map`, or a multi-threaded function with the same interface.

    Returns
    -------
    Tree
        Nodes in the order in which they were created, starting with the root.
    """
    sites = [one.on_grid() for one in sites]
    test, threshold, branch, depth = [0], [np.float32(0)], [0], [0]
    waiting: list[tuple[float, int, _Split, list[Indices]]] = []

    def look(node: int, samples: list[Indices]) -> None:
        split = _best_split(sites, samples, mapped) if depth[node] < MAX_DEPTH else None
        if split is not None:
            heapq.heappush(waiting, (-split.gain, node, split, samples))

    if sites:
        look(0, [np.arange(len(one.columns)) for one in sites])
    for _ in range(leaves - 1):
        if not waiting:
            break
        _, node, split, samples = heapq.heappop(waiting)
        test[node], threshold[node], branch[node] = split.test, split.threshold, len(test)
        cuts = np.array([split.threshold])
        above = [one.passed(split.test, cuts, of_leaf) for one, of_leaf in zip(sites, samples, strict=True)]
        for side in (False, True):
            test.append(0)
            threshold.append(np.float32(0))
            branch.append(0)
            depth.append(depth[node] + 1)
            look(len(test) - 1, [of_leaf[up == side] for of_leaf, up in zip(samples, above, strict=True)])
    return Tree(np.array(test, np.uint8), np.array(threshold, np.float32), np.array(branch, np.int32))


def _best_split(sites: Sequence[TreeSamples], samples: list[Indices], mapped: Mapped) -> _Split | None:
    """Find the split of a leaf with the largest gain.

    Return None if no gain is statistically significant, or if the leaf has too few samples for two leaves.
    """
    taps = sites[0].columns.shape[1] - OUTPUTS
    if min(map(len, samples)) < 2 * SAMPLES_PER_TAP * taps:
        return None
    best = None
    whole = [_sums(one, of_leaf) for one, of_leaf in zip(sites, samples, strict=True)]
    before = [float(_error(sums)) for sums in whole]
    noise = np.array([error / of_leaf.size for error, of_leaf in zip(before, samples, strict=True)])
    chance = CHANCE_DEVIATIONS * np.sqrt(2 * taps * np.square(noise).sum())

    telling = [of_leaf[:: max(of_leaf.size // QUOTIENT_SAMPLES, 1)] for of_leaf in samples]

    def tried(test: int) -> tuple[Floats, Array]:
        quotients = np.concatenate(
            [np.divide(*one.compared(test, of_leaf)) for one, of_leaf in zip(sites, telling, strict=True)]
        )
        cuts = np.quantile(quotients, np.arange(1, THRESHOLDS_PER_TEST + 1) / (THRESHOLDS_PER_TEST + 1)).astype(np.float32)
        cuts = np.unique(np.where(np.abs(cuts) < SMALLEST, np.float32(0), cuts))
        gain = np.zeros(len(cuts))
        for one, of_leaf, sums, error in zip(sites, samples, whole, before, strict=True):
            gain += _gains(one, of_leaf, test, cuts, sums, error)
        return cuts, gain

    for test, (cuts, gain) in enumerate(mapped(tried, range(TESTS))):
        if gain.max() > (best.gain if best else chance):
            best = _Split(float(gain.max()), test, cuts[gain.argmax()])
    return best


def _gains(site: TreeSamples, chosen: Indices, test: int, cuts: Floats, whole: Array, before: float) -> Array:
    """Return the gain from splitting one site's samples, for each threshold in `cuts`.

    The gain is the reduction in squared error, minus the reduction that the additional taps cause by chance. If one side of
    the split has too few samples, the gain is −∞.
    """
    taps = site.columns.shape[1] - OUTPUTS
    passed = site.passed(test, cuts, chosen)  # number of thresholds that each sample exceeds
    order, below = np.argsort(passed, kind="stable"), np.cumsum(np.bincount(passed, minlength=len(cuts)))[: len(cuts)]
    many = np.array([below, chosen.size - below])
    good = many.min(axis=0) >= SAMPLES_PER_TAP * taps
    gain = np.full(len(cuts), -np.inf)
    if good.any():
        sums = _sums_below(site, chosen[order], below[good].tolist(), whole)
        left, right = _error(sums), _error(whole - sums)
        low, high = many[:, good]
        gain[good] = before - left - right - taps * (left / low + right / high - before / chosen.size)
    return gain


def _sums_below(site: TreeSamples, chosen: Indices, ends: list[int], whole: Array) -> Array:
    """Sum the products of columns over the samples `chosen[:end]`, for each `end` in `ends`: (end, column, column).

    The ends divide the samples into segments. To save time, the largest segment's sum is computed as the difference between
    the total `whole` and the other segments' sums.
    """
    parts = list(itertools.pairwise([0, *ends, chosen.size]))
    largest = max(range(len(parts)), key=lambda part: parts[part][1] - parts[part][0])
    sums = np.zeros((len(parts), *whole.shape))
    for number, part in enumerate(parts):
        if number != largest:
            sums[number] = _sums(site, chosen[slice(*part)])
    sums[largest] = whole - sums.sum(axis=0)
    for before, each in itertools.pairwise(sums):
        each += before
    return sums[:-1]


def _sums(site: TreeSamples, chosen: Indices) -> Array:
    columns = site.columns.take(chosen, axis=0)
    return np.asarray(columns.T @ columns)


def _error(sums: Array) -> Array:
    """Return the squared residual of a least-squares fit, from sums of products (…, column, column)."""
    taps = sums.shape[-1] - OUTPUTS
    systems = sums.copy()
    diagonal = np.einsum("...ii->...i", systems)  # a view: changes to the diagonal also change `systems`
    for columns, ridge in (diagonal[..., :taps], TAP_RIDGE), (diagonal[..., taps:], OUTPUT_RIDGE):
        columns += ridge * columns.mean(axis=-1, keepdims=True) + 1e-9
    left = np.linalg.cholesky(systems)[..., taps:, taps:]
    return np.asarray((left * left).sum(axis=(-2, -1)))


PILOT_MOSAICS = 48  # total number of mosaics in which luminance noise is measured
PILOT_SIDE = 72  # side of these mosaics, in pixels
MAX_MEASURED_LEVEL = 0.8  # noise is measured only at levels up to this fraction of full scale
MIN_LEVEL_PIXELS = 1000  # for levels with fewer pixels, the noise is interpolated
LAB_SLOPES = (500.0, 116.0, 200.0)  # proportional to the slopes of a*, L* and b* near white, in the order of the planes


def luminance_noise(layer: LayerPass, frames: Iterable[TrainingPair], first: int, every: int) -> list[NDArray[np.float64]]:
    """Measure the noise in the luminance plane that the new layer reads.

    Parameters
    ----------
    layer : LayerPass
        Settings for training the refinement layer, and the previous layers.
    frames : iterable of TrainingPair
        Training frames.
    first : int
        Index of the first frame.
    every : int
        Spacing of the measured frames. Frames with an index that is not a multiple of this number are skipped.

    Returns
    -------
    list of ndarray, (2, level)
        One array per measured frame. Row 0 contains, for each level, the sum of (dx² + dy²) / 2 over its pixels. dx and dy
        are the differences in noise between the right and left neighbours, and between the lower and upper neighbours. Row 1
        contains the number of pixels at each level.
    """
    see, noisy, measured = layer.seer(), replace(layer.exposed, noisy=True, inner=PILOT_SIDE), []
    brightest = MAX_MEASURED_LEVEL * layer.camera.sensitivity.mean() / layer.camera.sensitivity.min()
    for index, frame in enumerate(frames, first):
        if index % every:
            continue
        total = np.zeros((2, layer.rule.levels))
        rng = layer.rng(index, 0)
        for mosaic in mosaics_of(frame, 1, noisy, rng):
            seen = see(mosaic)
            noise = seen.noisy[LUMINANCE] - seen.light[LUMINANCE]
            across, down = noise[1:-1, 2:] - noise[1:-1, :-2], noise[2:, 1:-1] - noise[:-2, 1:-1]
            place = layer.rule.split(seen.label)
            measurable = ((layer.rule.lost(place.kind) == 0) & (seen.brightness < brightest))[1:-1, 1:-1]
            level = place.level[1:-1, 1:-1][measurable]
            total[0] += np.bincount(level, ((across**2 + down**2) / 2)[measurable], layer.rule.levels)
            total[1] += np.bincount(level, minlength=layer.rule.levels)
        measured.append(total)
    return measured


def gradient_scale(layer: LayerPass, noise: Iterable[NDArray[np.float64]]) -> GradientScale:
    """Compute each level's factor that normalises gradients by their noise.

    In areas without structure, normalised gradients have the standard deviation `structure.SIGMA`.

    Parameters
    ----------
    layer : LayerPass
        Settings for training the refinement layer, and the previous layers.
    noise : iterable of ndarray, (2, level)
        Results of `luminance_noise` for all measured frames.

    Returns
    -------
    GradientScale
        The factors, one per level of the first layer.
    """
    squares, count = np.sum([np.zeros((2, layer.rule.levels)), *noise], axis=0)
    known = np.flatnonzero((count >= min(MIN_LEVEL_PIXELS, count.max())) & (squares > 0))
    deviation = np.ones(layer.rule.levels)
    if known.size:
        spread = np.log(squares[known] / count[known]) / 2
        deviation = np.exp(np.interp(np.arange(layer.rule.levels), known, spread))
    return GradientScale.of(structure.SIGMA / deviation)


def structure_rule(layer: LayerPass, scale: GradientScale) -> StructureRule:
    """Build a rule that classifies pixels by level and structure (docs/method.md#structure)."""
    return StructureRule(
        **vars(scale),
        level_step=layer.recipe.level_step,
        strength_edges=np.rint(np.array(layer.recipe.strengths) * structure.NOISE_TRACE).astype(np.uint32),
        coherence=round(64 * layer.recipe.coherence),
        turns=np.array([structure.turn_signs(orientations(3)[turn]) for turn in layer.turns], np.int8),
        cases=layer.rule.lost_cases,
    )


def sample_tree(
    layer: LayerPass, scale: GradientScale, frames: Iterable[TrainingPair], first: int
) -> list[dict[int, TreeSamples]]:
    """Draw random samples from which to grow a tree.

    Parameters
    ----------
    layer : LayerPass
        Settings for training the refinement layer, and the previous layers.
    scale : GradientScale
        Result of `gradient_scale`.
    frames : iterable of TrainingPair
        Training frames.
    first : int
        Index of the first frame.

    Returns
    -------
    list of dict of int to TreeSamples
        Each frame's samples, by canonical site.
    """
    see, reading, sampled = layer.seer(), layer.reading(_split_side(layer)), []
    perceptual_basis, turns = _perceptual_basis(layer), layer.turns
    per_mosaic = -(-layer.recipe.tree_rows // sum(layer.mosaics))
    exposed = replace(layer.exposed, inner=min(layer.exposed.inner, TREE_SIDE_PIXELS))
    for index, frame in enumerate(frames, first):
        rng = layer.rng(index, 2)
        parts: dict[int, list[TreeSamples]] = {}
        mosaics = mosaics_of(frame, layer.mosaics[index], exposed, rng)
        for sheet in sheets_of(mosaics, layer.camera.cfa.shape[0]):
            seen = see(sheet)
            place = layer.rule.split(seen.label)
            site = np.broadcast_to(place.site, seen.label.shape).ravel()
            weight = sample_weights(seen, layer.basis, layer.white_point, layer.learning, layer.pictures).ravel()
            target = seen.target.reshape(-1, seen.target.shape[-1]) @ perceptual_basis
            evidence = plane_evidence(seen.noisy, place.level, scale.gradient_factor, scale.gradient_shift)
            inner = seen.inner_pixels(layer.margin)
            free = inner[(layer.rule.lost(place.kind) == 0).ravel()[inner]]
            for canonical in np.unique(reading.canonical).tolist():
                of_site = free[reading.canonical[site[free]] == canonical]
                chosen = rng.choice(of_site, min(per_mosaic * sheet.count, of_site.size), replace=False)
                for one in np.unique(site[chosen]).tolist():
                    pixels = chosen[site[chosen] == one]
                    places = pixels[:, None] + reading.offsets(seen.label.shape[1])[one]
                    taps = np.concatenate([plane.take(places) for plane in seen.noisy], axis=1) * np.float32(PLANE_STEP)
                    weights = weight[pixels, None]
                    columns = np.concatenate([taps, target[pixels]], axis=1) * weights
                    parts.setdefault(canonical, []).append(
                        TreeSamples(columns, *turned_evidence(evidence, turns[one], pixels))
                    )
        sampled.append({site: TreeSamples.concatenated(several) for site, several in parts.items()})
    return sampled


def _split_side(layer: LayerPass) -> int:
    """Return the side, in pixels, of the windows in which splits are evaluated."""
    return min(layer.recipe.side, SPLIT_SIDE_PIXELS) if layer.learning.noise == "none" else layer.recipe.side


def are_samples(layer: LayerPass, samples: dict[int, TreeSamples]) -> bool:
    """Return whether one frame's tree samples, by CFA site, have the types and shapes that `sample_tree` returns."""
    width, sites = PLANES * _split_side(layer) ** 2 + OUTPUTS, layer.reading(1).canonical
    return all(
        site in sites
        and isinstance(each, TreeSamples)
        and each.columns.shape[1:] == (width,)
        and each.numerators.shape == (TESTS, len(each.columns))
        and each.denominators.shape[1:] == (len(each.columns),)
        for site, each in samples.items()
    )


def tree_rule(
    layer: LayerPass, scale: GradientScale, samples: Sequence[dict[int, TreeSamples]], mapped: Mapped = map
) -> TreeRule:
    """Grow a decision tree, and build a rule that classifies pixels by its leaves.

    Parameters
    ----------
    layer : LayerPass
        Settings for training the refinement layer, and the previous layers.
    scale : GradientScale
        Result of `gradient_scale`.
    samples : sequence of dict of int to TreeSamples
        Results of `sample_tree` for all frames, in the order of the frames.
    mapped : callable
        `map`, or a multi-threaded function with the same interface.

    Returns
    -------
    TreeRule
        Class rule with the tests, thresholds and branches of the tree, which all CFA sites share.
    """
    sites = sorted({site for sample in samples for site in sample})
    tree = grow(
        [TreeSamples.concatenated([one[site] for one in samples if site in one]) for site in sites],
        layer.recipe.leaves,
        mapped,
    )
    return TreeRule(**vars(scale), **tree._asdict(), turns=np.array(layer.turns, np.uint8), cases=layer.rule.lost_cases)


def _perceptual_basis(layer: LayerPass) -> NDArray[np.float32]:
    """Return a matrix (output, 3) that converts errors in X, Y and Z to errors in a*, L* and b* near white.

    If the outputs are not X, Y and Z, return the identity matrix.
    """
    if not layer.pictures:
        return np.eye(3, dtype=np.float32)
    white = layer.white_point / layer.white_point[LUMINANCE]
    return np.asarray(layer.basis * (np.array(LAB_SLOPES) / white), np.float32)
