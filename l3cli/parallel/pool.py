"""The common interface of all pools of workers."""

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
        """Yield function(item) for each item, in order.

        Parameters
        ----------
        function : callable
            Function at the top level of a module.
        items : iterable
            Arguments of the function.
        fits : callable, optional
            Function of an item and its result. It returns whether the result has the types and shapes that `function`
            returns for this item. For a result of a wrong type, it may also raise an exception. Only results from other
            machines are checked, because the workers there may run other code.

        Raises
        ------
        L3Error
            If a worker on another machine returns a result that does not fit.
        """
        return self._map(function, items, fits)
