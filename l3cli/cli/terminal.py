"""The only place that prints. Names and texts may come from untrusted files: none of them can move the cursor, hide other
text or add a line."""

import contextlib
import json
import math
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import IO, TYPE_CHECKING, Any, TypeVar

import click

from l3cli.system.console import Silent
from l3cli.system.text import columns, printable

if TYPE_CHECKING:
    from l3cli.system.console import Console

T = TypeVar("T")
SIZE = re.compile("0*[1-9][0-9]{0,5}")  # of a terminal, in COLUMNS or LINES
PARAMETER = re.compile("‹([a-z_]+)›")  # as messages from below the command line mark it


def show(*lines: str) -> None:
    """Print lines of a result on stdout."""
    click.echo("\n".join(map(printable, lines)))


def show_table(title: Sequence[str], headings: Sequence[str], rows: Sequence[Sequence[str]], *notes: str) -> None:
    """Print a table on stdout, as wide as that is, between the lines of its title and notes."""
    show(*title, *columns(headings, rows, width()), *notes)


def show_json(document: Any) -> None:
    """Print a document as JSON on stdout: in ASCII, so that it works in every encoding and with every file name."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


def finite(document: Any, console: "Console") -> Any:
    """Return a document for JSON, which has no NaN: a figure that cannot be computed is null, and named on the console."""
    missing: list[str] = []
    known = _finite(document, "", missing)
    if missing:
        named = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        console.warn(f"{named}: cannot be computed; null in the JSON")
    return known


def _finite(value: Any, name: str, missing: list[str]) -> Any:
    """Return `value` with null for NaN and infinity; their names are added to `missing`."""
    if isinstance(value, dict):
        return {key: _finite(each, f"{name}.{key}".lstrip("."), missing) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each, f"{name}.{index}".lstrip("."), missing) for index, each in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        missing.append(name)
        return None
    return value


def with_options(message: str) -> str:
    """Return a message that may come from below the command line, with an option for each parameter (‹skip_bad›)."""
    return PARAMETER.sub(lambda match: f"--{match[1].replace('_', '-')}", message)


def to_stderr(message: str) -> None:
    """Print one message on stderr. If it cannot be written, on a full disk or to a closed pipe, the work continues."""
    try:
        click.echo(printable(with_options(message)), err=True)
    except OSError:
        drop(sys.stderr)


def prepare() -> None:
    """Make "?" of characters that stdout or stderr cannot encode; ignore a COLUMNS or LINES that is no number."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    for name in ("COLUMNS", "LINES"):
        if not SIZE.fullmatch(os.environ.get(name, "")):
            os.environ.pop(name, None)


def drop(stream: IO[str]) -> None:
    """Send what is left for a stream nowhere, if it cannot be written: Python must not try to at exit."""
    try:
        stream.flush()
    except OSError:
        with contextlib.closing(open(os.devnull, "wb")) as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())


SELDOM, OFTEN = 600.0, 10.0  # seconds after which a log hears of the progress at the latest, and before which it does not


def width() -> int | None:
    """Return characters in a line of stdout, by its terminal or the environment variable COLUMNS; None: any number."""
    import shutil

    if not sys.stdout.isatty() and "COLUMNS" not in os.environ:
        return None
    return max(shutil.get_terminal_size().columns, 40)


def folded(line: str, deeper: int) -> list[str]:
    """Return a line of stdout as several, `deeper` characters further in from the second, where the terminal is narrower."""
    import textwrap

    wide = width()
    return textwrap.wrap(line, wide, subsequent_indent=" " * deeper, break_on_hyphens=False) if wide else [line]


# ------------------------------------------------------------------------------------------------------ consoles


class Terminal:
    """The console of a command: everything on stderr."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Show a bar on a terminal, elsewhere plain lines, one every tenth; with share, time passed, rate, time left."""
        interactive = sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"
        return (_with_bar if interactive else _with_lines)(items, total, what)

    def info(self, message: str) -> None:
        to_stderr(message)

    def warn(self, message: str) -> None:
        to_stderr(f"warning: {message}")

    def report(self, message: str) -> None:
        to_stderr(message)


class ErrorsOnly(Silent):
    """The console of a command with --quiet: on stderr what is left out, and nothing else."""

    def report(self, message: str) -> None:
        to_stderr(message)


def _with_bar(items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
    from rich import console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    pace = TextColumn("{task.fields[pace]}")
    columns = (TextColumn(what), BarColumn(bar_width=12), MofNCompleteColumn(), pace, TimeElapsedColumn())
    with Progress(*columns, console=console.Console(stderr=True), transient=True) as bar:
        task, start = bar.add_task(what, total=total, pace="0 %" if total else ""), time.monotonic()
        for done, item in enumerate(items, 1):
            yield item
            bar.update(task, advance=1, pace=_pace(done, total, time.monotonic() - start))


def _with_lines(items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
    start = last = time.monotonic()
    tenth = 0
    for done, item in enumerate(items, 1):
        yield item
        now = time.monotonic()
        reached = 10 * done // total if total else 0
        if done != total and ((reached > tenth and now - last >= OFTEN) or now - last >= SELDOM):
            of = f" of {total}" if total else ""
            to_stderr(f"{what}: {done}{of}, {_span(now - start)} passed, {_pace(done, total, now - start)}")
            last, tenth = now, reached


def _pace(done: int, total: int | None, seconds: float) -> str:
    """Return the share that is done, rate and time left."""
    each = max(seconds, 1e-9) / done
    rate = f"{1 / each:.3g} a second" if each < 2 else f"{_span(each)} each"
    return f"{100 * done // total} %, {rate}, {_span(max(total - done, 0) * each)} left" if total else rate


def _span(seconds: float) -> str:
    """Return a length of time in its two largest units."""
    seconds = round(seconds)
    for unit, name, part, smaller in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if seconds >= unit:
            return f"{seconds // unit} {name} {seconds % unit // part} {smaller}"
    return f"{seconds} s"
