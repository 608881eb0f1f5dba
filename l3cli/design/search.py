"""Search for the best array of filters: enumeration of all distinct arrays or, if there are too many, simulated annealing.

Arrays are equivalent if they differ only by a shift, rotation or reflection. Of equivalent arrays, only one is evaluated.
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

MAX_ENUMERATED = 4_000_000  # largest number of arrays, including equivalent arrays, that are enumerated
MAX_EVALUATED = 100_000  # largest number of distinct arrays that are evaluated
INDEPENDENT = 1e-3  # a singular value above this fraction of the largest singular value is an independent output
START_TEMPERATURE, END_TEMPERATURE = 0.03, 0.0005  # temperatures of simulated annealing, relative to the error
Arrays = NDArray[np.integer]  # (array, site), index of the filter
Allowed = Callable[[Sequence[int]], bool]  # returns whether an array may consist of the given filters


@dataclass(frozen=True)
class Problem:
    """The illuminants, exposures and noise for which arrays of filters are evaluated."""

    seen: tuple[Seen, ...]  # moments under each illuminant
    levels: tuple[Level, ...]
    noise: Noise

    def errors(self, cfa: Cfa) -> NDArray[np.float64]:
        """Return the predicted error of an array at each level (rows) and in each group of patches (columns)."""
        return np.array([array_errors(self.seen[level.light], cfa, self.noise, level) for level in self.levels])

    @functools.cached_property
    def share(self) -> NDArray[np.float64]:
        """Fraction of the patches in each group (columns), under the illuminant of each level (rows)."""
        return np.array([self.seen[level.light].share for level in self.levels])

    def means(self, cfa: Cfa) -> NDArray[np.float64]:
        """Return the predicted error of an array at each level, averaged over groups."""
        return np.asarray((self.errors(cfa) * self.share).sum(axis=1))

    def score(self, cfa: Cfa) -> float:
        """Return the geometric mean of the errors of an array over all levels."""
        return float(overall(self.means(cfa)))


@functools.cache
def symmetries(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the permutations of sites that turn an array into an equivalent array.

    Returns
    -------
    ndarray, (symmetry, site)
        All shifts, rotations and reflections that preserve the shape of the array.
    """
    sites = np.arange(math.prod(shape)).reshape(shape)
    turned = [np.rot90(each, turn) for each in (sites, sites.T) for turn in range(4)]
    orders = [np.roll(each, shift, (0, 1)).ravel() for each in turned if each.shape == shape for shift in np.ndindex(*shape)]
    return np.unique(np.array(orders), axis=0)


def canonical(cfa: Cfa) -> bytes:
    """Return a key of an array. Equivalent arrays of the same shape have the same key."""
    orders = symmetries((cfa.shape[0], cfa.shape[1]))
    return min(row.tobytes() for row in cfa.astype(np.uint8).ravel()[orders])


def distinct(arrays: Arrays, shape: tuple[int, int], filters: int) -> Arrays:
    """Return `arrays` without the arrays that are equivalent to an earlier array."""
    digits = np.int64(filters) ** np.arange(arrays.shape[1])[::-1]
    least = functools.reduce(np.minimum, (arrays[:, order] @ digits for order in symmetries(shape)))
    _, first = np.unique(least, return_index=True)
    return arrays[np.sort(first)]


def arrangements(counts: Sequence[int]) -> Iterator[list[int]]:
    """Yield all distinct arrangements of a multiset in which element i occurs `counts[i]` times."""
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
    """Return all distinct arrays of a shape that consist of allowed filters, or None if there are too many arrays.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns.
    filters : sequence of int
        Filters that the arrays may contain.
    counts : sequence of int, optional
        Number of sites of each filter. [default: any number]
    allowed : callable
        Function that returns whether an array may consist of a set of filters.
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
    """Return the number of independent outputs of a set of filters.

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
    """Search for the array with the smallest error with simulated annealing.

    A step either changes the filter at one site or swaps the filters of two sites. Arrays that are not allowed have an
    infinite error.

    Parameters
    ----------
    problem : Problem
        The illuminants, exposures and noise.
    start : ndarray, (row, col)
        The first array.
    filters : sequence of int
        Filters that the array may contain.
    swapped : bool
        Whether steps only swap filters, so that the number of sites of each filter stays the same.
    allowed : callable
        Function that returns whether an array may consist of a set of filters.
    rng : numpy.random.Generator
        Source of random numbers.
    steps : int
        Number of steps.

    Returns
    -------
    ndarray, (row, col)
        The best array that the search has reached.
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
