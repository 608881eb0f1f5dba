"""The result of a command, and the record of the run that --json adds to it."""

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
ERROR_KINDS = {2: "call", 3: "input", 4: "device", 130: "interrupted", 143: "terminated"}  # exit code → error type
MOST_MESSAGES = 1000  # maximum number of recorded messages, and of recorded warnings, because a long sequence can cause many
JSON = "--json"


@dataclass(frozen=True)
class Result:
    """Result of a command."""

    document: Mapping[str, Any] = field(default_factory=dict)  # the result as JSON types
    text: Callable[[], object] | None = None  # prints the result as text; None if there is nothing to print
    fault: BaseException | None = None  # error to raise after the result has been printed
    code: int = 0  # exit code if there is no fault
    files: FilesUsed = field(default_factory=FilesUsed)  # files that the command has read and written


@dataclass
class Record:
    """Record of a run: the messages, times and error that --json prints, and the log for --log.

    Click passes the record to commands as the attribute `obj` of its contexts.
    """

    command: str = ""
    as_json: bool = False  # whether --json is set
    log: Logged | None = None  # console that writes the log, if --log is set
    warnings: list[str] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    left_out: int = 0  # number of warnings and messages that were not recorded
    steps: dict[str, tuple[int, float]] = field(default_factory=dict)  # step → number of items, duration in s
    error: dict[str, str] | None = None  # type and message of the error that ended the command
    console: Console = field(default_factory=Terminal)  # console that displays the command's messages
    begun: float = field(default_factory=time.time)  # start time in s since 1970
    start: float = field(default_factory=time.monotonic)  # start time in s on a monotonic clock, for the duration

    def add(self, messages: list[str], message: str) -> None:
        if len(messages) < MOST_MESSAGES:
            messages.append(with_options(message))
        else:
            self.left_out += 1

    def fail(self, message: str, code: int) -> None:
        """Record the error that ended the command, and write it to the log. `code` is the exit code."""
        if self.log is not None:
            self.log.heard("error", message)
        self.error = {"kind": ERROR_KINDS.get(code, "failure"), "message": with_options(message)}

    def show(self, result: Result | None, code: int) -> None:
        """Print the result as JSON, with the record of the run under the key "run".

        The record contains the SHA-256 digests of all inputs and outputs, unless the command was interrupted or has no
        result.
        """
        seconds, console = time.monotonic() - self.start, Recorded(self.console, self)
        is_whole = result is not None and (result.fault is None or isinstance(result.fault, L3Error))
        # Computing the digests after an interruption would delay the exit.
        files = result.files if result is not None and is_whole else FilesUsed()
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
    """Return the path, the size in bytes and the SHA-256 digest of a file.

    Size and digest are None if the path is not a regular file. They are also None, with a warning, if the file has changed
    since `at`.
    """
    size, digest = None, None
    try:
        require_regular(path)
        if dated(path) != at:
            console.warn(f"{path} changed while l3 was running, so the JSON does not contain its digest")
        else:
            size, digest = at[0] if at else None, sha256(path)
    except InputFileError:
        pass  # the path is a folder or a stream, or the file has been removed
    return {"path": str(path), "bytes": size, "sha256": digest}


def begin(arguments: list[str]) -> Record:
    """Create the record of a run before click parses the arguments, so that it also covers parsing errors."""
    before = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return Record(next(iter(arguments), ""), as_json=JSON in before)


class Recorded(Passing):
    """A console that forwards all messages, and adds them to the record."""

    def __init__(self, console: Console, record: Record) -> None:
        super().__init__(console)
        self._record = record

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Forward progress to the other console, and record the number of items and the duration.

        Items and durations of steps with the same name are added up.
        """
        start = time.monotonic()
        done, before = self._record.steps.get(what, (0, 0.0))
        for item in self._console.progress(items, total, what):
            yield item
            done += 1
            self._record.steps[what] = (done, before + time.monotonic() - start)

    def heard(self, level: str, message: str) -> None:
        self._record.add(self._record.messages if level == "info" else self._record.warnings, message)
