"""Convert SIGINT and SIGTERM to exceptions, so that the program cleans up and prints one line before it ends.

Because l3 writes outputs to temporary files and renames them when they are complete, an exception may occur at almost any
time. Only three pieces of code must not be interrupted by signals:

* The callbacks through which HDF5 writes. HDF5 would discard both the exception and the data, and the incomplete file would
  look complete.
* The initialisation of extension modules. C++ modules such as pyopencl would abort the process.
* The import of h5py. h5py registers Python functions for type conversion with HDF5, and then an exit handler that removes
  them. An exception between these two steps would crash the process at exit, because HDF5 would call the functions after
  the Python interpreter has ended.
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
RETRY_SECONDS = 0.05  # delay before a signal that could not be handled is sent again

HELD_BACK_IMPORT = "h5py"
_held_back: set[CodeType] = {ExtensionFileLoader.create_module.__code__, ExtensionFileLoader.exec_module.__code__}


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM, just as KeyboardInterrupt is raised on SIGINT.

    It is a subclass of KeyboardInterrupt because Python's compiler, which runs when a module without a .pyc file is
    imported, discards all other exceptions.
    """


def heed() -> None:
    """Install handlers that raise KeyboardInterrupt on SIGINT and Terminated on SIGTERM. Ignored signals stay ignored."""
    sys.unraisablehook = repeat_lost
    for each in SIGNALS:
        if signal.getsignal(each) is not signal.SIG_IGN:  # shells start background jobs with SIGINT ignored
            signal.signal(each, end)


def ignore() -> None:
    """Ignore all further signals. The program calls this function after the first signal, before it cleans up."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_IGN)


def leave_to_python() -> None:
    """Restore the default handlers before the program exits, because nothing catches exceptions during the exit."""
    for each in SIGNALS:
        if signal.getsignal(each) is end:
            signal.signal(each, signal.SIG_DFL)


def end(number: int, frame: FrameType | None) -> None:
    """Signal handler: raise the signal's exception or, if the running code must not be interrupted, resend it later."""
    while frame is not None:
        imports = frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == HELD_BACK_IMPORT
        if imports or frame.f_code in _held_back:
            _send_again(number)
            return
        frame = frame.f_back
    raise KeyboardInterrupt if number == signal.SIGINT else Terminated


def behind(error: BaseException) -> KeyboardInterrupt | None:
    """Return the KeyboardInterrupt behind an error: the error itself, or one of its causes. Returns None if there is none.

    Python 3.11 wraps an exception in `__set_name__` in a RuntimeError, and some libraries wrap exceptions in their own error
    classes.
    """
    cause: BaseException | None = error
    while not (cause is None or isinstance(cause, KeyboardInterrupt)):
        cause = cause.__cause__
    return cause


def held_back_in(callback: F) -> F:
    """Decorator that delays signals until the function returns, for code that calls or is called by a C library."""
    _held_back.add(callback.__code__)
    return callback


def repeat_lost(what: Any) -> None:
    """Resend a signal if Python discarded its exception, for example in a finaliser. Used as `sys.unraisablehook`."""
    if what.exc_type in (KeyboardInterrupt, Terminated):
        _send_again(signal.SIGTERM if what.exc_type is Terminated else signal.SIGINT)
    else:
        sys.__unraisablehook__(what)


def _send_again(number: int) -> None:
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    threading.Timer(RETRY_SECONDS, signal.pthread_kill, (main_thread, number)).start()
