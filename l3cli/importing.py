"""Imports of many modules at once, as every start is."""

import atexit
import contextlib
import gc
from collections.abc import Iterator

_is_own = False


def own_process() -> None:
    """This process does nothing but run a command: what `without_collecting` imports from now on is never searched for
    cycles, nor is anything else that is there then."""
    global _is_own
    _is_own = True
    atexit.register(gc.unfreeze)  # libraries complain of objects that are there when Python has ended


@contextlib.contextmanager
def without_collecting() -> Iterator[None]:
    """Within the block nothing is searched for cycles: modules make a hundred thousand objects that all stay, and Python
    would look through them some two hundred times."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            if _is_own:
                gc.freeze()
            gc.enable()
