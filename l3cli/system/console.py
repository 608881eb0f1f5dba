"""Consoles: objects that receive the progress and the messages of a stage."""

import os
import stat
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Protocol, TypeVar

from l3cli.errors import L3Error, RecipeError
from l3cli.system.text import printable

T = TypeVar("T")
HEADING = b"# l3 log\n"  # first line of every log, so that l3 never appends to other files


class Console(Protocol):
    """Interface of consoles, which receive the progress and the messages of a stage."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Iterate over `items`, and report how many of them have been processed.

        `total` is the number of items, or None if unknown. `what` is a plural noun for the items, such as "frames".
        """

    def info(self, message: str) -> None:
        """Report a result, or suggest the next command."""

    def warn(self, message: str) -> None:
        """Warn about something that may degrade the result."""

    def report(self, message: str) -> None:
        """Report skipped work, or a risk that l3 cannot prevent. The message appears even with --quiet."""


class Silent:
    """A console that discards everything."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        return iter(items)

    def info(self, message: str) -> None:
        pass

    def warn(self, message: str) -> None:
        pass

    def report(self, message: str) -> None:
        pass


class PythonWarnings(Silent):
    """A console that turns warnings and reports into Python warnings, and discards all other messages."""

    def warn(self, message: str) -> None:
        warn_caller(message)

    def report(self, message: str) -> None:
        warn_caller(message)


def warn_caller(message: str) -> None:
    """Issue a UserWarning that points to the line of user code that called l3."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "l3cli":
        level, frame = level + 1, frame.f_back
    warnings.warn(message, stacklevel=level)


class Passing:
    """Base class of consoles that forward every message to another console, and then process it in `heard`."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        return self._console.progress(items, total, what)

    def info(self, message: str) -> None:
        self._console.info(message)
        self.heard("info", message)

    def warn(self, message: str) -> None:
        self._console.warn(message)
        self.heard("warning", message)

    def report(self, message: str) -> None:
        self._console.report(message)
        self.heard("warning", message)

    def heard(self, level: str, message: str) -> None:
        """Process a message after it has been forwarded. `level` is "info" or "warning"."""
        raise NotImplementedError


class Gathering(Passing):
    """A console that forwards all messages, and stores the first `most` warnings."""

    def __init__(self, console: Console, most: int) -> None:
        super().__init__(console)
        self._most = most
        self.warnings: list[str] = []

    def heard(self, level: str, message: str) -> None:
        if level == "warning" and len(self.warnings) < self._most:
            self.warnings.append(message)


class Logged(Passing):
    """A console that forwards all messages, and appends them to a log file.

    Each line of the log contains the UTC time, the level, the command and the message.

    Parameters
    ----------
    console : Console
        Console to which messages are forwarded.
    path : Path
        Log file. It is created if it does not exist.
    command : str
        Name of the command, such as "render".
    wording : callable
        Function that rewrites each message for the log. [default: no change]

    Raises
    ------
    RecipeError
        If the file exists but is not an l3 log.
    L3Error
        If the file cannot be written.
    """

    def __init__(self, console: Console, path: Path, command: str, wording: Callable[[str], str] = str) -> None:
        super().__init__(console)
        self._path, self._command, self._wording = path, command, wording
        self._lost = False  # whether a write error has occurred
        if path.exists() and not (path.is_file() and _is_log(path)):
            raise RecipeError(f"{path} is not an l3 log; choose another file for ‹log›")
        self._append(b"" if path.exists() else HEADING)

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Forward progress to the other console. The log records only the start and the end of the work."""
        self.heard("info", what if total is None else f"{what}: {total} to do")
        done, start = 0, time.monotonic()
        for item in self._console.progress(items, total, what):
            yield item
            done += 1
        self.heard("info", f"{what}: {done} done in {time.monotonic() - start:.3g} s")

    def heard(self, level: str, message: str) -> None:
        """Append a message to the log. If writing fails, report the error once and continue without the log."""
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        if self._lost:
            return
        try:
            self._append(f"{now} {level} {self._command} {printable(self._wording(message))}\n".encode())
        except L3Error as error:
            self._lost = True
            self._console.report(f"warning: {error}")

    def _append(self, line: bytes) -> None:
        try:
            file = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o666)
            try:
                if os.write(file, line) < len(line):
                    raise L3Error(f"{self._path} cannot be written: the disk is full; free some space")
            finally:
                os.close(file)
        except OSError as error:
            raise L3Error(f"{self._path} cannot be written: {error.strerror}; choose another file for ‹log›") from error


def _is_log(path: Path) -> bool:
    with open(path, "rb") as file:
        return stat.S_ISREG(os.fstat(file.fileno()).st_mode) and file.read(len(HEADING)) == HEADING
