"""Destinations of a stage's progress and messages: a terminal, a log, nothing."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

T = TypeVar("T")


class Console(Protocol):
    """Receiver of a stage's messages. A terminal is one implementation, `Silent` another."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Pass `items` on, of which there are `total` (None: nobody knows), and report how far the work is; `what`: their
        name in the plural."""

    def info(self, message: str) -> None:
        """State what has been made, or what comes next."""

    def warn(self, message: str) -> None:
        """Warn of what may make the result worse than expected."""

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


class Gathering:
    """A console that passes everything on to another one and keeps the first warnings, `most` at most."""

    def __init__(self, console: Console, most: int) -> None:
        self._console, self._most = console, most
        self.warnings: list[str] = []

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        return self._console.progress(items, total, what)

    def info(self, message: str) -> None:
        self._console.info(message)

    def warn(self, message: str) -> None:
        self._console.warn(message)
        self.warnings = [*self.warnings, message][: self._most]

    def report(self, message: str) -> None:
        self._console.report(message)
        self.warnings = [*self.warnings, message][: self._most]
