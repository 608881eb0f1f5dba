"""Stand-ins for decoders of foreign files, that fail variously. A light module: the process that decodes imports it."""

import os
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.io.apart import apart


@apart
def crash(path: Path) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


@apart
def work(path: Path) -> None:
    while True:
        pass


@apart
def sleep(path: Path) -> None:
    time.sleep(600)


@apart
def hoard(path: Path) -> None:
    hoarded = [np.empty(1 << 28, np.uint8) for _ in range(1000)]
    assert hoarded


@apart
def abort(path: Path) -> None:
    os.abort()


@apart
def stumble(path: Path) -> None:
    raise IndexError("list index\nout of range")


@apart
def write_much(path: Path) -> None:
    with tempfile.TemporaryFile() as file:
        os.posix_fallocate(file.fileno(), 0, 1 << 40)


@apart
def echo(path: Path, text: str, number: int | None) -> dict[str, Any]:
    ordered = np.asfortranarray(np.arange(6, dtype=">u2").reshape(2, 3))
    return {
        "process": os.getpid(),
        "told": (text, number, [1.5, True]),
        "arrays": {"empty": np.zeros((0, 3), np.float32), "one": np.float64(2.5), "F": ordered, "C": np.arange(4) > 1},
    }
