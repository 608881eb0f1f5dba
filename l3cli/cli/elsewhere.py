"""What workers of other machines do for l3 render: read a raw frame or take the one they are sent, render it, send the
picture, as the content of its file where it becomes one."""

import collections
import functools
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l3cli.cli.sequence import DEPTH, Look, Taken, Target, pixels_of, write_pixels
from l3cli.errors import InputFileError, L3Error
from l3cli.files import require_same, sha256
from l3cli.frame import RawFrame
from l3cli.io.raw_files import KnownBetter, read_raw
from l3cli.parallel import Crew, ahead

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable
    from l3cli.render.renderer import Renderer


@dataclass(frozen=True)
class Way:
    """What all frames share."""

    table: Path
    digest: str  # SHA-256 of the table
    backend: str
    known: KnownBetter
    look: Look
    suffix: str | None  # of the picture files; None: pixels are wanted


@dataclass(frozen=True)
class Order:
    """A frame to be rendered."""

    way: Way
    frame: RawFrame | Path
    digest: str  # SHA-256 of the file, if the worker is to read it
    scale: float  # as Taken


class Elsewhere:
    """Renders frames by the workers of other machines."""

    by_path = True

    def __init__(self, crew: Crew, way: Way) -> None:
        self._crew, self._way = crew, way

    def develop(self, frames: Iterator[Taken]) -> Iterator[tuple[Taken, Any]]:
        """Every frame with its pixels, its file's content, or what is wrong with it; None where there is nothing to do."""
        passed: collections.deque[Taken] = collections.deque()  # those whose turn has not come

        def orders() -> Iterator[Order]:
            for each in ahead(frames, DEPTH):
                passed.append(each)
                if each.frame is not None:
                    digest = sha256(each.frame) if isinstance(each.frame, Path) else ""
                    yield Order(self._way, each.frame, digest, each.scale)

        for made in self._crew(_developed, orders()):
            while passed[0].frame is None:
                yield passed.popleft(), None
            yield passed.popleft(), made
        for each in passed:
            yield each, None


def make_way(table: Path, backend: str, known: KnownBetter, look: Look, target: Target) -> Way:
    """What workers are told; they open the table by its path."""
    suffix = target.file(0, "frame").suffix if target.one_by_one else None
    return Way(table.absolute(), sha256(table), backend, known, look, suffix)


def _developed(order: Order) -> Any:
    """In a worker: the picture of a frame, or what is wrong with its file."""
    way = order.way
    table, renderer = _renderer(way.table, way.digest, way.backend)
    frame = order.frame
    if isinstance(frame, Path):
        try:
            require_same(frame, order.digest)
            frame = read_raw(frame, table, way.known)
        except (L3Error, OSError) as error:
            return error if isinstance(error, L3Error) else InputFileError(str(error))
    pixels = pixels_of(renderer, frame, way.look, order.scale)
    if way.suffix is None:
        return pixels
    with tempfile.TemporaryDirectory(prefix="l3-") as folder:
        file = Path(folder) / f"frame{way.suffix}"
        write_pixels(file, pixels, table.outputs)
        return file.read_bytes()


@functools.lru_cache(1)
def _renderer(path: Path, digest: str, backend: str) -> "tuple[TransformTable, Renderer]":
    """The table and what renders through it, made once a worker."""
    from l3cli.artifacts.base import load
    from l3cli.artifacts.table import TransformTable
    from l3cli.render.renderer import make_renderer

    require_same(path, digest)
    table = load(TransformTable, path)
    return table, make_renderer(backend, table)
