"""Pools of worker processes and of workers on other machines.

Results are in the order of the items and do not depend on the workers. Modules that start processes are imported only when
processes are needed.
"""

import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, TypeVar

from l3cli.parallel.pool import WorkerPool
from l3cli.system.limits import ONE_BLAS_THREAD

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler

T = TypeVar("T")
R = TypeVar("R")


def one_blas_thread() -> None:
    """Limit BLAS to one thread in this process and its children. Must be called before numpy is first imported.

    With several threads, small matrix products are slower, idle threads slow down video encoders, and the rounding of
    results depends on the number of cores.
    """
    os.environ.update(ONE_BLAS_THREAD)


def without_plots() -> None:
    """Prevent colour-science from importing matplotlib and pandas, which l3 does not use.

    If they are installed, importing colour-science would take 4.8 instead of 2.4 s of processor time (on a slow core) in
    each process that simulates or trains.
    """
    for name in ("matplotlib", "pandas"):
        sys.modules.setdefault(name, None)  # type: ignore[arg-type] # None makes imports fail


def ordered_map(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """Yield function(item) for each item, in order, computed by `jobs` processes. If `jobs` is 1, this process is used.

    At most 2·jobs results are stored, so that memory does not grow with the number of items. Processes are spawned rather
    than forked, because a forked process hangs if an OpenCL context exists. Each process uses one BLAS thread.
    """
    with workers(jobs) as pool:
        yield from pool(function, items)


@contextlib.contextmanager
def workers(jobs: int, scheduler: "Scheduler | None" = None) -> Iterator[WorkerPool]:
    """Yield a pool that consists of `jobs` processes or, if there is a scheduler, of the workers of the scheduler."""
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
