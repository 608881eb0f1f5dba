"""The one door to processes, other machines (cluster) and threads (threads): the same results in the same order whatever
the workers."""

import collections
import contextlib
import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import TYPE_CHECKING, Any, TypeVar

from l3cli.errors import L3Error
from l3cli.interrupts import uninterrupted
from l3cli.limits import ONE_BLAS_THREAD

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler

T = TypeVar("T")
R = TypeVar("R")


def one_blas_thread() -> None:
    """Keep BLAS to one thread in this process and its children: small products are faster so, and the number of cores does
    not change how they are rounded. To be called before numpy is first imported; what the user has set himself stays."""
    for name, value in ONE_BLAS_THREAD.items():
        os.environ.setdefault(name, value)


def ordered_map(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """function(item) of every item, in order, by `jobs` processes (1: in this one).

    Processes are spawned, not forked: a fork after an OpenCL context exists hangs. Their BLAS is kept to one thread each.
    At most 2·jobs results wait, so memory is bounded by the workers, not by the number of items.
    """
    with workers(jobs) as crew:
        yield from crew(function, items)


@dataclass(frozen=True)
class Crew:
    """Workers that are handed items: crew(function, items) gives function(item) of every item, in order."""

    size: int  # that work at a time
    _map: Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

    def __call__(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        return self._map(function, items)


@contextlib.contextmanager
def workers(jobs: int, scheduler: "Scheduler | None" = None) -> Iterator[Crew]:
    """`ordered_map` for several calls by the same processes, or by the workers of a scheduler."""
    if scheduler is not None:
        from l3cli.parallel.cluster import workers_of

        with workers_of(scheduler) as crew:
            yield crew
    elif jobs == 1:
        yield Crew(1, map)
    else:
        with _pool(jobs) as pool:
            yield Crew(jobs, functools.partial(_pooled, pool, 2 * jobs))


def alone(function: Callable[[T], R], item: T) -> R:
    """function(item) by a separate process, whose memory nothing else has used."""
    with _pool(1) as pool:
        return _result(_submit(pool, function, item))


@contextlib.contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block: at once where it fails or is interrupted."""
    saved = {name: os.environ.get(name) for name in ONE_BLAS_THREAD}
    os.environ.update(ONE_BLAS_THREAD)
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _end_with_parent)
    before = multiprocessing.active_children()
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            if child not in before:
                child.terminate()
        # One that ends while it sends a result leaves half of it. The pool's thread waits for the rest as long as anybody
        # could send it, and so do we, who hold that end of the pipe, too.
        pool._result_queue._writer.close()  # type: ignore[attr-defined]
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@uninterrupted  # a process that is only half started would wait for its beginning, and we for its end
def _submit(pool: ProcessPoolExecutor, function: Callable[[T], R], item: T) -> "Future[R]":
    """Hand an item to the pool, which may start a process for it: one that leaves Ctrl-C, which reaches the whole group, to
    its parent. A blocked signal is inherited from the first instruction on, and still reaches the parent afterwards."""
    old = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(function, item)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, old)


def _result(future: "Future[R]") -> R:
    try:
        return future.result()
    except BrokenProcessPool as error:
        raise L3Error("a worker process was ended from outside, perhaps for lack of memory; use fewer ‹jobs›") from error


def _end_with_parent() -> None:
    """In a worker: end when the parent has, even if it was killed; nobody would take the results."""
    parent: Any = multiprocessing.parent_process()

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _pooled(pool: ProcessPoolExecutor, most: int, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    waiting: collections.deque[Future[R]] = collections.deque()
    for item in items:
        waiting.append(_submit(pool, function, item))
        if len(waiting) >= most:
            yield _result(waiting.popleft())
    while waiting:
        yield _result(waiting.popleft())
