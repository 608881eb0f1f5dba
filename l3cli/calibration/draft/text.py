"""The draft as text: keys, what was assumed and what is missing as comments beside them."""

import json
import re
from collections.abc import Sequence
from typing import Any

COLUMN = 54  # at which comments begin


class DraftText:
    """A measurement file as it grows."""

    def __init__(self) -> None:
        self._lines: list[str] = []
        self.assumed: list[str] = []  # what the user ought to check
        self._missing: list[tuple[str, str, str]] = []  # key, of what, what it is

    def __str__(self) -> str:
        return "\n".join(self._lines) + "\n"

    def table(self, heading: str) -> None:
        """A table or an entry of a list of tables, [sensor] or [[mono]]."""
        self._lines += ["", heading]

    def head(self, *lines: str) -> None:
        """Comments before everything."""
        self._lines[:0] = [f"# {_one_line(line)}" for line in lines]

    def comment(self, *lines: str) -> None:
        self._lines += [f"# {_one_line(line)}".rstrip("# ") if not line else f"# {_one_line(line)}" for line in lines]

    def key(self, name: str, value: Any, comment: str = "") -> None:
        self._line(f"{name} = {_toml(value)}", comment)

    def assume(self, name: str, value: Any, why: str, said: bool = True) -> None:
        """A key whose value is probable; `said`: name it on the console, too."""
        self._line(f"{name} = {_toml(value)}", f"ASSUMED: {why}")
        if said:
            self.assumed.append(f"{name} = {_toml(value)}: {why}")

    def todo(self, name: str, example: Any, what: str, where: str) -> None:
        """A key that only the user knows, with an example; `where`: of which capture, file or table."""
        self._line(f"# TODO {name} = {_toml(example)}", what)
        self._missing.append((name, where, what))

    def todo_table(self, heading: str, what: str, *keys: tuple[str, Any]) -> None:
        """A whole table that is missing."""
        self._lines += ["", f"# TODO {heading}  # {_one_line(what)}"]
        self._lines += [f"# {name} = {_toml(value)}" for name, value in keys]
        self._missing.append((heading, "", what))

    @property
    def missing(self) -> list[str]:
        """What the user has to fill in, a line for each key and reason."""
        alike: dict[tuple[str, str], list[str]] = {}
        for name, where, what in self._missing:
            alike.setdefault((name, re.sub(r"\d[\d.e+-]*", "#", what)), []).append(where)
        reasons = {(name, re.sub(r"\d[\d.e+-]*", "#", what)): what for name, _, what in reversed(self._missing)}
        return [
            f"{key[0]}{' of ' * bool(where[0])}{where[0]}{f' and {len(where) - 1} more' * (len(where) > 1)}: {reasons[key]}"
            for key, where in alike.items()
        ]

    def _line(self, text: str, comment: str) -> None:
        self._lines.append(f"{text:{COLUMN}}  # {_one_line(comment)}" if comment else text)


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_toml(each)}" for name, each in value.items()) + "}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _one_line(text: str) -> str:
    """Names of files may hold what would end a comment."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
