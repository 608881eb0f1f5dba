"""Arrays to be tried: enumerated without those that are the same but for where they begin, turns and mirrors; annealed where
there are too many."""

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts.design import overall
from l3cli.design.error import Cfa, Level, Noise, Seen, array_errors

MOST_ENUMERATED, MOST_JUDGED = 4_000_000, 100_000  # arrangements that are counted, and distinct ones that are judged
INDEPENDENT = 1e-3  # smallest singular value of filters' responses to the basis, over the largest
HOT, COLD = 0.03, 0.0005  # of annealing; temperatures are relative to the error
Arrays = NDArray[np.integer]  # (array, site) filters
Allowed = Callable[[Sequence[int]], bool]  # whether filters may stand in an array together


@dataclass(frozen=True)
class Problem:
    """The lights, exposures and noise by which arrays of a library are judged."""

    seen: tuple[Seen, ...]  # by each light of the moments
    levels: tuple[Level, ...]
    noise: Noise

    def errors(self, cfa: Cfa) -> NDArray[np.float64]:
        """Return the error (level, group) of an array."""
        return np.array([array_errors(self.seen[level.light], cfa, self.noise, level) for level in self.levels])

    @functools.cached_property
    def share(self) -> NDArray[np.float64]:
        """Return the share (level, group) of the patches."""
        return np.array([self.seen[level.light].share for level in self.levels])

    def means(self, cfa: Cfa) -> NDArray[np.float64]:
        """Return the error (level) of an array over all groups."""
        return np.asarray((self.errors(cfa) * self.share).sum(axis=1))

    def score(self, cfa: Cfa) -> float:
        """Return the geometric mean, over levels, of the error of an array."""
        return float(overall(self.means(cfa)))


@functools.cache
def symmetries(shape: tuple[int, int]) -> NDArray[np.intp]:
    """Return the orders (symmetry, site) in which the sites of an array of that period may be read without changing it:
    shifts, and the turns and mirrors that keep its shape."""
    sites = np.arange(math.prod(shape)).reshape(shape)
    turned = [np.rot90(each, turn) for each in (sites, sites.T) for turn in range(4)]
    orders = [np.roll(each, shift, (0, 1)).ravel() for each in turned if each.shape == shape for shift in np.ndindex(*shape)]
    return np.unique(np.array(orders), axis=0)


def canonical(cfa: Cfa) -> bytes:
    """Return what all arrays share that are the same but for `symmetries`, and no others of that shape."""
    orders = symmetries((cfa.shape[0], cfa.shape[1]))
    return min(row.tobytes() for row in cfa.astype(np.uint8).ravel()[orders])


def distinct(arrays: Arrays, shape: tuple[int, int], filters: int) -> Arrays:
    """Return the first of all arrays (array, site) that are the same but for symmetries, in order."""
    digits = np.int64(filters) ** np.arange(arrays.shape[1])[::-1]
    least = functools.reduce(np.minimum, (arrays[:, order] @ digits for order in symmetries(shape)))
    _, first = np.unique(least, return_index=True)
    return arrays[np.sort(first)]


def arrangements(counts: Sequence[int]) -> Iterator[list[int]]:
    """Yield every arrangement of a multiset: so many of each filter."""
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
    """Return all distinct arrays of a shape, of any of the `filters` or of so many of each, whose filters are `allowed`;
    None: they are too many."""
    sites, base = math.prod(shape), len(filters)
    size = math.factorial(sites) // math.prod(map(math.factorial, counts)) if counts else base**sites
    if size > MOST_ENUMERATED or base**sites >= 2**62:
        return None
    every = list(arrangements(counts)) if counts else np.arange(size)[:, None] // base ** np.arange(sites)[::-1] % base
    single = np.asarray(filters)[distinct(np.asarray(every), shape, base)]
    known = functools.cache(lambda used: allowed(list(used)))
    arrays = [row.reshape(shape) for row in single if known(frozenset(row.tolist()))]
    return None if len(arrays) > MOST_JUDGED else arrays


def independent_outputs(responses: NDArray[np.floating]) -> int:
    """Return how many independent outputs filters have, by their responses (filter, term) to principal spectra."""
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
    """Return the best array of `steps` steps of simulated annealing from `start`: a site is changed or two are
    swapped, with `swapped` this alone. Of filters that are not `allowed` together the error is infinite."""
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
        if rise < 0 or rng.random() < np.exp(-rise / (HOT * (COLD / HOT) ** (step / steps))):
            cfa = other
        best = min(best, cfa, key=error)
    return best
