"""Imports of many modules at once, as every start is."""

import contextlib
import gc
from collections.abc import Iterator


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
            gc.enable()
