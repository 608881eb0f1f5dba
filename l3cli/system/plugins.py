"""Find and call functions that other installed packages provide as entry points (docs/python.md#a-baseline)."""

import contextlib
import re
from collections.abc import Iterator
from importlib.metadata import EntryPoint, entry_points

from l3cli.errors import L3Error

BASELINES, NOISE = "l3cli.baselines", "l3cli.noise"  # entry-point groups
NAME = re.compile(r"[\w.-]+")  # pattern of entry-point names, which become part of file names


def plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points in a group, sorted by name.

    If several packages use the same name, the first entry point that Python finds is returned. Raises L3Error if a name
    contains characters other than letters, digits, "_", "." and "-".
    """
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=group):
        if not NAME.fullmatch(entry.name):
            raise L3Error(f'{described(entry)} may contain only letters, digits, "_", "." and "-"; rename it')
        found.setdefault(entry.name, entry)
    return {name: found[name] for name in sorted(found)}


def package(entry: EntryPoint) -> str:
    """Return the name and version of the package that provides an entry point, or "MODULE:OBJECT" if unknown."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value


def described(entry: EntryPoint) -> str:
    """Describe an entry point for messages, with its name, group and package."""
    return f'entry point "{entry.name}" ({entry.group}) of {package(entry)}'


@contextlib.contextmanager
def blamed(entry: EntryPoint) -> Iterator[None]:
    """Convert an exception in the block to an L3Error that names the entry point.

    The block calls the entry point, and may also check what it returns.
    """
    try:
        yield
    except Exception as error:
        what = " ".join(str(error).split())
        raise L3Error(f"{described(entry)} fails with {type(error).__name__}: {what}; correct or uninstall it") from error
