"""Parts of a design stage's work, stored as they are finished, so that the same run goes on where it was stopped."""

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from l3cli.parallel import WorkerPool
from l3cli.system.checkpoint import PartsFolder
from l3cli.system.console import Console
from l3cli.system.files import dated, write_whole

T = TypeVar("T")
Arrays = Mapping[str, NDArray]


class Parts(PartsFolder):
    """The finished parts of a run: each some arrays, by name."""

    def each(
        self, what: str, work: Callable[[T], Arrays], items: Sequence[T], pool: WorkerPool, console: Console
    ) -> Iterator[dict[str, NDArray]]:
        """Yield the arrays that `work` makes of each item, in order, those of a run before as they are stored."""
        paths = [self.folder / f"{what}-{number:05d}.npz" for number in range(len(items))]
        done = [self.checkpoint.items.get(path.name) == list(dated(path) or ()) for path in paths]
        fresh = pool(work, [item for item, stored in zip(items, done, strict=True) if not stored])
        for path, stored in console.progress(zip(paths, done, strict=True), len(paths), what):
            if not stored:
                content = io.BytesIO()
                np.savez(content, **next(fresh))  # type: ignore[arg-type]
                write_whole(path, content.getvalue())
                self.checkpoint.add(path.name, dated(path))
            with np.load(path, allow_pickle=False) as arrays:
                yield {name: arrays[name] for name in arrays.files}
