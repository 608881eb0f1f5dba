"""Functions that tests run in worker processes. Workers import this module, so this module imports little."""

import contextlib
import os
from collections.abc import Callable
from typing import TypeVar

from l3cli.errors import L3Error

T = TypeVar("T")
R = TypeVar("R")

PATIENCE = 300.0  # seconds that a test waits for a worker


def squared(number: int) -> int:
    return number * number


def refusing(number: int) -> int:
    raise L3Error(f"not {number}")


def here(number: int) -> str:
    return os.getcwd()


def in_folder(folder: str, function: Callable[[T], R], item: T) -> R:
    with contextlib.chdir(folder):
        return function(item)
