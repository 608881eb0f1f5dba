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

RUN = "run"  # name of the file in a folder of parts that holds the key of the run


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
