"""In which line of a TOML text each key stands, which tomllib does not say."""

import re
import tomllib
from bisect import bisect_right
from collections.abc import Mapping

KeyPath = tuple[str | int, ...]  # keys, and numbers of entries from 0: ("scene", 1, "size")

BLANK = re.compile(r"[ \t]*")
BETWEEN = re.compile(r"(?:[ \t\n]|#[^\n]*)*")  # what may stand between statements and between entries of lists
BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
STRING = re.compile(
    r'"""(?:[^"\\]++|\\.|"{1,2}(?!"))*+"{3,5}'  # up to two quotation marks may stand before the three that end it
    r"|'''(?:[^']++|'{1,2}(?!'))*+'{3,5}"
    r'|"(?:[^"\\\n]++|\\.)*+"'
    r"|'[^'\n]*'",
    re.DOTALL,
)
SCALAR = re.compile(r"[^,\]}#\n]+")  # a number, a date, a truth value


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line, from 1, of every key, table and entry of a list in `text`, which tomllib has read without an
    error."""
    return _Scanner(text.replace("\r\n", "\n")).document()


def line_of(path: KeyPath, lines: Mapping[KeyPath, int]) -> int:
    """Return the line of a key or, where it is missing, of the table that lacks it; 1 of what is missing at the top."""
    return next((lines[path[:length]] for length in range(len(path), 0, -1) if path[:length] in lines), 1)


class _Scanner:
    """Goes through a text once; each method begins at `self.at` and leaves it behind what it is named after."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.ends = [match.start() for match in re.finditer("\n", text)]
        self.lines: dict[KeyPath, int] = {}
        self.entries: dict[KeyPath, int] = {}  # tables that a list of tables has so far

    def document(self) -> dict[KeyPath, int]:
        table: KeyPath = ()
        self._skip(BETWEEN)
        while self.at < len(self.text):
            if self.text.startswith("[", self.at):
                table = self._header()
            else:
                self._pair(table)
            self._skip(BETWEEN)
        return self.lines

    def _header(self) -> KeyPath:
        several = self.text.startswith("[[", self.at)
        line = self._line()
        self.at += 2 if several else 1
        *outer, last = self._key()
        self.at += 2 if several else 1
        table: KeyPath = ()
        for name in outer:
            table = self._inside((*table, name), line)
        if not several:
            return self._inside((*table, last), line)
        table = (*table, last)
        self.lines.setdefault(table, line)
        self.entries[table] = self.entries.get(table, -1) + 1
        table = (*table, self.entries[table])
        self.lines[table] = line
        return table

    def _inside(self, table: KeyPath, line: int) -> KeyPath:
        """Return the table of that name: of a list of tables its last one."""
        self.lines.setdefault(table, line)
        return (*table, self.entries[table]) if table in self.entries else table

    def _pair(self, table: KeyPath) -> None:
        line = self._line()
        for name in self._key():
            table = (*table, name)
            self.lines.setdefault(table, line)
        self.at += 1  # =
        self._value(table)

    def _key(self) -> list[str]:
        names = []
        while True:
            self._skip(BLANK)
            bare = BARE_KEY.match(self.text, self.at) or STRING.match(self.text, self.at)
            assert bare is not None
            self.at = bare.end()
            written = bare.group()
            names.append(tomllib.loads(f"key = {written}")["key"] if written[0] in "\"'" else written)
            self._skip(BLANK)
            if not self.text.startswith(".", self.at):
                return names
            self.at += 1

    def _value(self, path: KeyPath) -> None:
        self._skip(BLANK)
        if self.text.startswith("[", self.at):
            self.at += 1
            self._list(path)
        elif self.text.startswith("{", self.at):
            self.at += 1
            self._inline_table(path)
        else:
            match = STRING.match(self.text, self.at) or SCALAR.match(self.text, self.at)
            assert match is not None
            self.at = match.end()

    def _list(self, path: KeyPath) -> None:
        number = 0
        while not self._closed("]"):
            self.lines[*path, number] = self._line()
            self._value((*path, number))
            number += 1
            self._skip(BETWEEN)
            self.at += self.text.startswith(",", self.at)

    def _inline_table(self, path: KeyPath) -> None:
        while not self._closed("}"):
            self._pair(path)
            self._skip(BETWEEN)
            self.at += self.text.startswith(",", self.at)

    def _closed(self, bracket: str) -> bool:
        self._skip(BETWEEN)
        closed = self.text.startswith(bracket, self.at)
        self.at += closed
        return closed

    def _skip(self, what: re.Pattern[str]) -> None:
        match = what.match(self.text, self.at)
        assert match is not None
        self.at = match.end()

    def _line(self) -> int:
        return bisect_right(self.ends, self.at - 1) + 1
