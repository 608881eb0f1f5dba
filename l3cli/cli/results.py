"""The result of a command: a JSON document, and a function that prints it as text. --json also prints a record of the
run.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from l3cli import __version__
from l3cli.cli.terminal import Terminal, finite, show_json, with_options
from l3cli.errors import InputFileError, L3Error
from l3cli.system.console import Console, Logged, Passing
from l3cli.system.files import Dated, FilesUsed, dated, require_regular, sha256

T = TypeVar("T")
RUN_FORMAT = 1  # version of the keys in "run"
ERROR_KINDS = {2: "call", 3: "input", 4: "device", 130: "interrupted", 143: "terminated"}  # by exit code
MOST_MESSAGES = 1000  # largest number of recorded messages, and of recorded warnings, because many frames can cause many
JSON = "--json"


@dataclass(frozen=True)
class Result:
    """Result of a command."""

    document: Mapping[str, Any] = field(default_factory=dict)  # ready for JSON
    text: Callable[[], object] | None = None  # prints the document as text; None if messages already contain the results
    fault: BaseException | None = None  # error that the result reports, or that ended the command early
    code: int = 0  # exit code without a fault
    files: FilesUsed = field(default_factory=FilesUsed)


@dataclass
class Record:
    """The course of a command: its log, and the messages and times that --json prints.

    Click passes the record to the commands as the `obj` of its contexts.
    """

    command: str = ""
    as_json: bool = False
    log: Logged | None = None  # also receives the final error
    warnings: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    left_out: int = 0  # number of warnings and messages that were not recorded
    steps: dict[str, tuple[int, float]] = field(default_factory=dict)  # number of items and duration in s, by step
    error: dict[str, str] | None = None
    console: Console = field(default_factory=Terminal)  # console to which the command sends its messages
    begun: float = field(default_factory=time.time)  # s since 1970
    start: float = field(default_factory=time.monotonic)

    def add(self, messages: list[str], message: str) -> None:
        if len(messages) < MOST_MESSAGES:
            messages.append(with_options(message))
        else:
            self.left_out += 1

    def fail(self, message: str, code: int) -> None:
        """Record the error that ended the command, and write it to the log."""
        if self.log is not None:
            self.log.heard("error", message)
        self.error = {"kind": ERROR_KINDS.get(code, "failure"), "message": with_options(message)}

    def show(self, result: Result | None, code: int) -> None:
        """Print the document as JSON, with the record of the command under "run".

        The record contains the SHA-256 of all inputs and outputs. It lists no files if the command was interrupted or has no
        result.
        """
        seconds, console = time.monotonic() - self.start, Recorded(self.console, self)
        is_whole = result is not None and (result.fault is None or isinstance(result.fault, L3Error))
        files = result.files if result is not None and is_whole else FilesUsed()  # digests would delay Ctrl-C
        inputs = {role: [_file(path, at, console) for path, at in read.items()] for role, read in files.read.items()}
        outputs = [_file(path, dated(path), console) for path in dict.fromkeys(map(Path.absolute, files.written))]
        document = finite(result.document if result else {}, console)
        run = {
            "format": RUN_FORMAT,
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
            "outputs": outputs,
        }
        show_json({**document, "run": run})


def _file(path: Path, at: Dated | None, console: Console) -> dict[str, Any]:
    """Return path, size and SHA-256 of a file.

    The size and the digest are None if the path is not a regular file, or if the file has changed since `at`. A change is
    also reported as a warning.
    """
    size, digest = None, None
    try:
        require_regular(path)
        if dated(path) != at:
            console.warn(f"{path} changed during the run, so the JSON does not contain its digest")
        else:
            size, digest = at[0] if at else None, sha256(path)
    except InputFileError:
        pass  # the path is a folder or a stream, or the file was removed
    return {"path": str(path), "bytes": size, "sha256": digest}


def begin(arguments: list[str]) -> Record:
    """Return the record of a call. It is created before click parses the arguments, because parsing may fail."""
    before = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return Record(next(iter(arguments), ""), as_json=JSON in before)


class Recorded(Passing):
    """A console that passes all messages to another console and adds them to the record."""

    def __init__(self, console: Console, record: Record) -> None:
        super().__init__(console)
        self._record = record

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Show progress on the inner console and record the duration. The durations of steps with the same name are
        added.
        """
        start = time.monotonic()
        done, before = self._record.steps.get(what, (0, 0.0))
        for item in self._console.progress(items, total, what):
            yield item
            done += 1
            self._record.steps[what] = (done, before + time.monotonic() - start)

    def heard(self, level: str, message: str) -> None:
        self._record.add(self._record.messages if level == "info" else self._record.warnings, message)
