"""Outputs of a stage before its work: what it reads is not replaced, what it writes is refused if it cannot be written and
kept from other runs until the stage ends; in a dry run, what it would read and make, of which nothing is written, not even a
lock."""

import contextlib
import itertools
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from l3cli.errors import L3Error, RecipeError, listed
from l3cli.system.console import Console
from l3cli.system.files import note_inputs, note_places, protecting, refuse_existing, refuse_filled_folder, refuse_protected
from l3cli.system.locks import sole_writer_of_file, sole_writer_of_folder, without_writing


class OutputGuard(contextlib.ExitStack):
    """Inputs that are protected and outputs that are locked until the block ends."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        self._guarded: list[tuple[Path, tuple[str, ...]]] = []  # outputs, and folders with globs of what is written there

    def protect(self, *inputs: Path) -> None:
        """Name the files that are read, as soon as they are known: until the end nothing takes the place of one of them,
        by whatever name, even if outputs may be replaced. RecipeError if an output that is guarded already would."""
        self.enter_context(protecting(inputs))
        for path, globs in self._guarded:
            _refuse_protected(path, globs)

    def guard_file(self, path: Path, force: bool, recipe: bool = False) -> None:
        """Call `hold_file`, and refuse an output that is there already."""
        self.hold_file(path, recipe)  # first: the run that holds it may be about to end
        refuse_existing(path, force)

    def hold_file(self, path: Path, recipe: bool = False) -> None:
        """Refuse before any work an output that is read, is no file, would pass for a `recipe` but is none, or cannot be
        written; keep other runs off it until the end."""
        if path.suffix == ".toml" and not recipe:
            raise RecipeError(f"{path}: .toml is for recipes; name an output that ends otherwise")
        self._remember(path)
        refuse_existing(path, force=True)  # a folder or device
        refuse_unwritable(path)
        self.hold(sole_writer_of_file(path), path)

    def guard_folder(self, path: Path, force: bool, *globs: str) -> None:
        """Call `hold_folder`, and refuse a folder that holds something."""
        self.hold_folder(path, *globs)
        refuse_filled_folder(path, force)

    def hold_folder(self, path: Path, *globs: str) -> None:
        """Refuse, before any work, a folder that is a file or cannot be written into, or where what is read is among the
        files that will be written, which the globs match; keep other runs off it until the end."""
        refuse_filled_folder(path, force=True)  # a file
        refuse_unwritable(path)
        self._remember(path, *globs)
        self.hold(sole_writer_of_folder(path), path)

    def hold(self, lock: AbstractContextManager[bool], output: Path) -> None:
        """Keep a lock on an output until the end."""
        if not self.enter_context(lock):
            self._console.report(f"warning: {output} lies on storage without file locks: see that no other run writes it")

    def _remember(self, path: Path, *globs: str) -> None:
        """Refuse outputs in place of what is read, as far as that is known, or of another, and remember them for what will
        be."""
        _refuse_protected(path, globs)
        if any(path.resolve() == other.resolve() for other, _ in self._guarded):
            raise RecipeError(f"{path} is named for two outputs; name two files")
        self._guarded.append((path, globs))


def _refuse_protected(path: Path, globs: tuple[str, ...]) -> None:
    for file in itertools.chain([path], *(path.glob(each) for each in globs)):
        refuse_protected(file)


def refuse_unwritable(path: Path) -> None:
    """Raise L3Error if `path` lies where nothing can be written."""
    whole = path.absolute()
    folder = whole if whole.is_dir() else next(parent for parent in whole.parents if parent.exists())
    if not folder.is_dir():
        raise L3Error(f"{folder} is a file, not a folder; name another output than {path}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise L3Error(f"{folder} cannot be written to; name an output in a folder of your own")


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
