"""Check and lock the outputs of a stage before the work of the stage begins.

A stage fails if an output would replace an input or cannot be written. Until the stage ends, locks prevent other runs from
writing the same outputs.
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
    """Context manager that protects the inputs and locks the outputs of a stage until the end of the block."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        # (path of an output, glob patterns of the files that l3 writes if the output is a folder)
        self._guarded: list[tuple[Path, tuple[str, ...]]] = []

    def protect(self, *inputs: Path) -> None:
        """Protect input files until the end of the block. Even with `force`, no output may replace these files.

        Raises
        ------
        RecipeError
            If an output that is already locked would replace one of the files.
        """
        self.enter_context(protecting(inputs))
        for path, globs in self._guarded:
            _refuse_protected(path, globs)

    def guard_file(self, path: Path, force: bool, recipe: bool = False) -> None:
        """Lock an output file as `hold_file` does. Raise L3Error if the file exists and `force` is not set."""
        self.hold_file(path, recipe)  # before the check, because another run may create the file between check and lock
        refuse_existing(path, force)

    def hold_file(self, path: Path, recipe: bool = False) -> None:
        """Lock an output file until the end of the block. The file may exist.

        Parameters
        ----------
        path : Path
            The output.
        recipe : bool
            Whether the output is a recipe. Only recipes may have the suffix ".toml".

        Raises
        ------
        RecipeError
            If the output has the suffix ".toml" but is not a recipe, or if it would replace an input or another output.
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
        """Lock an output folder as `hold_folder` does. Raise L3Error if the folder is not empty and `force` is not set."""
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
            If the folder is also set as another output, or if an input in the folder matches a pattern.
        L3Error
            If the path is a file, if the folder is not writable, or if another run is writing into the folder.
        """
        refuse_filled_folder(path, force=True)  # refuses only files
        refuse_unwritable(path)
        self._remember(path, *globs)
        self.hold(sole_writer_of_folder(path), path)

    def hold(self, lock: AbstractContextManager[bool], output: Path) -> None:
        """Acquire a lock on an output, and keep the lock until the end of the block.

        The context manager `lock` yields whether the storage supports locks. If the storage does not support locks, a
        warning is reported.
        """
        if not self.enter_context(lock):
            self._console.report(
                f"warning: {output} is on storage without file locks; make sure that no other run writes to it"
            )

    def _remember(self, path: Path, *globs: str) -> None:
        """Record an output, so that `protect` can compare the output with inputs that are added later.

        Raises RecipeError if the output would replace a protected input or another output.
        """
        _refuse_protected(path, globs)
        if any(path.resolve() == other.resolve() for other, _ in self._guarded):
            raise RecipeError(f"{path} is set as two outputs; choose a different path for each output")
        self._guarded.append((path, globs))


def _refuse_protected(path: Path, globs: tuple[str, ...]) -> None:
    """Raise RecipeError if an output is a protected input, or contains a protected input that matches a glob pattern."""
    for file in itertools.chain([path], *(path.glob(each) for each in globs)):
        refuse_protected(file)


def refuse_unwritable(path: Path) -> None:
    """Raise L3Error if no file or folder can be written at `path`. The folders in the path need not exist."""
    whole = path.absolute()
    folder = whole if whole.is_dir() else next(parent for parent in whole.parents if parent.exists())
    if not folder.is_dir():
        raise L3Error(f"{folder} is a file, not a folder; choose an output other than {path}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise L3Error(f"{folder} cannot be written to; choose an output in a folder that you may write to")
