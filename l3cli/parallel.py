"""The one door to processes: the same results in the same order whatever the number of workers."""

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

T = TypeVar("T")
R = TypeVar("R")


def one_blas_thread() -> None:
    """Keep BLAS to one thread in this process and its children: small products are faster so, and the number of cores does
    not change how they are rounded. To be called before numpy is first imported; what the user has set himself stays."""
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)


def ordered_map(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """function(item) of every item, in order, by `jobs` processes (1: in this one).

    Processes are spawned, not forked: a fork after an OpenCL context exists hangs. Their BLAS is kept to one thread each.
    At most 2·jobs results wait, so memory is bounded by the workers, not by the number of items.
    """
    return map(function, items) if jobs == 1 else _pooled(function, items, jobs)


def alone(function: Callable[[T], R], item: T) -> R:
    """function(item) by a process of its own, whose memory nothing else has used."""
    return next(_pooled(function, [item], 1))


def _pooled(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    saved = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        with multiprocessing.get_context("spawn").Pool(jobs) as pool:
            waiting: list = []
            for item in items:
                waiting.append(pool.apply_async(function, (item,)))
                if len(waiting) >= 2 * jobs:
                    yield waiting.pop(0).get()
            for result in waiting:
                yield result.get()
    finally:
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
