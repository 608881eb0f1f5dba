"""Run work in several processes on this machine."""

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
from l3cli.system.limits import ONE_BLAS_THREAD, environment, without_plots
from l3cli.system.signals import SIGNALS

T = TypeVar("T")
R = TypeVar("R")


@contextlib.contextmanager
def several(jobs: int) -> Iterator[Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]]:
    """Context manager that starts `jobs` processes and yields a function like `map` that distributes calls over them.

    At most two results per process are kept at a time. The processes end with the block. If the block fails or is
    interrupted, they are terminated immediately.
    """
    with environment(ONE_BLAS_THREAD):
        pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _begin)
        before = multiprocessing.active_children()
        try:
            yield functools.partial(_pooled, pool, 2 * jobs)
        except BaseException:
            for child in multiprocessing.active_children():
                if child not in before:
                    child.terminate()
            # If a worker is terminated while it sends a large result, the pool's result thread waits for the rest of the
            # data until all writing ends of the pipe are closed. So that Ctrl-C does not hang, this process closes its own
            # writing end. Before Python 3.11.5, the thread that sends items waits in the same way until all reading ends are
            # closed (python/cpython#94777).
            pool._result_queue._writer.close()  # type: ignore[attr-defined]
            if sys.version_info < (3, 11, 5):
                pool._call_queue._reader.close()  # type: ignore[attr-defined]
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _submit(pool: ProcessPoolExecutor, function: Callable[[T], R], item: T) -> "Future[R]":
    """Submit an item to the pool, which may start a process.

    Signals are blocked while a process starts, because an interrupted start would print a traceback. The new process
    inherits the blocked signals and unblocks only SIGTERM. Ctrl-C sends SIGINT to all processes, but only the parent must
    handle it.
    """
    old = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        with _script_left_alone(function):
            return pool.submit(function, item)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, old)


@contextlib.contextmanager
def _script_left_alone(function: Callable[..., object]) -> Iterator[None]:
    """Prevent new processes from importing the running script, unless the script defines `function`.

    Otherwise, a script that calls l3cli at its top level would call it again in every process.
    """
    script = sys.modules["__main__"]
    if getattr(function, "__module__", None) == "__main__":
        yield
        return
    names = {name: value for name, value in vars(script).items() if name in ("__spec__", "__file__")}
    vars(script).update(dict.fromkeys(names))  # multiprocessing then finds no script to import
    try:
        yield
    finally:
        vars(script).update(names)


def _begin() -> None:
    """Initialise a worker process: unblock SIGTERM, prevent the import of plotting libraries, and watch the parent."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    without_plots()
    _end_with_parent()


def _end_with_parent() -> None:
    """Start a thread that ends this worker process when the parent process ends, even if the parent is killed."""
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
        raise L3Error("a worker process was killed, perhaps because it ran out of memory; reduce ‹jobs›") from error
