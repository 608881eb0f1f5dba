"""SIGINT and SIGTERM as exceptions, and where they must wait, since an exception there would do harm.

A signal becomes an exception wherever Python happens to be. A C library that has called back crashes on it or, worse, takes
what was not written for written; another complains on stderr that it was left with half a picture; a lock file that has just
been made stays; a condition that has just been acquired stays so for ever.
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
_waiting: type[BaseException] | None = None  # what a signal that waits will be


def uninterrupted(function: F) -> F:
    """Keep signals waiting until `function`, and what it calls, has returned; one that may take long checks `is_wanted`."""
    _uninterrupted.add(function.__code__)
    return function


def must_wait(frame: FrameType | None, ending: type[BaseException]) -> bool:
    """Return whether a signal, to become the exception `ending`, has to wait since it came while `frame` ran."""
    global _waiting
    while frame is not None and frame.f_code not in _uninterrupted:
        frame = frame.f_back
    _waiting = ending if frame is not None else None
    return _waiting is not None


def is_wanted() -> bool:
    """Return whether a signal waits: work that has not begun should be left."""
    return _waiting is not None


def raise_pending() -> None:
    """Raise what the signal that waits would become, if one does: after it something has been left, nothing may go on."""
    global _waiting
    if _waiting is not None:
        ignore()
        ending, _waiting = _waiting, None
        raise ending


def ignore() -> None:
    """Ignore further signals: once is enough, nothing must disturb the cleaning up."""
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)


# Queues, semaphores and futures are made of conditions. An exception on entering or leaving the "with" of one would leave
# it acquired, or let it go twice; in the middle of a notification it would have the next one go to nobody.
for _step in ("__enter__", "__exit__", "_release_save", "_acquire_restore", "notify"):
    uninterrupted(getattr(threading.Condition, _step))
# A compiled module takes an exception in its import for a failure of its own, and who can do without the module goes on.
uninterrupted(sys.modules["_frozen_importlib"]._find_and_load)


# ------------------------------------------------------------------------------------------------------ exceptions


class Terminated(BaseException):
    """Arrival of SIGTERM: a scheduler or a user ends the program, which cleans up as after Ctrl-C."""


def heed() -> None:
    """Make SIGINT and SIGTERM from now on raise KeyboardInterrupt and Terminated, unless they were ignored."""
    sys.unraisablehook = repeat_lost
    for each in SIGNALS:
        if signal.getsignal(each) is not signal.SIG_IGN:  # as a job in the background ignores Ctrl-C
            signal.signal(each, end)


def leave_to_python() -> None:
    """Leave signals to Python: all is done but for its end, where an exception would be caught by nothing."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_DFL)


def end(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise its exception, or have it come again where it must wait."""
    ending = KeyboardInterrupt if number == signal.SIGINT else Terminated
    if must_wait(frame, ending):
        _come_again(number)
        return
    ignore()
    raise ending


@uninterrupted  # or the signal that comes again while its timer still starts would be lost here
def repeat_lost(what: Any) -> None:
    """Send a signal again that was raised where Python cannot pass it on, as in a finaliser."""
    if what.exc_type not in (KeyboardInterrupt, Terminated):
        sys.__unraisablehook__(what)
        return
    number = signal.SIGINT if what.exc_type is KeyboardInterrupt else signal.SIGTERM
    signal.signal(number, end)
    _come_again(number)  # not here, where it would be lost, too


def _come_again(number: int) -> None:
    """Send the main thread a signal a little later."""
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    threading.Timer(RETRY_SECONDS, signal.pthread_kill, (main_thread, number)).start()
