"""A log: all that a command says, appended to a file, a line each with time (UTC), level and command."""

import os
import stat
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TypeVar

from l3cli.errors import L3Error, RecipeError
from l3cli.stages.console import Console
from l3cli.system.text import printable

T = TypeVar("T")
HEADING = b"# l3 log\n"  # which distinguishes a log from any other file: nothing else is ever written to


class Logged:
    """A console that passes everything on to another one and appends it to a log."""

    current: "Logged | None" = None  # of the command that is running, for the error that ends it

    def __init__(self, console: Console, path: Path, command: str, wording: Callable[[str], str] = str) -> None:
        """`wording` makes of a message what the log holds. RecipeError if there is something else than a log at `path`,
        L3Error if it cannot be written."""
        self._console, self._path, self._command, self._wording = console, path, command, wording
        self._lost = False  # whether it could not be written
        if path.exists() and not (path.is_file() and _is_log(path)):
            raise RecipeError(f"{path} is no log of l3's; name another file for ‹log›")
        self._append(b"" if path.exists() else HEADING)
        Logged.current = self

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """As the other console shows it; the log gets its beginning and its end."""
        self.record("info", what if total is None else f"{what}: {total} to do")
        done, start = 0, time.monotonic()
        for item in self._console.progress(items, total, what):
            yield item
            done += 1
        self.record("info", f"{what}: {done} done in {time.monotonic() - start:.3g} s")

    def info(self, message: str) -> None:
        self._console.info(message)
        self.record("info", message)

    def warn(self, message: str) -> None:
        self._console.warn(message)
        self.record("warning", message)

    def report(self, message: str) -> None:
        self._console.report(message)
        self.record("warning", message)

    def record(self, level: str, message: str) -> None:
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
