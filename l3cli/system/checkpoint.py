"""What lets an interrupted run continue, even after SIGKILL: the key of the run, and the names of its finished units.

The key is a digest of everything on which the bytes of the outputs depend. There are two places for finished units:

* `PartsFolder`: files in a folder of the run's own, such as the frames of a training set, until the output is complete.
* `Checkpoint`: a list beside outputs in a folder of the user's, such as pictures. A file that is not listed does not belong
  to the run.
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

RUN = "run"  # name of the file in a folder of parts that holds the key of the run


class Checkpoint:
    """List of a run's finished units, with facts that identify each of them.

    The first line of the file is the key of the run. Each further line is a unit as JSON. It is on disk before the unit's
    file gets its final name, and a listed unit whose file is missing is made again.

    Parameters
    ----------
    path : Path
        File of the list.
    key : str
        Key of the run.
    """

    def __init__(self, path: Path, key: str) -> None:
        self.path, self.key = path, key
        self.items: dict[str, Any] = {}  # facts of each unit by name

    def take_over(self, path: Path) -> bool:
        """Read the units that an earlier run has finished from its list.

        Returns
        -------
        bool
            Whether the list belongs to the same run. If not, nothing is read.
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
        """Write the list. New units are appended from now on."""
        write_whole(self.path, "\n".join([self.key, *map(json.dumps, self.items.items())]))

    def add(self, name: str, facts: Any) -> None:
        """Append a unit, from any process. The line is on disk when this returns."""
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
    """Folder "NAME.parts" beside an output, in which a run keeps finished parts until the output is complete.

    The file `run` holds the key of the run. Each part is a file that appears only when it is complete, so a part that exists
    is finished, whichever process wrote it.
    """

    def __init__(self, output: Path, key: str) -> None:
        self.folder, self.key = output.with_name(f"{output.name}.parts"), key
        self._run = self.folder / RUN

    @contextlib.contextmanager
    def held(self, resume: bool, force: bool, is_whole: Callable[[Path], bool] = Path.is_file) -> Iterator[None]:
        """Keep the folder during the block, and remove it at the end.

        If the block fails, the folder stays unless it is empty.

        Parameters
        ----------
        resume : bool
            Whether to continue with the parts of an earlier run. Otherwise they are removed.
        force : bool
            Whether to remove them if they belong to another run.
        is_whole : callable
            Whether a part is undamaged. Others are removed.

        Raises
        ------
        RecipeError
            If `resume` is set, `force` is not, and the parts belong to another run.
        L3Error
            If the folder holds files that l3 did not make.
        """
        if self.folder.exists():
            self._take_over(resume, force, is_whole)
        write_whole(self._run, self.key)
        try:
            yield
        except BaseException:
            sweep(self.folder)  # temporary files of worker processes that were killed
            if all(each.name == RUN for each in self.folder.iterdir()):
                self.remove()
            raise
        self.remove()

    def _take_over(self, resume: bool, force: bool, is_whole: Callable[[Path], bool]) -> None:
        files = list(self.folder.iterdir())
        for each in files:
            refuse_protected(each)
        if not self._run.is_file() and not all(is_ours(each.name) for each in files):
            raise L3Error(f"{self.folder} holds files that l3 did not make; move it elsewhere")
        is_same = self._run.is_file() and self._run.read_bytes() == self.key.encode()
        if resume and not is_same and self._run.is_file() and not force:
            raise RecipeError(
                f"{self.folder} is of a run with another recipe, camera, seed or version; leave ‹resume› out or add ‹force›"
            )
        if not (resume and is_same):
            self.remove()
            return
        sweep(self.folder)
        for each in self.folder.iterdir():
            if each != self._run and not is_whole(each):
                each.unlink()

    def remove(self) -> None:
        """Remove the folder, if it exists. The file `run` goes last, because it shows that the folder is l3's."""
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

    The marker is a file with the key of the run.

    Raises
    ------
    L3Error
        If the folder holds something else and `force` is not set.
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
    """Note in `folder` that the run with this key has finished it."""
    write_whole(folder / FINISHED, key)


def is_finished(folder: Path, key: str) -> bool:
    """Whether the run with this key has finished `folder`."""
    marker = folder / FINISHED
    return marker.is_file() and marker.read_bytes() == key.encode()


def refuse_other_run(folder: Path, key: str, force: bool) -> None:
    """Raise L3Error if `folder` holds anything except what an interrupted run with this key left, unless `force` is set."""
    marker = folder / UNFINISHED
    is_same = marker.is_file() and marker.read_bytes() == key.encode()
    refuse_filled_folder(folder, force or is_same)
