"""The interface that all pools of workers share."""

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
            Function at the top level of a module, because workers import it by name.
        items : iterable
            Arguments of the function, which must be picklable.
        fits : callable, optional
            Function of an item and its result. It returns whether the types and shapes of the result are correct, and may
            raise any exception if the type is wrong. The function is called only for results from other machines, because
            the workers there may run different code. [default: accept every result]

        Raises
        ------
        L3Error
            If a worker on another machine returns a result that `fits` rejects.
        """
        return self._map(function, items, fits)
