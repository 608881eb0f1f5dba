"""Destinations of a stage's progress and messages: a terminal, a log, nothing."""

import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Protocol, TypeVar

from l3cli.errors import L3Error, RecipeError
from l3cli.system.text import printable

T = TypeVar("T")
HEADING = b"# l3 log\n"  # which distinguishes a log from any other file: nothing else is ever written to


class Console(Protocol):
    """Receiver of a stage's messages. A terminal is one implementation, `Silent` another."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Pass `items` on, of which there are `total` (None: nobody knows), and report how far the work is; `what`: their
        name in the plural."""

    def info(self, message: str) -> None:
        """Report what has been made, or what comes next."""

    def warn(self, message: str) -> None:
        """Warn about what may make the result worse than expected."""

    def report(self, message: str) -> None:
        """Report what is left out although it was asked for, or cannot be guarded against, also where messages are few."""


class Silent:
    """A console that says nothing."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        return iter(items)

    def info(self, message: str) -> None:
        pass

    def warn(self, message: str) -> None:
        pass

    def report(self, message: str) -> None:
        pass


class Passing:
    """A console that passes everything on to another one, and hears of it."""

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
        """Take a message that was passed on."""
        raise NotImplementedError


class Gathering(Passing):
    """A console that keeps the first warnings, `most` at most."""

    def __init__(self, console: Console, most: int) -> None:
        super().__init__(console)
        self._most = most
        self.warnings: list[str] = []

    def heard(self, level: str, message: str) -> None:
        if level == "warning" and len(self.warnings) < self._most:
            self.warnings.append(message)


class Logged(Passing):
    """A console that appends all that a command says to a file, a line each with time (UTC), level and command."""

    current: "Logged | None" = None  # of the command that is running, for the error that ends it

    def __init__(self, console: Console, path: Path, command: str, wording: Callable[[str], str] = str) -> None:
        """Open the log. `wording` makes of a message what the log holds. RecipeError if there is something else than a log
        at `path`, L3Error if it cannot be written."""
        super().__init__(console)
        self._path, self._command, self._wording = path, command, wording
        self._lost = False  # whether it could not be written
        if path.exists() and not (path.is_file() and _is_log(path)):
            raise RecipeError(f"{path} is not a log of l3's; name another file for ‹log›")
        self._append(b"" if path.exists() else HEADING)
        Logged.current = self

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Show progress as the other console; the log gets its beginning and its end."""
        self.heard("info", what if total is None else f"{what}: {total} to do")
        done, start = 0, time.monotonic()
        for item in self._console.progress(items, total, what):
            yield item
            done += 1
        self.heard("info", f"{what}: {done} done in {time.monotonic() - start:.3g} s")

    def heard(self, level: str, message: str) -> None:
        """Append a line. A log that can no longer be written is said once, and the work goes on."""
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
            raise L3Error(f"{self._path} cannot be written: {error.strerror}; name another file for ‹log›") from error


def _is_log(path: Path) -> bool:
    with open(path, "rb") as file:
        return stat.S_ISREG(os.fstat(file.fileno()).st_mode) and file.read(len(HEADING)) == HEADING
