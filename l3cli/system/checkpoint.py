"""Checkpoints: a file beside the outputs of a run that lets an interrupted run continue, even after SIGKILL.

The first line is the key of the run. Each further line is a finished item as JSON, with facts that identify it. The line is
on disk before the item gets its final name (in a folder of the run's own, right after). So a file that is not listed does
not belong to the run, and a listed item that is missing is made again.
"""

import contextlib
import errno
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from l3cli.errors import L3Error, RecipeError
from l3cli.system.files import UNFINISHED, is_ours, refuse_filled_folder, refuse_protected, sweep, write_whole

RUN = "run"  # name of the checkpoint in a folder of parts


class Checkpoint:
    """Checkpoint of a run, with the facts of each finished item by name.

    Parameters
    ----------
    path : Path
        File of the checkpoint.
    key : str
        Key of the run.
    force : bool
        Whether the run may replace existing outputs, also when it continues.
    """

    def __init__(self, path: Path, key: str, force: bool = False) -> None:
        self.path, self.key, self.force = path, key, force
        self.items: dict[str, Any] = {}

    def take_over(self, path: Path | None = None) -> bool:
        """Read the items of an earlier run from the checkpoint, or from the file `path`.

        Returns
        -------
        bool
            Whether the file belongs to the same run. If not, nothing is read.
        """
        key, force, lines = _read(path or self.path)
        if key != self.key:
            return False
        self.force = self.force or force
        for line in lines:
            with contextlib.suppress(ValueError, TypeError):  # the last line may be incomplete
                name, facts = json.loads(line)
                self.items[name] = facts
        return True

    def begin(self) -> None:
        """Write the checkpoint. New items are appended from now on."""
        self._write(self.path, self.force)

    def _write(self, path: Path, force: bool) -> None:
        lines = [f"{self.key} force" if force else self.key, *(json.dumps(item) for item in self.items.items())]
        write_whole(path, "\n".join(lines))

    def add(self, name: str, facts: Any) -> None:
        """Append an item, from any process. The line is on disk when this returns."""
        self.items[name] = facts
        line = f"\n{json.dumps([name, facts])}".encode()
        file = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        try:
            if os.write(file, line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
            os.fdatasync(file)
        finally:
            os.close(file)

    def end(self, finished: Path | None = None) -> None:
        """Remove the checkpoint. Its content goes into the file `finished`, if one is given."""
        if finished is not None:
            self._write(finished, force=False)
        self.path.unlink(missing_ok=True)


def key_in(path: Path) -> str | None:
    """Return the key of the run that a checkpoint belongs to, or None if there is no checkpoint."""
    return _read(path)[0]


def _read(path: Path) -> tuple[str | None, bool, list[str]]:
    """Return the key, whether the run may replace existing outputs, and the lines of items."""
    if not path.is_file():
        return None, False, []
    first, *lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    key, _, force = first.partition(" ")
    return key, bool(force), lines


class PartsFolder:
    """Folder in which a run keeps finished parts, with their checkpoint, until it ends."""

    def __init__(self, folder: Path, key: str) -> None:
        self.folder, self.key, self.checkpoint = folder, key, Checkpoint(folder / RUN, key)

    def goes_on(self, resume: bool, force: bool) -> bool:
        """Return whether the run continues with stored parts, which requires `resume` and parts of the same run.

        Raises
        ------
        RecipeError
            If the parts belong to another run and `force` is not set.
        L3Error
            If the folder holds files that l3 did not make.
        """
        if not self.folder.exists():
            return False
        for each in self.folder.iterdir():
            refuse_protected(each)
        is_checkpoint = self.checkpoint.path.is_file()
        if not is_checkpoint and not all(is_ours(each.name) for each in self.folder.iterdir()):
            raise L3Error(f"{self.folder} holds files that l3 did not make; move it elsewhere")
        same = resume and self.checkpoint.take_over()
        if resume and is_checkpoint and not same and not force:
            raise RecipeError(
                f"{self.folder} is of a run with another recipe, camera, seed or version; leave ‹resume› out or add ‹force›"
            )
        return same

    @contextlib.contextmanager
    def held(self, resume: bool, force: bool, is_whole: Callable[[Path], bool] = Path.is_file) -> Iterator[None]:
        """Hold the folder during the block, with the listed and complete parts of an earlier run, and remove it at the end.

        If the block fails or is interrupted, the folder stays. Errors are those of `goes_on`.
        """
        if self.goes_on(resume, force):
            sweep(self.folder)
            items = self.checkpoint.items.items()
            self.checkpoint.items = {name: state for name, state in items if is_whole(self.folder / name)}
        elif self.folder.exists():
            remove_parts(self.folder)
        self.checkpoint.begin()
        try:
            yield
        except BaseException:
            sweep(self.folder)  # temporary files of worker processes that were killed
            if all(each.name == RUN for each in self.folder.iterdir()):
                remove_parts(self.folder)
            raise
        remove_parts(self.folder)


def parts_folder(output: Path) -> Path:
    """Return the folder for the parts of an output."""
    return output.with_name(f"{output.name}.parts")


def remove_parts(folder: Path) -> None:
    """Remove a folder of parts. The checkpoint goes last, because it shows that the folder is l3's."""
    for each in folder.iterdir():
        if each.name != RUN:
            each.unlink(missing_ok=True)
    (folder / RUN).unlink(missing_ok=True)
    folder.rmdir()


@contextlib.contextmanager
def incomplete_folder(folder: Path, key: str, force: bool) -> Iterator[None]:
    """Mark `folder` as incomplete until the block ends without an error, so that the same run can continue in it.

    Raises
    ------
    L3Error
        If the folder holds something else and `force` is not set.
    """
    refuse_other_run(folder, key, force)
    checkpoint = Checkpoint(folder / UNFINISHED, key)
    checkpoint.begin()
    try:
        yield
    except BaseException:
        sweep(folder)
        if all(is_ours(each.name) for each in folder.iterdir()):
            checkpoint.end()
        raise
    checkpoint.end()


def refuse_other_run(folder: Path, key: str, force: bool) -> None:
    """Raise L3Error if `folder` holds anything except what an interrupted run with this key left, unless `force` is set."""
    refuse_filled_folder(folder, force or key_in(folder / UNFINISHED) == key)
