"""Checkpoints, from which an interrupted run can continue even after SIGKILL.

A checkpoint contains the key of the run and the names of the finished units of work. The key is a digest of everything that
affects the bytes of the outputs. There are two types of checkpoint:

* `PartsFolder`: each finished unit, such as a frame of a training set, is a file in a separate folder until the output is
  complete.
* `Checkpoint`: each finished unit, such as a picture, is an output file in the user's folder, and a file lists the finished
  units. Files that are not listed do not belong to the run.
"""

import contextlib
import errno
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from l3cli.errors import L3Error, RecipeError
from l3cli.system.files import FINISHED, UNFINISHED, is_ours, refuse_filled_folder, refuse_protected, sweep, write_whole

RUN = "run"  # file in a PartsFolder that contains the key of the run


class Checkpoint:
    """File that lists the finished units of a run, with facts that identify the content of each unit.

    The first line of the file is the key of the run. Each of the following lines is a JSON array [name, facts] for one unit.
    A line is on disk before the output file of its unit is renamed to its final name. If the output file of a listed unit is
    missing, the unit is computed again.

    Parameters
    ----------
    path : Path
        The file that contains the list.
    key : str
        Key of the run.
    """

    def __init__(self, path: Path, key: str) -> None:
        self.path, self.key = path, key
        self.items: dict[str, Any] = {}  # name of each unit → its facts

    def take_over(self, path: Path) -> bool:
        """Add the units that an earlier run listed in the file `path`. Incomplete lines are ignored.

        Returns
        -------
        bool
            Whether the keys of the two runs are equal. If not, no units are added.

        Raises
        ------
        OSError
            If the file does not exist.
        """
        key, *lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
        if key != self.key:
            return False
        for line in lines:
            with contextlib.suppress(ValueError, TypeError):  # the last line may be incomplete
                name, facts = json.loads(line)
                self.items[name] = facts
        return True

    def begin(self) -> None:
        """Create the file with all units that are known so far. Afterwards, `add` may append units.

        Temporary files that killed runs left behind are removed.
        """
        sweep(self.path.parent, self.path)
        write_whole(self.path, "\n".join([self.key, *map(json.dumps, self.items.items())]))

    def add(self, name: str, facts: Any) -> None:
        """Append a finished unit to the file. Several processes may call this method.

        The line is on disk when the method returns. Raises OSError if the disk is full.
        """
        self.items[name] = facts
        line = f"\n{json.dumps([name, facts])}".encode()
        file = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        try:
            if os.write(file, line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self.path))
            os.fdatasync(file)
        finally:
            os.close(file)

    def end(self) -> None:
        """Remove the file, if it exists."""
        self.path.unlink(missing_ok=True)


class PartsFolder:
    """The folder "NAME.parts" next to an output NAME. A run stores its finished parts there until the output is complete.

    The file `run` in the folder contains the key of the run. Each part is a file that is renamed to its final name when it
    is complete, so every part in the folder is finished.
    """

    def __init__(self, output: Path, key: str) -> None:
        self.folder, self.key = output.with_name(f"{output.name}.parts"), key
        self._run = self.folder / RUN

    @contextlib.contextmanager
    def held(self, resume: bool, force: bool, is_whole: Callable[[Path], bool] = Path.is_file) -> Iterator[None]:
        """Create the folder for the duration of the block, and remove it if the block succeeds.

        If the block fails, the folder remains, unless it contains no parts.

        Parameters
        ----------
        resume : bool
            Whether to continue with the parts of an earlier run that has the same key. Otherwise, existing parts are
            removed.
        force : bool
            Whether to remove parts of a run with a different key if `resume` is set.
        is_whole : callable
            Function that returns whether the file of a part is undamaged. Damaged parts are removed.

        Raises
        ------
        RecipeError
            If `resume` is set, `force` is not set, and the parts belong to a run with a different key.
        L3Error
            If the folder contains files that l3 did not write.
        """
        if self.folder.exists():
            self._take_over(resume, force, is_whole)
        write_whole(self._run, self.key)
        try:
            yield
        except BaseException:
            sweep(self.folder)  # removes temporary files of killed worker processes
            if all(each.name == RUN for each in self.folder.iterdir()):
                self.remove()
            raise
        self.remove()

    def _take_over(self, resume: bool, force: bool, is_whole: Callable[[Path], bool]) -> None:
        files = list(self.folder.iterdir())
        for each in files:
            refuse_protected(each)
        if not self._run.is_file() and not all(is_ours(each.name) for each in files):
            raise L3Error(f"{self.folder} contains files that l3 did not write; move the folder elsewhere")
        is_same = self._run.is_file() and self._run.read_bytes() == self.key.encode()
        if resume and not is_same and self._run.is_file() and not force:
            raise RecipeError(
                f"{self.folder} is from a run with a different recipe, camera, seed or version; "
                "remove ‹resume› or add ‹force›"
            )
        if not (resume and is_same):
            self.remove()
            return
        sweep(self.folder)
        for each in self.folder.iterdir():
            if each != self._run and not is_whole(each):
                each.unlink()

    def remove(self) -> None:
        """Remove the folder if it exists. The file `run` is removed last, because it shows that l3 created the folder."""
        if not self.folder.exists():
            return
        for each in self.folder.iterdir():
            if each != self._run:
                each.unlink(missing_ok=True)
        self._run.unlink(missing_ok=True)
        self.folder.rmdir()


@contextlib.contextmanager
def incomplete_folder(folder: Path, key: str, force: bool) -> Iterator[None]:
    """Mark `folder` as incomplete until the block succeeds, so that the same command can write into the folder again.

    The mark is a file that contains the key of the run. If the block fails, the mark remains, unless the folder contains no
    outputs.

    Raises
    ------
    L3Error
        If the folder contains files that do not belong to an interrupted run with this key, and `force` is not set.
    """
    refuse_other_run(folder, key, force)
    marker, finished = folder / UNFINISHED, folder / FINISHED
    refuse_protected(finished)
    write_whole(marker, key)
    finished.unlink(missing_ok=True)
    try:
        yield
    except BaseException:
        sweep(folder)
        if all(is_ours(each.name) for each in folder.iterdir()):
            marker.unlink()
        raise
    marker.unlink()


def mark_finished(folder: Path, key: str) -> None:
    """Write a file into `folder` that records that the run with this key has completed the folder."""
    write_whole(folder / FINISHED, key)


def is_finished(folder: Path, key: str) -> bool:
    """Return whether the run with this key has completed `folder`. A missing folder is not complete."""
    marker = folder / FINISHED
    return marker.is_file() and marker.read_bytes() == key.encode()


def refuse_other_run(folder: Path, key: str, force: bool) -> None:
    """Raise L3Error if `folder` is not empty, unless an interrupted run with this key wrote it or `force` is set."""
    marker = folder / UNFINISHED
    is_same = marker.is_file() and marker.read_bytes() == key.encode()
    refuse_filled_folder(folder, force or is_same)
