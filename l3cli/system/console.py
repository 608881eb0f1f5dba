"""Destinations of a stage's progress and messages: a terminal, nothing."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

T = TypeVar("T")


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
