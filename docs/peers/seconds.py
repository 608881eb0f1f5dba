"""Measure the CPU time of demosaicing per megapixel, without start-up and other fixed costs of a picture."""

import resource
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

SIDES = (504, 1512)  # sides of two pictures in pixels (whole periods); the difference is timed
ROUNDS = 3  # rounds over all methods; the result is the smallest time of each method
ENOUGH = 3.0  # CPU time in s, after which a slow method is not run again
LONG = 20.0  # CPU time in s; a method that takes longer for the small picture is measured only on this picture


def core_seconds() -> float:
    """Return the CPU time of this process and of its finished child processes."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def tiled_to(plane: NDArray, side: int, period: tuple[int, ...]) -> NDArray:
    """Repeat a plane (row, col) to a square of `side`. The plane is cut to whole periods, so that the array continues."""
    rows, cols = (length // by * by for length, by in zip(plane.shape, period, strict=True))
    whole = plane[:rows, :cols]
    repeated = np.tile(whole, (-(-side // rows), -(-side // cols)))
    return repeated[:side, :side]


def per_megapixel(methods: Mapping[str, Callable[[int], Callable[[], object]]]) -> dict[str, float]:
    """Return the core-seconds per megapixel of each method.

    Each method maps the side of a square picture to the call that is timed. A first call is not counted, because it includes
    costs such as the compilation of kernels.
    """
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
