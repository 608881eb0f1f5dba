"""The common interface of all worker pools."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")


def _accepted(item: object, result: object) -> bool:
    return True


@dataclass(frozen=True)
class WorkerPool:
    """Workers that compute function(item) for each item."""

    size: int  # number of workers
    _map: Callable[[Callable[[Any], Any], Iterable[Any], Callable[[Any, Any], bool]], Iterator[Any]]

    def __call__(
        self, function: Callable[[T], R], items: Iterable[T], fits: Callable[[T, R], bool] = _accepted
    ) -> Iterator[R]:
        """Compute function(item) for each item, and yield the results in the order of the items.

        Parameters
        ----------
        function : callable
            Function of one item. It must be defined at the top level of a module, because workers import it by name.
        items : iterable
            Items, which must be picklable.
        fits : callable, optional
            Function that takes an item and its result, and returns whether the result has the expected types and shapes. It
            may raise any exception if the type is wrong. Only results from other machines are checked, because workers
            there may run different code. [default: accept every result]

        Raises
        ------
        L3Error
            If a worker on another machine returns a result that `fits` rejects.
        """
        return self._map(function, items, fits)
