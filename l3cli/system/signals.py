"""SIGINT and SIGTERM as exceptions, and the places where they must wait.

Python raises the exception of a signal wherever it happens to be. In a callback from a C library this can crash the library
or lose data. It can also leave a lock file behind, or a condition acquired for ever.
"""

import signal
import sys
import threading
from collections.abc import Callable
from types import CodeType, FrameType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
SIGNALS = (signal.SIGINT, signal.SIGTERM)
RETRY_SECONDS = 0.05  # until a signal that came where it must wait is sent again

_uninterrupted: set[CodeType] = set()
_waiting: type[BaseException] | None = None  # exception of the waiting signal


def uninterrupted(function: F) -> F:
    """Decorator: signals wait until `function` has returned. A function that takes long checks `is_wanted`."""
    _uninterrupted.add(function.__code__)
    return function


def must_wait(frame: FrameType | None, ending: type[BaseException]) -> bool:
    """Return whether a signal that arrived in `frame` must wait, and remember its exception `ending` if so."""
    global _waiting
    while frame is not None and frame.f_code not in _uninterrupted:
        frame = frame.f_back
    _waiting = ending if frame is not None else None
    return _waiting is not None


def is_wanted() -> bool:
    """Return whether a signal is waiting, so that no new work should begin."""
    return _waiting is not None


def raise_pending() -> None:
    """Raise the exception of a waiting signal, if there is one."""
    global _waiting
    if _waiting is not None:
        ignore()
        ending, _waiting = _waiting, None
        raise ending


def ignore() -> None:
    """Ignore further signals, so that nothing interrupts the clean-up."""
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)


# Queues, semaphores and futures use conditions. An exception while a condition is entered or left would leave it acquired or
# release it twice, and during a notification the next notification would be lost.
for _step in ("__enter__", "__exit__", "_release_save", "_acquire_restore", "notify"):
    uninterrupted(getattr(threading.Condition, _step))
# A compiled module reports an exception during its import as an ImportError, which callers may silently ignore.
uninterrupted(sys.modules["_frozen_importlib"]._find_and_load)


# ------------------------------------------------------------------------------------------------------ exceptions


class Terminated(BaseException):
    """Raised on SIGTERM. The program cleans up as after Ctrl-C."""


def heed() -> None:
    """Make SIGINT and SIGTERM raise KeyboardInterrupt and Terminated from now on, unless they were ignored."""
    sys.unraisablehook = repeat_lost
    for each in SIGNALS:
        if signal.getsignal(each) is not signal.SIG_IGN:  # background jobs ignore Ctrl-C
            signal.signal(each, end)


def leave_to_python() -> None:
    """Restore the default handlers before the program exits, when nothing would catch an exception."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_DFL)


def end(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise its exception, or send the signal again later if it must wait."""
    ending = KeyboardInterrupt if number == signal.SIGINT else Terminated
    if must_wait(frame, ending):
        _come_again(number)
        return
    ignore()
    raise ending


@uninterrupted  # otherwise a signal that arrives while its timer starts would be lost
def repeat_lost(what: Any) -> None:
    """Send a signal again whose exception Python cannot pass on, as in a finaliser."""
    if what.exc_type not in (KeyboardInterrupt, Terminated):
        sys.__unraisablehook__(what)
        return
    number = signal.SIGINT if what.exc_type is KeyboardInterrupt else signal.SIGTERM
    signal.signal(number, end)
    _come_again(number)  # later, because an exception raised here would be lost, too


def _come_again(number: int) -> None:
    """Send a signal to the main thread after a short delay."""
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    threading.Timer(RETRY_SECONDS, signal.pthread_kill, (main_thread, number)).start()
