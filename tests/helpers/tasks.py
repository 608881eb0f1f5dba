"""Functions that tests run in worker processes. Workers import this module, so this module imports little."""

import contextlib
import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from l3cli.errors import L3Error

T = TypeVar("T")
R = TypeVar("R")

PATIENCE = 300.0  # seconds that a test waits for a worker


def squared(number: int) -> int:
    return number * number


def refusing(number: int) -> int:
    raise L3Error(f"not {number}")


def stopping_once(marker: str) -> int:
    """Return the number of this process, but stop the process if no earlier call has created the file `marker`."""
    try:
        Path(marker).touch(exist_ok=False)
    except FileExistsError:
        return os.getpid()
    os.kill(os.getpid(), signal.SIGSTOP)
    return 0


def here(number: int) -> str:
    return os.getcwd()


def in_folder(folder: str, function: Callable[[T], R], item: T) -> R:
    with contextlib.chdir(folder):
        return function(item)
