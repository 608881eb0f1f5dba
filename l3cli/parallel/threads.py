"""Threads that prefetch items, write behind whoever asks for it, or do a task in the background."""

import contextlib
import os
import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from l3cli.system.signals import is_wanted, raise_pending, uninterrupted

T = TypeVar("T")
R = TypeVar("R")
READING, WRITING = 1.0, 25.0  # seconds after an interrupt in which an item that is being read, or written, is finished
STEP = 0.5  # seconds


class _End(Exception):
    """Mark behind the last item of a queue."""


@contextlib.contextmanager
def threaded(count: int) -> Iterator[Callable[[Callable[[T], R], Iterable[T]], Iterable[R]]]:
    """Yield a `map` that works in `count` threads, of no more than there are cores; results keep their order."""
    if (count := min(count, os.cpu_count() or 1)) < 2:
        yield map
        return
    from concurrent.futures import ThreadPoolExecutor  # which no frame needs

    with ThreadPoolExecutor(count) as pool:
        yield pool.map


def prefetched(items: Iterable[T], depth: int) -> Iterator[T]:
    """Yield the same items, made by another thread at most `depth` ahead of who takes them."""
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
            room.release()
    finally:
        stopped.set()
        room.release()
        with contextlib.suppress(RuntimeError):  # when Python itself ends, 3.14 waits for no thread any more
            thread.join(READING)  # as in WriteBehind


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


class BackgroundTask:
    """Execution of `work` in another thread while the block runs, which waits for its end. What goes wrong in it is left to
    whoever does the same later: the work only makes something ready."""

    def __init__(self, work: Callable[[], object]) -> None:
        self._work = work
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> None:
        self._thread.start()

    @uninterrupted  # as in WriteBehind
    def __exit__(self, *exception: object) -> None:
        self._thread.join()

    def _run(self) -> None:
        with contextlib.suppress(Exception):
            self._work()


class WriteBehind:
    """Calls of function(item) in other threads, at most `depth` items behind; in order if there is one thread.

    As a context manager it waits for the last item, also when the block fails. What goes wrong is raised by the next
    `put`, or at the end; after that, or after an interrupt, what waits is dropped, but what is being done is done: for up to
    WRITING seconds after an interrupt, without a limit otherwise.
    """

    def __init__(self, function: Callable[[T], object], depth: int, threads: int = 1) -> None:
        self._function = function
        self._items: queue.Queue[Any] = queue.Queue(depth)
        self._error: BaseException | None = None
        self._complete = False  # nothing more will be put
        self._threads = [threading.Thread(target=self._work, daemon=True) for _ in range(threads)]

    def __enter__(self) -> "WriteBehind":
        for thread in self._threads:
            thread.start()
        return self

    def put(self, item: Any) -> None:
        if self._error is not None:
            raise self._error
        self._items.put(item)

    @uninterrupted  # a thread that is still at work in a library when the program ends aborts it
    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        interrupted = error is not None and not isinstance(error, Exception)
        if interrupted:
            self._error = self._error or error
        self._complete = True
        self._wake_one()
        left = WRITING
        for thread in self._threads:
            while thread.is_alive() and left > 0:  # a pipe that nobody reads would take for ever
                thread.join(STEP)
                left -= STEP if interrupted or is_wanted() else 0
        if error is None:
            raise_pending()  # what waited has been dropped: nobody may take what is written for all
            if self._error is not None:
                raise self._error

    def _wake_one(self) -> None:
        with contextlib.suppress(queue.Full):  # whoever takes the last item will see
            self._items.put_nowait(_End)

    def _work(self) -> None:
        while not (self._complete and self._items.empty()):
            item = self._items.get()
            if item is _End or self._error is not None or is_wanted():
                continue  # emptied, so that nobody waits to put
            try:
                self._function(item)
            except BaseException as error:
                self._error = error
        self._wake_one()  # it may wait for items, too
