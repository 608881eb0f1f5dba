"""A dry run: what a stage would read and make, known once every refusal that comes before work has been passed. Nothing is
written, not even a lock; what a stage checks only while it works is not known.
"""

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from l3cli.errors import listed
from l3cli.locks import without_writing

_DRY: ContextVar[bool] = ContextVar("dry run", default=False)
SHOWN = 3  # files of a role that are named


@dataclass(frozen=True)
class Made:
    """An output: a file, or a folder with `count` files."""

    path: Path
    what: str
    size: int | None = None  # bytes, where they are known


class Planned(Exception):
    """A dry run has come to the work that it leaves out; `lines` say what would be read and made."""

    def __init__(self, lines: tuple[str, ...]) -> None:
        super().__init__("dry run")
        self.lines = lines


@contextlib.contextmanager
def dry_run() -> Iterator[None]:
    """Within the block stages end where their work would begin, by Planned."""
    token = _DRY.set(True)
    try:
        with without_writing():
            yield
    finally:
        _DRY.reset(token)


def is_dry() -> bool:
    """Whether this is a dry run."""
    return _DRY.get()


def before_work(reads: Mapping[str, Iterable[Path]], *makes: Made) -> None:
    """In a dry run Planned: the files that are read, by their role, and what is made of them. Else nothing."""
    if is_dry():
        lines = [_read(role, list(dict.fromkeys(paths))) for role, paths in reads.items()]
        raise Planned((*filter(None, lines), *map(_made, makes), "dry run: nothing has been written"))


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
