"""Checkpoints: a file beside the outputs of a run for as long as it lasts, from which the same run goes on where it was
stopped, be it by SIGKILL.

Its first line is the run's key, and each further line an item that the run has finished, with facts that identify it, as
JSON. A line is on the disk before its item gets its name, or, in a folder of the run's own, as soon as it has: a file that
is not listed is not taken for the run's, and one that is listed but not there is made again.
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
    """The checkpoint of the run `key` in the file `path`: the facts of each finished item by name. `force`: the run may
    replace what it finds, also when it goes on."""

    def __init__(self, path: Path, key: str, force: bool = False) -> None:
        self.path, self.key, self.force = path, key, force
        self.items: dict[str, Any] = {}

    def take_over(self, path: Path | None = None) -> bool:
        """Read what is listed there, or in the file `path`; return whether it is of the same run: of another one nothing is
        taken."""
        key, force, lines = _read(path or self.path)
        if key != self.key:
            return False
        self.force = self.force or force
        for line in lines:
            with contextlib.suppress(ValueError, TypeError):  # a line that was cut off
                name, facts = json.loads(line)
                self.items[name] = facts
        return True

    def begin(self) -> None:
        """Write the checkpoint; what is listed from now on goes behind it."""
        self._write(self.path, self.force)

    def _write(self, path: Path, force: bool) -> None:
        lines = [f"{self.key} force" if force else self.key, *(json.dumps(item) for item in self.items.items())]
        write_whole(path, "\n".join(lines))

    def add(self, name: str, facts: Any) -> None:
        """List an item, from whatever process; the line is on the disk when this returns."""
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
        """Remove the checkpoint; what it lists goes into the file `finished`, if there is one."""
        if finished is not None:
            self._write(finished, force=False)
        self.path.unlink(missing_ok=True)


def key_in(path: Path) -> str | None:
    """Return the key of the run whose checkpoint this is; None if there is none."""
    return _read(path)[0]


def _read(path: Path) -> tuple[str | None, bool, list[str]]:
    """Return the key, whether the run may replace what it finds, and the lines of items."""
    if not path.is_file():
        return None, False, []
    first, *lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    key, _, force = first.partition(" ")
    return key, bool(force), lines


class PartsFolder:
    """The folder in which the run `key` stores its parts for as long as it lasts, with their checkpoint."""

    def __init__(self, folder: Path, key: str) -> None:
        self.folder, self.key, self.checkpoint = folder, key, Checkpoint(folder / RUN, key)

    def goes_on(self, resume: bool, force: bool) -> bool:
        """Return whether the run goes on with parts that are stored: with `resume` those of the same run. If they are of
        another one, RecipeError, unless `force`; L3Error if the folder is not of l3's making."""
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
        """Keep the folder for the block, with those parts to go on with that are listed and whole, and remove it at the end;
        if that fails or is interrupted, keep what parts there are. Errors as of `goes_on`."""
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
            sweep(self.folder)  # what worker processes left that were ended
            if all(each.name == RUN for each in self.folder.iterdir()):
                remove_parts(self.folder)
            raise
        remove_parts(self.folder)


def parts_folder(output: Path) -> Path:
    """Return the folder of the stored parts of an output."""
    return output.with_name(f"{output.name}.parts")


def remove_parts(folder: Path) -> None:
    """Remove a folder of parts, its checkpoint last: without one nobody would know whose it is."""
    for each in folder.iterdir():
        if each.name != RUN:
            each.unlink(missing_ok=True)
    (folder / RUN).unlink(missing_ok=True)
    folder.rmdir()


@contextlib.contextmanager
def incomplete_folder(folder: Path, key: str, force: bool) -> Iterator[None]:
    """Take `folder` for the files of the run `key` until the block ends without an error: if it is stopped, the same run may
    go on there. L3Error if the folder holds something else, unless `force`."""
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
    """Raise L3Error if `folder` holds anything but what a stopped run `key` has left, unless `force`."""
    refuse_filled_folder(folder, force or key_in(folder / UNFINISHED) == key)
