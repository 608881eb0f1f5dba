"""The one door to processes: the same results in the same order whatever the number of workers."""

import collections
import contextlib
import functools
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.pool import Pool
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
    with workers(jobs) as crew:
        yield from crew(function, items)


@contextlib.contextmanager
def workers(jobs: int) -> Iterator[Callable[[Callable[[T], R], Iterable[T]], Iterator[R]]]:
    """`ordered_map` for several calls by the same processes."""
    if jobs == 1:
        yield map
        return
    with _pool(jobs) as pool:
        yield functools.partial(_pooled, pool, 2 * jobs)


def alone(function: Callable[[T], R], item: T) -> R:
    """function(item) by a process of its own, whose memory nothing else has used."""
    with _pool(1) as pool:
        return pool.apply(function, (item,))


@contextlib.contextmanager
def _pool(jobs: int) -> Iterator[Pool]:
    saved = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        with multiprocessing.get_context("spawn").Pool(jobs) as pool:
            yield pool
    finally:
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _pooled(pool: Pool, most: int, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    waiting: collections.deque = collections.deque()
    for item in items:
        waiting.append(pool.apply_async(function, (item,)))
        if len(waiting) >= most:
            yield waiting.popleft().get()
    while waiting:
        yield waiting.popleft().get()
