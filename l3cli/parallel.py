"""The one door to processes and threads: the same results in the same order whatever the number of workers."""

import collections
import contextlib
import functools
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any, TypeVar

from l3cli.errors import L3Error

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
        return _result(_submit(pool, function, item))


@contextlib.contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end with the block: at once where it fails or is interrupted."""
    saved = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _end_with_parent)
    before = multiprocessing.active_children()
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            if child not in before:
                child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        for name, value in saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


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
        raise L3Error("a worker process was ended from outside, perhaps for lack of memory; use fewer --jobs") from error


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


# ------------------------------------------------------------------------------------------------------- threads


class _End(Exception):
    """Put behind the last item of a queue."""


def ahead(items: Iterable[T], depth: int) -> Iterator[T]:
    """The same items, made by a thread of their own at most `depth` ahead of who takes them."""
    ready: queue.Queue[Any] = queue.Queue()
    room = threading.Semaphore(depth)
    stopped = threading.Event()

    def work() -> None:
        try:
            for item in _while_room(items, room, stopped):
                ready.put((item, None))
            ready.put((None, _End()))
        except BaseException as error:
            ready.put((None, error))

    # A daemon: one that waits for a stream that never comes must not keep the program from ending.
    threading.Thread(target=work, daemon=True).start()
    try:
        while True:
            item, error = ready.get()
            if isinstance(error, _End):
                return
            if error is not None:
                raise error
            yield item
            room.release()
    finally:
        stopped.set()
        room.release()


def _while_room(items: Iterable[T], room: threading.Semaphore, stopped: threading.Event) -> Iterator[T]:
    iterator = iter(items)
    while True:
        room.acquire()  # before an item is made: `depth` counts those in the making
        if stopped.is_set():
            return
        try:
            item = next(iterator)
        except StopIteration:
            return
        yield item


class Behind:
    """Calls function(item) in threads of their own, at most `depth` items behind; in order if there is one thread.

    As a context manager it waits for the last item, also when the block fails. What goes wrong is raised by the next
    `put`, or at the end; after that, or when the block is interrupted, what waits is dropped.
    """

    def __init__(self, function: Callable[[T], object], depth: int, threads: int = 1) -> None:
        self._function = function
        self._items: queue.Queue[Any] = queue.Queue(depth)
        self._error: BaseException | None = None
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(threads)]

    def __enter__(self) -> "Behind":
        for thread in self._threads:
            thread.start()
        return self

    def put(self, item: Any) -> None:
        if self._error is not None:
            raise self._error
        self._items.put(item)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and not isinstance(error, Exception):
            self._error = self._error or error
        for _ in self._threads:
            self._items.put(_End)
        for thread in self._threads:
            thread.join()
        if error is None and self._error is not None:
            raise self._error

    def _work(self) -> None:
        while (item := self._items.get()) is not _End:
            if self._error is not None:
                continue  # emptied, so that nobody waits to put
            try:
                self._function(item)
            except BaseException as error:
                self._error = error
