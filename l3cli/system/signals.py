"""Convert SIGINT and SIGTERM to exceptions, after which the program cleans up and reports one line.

Outputs are temporary files that are renamed when they are complete, so an exception may occur at almost any time. Only three
kinds of code must not be interrupted:

* The callbacks through which HDF5 writes. HDF5 would discard both the exception and the data, and the file would look
  complete although it is not.
* The initialisation of extension modules. Modules in C++, such as pyopencl, would abort the process.
* The import of h5py. It first gives HDF5 functions for the conversion of types, and then tells Python to take them back at
  exit. Between these two steps, an exception would lead to a crash at exit, because HDF5 would call the functions after
  Python has ended.
"""

import signal
import sys
import threading
from collections.abc import Callable
from importlib.machinery import ExtensionFileLoader
from types import CodeType, FrameType
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
SIGNALS = (signal.SIGINT, signal.SIGTERM)
RETRY_SECONDS = 0.05  # delay before a signal that was held back is sent again

HELD_BACK_IMPORT = "h5py"
_held_back: set[CodeType] = {ExtensionFileLoader.create_module.__code__, ExtensionFileLoader.exec_module.__code__}


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM, like KeyboardInterrupt on SIGINT.

    It is a KeyboardInterrupt because Python's compiler, which runs when a module without a .pyc file is imported, discards
    other exceptions.
    """


def heed() -> None:
    """Let SIGINT and SIGTERM raise KeyboardInterrupt and Terminated from now on, unless the signals are ignored."""
    sys.unraisablehook = repeat_lost
    for each in SIGNALS:
        if signal.getsignal(each) is not signal.SIG_IGN:  # shells start background jobs with SIGINT ignored
            signal.signal(each, end)


def ignore() -> None:
    """Ignore further signals while the program reports the first signal and ends."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_IGN)


def leave_to_python() -> None:
    """Restore the default handlers before the program exits, when no code would catch an exception any more."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_DFL)


def end(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise its exception or, while signals are held back, send the signal again later."""
    while frame is not None:
        imports = frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == HELD_BACK_IMPORT
        if imports or frame.f_code in _held_back:
            _send_again(number)
            return
        frame = frame.f_back
    raise KeyboardInterrupt if number == signal.SIGINT else Terminated


def behind(error: BaseException) -> KeyboardInterrupt | None:
    """Return the exception of the signal that caused another exception, or None.

    Python 3.11 turns an exception in `__set_name__` into a RuntimeError, and libraries may turn it into errors of their own.
    """
    cause: BaseException | None = error
    while not (cause is None or isinstance(cause, KeyboardInterrupt)):
        cause = cause.__cause__
    return cause


def held_back_in(callback: F) -> F:
    """Decorator for functions that call a C library or are called by one: signals wait until the function has returned."""
    _held_back.add(callback.__code__)
    return callback


def repeat_lost(what: Any) -> None:
    """Send a signal again if Python cannot pass on its exception, for example in finalisers that run during imports."""
    if what.exc_type in (KeyboardInterrupt, Terminated):
        _send_again(signal.SIGTERM if what.exc_type is Terminated else signal.SIGINT)
    else:
        sys.__unraisablehook__(what)


def _send_again(number: int) -> None:
    """Send a signal to the main thread after a short delay."""
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    threading.Timer(RETRY_SECONDS, signal.pthread_kill, (main_thread, number)).start()
