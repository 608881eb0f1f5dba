"""Check and lock a stage's outputs before the stage starts its work.

The stage fails at once if an output would replace an input or cannot be written. Until the stage ends, locks prevent other
runs from writing the same outputs.
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
    """Context manager that protects a stage's inputs and locks its outputs until the end of the block."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        # (output, glob patterns of the files that l3 writes into an output folder)
        self._guarded: list[tuple[Path, tuple[str, ...]]] = []

    def protect(self, *inputs: Path) -> None:
        """Protect input files until the end of the block. No output may replace them, even with `force`.

        Raises
        ------
        RecipeError
            If an output that is already locked would replace one of the files.
        """
        self.enter_context(protecting(inputs))
        for path, globs in self._guarded:
            _refuse_protected(path, globs)

    def guard_file(self, path: Path, force: bool, recipe: bool = False) -> None:
        """Lock an output file as `hold_file` does, and raise L3Error if the file exists and `force` is not set."""
        self.hold_file(path, recipe)  # lock before the check, so that no other run creates the file in between
        refuse_existing(path, force)

    def hold_file(self, path: Path, recipe: bool = False) -> None:
        """Lock an output file until the end of the block. The file may exist.

        Parameters
        ----------
        path : Path
            The output.
        recipe : bool
            Whether the output is a recipe. Only recipes may have the suffix .toml.

        Raises
        ------
        RecipeError
            If the output has the suffix .toml but is not a recipe, or if it would replace an input or another output.
        L3Error
            If the output is a folder or a device, if its folder is not writable, or if another run is writing the output.
        """
        if path.suffix == ".toml" and not recipe:
            raise RecipeError(f"{path}: .toml is for recipes; choose an output with another suffix")
        self._remember(path)
        refuse_existing(path, force=True)  # refuses only folders and devices
        refuse_unwritable(path)
        self.hold(sole_writer_of_file(path), path)

    def guard_folder(self, path: Path, force: bool, *globs: str) -> None:
        """Lock an output folder as `hold_folder` does, and raise L3Error if it is not empty and `force` is not set."""
        self.hold_folder(path, *globs)
        refuse_filled_folder(path, force)

    def hold_folder(self, path: Path, *globs: str) -> None:
        """Lock an output folder until the end of the block. The folder may exist and contain files.

        Parameters
        ----------
        path : Path
            The folder.
        *globs : str
            Glob patterns of the files that l3 will write into the folder.

        Raises
        ------
        RecipeError
            If the folder is already another output, or if an input in the folder matches a pattern.
        L3Error
            If the path is a file, if the folder is not writable, or if another run is writing into the folder.
        """
        refuse_filled_folder(path, force=True)  # refuses only files
        refuse_unwritable(path)
        self._remember(path, *globs)
        self.hold(sole_writer_of_folder(path), path)

    def hold(self, lock: AbstractContextManager[bool], output: Path) -> None:
        """Acquire a lock on an output until the end of the block, and warn if the storage does not support locks.

        `lock` is a context manager that yields whether the storage supports locks.
        """
        if not self.enter_context(lock):
            self._console.report(
                f"warning: {output} is on storage without file locks; make sure that no other run writes to it"
            )

    def _remember(self, path: Path, *globs: str) -> None:
        """Record an output, so that `protect` can compare it with inputs that are added later.

        Raises RecipeError if the output would replace a protected input or another output.
        """
        _refuse_protected(path, globs)
        if any(path.resolve() == other.resolve() for other, _ in self._guarded):
            raise RecipeError(f"{path} is specified for two outputs; choose a different path for each output")
        self._guarded.append((path, globs))


def _refuse_protected(path: Path, globs: tuple[str, ...]) -> None:
    """Raise RecipeError if an output is a protected input, or a folder in which a protected input matches a glob pattern."""
    for file in itertools.chain([path], *(path.glob(each) for each in globs)):
        refuse_protected(file)


def refuse_unwritable(path: Path) -> None:
    """Raise L3Error if `path` cannot be created or replaced. Its parent folders need not exist."""
    whole = path.absolute()
    folder = whole if whole.is_dir() else next(parent for parent in whole.parents if parent.exists())
    if not folder.is_dir():
        raise L3Error(f"{folder} is a file, not a folder; choose an output other than {path}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise L3Error(f"{folder} is not writable; choose an output in a writable folder")
