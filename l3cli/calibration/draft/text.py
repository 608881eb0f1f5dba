"""The draft as text: keys, what was assumed and what is missing as comments beside them."""

import re
from typing import Any

from l3cli.recipes.toml import toml_value
from l3cli.system.text import printable

COLUMN = 54  # at which comments begin


class DraftText:
    """A measurement file as it grows."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self.assumed: list[str] = []  # what the user ought to check
        self._missing: list[tuple[str, str, str]] = []  # key, of what, what it is

    def __str__(self) -> str:
        return "\n".join(self._lines) + "\n"

    def table(self, heading: str, **keys: Any) -> None:
        """Begin a table or an entry of a list of tables, [sensor] or [[mono]], with keys that are known."""
        self._lines += ["", heading]
        for name, value in keys.items():
            self.key(name, value)

    def head(self, *lines: str) -> None:
        """Add comments before everything."""
        self._lines[:0] = [f"# {printable(line)}" for line in lines]

    def comment(self, *lines: str) -> None:
        self._lines += [f"# {printable(line)}".rstrip("# ") if not line else f"# {printable(line)}" for line in lines]

    def key(self, name: str, value: Any, comment: str = "") -> None:
        self._line(f"{name} = {toml_value(value)}", comment)

    def assume(self, name: str, value: Any, why: str, announced: bool = True) -> None:
        """Add a key whose value is probable; `announced`: name it on the console, too."""
        self._line(f"{name} = {toml_value(value)}", f"ASSUMED: {why}")
        if announced:
            self.assumed.append(f"{name} = {toml_value(value)}: {why}")

    def todo(self, name: str, example: Any, what: str, where: str) -> None:
        """Add a key that only the user knows, with an example; `where`: of which capture, file or table."""
        self._line(f"# TODO {name} = {toml_value(example)}", what)
        self._missing.append((name, where, what))

    def fill(self, name: str, value: Any, what: str, where: str) -> None:
        """Add a key that names something that only the user can make."""
        self._line(f"{name} = {toml_value(value)}", f"TODO: {what}")
        self._missing.append((name, where, what))

    def todo_table(self, heading: str, what: str, *keys: tuple[str, Any]) -> None:
        """Add a whole table that is missing."""
        self._lines += ["", f"# TODO {heading}  # {printable(what)}"]
        self._lines += [f"# {name} = {toml_value(value)}" for name, value in keys]
        self._missing.append((heading, "", what))

    @property
    def missing(self) -> list[str]:
        """Return a line for each key that the user must fill in, with the reason."""
        alike: dict[tuple[str, str], list[str]] = {}
        for name, where, what in self._missing:
            alike.setdefault((name, re.sub(r"\d[\d.e+-]*", "#", what)), []).append(where)
        reasons = {(name, re.sub(r"\d[\d.e+-]*", "#", what)): what for name, _, what in reversed(self._missing)}
        return [
            f"{key[0]}{' of ' * bool(where[0])}{where[0]}{f' and {len(where) - 1} more' * (len(where) > 1)}: {reasons[key]}"
            for key, where in alike.items()
        ]

    def _line(self, text: str, comment: str) -> None:
        self._lines.append(f"{text:{COLUMN}}  # {printable(comment)}" if comment else text)
