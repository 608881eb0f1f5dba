"""Checkpoints, from which a run can resume after an interruption, even after SIGKILL.

A checkpoint records the run's key and the finished units of work. The key is a digest of everything that affects the bytes
of the outputs. There are two types of checkpoint:

* `PartsFolder` stores each finished unit, such as a frame of a training set, as a file in a separate folder until the output
  is complete.
* `Checkpoint` is a file that lists the finished units. Each unit is an output file, such as a picture, in the user's folder.
  Files that are not listed do not belong to the run.
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

RUN = "run"  # file in a PartsFolder that contains the run's key


class Checkpoint:
    """File that lists a run's finished units, together with facts that identify each unit's content.

    The first line is the run's key. Every other line is a JSON array [name, facts] for one unit. l3 writes this line to disk
    before it renames the unit's output file to its final name. A listed unit without an output file is computed again.

    Parameters
    ----------
    path : Path
        The checkpoint file.
    key : str
        The run's key.
    """

    def __init__(self, path: Path, key: str) -> None:
        self.path, self.key = path, key
        self.items: dict[str, Any] = {}  # unit name → facts

    def take_over(self, path: Path) -> bool:
        """Copy the finished units from an earlier run's checkpoint file. Incomplete lines are ignored.

        Returns
        -------
        bool
            Whether the two runs have the same key. If not, no units are copied.

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
        """Create the file and write all units recorded so far, so that `add` can append further units.

        Leftover temporary files from killed runs are removed.
        """
        sweep(self.path.parent, self.path)
        write_whole(self.path, "\n".join([self.key, *map(json.dumps, self.items.items())]))

    def add(self, name: str, facts: Any) -> None:
        """Append a finished unit, and flush the file to disk. Several processes may call this method.

        Raises OSError if the disk is full.
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
    """The folder NAME.parts next to an output NAME. It stores a run's finished parts until the output is complete.

    The file `run` in the folder contains the run's key. A part gets its final file name only when it is complete, so the
    folder never contains unfinished parts.
    """

    def __init__(self, output: Path, key: str) -> None:
        self.folder, self.key = output.with_name(f"{output.name}.parts"), key
        self._run = self.folder / RUN

    @contextlib.contextmanager
    def held(self, resume: bool, force: bool, is_whole: Callable[[Path], bool] = Path.is_file) -> Iterator[None]:
        """Context manager that creates the folder, and removes it if the block succeeds.

        If the block fails, a folder that contains parts is kept.

        Parameters
        ----------
        resume : bool
            Whether to reuse the parts of an earlier run with the same key. Otherwise, existing parts are removed.
        force : bool
            Used only with `resume`: whether to remove parts from a run with a different key instead of raising an error.
        is_whole : callable
            Function that takes the path of a part and returns whether the file is undamaged. Damaged parts are removed.

        Raises
        ------
        RecipeError
            If `resume` is set without `force`, and the parts belong to a run with a different key.
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
        """Remove the folder if it exists. The file `run` is removed last, because it proves that l3 created the folder."""
        if not self.folder.exists():
            return
        for each in self.folder.iterdir():
            if each != self._run:
                each.unlink(missing_ok=True)
        self._run.unlink(missing_ok=True)
        self.folder.rmdir()


@contextlib.contextmanager
def incomplete_folder(folder: Path, key: str, force: bool) -> Iterator[None]:
    """Mark a folder as incomplete until the block succeeds, so that a rerun of the same command may write into it.

    The marker is a file that contains the run's key. If the block fails after writing outputs, the marker is kept.

    Raises
    ------
    L3Error
        If the folder contains files, unless an interrupted run with this key wrote them or `force` is set.
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
    """Write a marker file that records that the run with this key has completed the folder."""
    write_whole(folder / FINISHED, key)


def is_finished(folder: Path, key: str) -> bool:
    """Return whether the run with this key has completed the folder. The folder need not exist."""
    marker = folder / FINISHED
    return marker.is_file() and marker.read_bytes() == key.encode()


def refuse_other_run(folder: Path, key: str, force: bool) -> None:
    """Raise L3Error if the folder contains files, unless an interrupted run with this key wrote them or `force` is set."""
    marker = folder / UNFINISHED
    is_same = marker.is_file() and marker.read_bytes() == key.encode()
    refuse_filled_folder(folder, force or is_same)
