"""Functions that installed packages offer by entry points (docs/python.md#a-baseline)."""

import contextlib
import re
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points

from l3cli.errors import L3Error

BASELINES, NOISE = "l3cli.baselines", "l3cli.noise"  # groups
NAME = re.compile(r"[\w.-]+")  # one that can be part of the name of a file


def plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, in order; of several of one name that whose package Python finds first.
    L3Error if a name is no name of a file."""
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=group):
        if not NAME.fullmatch(entry.name):
            raise L3Error(
                f'{described(entry)} has a name of other characters than letters, digits, "_", "." and "-"; rename it'
            )
        found.setdefault(entry.name, entry)
    return {name: found[name] for name in sorted(found)}


def package(entry: EntryPoint) -> str:
    """Return name and version of the package that offers an entry point."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value


def described(entry: EntryPoint) -> str:
    """Return an entry point as messages name it."""
    return f'entry point "{entry.name}" ({entry.group}) of {package(entry)}'


@contextlib.contextmanager
def blamed(entry: EntryPoint) -> Iterator[None]:
    """Raise an error of the code of an entry point as an L3Error that names it."""
    try:
        yield
    except Exception as error:
        what = " ".join(str(error).split())
        raise L3Error(f"{described(entry)} fails with {type(error).__name__}: {what}; correct or uninstall it") from error
