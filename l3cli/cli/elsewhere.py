"""What workers of other machines do for l3 render: read a raw frame or take the one they are sent, render it, send the
picture, as the content of its file where it becomes one."""

import collections
import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from l3cli.cli.sequence import Exposed, Look, Unread, file_of, pixels_of
from l3cli.errors import InputFileError, L3Error
from l3cli.files import require_same
from l3cli.frame import RawFrame
from l3cli.io.raw_files import KnownBetter, read_raw
from l3cli.io.sequences import Pending
from l3cli.parallel import Crew

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable
    from l3cli.render.renderer import Renderer


@dataclass(frozen=True)
class Way:
    """What all frames share."""

    table: Path  # absolute: workers open it
    digest: str  # SHA-256 of the table
    backend: str
    engine: Mapping[str, str | None]  # the backend's options
    known: KnownBetter
    look: Look
    suffix: str | None  # of the picture files; None: pixels are wanted


@dataclass(frozen=True)
class Order:
    """A frame to be rendered."""

    way: Way
    frame: RawFrame | Unread
    scale: float  # of exposure; 0: the frame's own


class Elsewhere:
    """Renders frames by the workers of other machines."""

    def __init__(self, crew: Crew, way: Way, by_path: bool) -> None:
        """`by_path`: workers read the files themselves."""
        self._crew, self._way, self.by_path = crew, way, by_path

    def develop(self, exposed: Iterator[Exposed]) -> Iterator[tuple[Pending, Any]]:
        """Pixels of each frame, content of its picture's file, or what is wrong with it, in order."""
        away: collections.deque[Pending] = collections.deque()

        def orders() -> Iterator[Order]:
            for pending, frame, scale in exposed:
                away.append(pending)
                yield Order(self._way, frame, scale)

        for made in self._crew(_developed, orders()):
            yield away.popleft(), made


def _developed(order: Order) -> Any:
    """In a worker: the picture of a frame, or what is wrong with its file."""
    way = order.way
    table, renderer = _renderer(way.table, way.digest, way.backend, tuple(way.engine.items()))
    frame = order.frame
    if isinstance(frame, Unread):
        try:
            require_same(frame.path, frame.digest)
            frame = read_raw(frame.path, table, way.known)
        except (L3Error, OSError) as error:
            return error if isinstance(error, L3Error) else InputFileError(str(error))
    pixels = pixels_of(renderer, frame, way.look, order.scale)
    if way.suffix is None:
        return pixels
    return file_of(Path(f"frame{way.suffix}"), pixels, table.outputs)


@functools.lru_cache(1)
def _renderer(
    path: Path, digest: str, backend: str, engine: tuple[tuple[str, str | None], ...]
) -> "tuple[TransformTable, Renderer]":
    """The table and what renders through it, made once a worker."""
    from l3cli.artifacts.store import load
    from l3cli.artifacts.table import TransformTable
    from l3cli.render.renderer import make_renderer

    require_same(path, digest)
    table = load(TransformTable, path)
    return table, make_renderer(backend, table, **dict(engine))
