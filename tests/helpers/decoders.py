"""Fake decoders of foreign files that fail in various ways.

The decoding process imports this module, so this module imports little.
"""

import errno
import importlib
import os
import resource
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from l3cli.io.isolated import isolated


@isolated()
def crash(path: Path) -> None:
    """Crash with a segmentation fault."""
    os.kill(os.getpid(), signal.SIGSEGV)


@isolated()
def work(path: Path) -> None:
    """Compute forever."""
    while True:
        pass


@isolated()
def sleep(path: Path) -> None:
    """Wait far longer than any decoder may take."""
    time.sleep(600)


@isolated()
def hoard(path: Path) -> None:
    """Allocate more memory than is allowed."""
    hoarded = [np.empty(1 << 28, np.uint8) for _ in range(1000)]
    assert hoarded


@isolated()
def abort(path: Path) -> None:
    """Abort the process."""
    os.abort()


@isolated()
def stumble(path: Path) -> None:
    """Raise an error whose message has two lines."""
    raise IndexError("list index\nout of range")


@isolated()
def write_much(path: Path) -> None:
    """Try to extend every inherited file beyond its size limit."""
    for inherited in range(3, 64):
        try:
            os.posix_fallocate(inherited, 0, 1 << 40)
        except OSError as error:
            if error.errno == errno.EFBIG:  # raised only for the file of the arrays
                raise


@isolated()
def limits(path: Path) -> list[tuple[int, int]]:
    """Return the limits of the address space and of the file size."""
    return [resource.getrlimit(what) for what in (resource.RLIMIT_AS, resource.RLIMIT_FSIZE)]


@isolated()
def echo(path: Path, text: str, number: int | None) -> dict[str, Any]:
    """Return the arguments and arrays of several layouts."""
    ordered = np.asfortranarray(np.arange(6, dtype=">u2").reshape(2, 3))
    return {
        "process": os.getpid(),
        "received": (text, number, [1.5, True]),
        "arrays": {"empty": np.zeros((0, 3), np.float32), "one": np.float64(2.5), "F": ordered, "C": np.arange(4) > 1},
    }


REACHES: dict[str, Callable[[Path, str], object]] = {
    "connect": lambda path, other: socket.create_connection(("127.0.0.1", 9)),
    "socket pair": lambda path, other: socket.socketpair(),
    "exec": lambda path, other: os.execv(sys.executable, [sys.executable, "-c", ""]),
    "fork": lambda path, other: os.fork(),
    "signal": lambda path, other: os.kill(os.getppid(), 0),
    "leave the group": lambda path, other: os.setsid(),
    "limits of others": lambda path, other: resource.prlimit(os.getppid(), resource.RLIMIT_NOFILE),
    "mode": lambda path, other: path.chmod(0o600),
    "time": lambda path, other: os.utime(path),
    "truncate": lambda path, other: os.truncate(path, 0),
    "truncate by reading": lambda path, other: os.open(path, os.O_RDONLY | os.O_TRUNC),
    "write": lambda path, other: path.write_bytes(b"x"),
    "append": lambda path, other: os.open(path, os.O_WRONLY | os.O_APPEND),
    "new file": lambda path, other: path.with_name("new").touch(),
    "new folder": lambda path, other: path.with_name("new").mkdir(),
    "remove": lambda path, other: path.unlink(),
    "rename": lambda path, other: path.rename(path.with_name("new")),
    "link": lambda path, other: path.with_name("new").symlink_to(path),
    "passwords": lambda path, other: Path("/etc/passwd").read_bytes(),
    "another file": lambda path, other: Path(other).read_bytes(),
    "its folder": lambda path, other: os.listdir(path.parent),
    "environment of others": lambda path, other: Path(f"/proc/{os.getppid()}/environ").read_bytes(),
    "memory of no file": lambda path, other: os.memfd_create("much"),
    "root": lambda path, other: os.chroot(path.parent),
    "memory": lambda path, other: os.open("/proc/self/mem", os.O_RDONLY),
}
NEVER = 10**6
LANDLOCK_SINCE = {  # first version of Landlock that prevents an operation; version 1 prevents all others
    **dict.fromkeys(("memory of no file", "root", "socket pair", "fork", "leave the group", "limits of others"), NEVER),
    **dict.fromkeys(("mode", "time"), NEVER),
    "truncate": 3,
    "connect": 4,
    "signal": 6,
}


@isolated()
def reach(path: Path, what: str, other: str) -> str:
    """Try an operation that a decoder is not allowed to do. Return the name of the error, or an empty string."""
    try:
        REACHES[what](path, other)
    except OSError as error:
        return errno.errorcode[error.errno or 0]
    return ""


@isolated()
def read(path: Path) -> tuple[int, int]:
    """Return the length of the file, read in a thread, and the number of names that an imported module exports."""
    made: list[int] = []
    thread = threading.Thread(target=lambda: made.append(len(path.read_bytes())))
    thread.start()
    thread.join()
    return made[0], len(importlib.import_module("wave").__all__)


_calls = 0


@isolated()
def count(path: Path) -> int:
    """Return how often this process has been called."""
    global _calls
    _calls += 1
    return _calls
