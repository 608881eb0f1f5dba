"""The stored frames of a simulation: a folder beside the output, from which a run that was stopped goes on."""

import contextlib
import dataclasses
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from l3cli.artifacts.schema import Stage
from l3cli.artifacts.store import open_artifact, read_history
from l3cli.artifacts.training_set import TrainingPair, read_part
from l3cli.errors import InputFileError, L3Error, RecipeError
from l3cli.stages.simulation.run import SimulationRun
from l3cli.system.files import is_ours, refuse_protected, sweep, write_whole

MARK = "run"  # names, in a folder of stored frames, the run they belong to


def key_of(stage: Stage) -> str:
    """Return the key that distinguishes a run from others: all that its frames depend on."""
    return hashlib.sha256(json.dumps(dataclasses.asdict(stage), sort_keys=True).encode()).hexdigest()


def open_folder(output: Path, key: str, resume: bool, force: bool) -> Path:
    """The folder beside `output` for the frames of the run called `key`: with `resume` what an earlier run left there,
    else empty. If that run was another one, RecipeError, or with `force` empty, too. L3Error if the folder is not of l3's
    making."""
    folder, mark = _folder_and_mark(output)
    if folder.exists():
        if goes_on(output, key, resume, force):
            sweep(folder)
            return folder
        _remove(folder)
    write_whole(mark, key)
    return folder


def goes_on(output: Path, key: str, resume: bool, force: bool) -> bool:
    """Return whether the run called `key` goes on with frames that are stored beside `output`; errors as of
    `open_folder`."""
    folder, mark = _folder_and_mark(output)
    if not folder.exists():
        return False
    for each in folder.iterdir():
        refuse_protected(each)
    if not mark.is_file() and not all(is_ours(each.name) for each in folder.iterdir()):
        raise L3Error(f"{folder} holds files that l3 did not make; move it elsewhere")
    same = resume and mark.is_file() and mark.read_text() == key
    if resume and mark.is_file() and not same and not force:
        raise RecipeError(
            f"{folder} is of a run with another recipe, camera, seed or version; leave ‹resume› out or add ‹force›"
        )
    return same


@contextlib.contextmanager
def close_folder(folder: Path) -> Iterator[None]:
    """Remove the folder after the block; if that fails or is interrupted, keep what frames there are for --resume."""
    try:
        yield
    except BaseException:
        sweep(folder)  # what worker processes left that were ended
        if not any(folder.glob("*.h5")):
            _remove(folder)
        raise
    _remove(folder)


def remove_finished(output: Path) -> None:
    """Remove the folder of a run that was killed after `output` had appeared, which holds all its frames."""
    folder, mark = _folder_and_mark(output)
    if mark.is_file() and is_of_run(output, mark.read_text()):
        _remove(folder)


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


@dataclass(frozen=True)
class StoredFrames:
    """All stored frames of a run in their order, read one by one."""

    run: SimulationRun
    total: int

    def __iter__(self) -> Iterator[TrainingPair]:
        for index in range(self.total):
            yield read_part(self.run.part(index), self.run.key)


def _folder_and_mark(output: Path) -> tuple[Path, Path]:
    folder = output.with_name(f"{output.name}.parts")
    return folder, folder / MARK


def _remove(folder: Path) -> None:
    """Remove the folder, its mark last: without one nobody would know whose it is."""
    for each in folder.iterdir():
        if each.name != MARK:
            each.unlink(missing_ok=True)
    (folder / MARK).unlink(missing_ok=True)
    folder.rmdir()
