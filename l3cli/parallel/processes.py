"""Worker processes of this machine, and what they are handed."""

import collections
import contextlib
import functools
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from typing import Any, TypeVar

from l3cli.errors import L3Error
from l3cli.parallel import without_plots
from l3cli.system.limits import ONE_BLAS_THREAD, environment
from l3cli.system.signals import uninterrupted

T = TypeVar("T")
R = TypeVar("R")


@contextlib.contextmanager
def several(jobs: int) -> Iterator[Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]]:
    """Offer `map` by so many processes, whose memory nothing else has used; at most two results for each wait. They end with
    the block: at once where it fails or is interrupted."""
    with environment(ONE_BLAS_THREAD):
        pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _begin)
        before = multiprocessing.active_children()
        try:
            yield functools.partial(_pooled, pool, 2 * jobs)
        except BaseException:
            for child in multiprocessing.active_children():
                if child not in before:
                    child.terminate()
            # One that ends while it sends a result leaves half of it. The pool's thread waits for the rest as long as
            # anybody could send it, and so do we, who hold that end of the pipe, too. So does the thread that hands out an
            # item as long as anybody could take it; later Pythons know (python/cpython#94777).
            pool._result_queue._writer.close()  # type: ignore[attr-defined]
            if sys.version_info < (3, 11, 5):
                pool._call_queue._reader.close()  # type: ignore[attr-defined]
            raise
        finally:
            pool.shutdown(cancel_futures=True)


@uninterrupted  # a process that is only half started would wait for its beginning, and we for its end
def _submit(pool: ProcessPoolExecutor, function: Callable[[T], R], item: T) -> "Future[R]":
    """Give an item to the pool, which may start a process for it: one that leaves Ctrl-C, which reaches the whole group, to
    its parent. A blocked signal is inherited from the first instruction on, and still reaches the parent afterwards."""
    old = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with _script_left_alone(function):
            return pool.submit(function, item)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, old)


@contextlib.contextmanager
def _script_left_alone(function: Callable[..., object]) -> Iterator[None]:
    """Keep a process that is started from importing the script that is run: one that calls `l3cli` on its top
    level would begin all its work anew in each of them. Only functions of the script itself need it."""
    script = sys.modules["__main__"]
    if getattr(function, "__module__", None) == "__main__":
        yield
        return
    names = {name: value for name, value in vars(script).items() if name in ("__spec__", "__file__")}
    vars(script).update(dict.fromkeys(names))  # multiprocessing finds nothing to import
    try:
        yield
    finally:
        vars(script).update(names)


def _begin() -> None:
    """Prepare a worker, before its first item."""
    without_plots()
    _end_with_parent()


def _end_with_parent() -> None:
    """End a worker when the parent has, even if it was killed; nobody would take the results."""
    parent: Any = multiprocessing.parent_process()

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _pooled(pool: ProcessPoolExecutor, most: int, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
    waiting: collections.deque[Future[R]] = collections.deque()
    try:
        for item in items:
            waiting.append(_submit(pool, function, item))
            if len(waiting) >= most:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except BrokenProcessPool as error:
        raise L3Error("a worker process was ended from outside, perhaps for lack of memory; use fewer ‹jobs›") from error
