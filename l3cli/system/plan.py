"""A dry run: what a stage would read and make, known once every refusal that comes before work has been passed. Nothing is
written, not even a lock; what a stage checks only while it works is not known.
"""

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from l3cli.errors import listed
from l3cli.system.files import note_inputs, note_places
from l3cli.system.locks import without_writing

_DRY: ContextVar[bool] = ContextVar("dry run", default=False)
SHOWN = 3  # files of a role that are named


@dataclass(frozen=True)
class Made:
    """An output: a file, or a folder with `count` files."""

    path: Path
    what: str
    size: int | None = None  # bytes, where they are known


class Planned(Exception):
    """End of a dry run, at the work that it leaves out."""

    def __init__(self, reads: Mapping[str, Iterable[Path]], makes: Iterable[Made]) -> None:
        super().__init__("dry run")
        self.reads, self.makes = {role: list(dict.fromkeys(paths)) for role, paths in reads.items()}, list(makes)

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the files that would be read and made, in words."""
        read = filter(None, (_read(role, paths) for role, paths in self.reads.items()))
        return (*read, *map(_made, self.makes), "dry run: nothing has been written")

    def document(self) -> dict[str, Any]:
        """Return the same, ready for JSON."""
        reads = {role: [str(path) for path in paths] for role, paths in self.reads.items()}
        makes = [{"path": str(made.path), "what": made.what, "bytes": made.size} for made in self.makes]
        return {"dry_run": {"reads": reads, "makes": makes}}


@contextlib.contextmanager
def dry_run() -> Iterator[None]:
    """End stages, within the block, by Planned where their work would begin."""
    token = _DRY.set(True)
    try:
        with without_writing():
            yield
    finally:
        _DRY.reset(token)


def is_dry() -> bool:
    """Return whether this is a dry run."""
    return _DRY.get()


def before_work(reads: Mapping[str, Iterable[Path]], *makes: Made) -> None:
    """Note the files that are read, by their role, and what is made of them; in a dry run raise Planned."""
    if is_dry():
        raise Planned(reads, makes)
    note_inputs(reads)
    note_places(made.path for made in makes)


def _read(role: str, paths: list[Path]) -> str:
    if not paths:
        return ""
    names = [f"{path}" for path in paths[:SHOWN]]
    named = listed(names) + (f" and {len(paths) - SHOWN} more" if len(paths) > SHOWN else "")
    size = sum(path.stat().st_size for path in paths if path.is_file())
    total = f", {size} bytes" if size else ""
    return f"reads {role}: {f'{len(paths)} files{total}, ' if len(paths) > 1 else ''}{named}{total * (len(paths) == 1)}"


def _made(made: Made) -> str:
    size = "" if made.size is None else f", {made.size} bytes"
    replaced = ", replacing the one that is there" if made.path.is_file() else ""
    return f"makes {made.path}: {made.what}{size}{replaced}"
