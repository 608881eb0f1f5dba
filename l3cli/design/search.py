"""Search for the best filter array.

All distinct arrays are evaluated or, if there are too many, simulated annealing is used. Arrays are equivalent if they
differ only by a shift, a rotation or a reflection. Only one of several equivalent arrays is evaluated.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import overall
from l3cli.design.error import Cfa, Level, Noise, Seen, array_errors

MAX_ENUMERATED = 4_000_000  # largest number of arrays, including equivalent ones, to enumerate
MAX_EVALUATED = 100_000  # largest number of distinct arrays to evaluate
INDEPENDENT = 1e-3  # smallest singular value that counts as an independent output, relative to the largest singular value
START_TEMPERATURE, END_TEMPERATURE = 0.03, 0.0005  # temperatures of simulated annealing, relative to the error
Arrays = NDArray[np.integer]  # (array, site): filter at each site
Allowed = Callable[[Sequence[int]], bool]  # tests whether an array may consist of a given set of filters


@dataclass(frozen=True)
class Problem:
    """Everything that determines an array's error, except the array: scenes, light levels and pixel noise."""

    seen: tuple[Seen, ...]  # moments under each illuminant
    levels: tuple[Level, ...]
    noise: Noise

    def errors(self, cfa: Cfa) -> NDArray[np.float64]:
        """Predict an array's error at each light level and in each group of patches: (level, group)."""
        return np.array([array_errors(self.seen[level.light], cfa, self.noise, level) for level in self.levels])

    @functools.cached_property
    def share(self) -> NDArray[np.float64]:
        """Fraction of the patches in each group under each light level's illuminant: (level, group)."""
        return np.array([self.seen[level.light].share for level in self.levels])

    def means(self, cfa: Cfa) -> NDArray[np.float64]:
        """Predict an array's error at each light level, averaged over all patches: (level,)."""
        return np.asarray((self.errors(cfa) * self.share).sum(axis=1))

    def score(self, cfa: Cfa) -> float:
        """Predict an array's error as the geometric mean over all light levels."""
        return float(overall(self.means(cfa)))


@functools.cache
def symmetries(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the site permutations that convert an array to an equivalent array of the same shape.

    Returns
    -------
    ndarray, (symmetry, site)
        Original site of the filter at each site.
    """
    sites = np.arange(math.prod(shape)).reshape(shape)
    turned = [np.rot90(each, turn) for each in (sites, sites.T) for turn in range(4)]
    orders = [np.roll(each, shift, (0, 1)).ravel() for each in turned if each.shape == shape for shift in np.ndindex(*shape)]
    return np.unique(np.array(orders), axis=0)


def canonical(cfa: Cfa) -> bytes:
    """Return a key that is the same for all equivalent arrays of the same shape."""
    orders = symmetries((cfa.shape[0], cfa.shape[1]))
    return min(row.tobytes() for row in cfa.astype(np.uint8).ravel()[orders])


def distinct(arrays: Arrays, shape: tuple[int, int], filters: int) -> Arrays:
    """Remove arrays that are equivalent to an earlier array. `filters` is the number of filters."""
    digits = np.int64(filters) ** np.arange(arrays.shape[1])[::-1]
    least = functools.reduce(np.minimum, (arrays[:, order] @ digits for order in symmetries(shape)))
    _, first = np.unique(least, return_index=True)
    return arrays[np.sort(first)]


def arrangements(counts: Sequence[int]) -> Iterator[list[int]]:
    """Yield all distinct sequences in which the number i occurs `counts[i]` times."""
    if len(counts) == 1:
        yield [0] * counts[0]
        return
    *others, last = counts
    for chosen in map(set, itertools.combinations(range(sum(counts)), last)):
        for rest in arrangements(others):
            remaining = iter(rest)
            yield [len(others) if site in chosen else next(remaining) for site in range(sum(counts))]


def every_array(
    shape: tuple[int, int], filters: Sequence[int], counts: Sequence[int] | None, allowed: Allowed
) -> list[Cfa] | None:
    """Enumerate all distinct arrays of a shape.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    filters : sequence of int
        Filters that the arrays may contain.
    counts : sequence of int or None
        Number of sites of each filter, or None for any number.
    allowed : callable
        Function that tests whether an array may consist of a set of filters.

    Returns
    -------
    list of ndarray, (row, col), or None
        The arrays, or None if there are more than MAX_ENUMERATED arrays or more than MAX_EVALUATED distinct arrays.
    """
    sites, base = math.prod(shape), len(filters)
    size = math.factorial(sites) // math.prod(map(math.factorial, counts)) if counts else base**sites
    if size > MAX_ENUMERATED or base**sites >= 2**62:
        return None
    every = list(arrangements(counts)) if counts else np.arange(size)[:, None] // base ** np.arange(sites)[::-1] % base
    single = np.asarray(filters)[distinct(np.asarray(every), shape, base)]
    known = functools.cache(lambda used: allowed(list(used)))
    arrays = [row.reshape(shape) for row in single if known(frozenset(row.tolist()))]
    return None if len(arrays) > MAX_EVALUATED else arrays


def independent_outputs(responses: NDArray[np.floating]) -> int:
    """Count the linearly independent outputs of a set of filters for the spectra of scenes.

    Parameters
    ----------
    responses : ndarray, (filter, term)
        Response of each filter to each principal spectrum.
    """
    scaled = responses / np.maximum(np.linalg.norm(responses, axis=1, keepdims=True), 1e-30)
    strength = np.linalg.svd(scaled, compute_uv=False)
    return int((strength > INDEPENDENT * strength[0]).sum())


def anneal(
    problem: Problem,
    start: Cfa,
    filters: Sequence[int],
    swapped: bool,
    allowed: Allowed,
    rng: np.random.Generator,
    steps: int,
) -> Cfa:
    """Search for the array with the smallest error by simulated annealing.

    In each step, the filter at one site changes, or two sites swap their filters. Arrays that are not allowed have an
    infinite error.

    Parameters
    ----------
    problem : Problem
        The scenes, the light levels and the noise.
    start : ndarray, (row, col)
        The first array.
    filters : sequence of int
        Filters that the array may contain.
    swapped : bool
        Whether all steps are swaps, so that the number of sites of each filter does not change.
    allowed : callable
        Function that tests whether an array may consist of a set of filters.
    rng : numpy.random.Generator
        Random generator.
    steps : int
        Number of steps.

    Returns
    -------
    ndarray, (row, col)
        The best array of the whole search.
    """
    known: dict[bytes, float] = {}

    def error(cfa: Cfa) -> float:
        key = canonical(cfa)
        if key not in known:
            known[key] = problem.score(cfa) if allowed(np.unique(cfa).tolist()) else np.inf
        return known[key]

    cfa = best = start
    for step in range(steps):
        other, (one, two) = cfa.copy(), (tuple(rng.integers(cfa.shape)) for _ in range(2))
        if swapped or rng.random() < 0.5:
            other[one], other[two] = cfa[two], cfa[one]
        else:
            other[one] = rng.choice(filters)
        now, then = error(cfa), error(other)
        rise = then / now - 1 if np.isfinite(now) else -1.0 if np.isfinite(then) else 0.0
        temperature = START_TEMPERATURE * (END_TEMPERATURE / START_TEMPERATURE) ** (step / steps)
        if rise < 0 or rng.random() < np.exp(-rise / temperature):
            cfa = other
        best = min(best, cfa, key=error)
    return best
