"""Checks of a stage's outputs before its work.

Inputs are never replaced. Outputs that cannot be written are refused, and other runs are kept off them until the stage ends.
A dry run lists what would be read and written, and writes nothing, not even locks.
"""

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
    """Context manager that protects inputs and locks outputs until the end of the block."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        self._guarded: list[tuple[Path, tuple[str, ...]]] = []  # outputs; folders with globs of the files written there

    def protect(self, *inputs: Path) -> None:
        """Protect input files until the end: no output may replace them, under any name, even with `force`.

        Raises
        ------
        RecipeError
            If an output that is already guarded would replace one.
        """
        self.enter_context(protecting(inputs))
        for path, globs in self._guarded:
            _refuse_protected(path, globs)

    def guard_file(self, path: Path, force: bool, recipe: bool = False) -> None:
        """Call `hold_file`, and refuse an output that exists unless `force` is set."""
        self.hold_file(path, recipe)  # first, because another run may be about to write it
        refuse_existing(path, force)

    def hold_file(self, path: Path, recipe: bool = False) -> None:
        """Refuse an output that is an input, not a file, not writable, or a .toml that is not a `recipe`. Lock it until the
        end.
        """
        if path.suffix == ".toml" and not recipe:
            raise RecipeError(f"{path}: .toml is for recipes; name an output that ends otherwise")
        self._remember(path)
        refuse_existing(path, force=True)  # a folder or device
        refuse_unwritable(path)
        self.hold(sole_writer_of_file(path), path)

    def guard_folder(self, path: Path, force: bool, *globs: str) -> None:
        """Call `hold_folder`, and refuse a folder that is not empty unless `force` is set."""
        self.hold_folder(path, *globs)
        refuse_filled_folder(path, force)

    def hold_folder(self, path: Path, *globs: str) -> None:
        """Refuse an output folder that is a file, not writable, or whose files that match `globs` are inputs. Lock it until
        the end.
        """
        refuse_filled_folder(path, force=True)  # a file
        refuse_unwritable(path)
        self._remember(path, *globs)
        self.hold(sole_writer_of_folder(path), path)

    def hold(self, lock: AbstractContextManager[bool], output: Path) -> None:
        """Hold a lock on an output until the end."""
        if not self.enter_context(lock):
            self._console.report(
                f"warning: {output} is on storage without file locks; make sure that no other run writes it"
            )

    def _remember(self, path: Path, *globs: str) -> None:
        """Refuse an output that would replace an input or another output, and remember it for inputs named later."""
        _refuse_protected(path, globs)
        if any(path.resolve() == other.resolve() for other, _ in self._guarded):
            raise RecipeError(f"{path} is named for two outputs; name two files")
        self._guarded.append((path, globs))


def _refuse_protected(path: Path, globs: tuple[str, ...]) -> None:
    for file in itertools.chain([path], *(path.glob(each) for each in globs)):
        refuse_protected(file)


def refuse_unwritable(path: Path) -> None:
    """Raise L3Error if `path` is in a place where nothing can be written."""
    whole = path.absolute()
    folder = whole if whole.is_dir() else next(parent for parent in whole.parents if parent.exists())
    if not folder.is_dir():
        raise L3Error(f"{folder} is a file, not a folder; name another output than {path}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise L3Error(f"{folder} cannot be written to; name an output in a folder of your own")


_DRY: ContextVar[bool] = ContextVar("dry run", default=False)
SHOWN = 3  # files that are named for each role


@dataclass(frozen=True)
class Made:
    """An output: a file or folder, and what it will hold."""

    path: Path
    what: str
    size: int | None = None  # bytes, if known


class Planned(Exception):
    """Raised by a dry run where the work would begin, with what would be read and made."""

    def __init__(self, reads: Mapping[str, Iterable[Path]], makes: Iterable[Made]) -> None:
        super().__init__("dry run")
        self.reads, self.makes = {role: list(dict.fromkeys(paths)) for role, paths in reads.items()}, list(makes)

    @property
    def lines(self) -> tuple[str, ...]:
        """Return what would be read and made, as text."""
        read = filter(None, (_read(role, paths) for role, paths in self.reads.items()))
        return (*read, *map(_made, self.makes), "dry run: nothing has been written")

    def document(self) -> dict[str, Any]:
        """Return what would be read and made, in a form that JSON can hold."""
        reads = {role: [str(path) for path in paths] for role, paths in self.reads.items()}
        makes = [{"path": str(made.path), "what": made.what, "bytes": made.size} for made in self.makes]
        return {"dry_run": {"reads": reads, "makes": makes}}


@contextlib.contextmanager
def dry_run() -> Iterator[None]:
    """Within the block, stages raise `Planned` before they do any work."""
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
    """Record the input files by role and the outputs. In a dry run, raise Planned instead."""
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
