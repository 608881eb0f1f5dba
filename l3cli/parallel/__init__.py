"""Distribute work over processes on this machine or over workers on other machines.

Results arrive in the order of the items and do not depend on the number of workers. To save start-up time, the modules that
start processes are imported only when needed.
"""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar

from l3cli.parallel.pool import WorkerPool
from l3cli.system.limits import ONE_BLAS_THREAD

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler

T = TypeVar("T")
R = TypeVar("R")


def one_blas_thread() -> None:
    """Limit BLAS to one thread in this process and its children. Call this function before numpy is first imported.

    With several BLAS threads, rounding would depend on the number of cores, small matrix products would be slower, and idle
    threads would slow down video encoders.
    """
    os.environ.update(ONE_BLAS_THREAD)


def ordered_map(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """Compute function(item) for each item in `jobs` processes, and yield the results in the order of the items.

    If `jobs` is 1, the current process computes the results. Otherwise, at most 2·jobs results are kept at a time, so that
    memory use does not grow with the number of items. The processes are spawned, because a forked process hangs if an OpenCL
    context exists. Each process uses one BLAS thread.
    """
    with workers(jobs) as pool:
        yield from pool(function, items)


@contextlib.contextmanager
def workers(jobs: int, scheduler: "Scheduler | None" = None) -> Iterator[WorkerPool]:
    """Context manager that yields a pool of workers.

    If there is a `scheduler`, the pool consists of its workers. Otherwise, it consists of `jobs` processes on this machine
    or, if `jobs` is 1, of the current process.
    """
    if scheduler is not None:
        from l3cli.parallel.cluster import workers_of

        with workers_of(scheduler) as pool:
            yield pool
    elif jobs == 1:
        yield WorkerPool(1, lambda function, items, _: map(function, items))
    else:
        from l3cli.parallel.processes import several

        with several(jobs) as mapped:
            yield WorkerPool(jobs, lambda function, items, _: mapped(function, items))
