"""Errors that l3 raises, their exit codes (docs/guarantees.md#exit-codes), and functions that format error messages.

Messages contain parameter names in angle quotes, such as ‹force›. The command line replaces each parameter name by the name
of the option, such as --force.
"""

import contextlib
from collections.abc import Iterable, Iterator
from itertools import accumulate


class L3Error(Exception):
    """Base class of all errors of l3. The message is one line that states the cause and a remedy."""

    exit_code = 1


class RecipeError(L3Error):
    """A recipe, an option or an argument is invalid."""

    exit_code = 2


class InputFileError(L3Error):
    """An input file is missing, damaged or of the wrong type, or does not fit the other inputs."""

    exit_code = 3


class DeviceError(L3Error):
    """No OpenCL device can be used."""

    exit_code = 4


@contextlib.contextmanager
def raised_as(kind: type[L3Error], name: object, of: type[Exception] = ValueError, cure: str = "") -> Iterator[None]:
    """Context manager that converts exceptions to errors of l3.

    Parameters
    ----------
    kind : type
        Type of the error to raise.
    name : object
        Beginning of the new message, such as the name of a file. The message of the exception follows.
    of : type
        Type of the exceptions that are converted.
    cure : str
        End of the new message, such as "; create the file again".
    """
    try:
        yield
    except of as error:
        raise kind(f"{name}: {error}{cure}") from error


MAX_CHARACTERS = 240  # approximate maximum length of a list of names in a message
MOST_SHOWN = 40  # maximum length of a user's text in a message; longer texts are truncated


def shortened(text: str) -> str:
    """Truncate a user's text for a message to MOST_SHOWN characters, and mark the omission with "…"."""
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"


def listed(lines: Iterable[str]) -> str:
    """Join names with commas for a message. If the list is too long, the last names are replaced by "and N more"."""
    lines = list(lines)
    shown = [
        line for line, length in zip(lines, accumulate(map(len, lines)), strict=True) if length < 2 * MAX_CHARACTERS
    ] or lines[:1]
    return ", ".join(shown) + (f" and {len(lines) - len(shown)} more" if len(shown) < len(lines) else "")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a question such as 'did you mean "bayer"?' that contains the known names most similar to `name`.

    If no known name is similar, the result is an empty string.
    """
    import difflib  # imported here, because it is needed only after an error

    spelled = {each.lower(): each for each in known}
    close = difflib.get_close_matches(name.lower(), spelled, n=3)
    return "did you mean " + " or ".join(f'"{spelled[match]}"' for match in close) + "?" if close else ""


def suggestion(name: str, known: Iterable[str]) -> str:
    """Return advice for an error message about an unknown name, such as 'did you mean "width"?' or "use one of a, b, c".

    The advice is a question if a known name is similar (see `nearest`).
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
