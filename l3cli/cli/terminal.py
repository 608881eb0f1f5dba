"""Print results, messages and progress to stdout and stderr.

Control characters are replaced, so that names and texts from untrusted files cannot move the cursor, hide text or add lines.
"""

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
SIZE = re.compile("0*[1-9][0-9]{0,5}")  # valid values of the environment variables COLUMNS and LINES
PARAMETER = re.compile("‹([a-z_]+)›")  # how messages quote the name of a parameter


def show(*lines: str) -> None:
    """Print lines of a result to stdout."""
    click.echo("\n".join(map(printable, lines)))


def show_table(title: Sequence[str], headings: Sequence[str], rows: Sequence[Sequence[str]], *notes: str) -> None:
    """Print a title, a table and notes to stdout. The table is fitted to the width of the terminal."""
    show(*title, *columns(headings, rows, width()), *notes)


def show_json(document: Any) -> None:
    """Print a document as JSON to stdout, in ASCII, so that every stdout encoding can represent it."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


def finite(document: Any, console: "Console") -> Any:
    """Replace NaN and infinity by None, because JSON supports neither, and list the replaced values in a warning."""
    missing: list[str] = []
    known = _finite(document, "", missing)
    if missing:
        named = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        console.warn(f"some values cannot be computed and are null in the JSON: {named}")
    return known


def _finite(value: Any, name: str, missing: list[str]) -> Any:
    """Replace NaN and infinity in `value` by None, and append the names of the replaced values to `missing`."""
    if isinstance(value, dict):
        return {key: _finite(each, f"{name}.{key}".lstrip("."), missing) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each, f"{name}.{index}".lstrip("."), missing) for index, each in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        missing.append(name)
        return None
    return value


def with_options(message: str) -> str:
    """Replace parameters such as ‹skip_bad› in a message by options such as --skip-bad."""
    return PARAMETER.sub(lambda match: f"--{match[1].replace('_', '-')}", message)


def to_stderr(message: str) -> None:
    """Print a message to stderr. If this fails, discard the message and continue."""
    try:
        click.echo(printable(with_options(message)), err=True)
    except OSError:
        drop(sys.stderr)


def prepare() -> None:
    """Make stdout and stderr print "?" for characters that they cannot encode, and unset invalid COLUMNS and LINES."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    for name in ("COLUMNS", "LINES"):
        if not SIZE.fullmatch(os.environ.get(name, "")):
            os.environ.pop(name, None)


def drop(stream: IO[str]) -> None:
    """Redirect a broken stream to the null device, so that Python can flush it at exit without an error."""
    try:
        stream.flush()
    except OSError:
        with contextlib.closing(open(os.devnull, "wb")) as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())


LONGEST_SILENCE, SHORTEST_SILENCE = 600.0, 10.0  # maximum and minimum time in s between progress lines in a pipe or file


def width() -> int | None:
    """Return the width of stdout in characters, from the terminal or from COLUMNS, but at least 40.

    Returns None if stdout is a pipe or a file and COLUMNS is not set.
    """
    import shutil

    if not sys.stdout.isatty() and "COLUMNS" not in os.environ:
        return None
    return max(shutil.get_terminal_size().columns, 40)


def folded(line: str, deeper: int) -> list[str]:
    """Wrap a line to the width of the terminal. Continuation lines are indented by `deeper` characters."""
    import textwrap

    wide = width()
    return textwrap.wrap(line, wide, subsequent_indent=" " * deeper, break_on_hyphens=False) if wide else [line]


# ------------------------------------------------------------------------------------------------------ consoles


class Terminal:
    """Console of a command. All messages go to stderr."""

    def progress(self, items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
        """Iterate over `items`, and display progress on stderr.

        A terminal shows a progress bar. Otherwise, a line is printed after each tenth of the work, but at most once per
        SHORTEST_SILENCE and at least once per LONGEST_SILENCE.
        """
        interactive = sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"
        return (_with_bar if interactive else _with_lines)(items, total, what)

    def info(self, message: str) -> None:
        to_stderr(message)

    def warn(self, message: str) -> None:
        to_stderr(f"warning: {message}")

    def report(self, message: str) -> None:
        to_stderr(message)


class ErrorsOnly(Silent):
    """Console of a command with --quiet, which prints only reports, for example of skipped frames."""

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
        if done != total and ((reached > tenth and now - last >= SHORTEST_SILENCE) or now - last >= LONGEST_SILENCE):
            of = f" of {total}" if total else ""
            to_stderr(f"{what}: {done}{of}, {_span(now - start)} elapsed, {_pace(done, total, now - start)}")
            last, tenth = now, reached


def _pace(done: int, total: int | None, seconds: float) -> str:
    """Describe how much of the work is done, the rate and the remaining time. If `total` is None, describe only the rate."""
    each = max(seconds, 1e-9) / done
    rate = f"{1 / each:.3g} per second" if each < 2 else f"{_span(each)} each"
    return f"{100 * done // total} %, {rate}, {_span(max(total - done, 0) * each)} left" if total else rate


def _span(seconds: float) -> str:
    """Format a duration in its two largest units, such as "2 h 5 min"."""
    seconds = round(seconds)
    for unit, name, part, smaller in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if seconds >= unit:
            return f"{seconds // unit} {name} {seconds % unit // part} {smaller}"
    return f"{seconds} s"
