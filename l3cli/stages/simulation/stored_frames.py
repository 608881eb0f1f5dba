"""Stored frames of a simulation: a folder beside the output, with the checkpoint from which a stopped run goes on."""

import contextlib
import dataclasses
import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import open_artifact, read_history
from l3cli.artifacts.training_set import SceneCoverage, TrainingPair, TrainingSetWriter, read_part, whole_part, write_part
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.system.checkpoint import Checkpoint, key_in
from l3cli.system.files import is_ours, refuse_protected, sweep
from l3cli.system.ledger import dated

RUN = "run"  # name of the checkpoint in the folder


def key_of(stage: Stage) -> str:
    """Return the key that distinguishes a run from others: all that its frames depend on."""
    return hashlib.sha256(json.dumps(dataclasses.asdict(stage), sort_keys=True).encode()).hexdigest()


def folder_of(output: Path) -> Path:
    """Return the folder of the stored frames of an output."""
    return output.with_name(f"{output.name}.parts")


class StoredFrames:
    """The frames of the run `key` in a folder, each in a file, by their indices; all of them, once they are there, are read
    one by one."""

    def __init__(self, folder: Path, key: str) -> None:
        self.folder, self.key, self._checkpoint = folder, key, Checkpoint(folder / RUN, key)
        self._total = 0

    def path(self, index: int) -> Path:
        return self.folder / f"{index:06d}.h5"

    def store(self, index: int, frame: TrainingPair, uncovered: float) -> None:
        """Store a frame, from whatever process; `uncovered`: share of the light for which its scene holds no data."""
        write_part(self.path(index), frame, uncovered)
        self.list(index)

    def list(self, index: int) -> None:
        """List a frame that has got its name."""
        self._checkpoint.add(self.path(index).name, dated(self.path(index)))

    def __contains__(self, index: int) -> bool:
        state = dated(self.path(index))
        return state is not None and self._checkpoint.items.get(self.path(index).name) == list(state)

    def close(self, total: int) -> None:
        """All frames, `total` of them, are stored, some by other processes."""
        self._total = total
        self._checkpoint.take_over()

    def __iter__(self) -> Iterator[TrainingPair]:
        return map(read_part, self._paths())

    def append_to(self, writer: TrainingSetWriter) -> Iterator[SceneCoverage]:
        """Append the frames to a training set; yield what each one's scene covers."""
        return map(writer.append_part, self._paths())

    def _paths(self) -> Iterator[Path]:
        """Yield the files of the frames; L3Error if another run has replaced one."""
        for index in range(self._total):
            if index not in self:
                raise L3Error(f"{self.path(index)} was replaced by another run; run again with ‹resume›")
            yield self.path(index)

    def goes_on(self, resume: bool, force: bool) -> bool:
        """Return whether the run goes on with frames that are stored: with `resume` those of the same run. If they are of
        another one, RecipeError, unless `force`; L3Error if the folder is not of l3's making."""
        if not self.folder.exists():
            return False
        for each in self.folder.iterdir():
            refuse_protected(each)
        is_checkpoint = self._checkpoint.path.is_file()
        if not is_checkpoint and not all(is_ours(each.name) for each in self.folder.iterdir()):
            raise L3Error(f"{self.folder} holds files that l3 did not make; move it elsewhere")
        same = resume and self._checkpoint.take_over()
        if resume and is_checkpoint and not same and not force:
            raise RecipeError(
                f"{self.folder} is of a run with another recipe, camera, seed or version; leave ‹resume› out or add ‹force›"
            )
        return same

    @contextlib.contextmanager
    def held(self, resume: bool, force: bool) -> Iterator[None]:
        """Keep the folder for the block, with the frames that the run goes on with, and remove it at the end; if that fails
        or is interrupted, keep what frames there are."""
        if self.goes_on(resume, force):
            sweep(self.folder)
            items = self._checkpoint.items
            self._checkpoint.items = {name: state for name, state in items.items() if whole_part(self.folder / name)}
        elif self.folder.exists():
            remove(self.folder)
        self._checkpoint.begin()
        try:
            yield
        except BaseException:
            sweep(self.folder)  # what worker processes left that were ended
            if not any(self.folder.glob("*.h5")):
                remove(self.folder)
            raise
        remove(self.folder)


def remove(folder: Path) -> None:
    """Remove a folder of stored frames, its checkpoint last: without one nobody would know whose it is."""
    for each in folder.iterdir():
        if each.name != RUN:
            each.unlink(missing_ok=True)
    (folder / RUN).unlink(missing_ok=True)
    folder.rmdir()


def remove_finished(output: Path) -> None:
    """Remove the folder of a run that was killed after `output` had appeared, which holds all its frames."""
    key = key_in(folder_of(output) / RUN)
    if key is not None and is_of_run(output, key):
        remove(folder_of(output))


def is_of_run(output: Path, key: str) -> bool:
    """Return whether `output` is the whole training set of the run called `key`."""
    if not output.is_file():
        return False
    try:
        with open_artifact(output) as root:
            history = read_history(root, output)
    except InputFileError:
        return False
    return bool(history) and key_of(history[-1]) == key
