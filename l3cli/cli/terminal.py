"""The one place that prints. Names and texts may come from anybody's file: nothing of them moves a cursor, hides what
stands beside it or makes a line of its own."""

import contextlib
import json
import math
import os
import sys
from typing import IO, Any

import click

from l3cli.columns import printable


def show(*lines: str) -> None:
    """Lines of a result on stdout."""
    click.echo("\n".join(map(printable, lines)))


def show_json(document: Any, quiet: bool = False) -> None:
    """A result as JSON on stdout: in ASCII, so that every encoding and every file name has its place there. JSON has no NaN:
    a figure that cannot be computed is null, and named on stderr unless `quiet`."""
    missing: list[str] = []
    click.echo(json.dumps(_finite(document, "", missing), indent=2, allow_nan=False))
    if missing and not quiet:
        named = ", ".join(missing[:4]) + (f" and {len(missing) - 4} more" if len(missing) > 4 else "")
        tell(f"warning: {named}: cannot be computed; null in the JSON")


def _finite(value: Any, name: str, missing: list[str]) -> Any:
    """`value` with null for numbers that are none; their names are added to `missing`."""
    if isinstance(value, dict):
        return {key: _finite(each, f"{name}.{key}".lstrip("."), missing) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each, f"{name}.{index}".lstrip("."), missing) for index, each in enumerate(value)]
    if isinstance(value, float) and not math.isfinite(value):
        missing.append(name)
        return None
    return value


def tell(message: str) -> None:
    """One line of talk on stderr. Where it cannot be said, on a full disk or to a reader who has gone, the work goes on."""
    try:
        click.echo(printable(message), err=True)
    except OSError:
        drop(sys.stderr)


def prepare() -> None:
    """What the encoding of stdout or stderr does not have becomes "?"; a size that is no number counts as none."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    for name in ("COLUMNS", "LINES"):
        size = os.environ.get(name, "")
        if not (size.isascii() and size.isdecimal() and int(size)):
            os.environ.pop(name, None)


def drop(stream: IO[str]) -> None:
    """Send what is left for a stream nowhere, if it cannot be written: Python must not try to at exit."""
    try:
        stream.flush()
    except OSError:
        with contextlib.closing(open(os.devnull, "wb")) as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())
