"""Check the outputs of a stage before the work begins, and lock them.

An output may not replace an input. Outputs that cannot be written are refused. The locks keep other runs from writing the
same outputs until the stage ends.
"""

import contextlib
import itertools
import os
from contextlib import AbstractContextManager
from pathlib import Path

from l3cli.errors import L3Error, RecipeError
from l3cli.system.console import Console
from l3cli.system.files import protecting, refuse_existing, refuse_filled_folder, refuse_protected
from l3cli.system.locks import sole_writer_of_file, sole_writer_of_folder


class OutputGuard(contextlib.ExitStack):
    """Context manager that protects inputs and locks outputs until the end of the block."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        self._guarded: list[tuple[Path, tuple[str, ...]]] = []  # outputs; folders with globs of the files written there

    def protect(self, *inputs: Path) -> None:
        """Protect input files until the end. No output may replace them, under any name, even with `force`.

        Raises
        ------
        RecipeError
            If an output that is already guarded would replace an input.
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
            raise RecipeError(f"{path} is given for two outputs; give a different file for each")
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
