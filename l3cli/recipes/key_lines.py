"""Find the line number of each key in a TOML document, because tomllib does not report line numbers."""

import re
import tomllib
from collections.abc import Mapping

from l3cli.recipes.toml import KeyPath

STRING = (
    r'"""[^"\\]*(?:(?:\\.|"{1,2}(?!"))[^"\\]*)*"{3,5}'  # up to two quotation marks may precede the closing three
    r"|'''[^']*(?:'{1,2}(?!')[^']*)*'{3,5}"
    r'|"[^"\\\n]*(?:\\.[^"\\\n]*)*"'
    r"|'[^'\n]*'"
)
TOKEN = re.compile(rf"{STRING}|#[^\n]*|[^\"'#.,\[\]{{}}=\n]+|.", re.DOTALL)  # a TOML token and adjacent blanks


def line_of(path: KeyPath, lines: Mapping[KeyPath, int]) -> int:
    """Look up a key's line number in the result of `key_lines`.

    For a missing key, return the line of the innermost existing table around it, or 1 if there is none.
    """
    return next((lines[path[:length]] for length in range(len(path), 0, -1) if path[:length] in lines), 1)


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line number, counted from 1, of every key, table and list entry in a valid TOML document."""
    return _Scanner(text.replace("\r\n", "\n")).document()


class _Scanner:
    """Finds the line numbers of all keys in one pass over the tokens. Each parsing method reads one TOML element."""

    def __init__(self, text: str) -> None:
        self.text, self.tokens = text, TOKEN.finditer(text)
        self.token, self.start, self.line = "", 0, 1
        self.lines: dict[KeyPath, int] = {}
        self.entries: dict[KeyPath, int] = {}  # path of a list of tables → index of the latest table in the list
        self._next()

    def _next(self) -> str:
        """Advance to the next token, and return the previous token. At the end of the text, the new token is ""."""
        before, self.token = self.token, ""
        for found in self.tokens:
            token = found.group().strip(" \t")
            if token and token[0] != "#":
                self.line += self.text.count("\n", self.start, found.start())
                self.token, self.start = token, found.start()
                break
        return before

    def document(self) -> dict[KeyPath, int]:
        table: KeyPath = ()
        while self.token:
            if self.token == "\n":
                self._next()
            elif self.token == "[":
                table = self._heading()
            else:
                self._pair(table)
        return self.lines

    def _heading(self) -> KeyPath:
        several, line = self.text.startswith("[[", self.start), self.line
        table: KeyPath = ()
        *outer, last = self._key()
        for name in outer if several else (*outer, last):
            table = (*table, name)
            self.lines.setdefault(table, line)
            if table in self.entries:  # the name refers to the latest table in a list of tables
                table = (*table, self.entries[table])
        if several:
            table = (*table, last)
            self.lines.setdefault(table, line)
            self.entries[table] = self.entries.get(table, -1) + 1
            table = (*table, self.entries[table])
            self.lines[table] = line
        while self.token == "]":
            self._next()
        return table

    def _key(self) -> list[str]:
        names = []
        while self.token not in ("=", "]"):
            written = self._next()
            if written[0] in "\"'":
                names.append(tomllib.loads(f"key = {written}")["key"])
            elif written not in ".[":
                names.append(written)
        return names

    def _pair(self, table: KeyPath) -> None:
        line = self.line
        for name in self._key():
            table = (*table, name)
            self.lines.setdefault(table, line)
        self._next()  # skip the equals sign
        self._value(table)

    def _value(self, path: KeyPath) -> None:
        if self.token in ("[", "{"):
            self._entries(path, "]" if self._next() == "[" else "}")
        while self.token not in (",", "]", "}", "\n", ""):
            self._next()

    def _entries(self, path: KeyPath, end: str) -> None:
        """Read the entries of a list or an inline table, up to the closing bracket `end`."""
        number = 0
        while self.token != end:
            if self.token in (",", "\n"):
                self._next()
            elif end == "]":
                self.lines[*path, number] = self.line
                self._value((*path, number))
                number += 1
            else:
                self._pair(path)
        self._next()
