"""SIGINT and SIGTERM as exceptions, after which the program cleans up and reports one line.

Outputs are temporary files that are renamed when they are complete, so an exception may come at any moment. The only code
that signals must not interrupt are the callbacks through which HDF5 writes: HDF5 forgets their exceptions together with the
data, so the file would be incomplete and look complete.
"""

import signal
import sys
import threading
from collections.abc import Callable
from types import CodeType, FrameType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
SIGNALS = (signal.SIGINT, signal.SIGTERM)
RETRY_SECONDS = 0.05  # until a signal that came during a callback is sent again

_callbacks: set[CodeType] = set()


class Terminated(BaseException):
    """Raised on SIGTERM, as KeyboardInterrupt is on SIGINT."""


def heed() -> None:
    """Make SIGINT and SIGTERM raise KeyboardInterrupt and Terminated from now on, unless they are ignored."""
    sys.unraisablehook = repeat_lost
    for each in SIGNALS:
        if signal.getsignal(each) is not signal.SIG_IGN:  # shells start background jobs with SIGINT ignored
            signal.signal(each, end)


def ignore() -> None:
    """Ignore further signals while the program reports the first one and ends."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_IGN)


def leave_to_python() -> None:
    """Restore the default handlers before the program exits, when nothing would catch an exception."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_DFL)


def end(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise its exception, or send it again later if it came during a callback of HDF5."""
    while frame is not None:
        if frame.f_code in _callbacks:
            _send_again(number)
            return
        frame = frame.f_back
    raise KeyboardInterrupt if number == signal.SIGINT else Terminated


def held_back_in(callback: F) -> F:
    """Decorator: signals wait until this function has returned, which calls a C library or is called by one."""
    _callbacks.add(callback.__code__)
    return callback


def repeat_lost(what: Any) -> None:
    """Send a signal again whose exception Python cannot pass on, as in the finalisers that run during imports."""
    if what.exc_type in (KeyboardInterrupt, Terminated):
        _send_again(signal.SIGINT if what.exc_type is KeyboardInterrupt else signal.SIGTERM)
    else:
        sys.__unraisablehook__(what)


def _send_again(number: int) -> None:
    """Send a signal to the main thread after a short delay."""
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    threading.Timer(RETRY_SECONDS, signal.pthread_kill, (main_thread, number)).start()
