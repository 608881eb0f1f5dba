"""Parts of a design stage's work, stored as they are finished, so that the same run goes on where it was stopped."""

import contextlib
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from l3cli.errors import L3Error, RecipeError
from l3cli.parallel import WorkerPool
from l3cli.system.checkpoint import Checkpoint
from l3cli.system.console import Console
from l3cli.system.files import is_ours, refuse_protected, sweep, write_whole
from l3cli.system.ledger import dated

T = TypeVar("T")
Arrays = Mapping[str, NDArray]
RUN = "run"  # name of the checkpoint in the folder


class Parts:
    """The finished parts of the run `key`, in a folder beside its `output`: each some arrays, by name."""

    def __init__(self, output: Path, key: str) -> None:
        self.folder = output.with_name(f"{output.name}.parts")
        self._checkpoint = Checkpoint(self.folder / RUN, key)

    @contextlib.contextmanager
    def held(self, resume: bool, force: bool) -> Iterator[None]:
        """Keep the folder for the block and remove it at its end; where that fails, leave it for a run with `resume`.
        RecipeError if that is of another run, unless `force`; L3Error if the folder is not of l3's making."""
        if self.folder.exists():
            known = self._checkpoint.path.is_file()
            for each in self.folder.iterdir():
                refuse_protected(each)
                if not known and not is_ours(each.name):
                    raise L3Error(f"{self.folder} holds files that l3 did not make; move it elsewhere")
            same = resume and self._checkpoint.take_over()
            if resume and known and not same and not force:
                raise RecipeError(f"{self.folder} is of a run with other inputs; leave ‹resume› out or add ‹force›")
            if not same:
                self._remove()
        self._checkpoint.begin()
        try:
            yield
        except BaseException:
            sweep(self.folder)
            if not any(self.folder.glob("*.npz")):
                self._remove()
            raise
        self._remove()

    def _remove(self) -> None:
        for each in sorted(self.folder.iterdir(), key=lambda path: path.name == RUN):  # the checkpoint last
            each.unlink(missing_ok=True)
        self.folder.rmdir()

    def each(
        self, what: str, work: Callable[[T], Arrays], items: Sequence[T], pool: WorkerPool, console: Console
    ) -> Iterator[dict[str, NDArray]]:
        """Yield the arrays that `work` makes of each item, in order, those of a run before as they are stored."""
        paths = [self.folder / f"{what}-{number:05d}.npz" for number in range(len(items))]
        done = [self._checkpoint.items.get(path.name) == list(dated(path) or ()) for path in paths]
        fresh = pool(work, [item for item, stored in zip(items, done, strict=True) if not stored])
        for path, stored in console.progress(zip(paths, done, strict=True), len(paths), what):
            if not stored:
                content = io.BytesIO()
                np.savez(content, **next(fresh))  # type: ignore[arg-type]
                write_whole(path, content.getvalue())
                self._checkpoint.add(path.name, dated(path))
            with np.load(path, allow_pickle=False) as arrays:
                yield {name: arrays[name] for name in arrays.files}
