"""Errors, and the exit code of each type of failure (docs/guarantees.md#exit-codes).

Messages contain names of parameters as ‹force›. The command line replaces them by the names of options, such as --force.
"""

import contextlib
from collections.abc import Iterable, Iterator
from itertools import accumulate


class L3Error(Exception):
    """Failure of a command. The message is one line that states the cause and a remedy."""

    exit_code = 1


class RecipeError(L3Error):
    """A recipe or an option requests something impossible."""

    exit_code = 2


class InputFileError(L3Error):
    """An input file is missing, damaged, of the wrong kind, or does not agree with the other inputs."""

    exit_code = 3


class DeviceError(L3Error):
    """No OpenCL device can be used."""

    exit_code = 4


@contextlib.contextmanager
def raised_as(kind: type[L3Error], name: object, of: type[Exception] = ValueError, cure: str = "") -> Iterator[None]:
    """Convert exceptions of the type `of` in the block to errors of another type, whose message begins with `name`."""
    try:
        yield
    except of as error:
        raise kind(f"{name}: {error}{cure}") from error


MAX_CHARACTERS = 240  # approximate largest length of a list of names in a message
MOST_SHOWN = 40  # largest number of characters of a user's text in a message


def shortened(text: str) -> str:
    """Return the beginning of a user's text if it is too long for a message."""
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"


def listed(lines: Iterable[str]) -> str:
    """Join names for a message. If there are too many, the rest is replaced by its number."""
    lines = list(lines)
    shown = [
        line for line, length in zip(lines, accumulate(map(len, lines)), strict=True) if length < 2 * MAX_CHARACTERS
    ] or lines[:1]
    return ", ".join(shown) + (f" and {len(lines) - len(shown)} more" if len(shown) < len(lines) else "")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a question that suggests the known names most similar to `name`, or an empty string if no name is similar."""
    import difflib  # imported here, because it is needed only after an error

    spelled = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), spelled, n=3)
    return "did you mean " + " or ".join(f'"{spelled[match]}"' for match in close) + "?" if close else ""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown name.

    It is a question with the most similar known names or, if no name is similar, a list of all known names.
    """
    known = list(known)
    if close := nearest(name, known):
        return close
    named = ", ".join(known)
    return (
        f"use one of {named}"
        if len(named) <= MAX_CHARACTERS
        else f"use one of {named[:MAX_CHARACTERS].rpartition(',')[0]} …"
    )
