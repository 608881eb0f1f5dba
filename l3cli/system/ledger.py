"""Files that a command reads and makes, for its report. Nothing is noted unless a ledger is open.

Like locks and protected inputs it belongs to the process: several threads put pictures in place. What worker processes
write has to be noted by the process that started them.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

Dated = tuple[int, int]  # size in bytes, time of the last change in ns


@dataclass
class Ledger:
    """Inputs by role, each as it was when it was named, and outputs in the order in which they got their names."""

    inputs: dict[str, dict[Path, Dated | None]] = field(default_factory=dict)
    outputs: dict[Path, None] = field(default_factory=dict)
    places: dict[Path, None] = field(default_factory=dict)  # files and folders that the command is to make


_open: Ledger | None = None


def open_ledger() -> Ledger:
    """Note everything from now on in a new ledger, and in no other; return it."""
    global _open
    _open = Ledger()
    return _open


def close_ledger() -> None:
    """Note nothing from now on."""
    global _open
    _open = None


def is_noting() -> bool:
    """Return whether a ledger is open."""
    return _open is not None


def note_inputs(roles: Mapping[str, Iterable[Path]]) -> None:
    """Note files that are read, by what they are to the command."""
    if _open is not None:
        for role, paths in roles.items():
            _open.inputs.setdefault(role, {}).update({path: dated(path) for path in paths})


def note_places(paths: Iterable[Path]) -> None:
    """Note the outputs: files, patterns of files, folders. Other files that are written are none of the command's
    outputs."""
    if _open is not None:
        _open.places.update(dict.fromkeys(path.absolute() for path in paths))


def note_output(path: Path) -> None:
    """Note a file that has got its name."""
    if _open is not None:
        _open.outputs[path.absolute()] = None


def outputs_of(ledger: Ledger) -> list[Path]:
    """Return the files made that exist, where the command was to make something."""
    folders = {place.parent for place in ledger.places} | set(ledger.places)
    return [path for path in ledger.outputs if not folders.isdisjoint(path.parents) and path.is_file()]


def dated(path: Path) -> Dated | None:
    """Return size and time of a file, which distinguish its contents; None if it does not exist."""
    try:
        state = os.stat(path)
    except OSError:
        return None
    return state.st_size, state.st_mtime_ns


def fingerprint(path: Path) -> tuple[int, ...]:
    """Return what tells one content of a file from another, from run to run: size, time of its last change, that of its
    inode's (which nobody can set back: a copy that keeps size and time has another), and the inode's number. Raise OSError
    if nothing is there."""
    state = path.stat()
    return state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino
