"""Read ahead, write, and run tasks in background threads."""

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")
# Time, in s, to wait for the threads of `prefetched`, BackgroundTask and WriteBehind after an interrupt.
READ_SECONDS, WORK_SECONDS, WRITE_SECONDS = 1.0, 5.0, 25.0


class _End(Exception):
    """Marks the end of a queue."""


@contextlib.contextmanager
def threaded(count: int) -> Iterator[Callable[[Callable[[T], R], Iterable[T]], Iterable[R]]]:
    """Context manager that yields a function like `map` with up to `count` threads, but at most one per core.

    The results are in the order of the items. With a single thread, the function is the built-in `map`.
    """
    if (count := min(count, os.cpu_count() or 1)) < 2:
        yield map
        return
    from concurrent.futures import ThreadPoolExecutor  # a slow import, not needed for a single thread

    with ThreadPoolExecutor(count) as pool:
        yield pool.map


def prefetched(items: Iterable[T], depth: int) -> Iterator[T]:
    """Iterate over `items`, while a thread computes up to `depth` items in advance.

    If an item raises an exception, all items before it are yielded first.
    """
    ready: queue.Queue[Any] = queue.Queue()
    free = threading.Semaphore(depth)  # how many more items the thread may compute
    stopped = threading.Event()

    def work() -> None:
        try:
            for item in _while_free(items, free, stopped):
                ready.put((item, None))
            ready.put((None, _End()))
        except BaseException as error:
            ready.put((None, error))

    # A daemon thread, so that the program can end while the thread waits for input.
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        while True:
            item, error = ready.get()
            if isinstance(error, _End):
                return
            if error is not None:
                raise error
            yield item
            free.release()
    finally:
        stopped.set()
        free.release()
        with contextlib.suppress(RuntimeError):  # raised by Python 3.14 during interpreter exit
            thread.join(READ_SECONDS)  # a thread inside a C library could crash the program at exit


def _while_free(items: Iterable[T], free: threading.Semaphore, stopped: threading.Event) -> Iterator[T]:
    iterator = iter(items)
    while True:
        free.acquire()  # before computing the item, because `depth` includes the item being computed
        if stopped.is_set():
            return
        try:
            item = next(iterator)
        except StopIteration:
            return
        yield item


class BackgroundTask:
    """Context manager that runs `work` in a thread during the block, and waits for the thread at the end.

    `work` must only prepare what the main thread needs later, for example load or cache a file. Its errors are ignored,
    because they occur again in the main thread.
    """

    def __init__(self, work: Callable[[], object]) -> None:
        self._work = work
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        # Wait even after an interrupt, because a thread inside a C library could crash the program at exit. This wait is
        # limited, because the thread itself may be waiting for an interrupted import.
        interrupted = kind is not None and not issubclass(kind, Exception)
        try:
            self._thread.join(WORK_SECONDS if interrupted else None)
        except BaseException:
            self._thread.join(WORK_SECONDS)
            raise

    def _run(self) -> None:
        with contextlib.suppress(Exception):
            self._work()


class WriteBehind:
    """Context manager that calls function(item) in background threads, for example to write files.

    `put` adds an item to the queue, and blocks while `depth` items are waiting. A single thread processes items in order. At
    the end of the block, WriteBehind waits until all items are processed, even if the block has failed. After an interrupt,
    it waits only for the items being processed, and for at most WRITE_SECONDS.

    If the function raises an error, the waiting items are discarded. The next call of `put`, or the end of the block, raises
    the error again.
    """

    def __init__(self, function: Callable[[T], object], depth: int, threads: int = 1) -> None:
        self._function = function
        self._items: queue.Queue[Any] = queue.Queue(depth)
        self._error: BaseException | None = None
        self._complete = False  # whether all items have been put
        # Events instead of Thread.join: in Python 3.11, a running thread counts as ended after an interrupted `join`.
        self._ended = [threading.Event() for _ in range(threads)]
        self._threads = [threading.Thread(target=self._run, args=(ended,), daemon=True) for ended in self._ended]

    def __enter__(self) -> "WriteBehind":
        for thread in self._threads:
            thread.start()
        return self

    def put(self, item: Any) -> None:
        if self._error is not None:
            raise self._error
        self._items.put(item)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._complete = True
        if error is not None and not isinstance(error, Exception):
            self._drop(error)
            return
        try:
            self._wake_one()
            for ended in self._ended:
                ended.wait()
        except BaseException as interruption:
            self._drop(interruption)
            raise
        if error is None and self._error is not None:
            raise self._error

    def _drop(self, interruption: BaseException) -> None:
        """Discard the waiting items, and wait for the items being processed.

        Without this wait, a thread inside a C library could crash the program at exit. The wait is limited to WRITE_SECONDS,
        because a write to a full pipe may never return.
        """
        self._error = self._error or interruption
        self._wake_one()
        end = time.monotonic() + WRITE_SECONDS
        for ended in self._ended:
            ended.wait(max(end - time.monotonic(), 0))

    def _wake_one(self) -> None:
        with contextlib.suppress(queue.Full):  # if the queue is full, no thread waits for an item
            self._items.put_nowait(_End)

    def _run(self, ended: threading.Event) -> None:
        try:
            self._work()
        finally:
            ended.set()

    def _work(self) -> None:
        while not (self._complete and self._items.empty()):
            item = self._items.get()
            if item is _End or self._error is not None:
                continue  # after an error, empty the queue without processing the items, so that `put` does not block
            try:
                self._function(item)
            except BaseException as error:
                self._error = error
        self._wake_one()  # the next thread may be waiting for an item
