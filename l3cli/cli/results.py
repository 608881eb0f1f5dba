"""Result of a command: one document, of which the text is made; with --json it is printed, and how the command ran."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from l3cli import __version__
from l3cli.cli.terminal import Terminal, finite, show_json, with_options
from l3cli.errors import InputFileError, L3Error
from l3cli.system.console import Console, Passing
from l3cli.system.files import Dated, Ledger, close_ledger, dated, open_ledger, outputs_of, require_regular, sha256

T = TypeVar("T")
FORMAT = 1  # of "run", raised when its keys change
KINDS = {2: "call", 3: "input", 4: "device", 130: "interrupted", 143: "terminated"}  # of errors, by exit code
MOST_KEPT = 1000  # messages, and as many warnings: there may be many frames
JSON = "--json"


@dataclass(frozen=True)
class Result:
    """Result of a command."""

    document: Mapping[str, Any] = field(default_factory=dict)  # ready for JSON
    text: Callable[[], object] | None = None  # prints the same for people; None: messages have said it
    fault: BaseException | None = None  # that the result shows, or that ended the command when this much was done
    code: int = 0  # exit code, if there is no fault


@dataclass
class Record:
    """Course of a command and its messages; held only for --json."""

    current: ClassVar["Record | None"] = None  # of the command that is running

    ledger: Ledger
    command: str = ""
    warnings: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    left_out: int = 0  # warnings and messages beyond MOST_KEPT
    steps: dict[str, tuple[int, float]] = field(default_factory=dict)  # name → items done, seconds
    error: dict[str, str] | None = None
    console: Console = field(default_factory=Terminal)  # of the command
    begun: float = field(default_factory=time.time)  # s since 1970
    start: float = field(default_factory=time.monotonic)

    def add(self, messages: list[str], message: str) -> None:
        if len(messages) < MOST_KEPT:
            messages.append(with_options(message))
        else:
            self.left_out += 1

    def fail(self, message: str, code: int) -> None:
        """Note the error that ends the command."""
        self.error = {"kind": KINDS.get(code, "failure"), "message": with_options(message)}

    def show(self, result: Result | None, code: int) -> None:
        """Print the document, and under "run" how the command ran; digests unless an error has ended it."""
        seconds, console = time.monotonic() - self.start, recorded(self.console)
        is_whole = result is not None and (result.fault is None or isinstance(result.fault, L3Error))
        roles, outputs = (self.ledger.inputs, outputs_of(self.ledger)) if is_whole else ({}, [])  # no waiting after Ctrl-C
        close_ledger()
        inputs = {role: [_file(path, at, console) for path, at in files.items()] for role, files in roles.items()}
        made = [_file(path, dated(path), console) for path in outputs]
        document = finite(result.document if result else {}, console)
        run = {
            "format": FORMAT,
            "command": self.command,
            "l3": __version__,
            "exit_code": code,
            "error": self.error,
            "warnings": self.warnings,
            "messages": self.messages,
            "messages_left_out": self.left_out,
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self.begun)),
            "seconds": round(seconds, 6),
            "steps": [{"what": what, "count": n, "seconds": round(s, 6)} for what, (n, s) in self.steps.items()],
            "inputs": inputs,
            "outputs": made,
        }
        show_json({**document, "run": run})


def _file(path: Path, at: Dated | None, console: Console) -> dict[str, Any]:
    """Return a file's name, size and SHA-256; without these if it is no file, or has changed since it was `at` that date."""
    size, digest = None, None
    try:
        require_regular(path)
        if dated(path) != at:
            console.warn(f"{path} has changed while it was worked on; no digest says what was read")
        else:
            size, digest = at[0] if at else None, sha256(path)
    except InputFileError:
        pass  # a folder, a stream, or gone
    return {"path": str(path), "bytes": size, "sha256": digest}


def begin(arguments: list[str]) -> Record | None:
    """Return the record of a command, if its arguments ask for JSON: known before they are read, as they may be wrong."""
    before = arguments[: arguments.index("--")] if "--" in arguments else arguments
    Record.current = None
    if JSON in before:
        Record.current = Record(open_ledger(), next(iter(arguments), ""))
    return Record.current


class Recorded(Passing):
    """A console that keeps everything for the record."""

    def __init__(self, console: Console, record: Record) -> None:
        super().__init__(console)
        self._record = record

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Show progress as the other console; steps of one name count together."""
        start = time.monotonic()
        done, before = self._record.steps.get(what, (0, 0.0))
        for item in self._console.progress(items, total, what):
            yield item
            done += 1
            self._record.steps[what] = (done, before + time.monotonic() - start)

    def heard(self, level: str, message: str) -> None:
        self._record.add(self._record.messages if level == "info" else self._record.warnings, message)


def recorded(console: Console) -> Console:
    """Return the console, and the record hears of all that is said to it, if there is one."""
    return console if Record.current is None else Recorded(console, Record.current)
