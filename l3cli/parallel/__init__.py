"""Access to worker processes, threads, and workers on other machines.

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
    """Limit BLAS to one thread in this process and its children. Call it before numpy is first imported.

    Small matrix products are faster with one thread, idle threads do not slow down encoders, and the rounding of results
    does not depend on the number of cores.
    """
    os.environ.update(ONE_BLAS_THREAD)


def without_plots() -> None:
    """Keep colour-science from importing matplotlib and pandas if they are installed, because l3 does not use them.

    The import then takes 2.4 instead of 4.8 s of processor time (on a slow core), in each process that simulates or trains.
    """
    for name in ("matplotlib", "pandas"):
        sys.modules.setdefault(name, None)  # type: ignore[arg-type] # None makes imports fail


def ordered_map(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """Yield function(item) for each item, in order, computed by `jobs` processes. If `jobs` is 1, use this process.

    At most 2·jobs results are stored, so the memory does not grow with the number of items. Processes are spawned rather
    than forked, because a forked process hangs if an OpenCL context exists. Each process uses one BLAS thread.
    """
    with workers(jobs) as pool:
        yield from pool(function, items)


@contextlib.contextmanager
def workers(jobs: int, scheduler: "Scheduler | None" = None) -> Iterator[WorkerPool]:
    """Yield a pool of `jobs` processes or of the workers of a scheduler, which can be called several times."""
    if scheduler is not None:
        from l3cli.parallel.cluster import workers_of

        with workers_of(scheduler) as pool:
            yield pool
    elif jobs == 1:
        yield WorkerPool(1, map)
    else:
        from l3cli.parallel.processes import several

        with several(jobs) as mapped:
            yield WorkerPool(jobs, mapped)
