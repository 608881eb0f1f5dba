"""Where SIGINT and SIGTERM must wait: in functions that libraries call or that call them half-way.

A signal becomes an exception wherever Python happens to be. A C library that has called back crashes on it or, worse, takes
what was not written for written; another complains on stderr that it was left with half a picture.
"""

from collections.abc import Callable
from types import CodeType, FrameType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

_uninterrupted: set[CodeType] = set()


def uninterrupted(function: F) -> F:
    """Have signals wait until `function`, and what it calls, has returned."""
    _uninterrupted.add(function.__code__)
    return function


def must_wait(frame: FrameType | None) -> bool:
    """Whether a signal that has come while `frame` ran has to wait."""
    while frame is not None:
        if frame.f_code in _uninterrupted:
            return True
        frame = frame.f_back
    return False
