"""Errors, and the exit code of each kind of failure (docs/guarantees.md#exit-codes).

A message that names a parameter marks it ‹force›, by its name in Python; the command line writes its option there, --force.
"""

import contextlib
from collections.abc import Iterable, Iterator
from itertools import accumulate


class L3Error(Exception):
    """Failure of a command. The message is one line that names the culprit and the cure."""

    exit_code = 1


class RecipeError(L3Error):
    """A recipe or an option that asks for something that cannot be."""

    exit_code = 2


class InputFileError(L3Error):
    """An input file that is missing, broken, of the wrong kind, or does not fit the others."""

    exit_code = 3


class DeviceError(L3Error):
    """No usable OpenCL device."""

    exit_code = 4


@contextlib.contextmanager
def raised_as(kind: type[L3Error], name: object, of: type[Exception] = ValueError, cure: str = "") -> Iterator[None]:
    """Raise an error `of` the block as one of a kind that calls the culprit by its name."""
    try:
        yield
    except of as error:
        raise kind(f"{name}: {error}{cure}") from error


MAX_CHARACTERS = 240  # characters of a list of names
MOST_SHOWN = 40  # characters of what somebody wrote


def shortened(text: str) -> str:
    """Return a user's text for a message: its beginning, where it is long."""
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"


def listed(lines: Iterable[str]) -> str:
    """Return several names, as many as can be read, and how many more there are."""
    lines = list(lines)
    shown = [
        line for line, length in zip(lines, accumulate(map(len, lines)), strict=True) if length < 2 * MAX_CHARACTERS
    ] or lines[:1]
    return ", ".join(shown) + (f" and {len(lines) - len(shown)} more" if len(shown) < len(lines) else "")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a question whether one of the `known` names near this one was meant; empty where none is near."""
    import difflib  # only where something went wrong

    spelled = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), spelled, n=3)
    return "did you mean " + " or ".join(f'"{spelled[match]}"' for match in close) + "?" if close else ""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return the cure for a name that is none of `known`: those that may have been meant or, where none is near, all."""
    known = list(known)
    if close := nearest(name, known):
        return close
    named = ", ".join(known)
    return (
        f"there are {named}" if len(named) <= MAX_CHARACTERS else f"there are {named[:MAX_CHARACTERS].rpartition(',')[0]} …"
    )
