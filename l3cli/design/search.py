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
HOT, COLD = 0.03, 0.0005  # temperatures of annealing, relative to the error
Arrays = NDArray[np.integer]  # (array, site) filters


@dataclass(frozen=True)
class Problem:
    """The lights, exposures and noise by which arrays of a library are judged."""

    seen: tuple[Seen, ...]  # by each light of the moments
    levels: tuple[Level, ...]
    noise: Noise

    def errors(self, cfa: Cfa) -> NDArray[np.float64]:
        """Return the error (level, group) of an array."""
        rows: dict[int, NDArray[np.float64]] = {}
        for light in dict.fromkeys(level.light for level in self.levels):
            places = [place for place, level in enumerate(self.levels) if level.light == light]
            of_light = array_errors(self.seen[light], cfa, self.noise, [self.levels[place] for place in places])
            rows |= dict(zip(places, of_light, strict=True))
        return np.array([rows[place] for place in range(len(self.levels))])

    @functools.cached_property
    def share(self) -> NDArray[np.float64]:
        """Return the share (level, group) of the patches."""
        return np.array([self.seen[level.light].share for level in self.levels])

    def score(self, errors: NDArray[np.float64]) -> float:
        """Return the geometric mean, over levels, of errors (level, group)."""
        return float(overall((errors * self.share).sum(axis=1)))


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
    sites = range(sum(counts))
    for places in itertools.combinations(sites, last):
        chosen = set(places)
        for rest in arrangements(others):
            remaining = iter(rest)
            yield [len(others) if site in chosen else next(remaining) for site in sites]


def multiset_size(counts: Sequence[int]) -> int:
    """Return the number of arrangements of a multiset."""
    return math.factorial(sum(counts)) // math.prod(map(math.factorial, counts))


def every_array(
    shape: tuple[int, int],
    filters: Sequence[int],
    counts: Sequence[int] | None,
    independent: Callable[[Sequence[int]], bool],
) -> list[Cfa] | None:
    """Return all distinct arrays of a shape, of any of the `filters` or of so many of each, whose filters are `independent`;
    None: they are too many."""
    sites, base = math.prod(shape), len(filters)
    size = base**sites if counts is None else multiset_size(counts)
    if size > MOST_ENUMERATED or base**sites >= 2**62:
        return None
    if counts is None:
        numbers = np.arange(size)[:, None] // base ** np.arange(sites)[::-1] % base
    else:
        numbers = np.array(list(arrangements(counts)))
    single = distinct(numbers, shape, base)
    known: dict[tuple[int, ...], bool] = {}
    arrays = []
    for row in np.asarray(filters)[single]:
        used = tuple(np.unique(row).tolist())
        if used not in known:
            known[used] = independent(used)
        if known[used]:
            arrays.append(row.reshape(shape))
    return None if len(arrays) > MOST_JUDGED else arrays


def independent_outputs(responses: NDArray[np.floating]) -> int:
    """Return how many independent outputs filters have, by their responses (filter, term) to principal spectra."""
    scaled = responses / np.maximum(np.linalg.norm(responses, axis=1, keepdims=True), 1e-30)
    strength = np.linalg.svd(scaled, compute_uv=False)
    return int((strength > INDEPENDENT * strength[0]).sum())


def anneal(
    problem: Problem,
    shape: tuple[int, int],
    filters: Sequence[int],
    counts: Sequence[int] | None,
    allowed: Callable[[Sequence[int]], bool],
    steps: int,
    rng: np.random.Generator,
) -> tuple[float, Cfa]:
    """Return the least error and its array of `steps` steps of simulated annealing from a random array: a site is changed or
    two are swapped, with `counts` swapped alone. Of filters that are not `allowed` together the error is infinite."""
    known: dict[bytes, float] = {}

    def error(cfa: Cfa) -> float:
        key = canonical(cfa)
        if key not in known:
            used = np.unique(cfa).tolist()
            known[key] = problem.score(problem.errors(cfa)) if allowed(used) else np.inf
        return known[key]

    pool = np.asarray(filters)
    sites = rng.permutation(np.repeat(pool, counts)) if counts else rng.choice(pool, math.prod(shape))
    cfa = best = sites.reshape(shape)
    for step in range(steps):
        other, (one, two) = cfa.copy(), (tuple(rng.integers(shape)) for _ in range(2))
        if counts or rng.random() < 0.5:
            other[one], other[two] = cfa[two], cfa[one]
        else:
            other[one] = rng.choice(pool)
        now, then = error(cfa), error(other)
        rise = then / now - 1 if np.isfinite(now) else -1.0 if np.isfinite(then) else 0.0
        if rise < 0 or rng.random() < np.exp(-rise / (HOT * (COLD / HOT) ** (step / steps))):
            cfa = other
        best = min(best, cfa, key=error)
    return error(best), best


def bayer_arrays(filters: Sequence[int], centres: NDArray[np.floating]) -> Iterator[Cfa]:
    """Yield the arrays of Bayer's pattern of any three filters: the middle one by the wavelength of its centre (filter) is
    on a diagonal, the two others beside it."""
    for three in itertools.combinations(filters, 3):
        blue, green, red = sorted(three, key=lambda each: float(centres[each]))
        yield np.array([[green, red], [blue, green]])
