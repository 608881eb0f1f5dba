"""Where the progress and the messages of a stage go: to a terminal, to a log, nowhere."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

T = TypeVar("T")


class Console(Protocol):
    """What a stage says while it works. A terminal is one implementation, `Silent` another."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Pass `items` on, of which there are `total` (None: nobody knows), and report how far the work is; `what`: their
        name in the plural."""

    def say(self, message: str) -> None:
        """What has been made, what comes next."""

    def warn(self, message: str) -> None:
        """What may make the result worse than expected."""

    def alert(self, message: str) -> None:
        """What is left out although it was asked for, or cannot be guarded against: said even where little is said."""


class Silent:
    """A console that says nothing."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        return iter(items)

    def say(self, message: str) -> None:
        pass

    def warn(self, message: str) -> None:
        pass

    def alert(self, message: str) -> None:
        pass


class Gathering:
    """A console that passes everything on to another one and keeps the first warnings, `most` at most."""

    def __init__(self, console: Console, most: int) -> None:
        self._console, self._most = console, most
        self.warnings: list[str] = []

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        return self._console.progress(items, total, what)

    def say(self, message: str) -> None:
        self._console.say(message)

    def warn(self, message: str) -> None:
        self._console.warn(message)
        self.warnings = [*self.warnings, message][: self._most]

    def alert(self, message: str) -> None:
        self._console.alert(message)
        self.warnings = [*self.warnings, message][: self._most]
