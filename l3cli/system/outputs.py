"""Check and lock the outputs of a stage before its work begins.

An output that would replace an input or cannot be written is refused. Until the stage ends, locks keep other runs from
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
    """Context manager that protects inputs and locks outputs until the end of the block."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        # (output path, glob patterns of the files that l3 writes to the output if the output is a folder)
        self._guarded: list[tuple[Path, tuple[str, ...]]] = []

    def protect(self, *inputs: Path) -> None:
        """Protect input files until the end. No output may replace an input, by any of its names, even with `force`.

        Raises
        ------
        RecipeError
            If an output that is already guarded would replace an input.
        """
        self.enter_context(protecting(inputs))
        for path, globs in self._guarded:
            _refuse_protected(path, globs)

    def guard_file(self, path: Path, force: bool, recipe: bool = False) -> None:
        """Do the same as `hold_file`, and raise L3Error if the output exists and `force` is not set."""
        self.hold_file(path, recipe)  # before the check, because another run may be about to write the file
        refuse_existing(path, force)

    def hold_file(self, path: Path, recipe: bool = False) -> None:
        """Lock an output file until the end.

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
            If the output is a folder or a device, if its folder is not writable, or if another run is writing it.
        """
        if path.suffix == ".toml" and not recipe:
            raise RecipeError(f"{path}: .toml is for recipes; choose an output with another suffix")
        self._remember(path)
        refuse_existing(path, force=True)  # refuses only folders and devices
        refuse_unwritable(path)
        self.hold(sole_writer_of_file(path), path)

    def guard_folder(self, path: Path, force: bool, *globs: str) -> None:
        """Do the same as `hold_folder`, and raise L3Error if the folder is not empty and `force` is not set."""
        self.hold_folder(path, *globs)
        refuse_filled_folder(path, force)

    def hold_folder(self, path: Path, *globs: str) -> None:
        """Lock an output folder until the end.

        Parameters
        ----------
        path : Path
            The output.
        *globs : str
            Patterns of the files that l3 will write into the folder.

        Raises
        ------
        RecipeError
            If the folder is another output, or if an input in the folder matches a pattern.
        L3Error
            If the output is a file, if it is not writable, or if another run is writing into it.
        """
        refuse_filled_folder(path, force=True)  # refuses only files
        refuse_unwritable(path)
        self._remember(path, *globs)
        self.hold(sole_writer_of_folder(path), path)

    def hold(self, lock: AbstractContextManager[bool], output: Path) -> None:
        """Acquire a lock on an output, and keep it until the end. Warn if the storage of the output does not
        support locks."""
        if not self.enter_context(lock):
            self._console.report(
                f"warning: {output} is on storage without file locks; make sure that no other run writes to it"
            )

    def _remember(self, path: Path, *globs: str) -> None:
        """Store an output, so that inputs that are added later cannot be replaced by this output.

        Raises RecipeError if the output would replace an input or another output.
        """
        _refuse_protected(path, globs)
        if any(path.resolve() == other.resolve() for other, _ in self._guarded):
            raise RecipeError(f"{path} is set as two outputs; choose a different path for each")
        self._guarded.append((path, globs))


def _refuse_protected(path: Path, globs: tuple[str, ...]) -> None:
    """Raise RecipeError if an output, or a file in it that matches one of the patterns `globs`, is a protected input."""
    for file in itertools.chain([path], *(path.glob(each) for each in globs)):
        refuse_protected(file)


def refuse_unwritable(path: Path) -> None:
    """Raise L3Error if no file can be written at `path`."""
    whole = path.absolute()
    folder = whole if whole.is_dir() else next(parent for parent in whole.parents if parent.exists())
    if not folder.is_dir():
        raise L3Error(f"{folder} is a file, not a folder; choose an output other than {path}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise L3Error(f"{folder} cannot be written to; choose an output in a folder that you may write to")
