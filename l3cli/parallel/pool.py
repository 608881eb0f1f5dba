"""The common interface of all pools of workers."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True)
class WorkerPool:
    """Workers that compute function(item) for each item. Calling pool(function, items) yields the results in order."""

    size: int  # number of workers
    _map: Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]

    def __call__(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        return self._map(function, items)
