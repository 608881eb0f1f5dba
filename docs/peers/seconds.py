"""Processor time a megapixel of demosaicking, start-up and other costs of a picture taken off."""

import resource
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

SIDES = (504, 1512)  # pixels, whole periods of every array; what the larger takes more is the time of the pixels it has more
ROUNDS = 3  # all methods in turn, the least of each counts
ENOUGH = 3.0  # s of processor time, after which a slow method is not run again
LONG = 20.0  # s of processor time; a method that takes more for the small picture is measured by it alone


def core_seconds() -> float:
    """Processor time so far of this process and of those it has run to their end."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def tiled_to(plane: NDArray, side: int, period: tuple[int, ...]) -> NDArray:
    """A square of `side` from repetitions of a plane (row, col), cut to whole periods so that its array goes on."""
    rows, cols = (length // by * by for length, by in zip(plane.shape, period, strict=True))
    whole = plane[:rows, :cols]
    repeated = np.tile(whole, (-(-side // rows), -(-side // cols)))
    return repeated[:side, :side]


def per_megapixel(methods: Mapping[str, Callable[[int], Callable[[], object]]]) -> dict[str, float]:
    """Core-seconds a megapixel by name. Each method makes, for the side of a square picture, the call to be timed. It is
    called once before: what the first call alone takes, such as to compile kernels, would count as a small picture's."""
    first = {name: _taken(prepared(SIDES[0])) for name, prepared in methods.items()}
    least: dict[tuple[str, int], float] = {}
    spent = dict.fromkeys(methods, 0.0)
    for _ in range(ROUNDS):
        for name, prepared in methods.items():
            if spent[name] > ENOUGH or first[name] > LONG:
                continue
            for side in SIDES:
                taken = _taken(prepared(side))
                spent[name] += taken
                least[name, side] = min(taken, least.get((name, side), np.inf))
    pixels = SIDES[1] ** 2 - SIDES[0] ** 2
    seconds = {name: taken / (SIDES[0] ** 2 * 1e-6) for name, taken in first.items() if taken > LONG}
    for name in methods.keys() - seconds:
        seconds[name] = max(least[name, SIDES[1]] - least[name, SIDES[0]], 0.0) / (pixels * 1e-6)
    return seconds


def _taken(call: Callable[[], object]) -> float:
    start = core_seconds()
    call()
    return core_seconds() - start
