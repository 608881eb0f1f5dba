"""The one door to processes (processes), other machines (cluster) and threads (threads): the same results in the same order
whatever the workers. What starts processes is imported when there are some to start: a single frame needs none."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from l3cli.system.limits import ONE_BLAS_THREAD

if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler

T = TypeVar("T")
R = TypeVar("R")


def one_blas_thread() -> None:
    """Keep BLAS to one thread in this process and its children, whatever the user has set: small products are faster so,
    threads that wait for them take no time of encoders, and the number of cores does not change how they are rounded. To be
    called before numpy is first imported."""
    os.environ.update(ONE_BLAS_THREAD)


def without_plots() -> None:
    """Hide from colour-science, in a process of our own, what it draws plots and makes tables with: nothing here asks for
    it, and it takes half of the time that the import needs."""
    for name in ("matplotlib", "pandas"):
        sys.modules.setdefault(name, None)  # type: ignore[arg-type] # as Python notes that there is none


def ordered_map(function: Callable[[T], R], items: Iterable[T], jobs: int) -> Iterator[R]:
    """Yield function(item) of every item, in order, by `jobs` processes (1: in this one).

    Processes are spawned, not forked: a fork after an OpenCL context exists hangs. Their BLAS is kept to one thread each.
    At most 2·jobs results wait, so memory is bounded by the workers, not by the number of items.
    """
    with workers(jobs) as pool:
        yield from pool(function, items)


@dataclass(frozen=True)
class WorkerPool:
    """Workers that are handed items: pool(function, items) gives function(item) of every item, in order."""

    size: int  # that work at a time
    _map: Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

    def __call__(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        return self._map(function, items)


@contextlib.contextmanager
def workers(jobs: int, scheduler: "Scheduler | None" = None) -> Iterator[WorkerPool]:
    """Offer `ordered_map` for several calls by the same processes, or by the workers of a scheduler."""
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
