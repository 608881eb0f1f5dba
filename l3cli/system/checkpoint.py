"""Checkpoints, with which an interrupted run can continue even after SIGKILL.

A checkpoint contains the key of the run, which is a digest of everything that affects the bytes of the outputs, and the
names of the finished units. There are two kinds of checkpoint:

* `PartsFolder`: finished units are files in a separate folder, such as the frames of a training set, until the output is
  complete.
* `Checkpoint`: finished units are outputs in a folder of the user, such as pictures, and a file lists them. A file that is
  not listed does not belong to the run.
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

RUN = "run"  # name of the file with the key of the run, in a folder of parts


class Checkpoint:
    """List of the finished units of a run, with facts that identify each unit.

    The first line of the file is the key of the run. Each further line is a unit in JSON. The line is on disk before the
    file of the unit gets its final name. If the file of a listed unit is missing, the unit is computed again.

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
        """Read the units that an earlier run has finished from the list of that run.

        Returns
        -------
        bool
            Whether the list belongs to the same run. If it does not, no units are read.
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
        """Write the list. From now on, new units are appended."""
        write_whole(self.path, "\n".join([self.key, *map(json.dumps, self.items.items())]))

    def add(self, name: str, facts: Any) -> None:
        """Append a unit, from any process. The line is on disk when this method returns.

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
        """Remove the list."""
        self.path.unlink(missing_ok=True)


class PartsFolder:
    """A folder "NAME.parts" next to an output, in which a run stores finished parts until the output is complete.

    The file `run` contains the key of the run. Each part is a file that appears only when it is complete, so every part that
    exists is finished, whichever process wrote it.
    """

    def __init__(self, output: Path, key: str) -> None:
        self.folder, self.key = output.with_name(f"{output.name}.parts"), key
        self._run = self.folder / RUN

    @contextlib.contextmanager
    def held(self, resume: bool, force: bool, is_whole: Callable[[Path], bool] = Path.is_file) -> Iterator[None]:
        """Use the folder during the block, and remove it at the end.

        If the block fails, the folder is kept unless it contains no parts.

        Parameters
        ----------
        resume : bool
            Whether to continue with the parts of an earlier run. Otherwise they are removed.
        force : bool
            Whether to remove the parts even if they belong to another run.
        is_whole : callable
            Whether a part is undamaged. Damaged parts are removed.

        Raises
        ------
        RecipeError
            If `resume` is set, `force` is not, and the parts belong to another run.
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
                f"{self.folder} is from a run with another recipe, camera, seed or version; "
                "leave ‹resume› out or add ‹force›"
            )
        if not (resume and is_same):
            self.remove()
            return
        sweep(self.folder)
        for each in self.folder.iterdir():
            if each != self._run and not is_whole(each):
                each.unlink()

    def remove(self) -> None:
        """Remove the folder if it exists. The file `run` is removed last, because it identifies the folder as l3's."""
        if not self.folder.exists():
            return
        for each in self.folder.iterdir():
            if each != self._run:
                each.unlink(missing_ok=True)
        self._run.unlink(missing_ok=True)
        self.folder.rmdir()


@contextlib.contextmanager
def incomplete_folder(folder: Path, key: str, force: bool) -> Iterator[None]:
    """Mark `folder` as incomplete until the block ends without an error, so that the same run can write into it again.

    The mark is a file that contains the key of the run.

    Raises
    ------
    L3Error
        If the folder contains other files and `force` is not set.
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
    """Record in `folder` that the run with this key has finished it."""
    write_whole(folder / FINISHED, key)


def is_finished(folder: Path, key: str) -> bool:
    """Whether the run with this key has finished `folder`."""
    marker = folder / FINISHED
    return marker.is_file() and marker.read_bytes() == key.encode()


def refuse_other_run(folder: Path, key: str, force: bool) -> None:
    """Raise L3Error if `folder` contains anything but files of an interrupted run with this key, unless `force` is set."""
    marker = folder / UNFINISHED
    is_same = marker.is_file() and marker.read_bytes() == key.encode()
    refuse_filled_folder(folder, force or is_same)
