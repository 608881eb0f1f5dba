"""Renderers of frames: this process, or the workers of other machines, which read a raw frame or take the one that they are
sent, render it, and send the picture, as the content of its file where it becomes one."""

import collections
import contextlib
import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from l3cli.errors import InputFileError, L3Error
from l3cli.frames.correction import CameraFile, correction_again
from l3cli.frames.frame import RawFrame, upright
from l3cli.io.pictures.dng import raw_values
from l3cli.io.pictures.registry import BY_SUFFIX, Label, Picture, picture_file
from l3cli.io.raw.files import RawOverrides, read_raw
from l3cli.io.sequences import FrameReference
from l3cli.parallel import WorkerPool
from l3cli.parallel.threads import BackgroundTask
from l3cli.rendering.conditions import Mix, mixed
from l3cli.rendering.display import Display
from l3cli.rendering.rendition import Rendition, rendered, shown
from l3cli.rendering.white.scene_white import WhiteBalance
from l3cli.system.files import require_same

if TYPE_CHECKING:
    from l3cli.artifacts.table import TransformTable
    from l3cli.frames.shading import Shading
    from l3cli.parallel.cluster import Scheduler
    from l3cli.rendering.renderer import Renderer


@dataclass(frozen=True)
class Unread:
    """A frame that whoever renders it is to read."""

    path: Path
    digest: str  # SHA-256 of the file


@dataclass(frozen=True)
class Exposed:
    """A frame to be rendered, and how it is shown."""

    reference: FrameReference
    frame: RawFrame | Unread
    scale: float  # of its exposure, 0: automatic
    balance: WhiteBalance | None  # its own; None: the rendition's


class Local:
    """Renderer of frames in this process."""

    by_path = False  # whether it reads files itself

    def __init__(self, renderer: "Renderer", setup: "RenderSetup") -> None:
        self._renderer, self._setup = renderer, setup

    def render(self, exposed: Iterator[Exposed]) -> Iterator[tuple[FrameReference, Any]]:
        """Yield each frame rendered, in order.

        Pictures whose exposure is known beforehand overlap on the device: while one is written the next is at work.
        """
        at_work: collections.deque[tuple[FrameReference, RawFrame]] = collections.deque()

        setup, rendition, outputs = self._setup, self._setup.rendition, self._renderer.table.outputs
        usual = rendition.balance
        if usual is None or rendition.is_linear:
            for each in exposed:
                made = rendered(self._renderer, frame := _read(each), rendition, each.scale, each.balance)
                yield each.reference, picture_of(made, frame, each.reference.identity, setup, outputs)
            return

        def displayed() -> Iterator[tuple[RawFrame, Display]]:
            for each in exposed:
                frame = _read(each)
                at_work.append((each.reference, frame))
                yield shown(self._renderer, frame, rendition, each.balance or usual, each.scale)

        for picture in self._renderer.pictures(displayed()):
            reference, frame = at_work.popleft()
            made = upright(picture, frame.orientation), 0.0
            yield reference, picture_of(made, frame, reference.identity, setup, outputs)


def _read(exposed: Exposed) -> RawFrame:
    assert isinstance(exposed.frame, RawFrame)  # who renders here leaves no file unread
    return exposed.frame


@dataclass(frozen=True)
class RenderSetup:
    """Settings that all frames share."""

    table: Path  # absolute: workers open it
    digest: str  # SHA-256 of the table
    backend: str
    engine: Mapping[str, str | None]  # the backend's options
    known: RawOverrides
    rendition: Rendition
    suffix: str | None  # of the picture files; None: pixels are wanted
    camera: CameraFile | None = None  # whose defects and flat field are corrected
    mix: Mix | None = None  # of the table's lights


@dataclass(frozen=True)
class RenderJob:
    """A frame to be rendered."""

    setup: RenderSetup
    frame: RawFrame | Unread
    scale: float  # of exposure; 0: automatic
    balance: WhiteBalance | None  # the frame's own
    identity: str  # of the frame, as its picture states it


class Remote:
    """Renderer of frames by the workers of other machines."""

    def __init__(self, pool: WorkerPool, setup: RenderSetup, by_path: bool, shading: "Shading | None" = None) -> None:
        """Begin with no workers. `by_path`: they read the files; `shading`: of the setup's camera, which they know."""
        self._pool, self._setup, self.by_path, self._shading = pool, setup, by_path, shading

    def render(self, exposed: Iterator[Exposed]) -> Iterator[tuple[FrameReference, Any]]:
        """Yield each frame rendered, the content of its picture's file, or what is wrong with it, in order."""
        away: collections.deque[FrameReference] = collections.deque()

        def jobs() -> Iterator[RenderJob]:
            for each in exposed:
                frame = each.frame
                away.append(each.reference)
                if isinstance(frame, RawFrame) and frame.shading is self._shading:
                    frame = replace(frame, shading=None)  # larger than the frame, and the same for all
                yield RenderJob(self._setup, frame, each.scale, each.balance, each.reference.identity)

        for made in self._pool(_rendered, jobs()):
            yield away.popleft(), made


def picture_of(
    made: tuple[NDArray[Any], float], frame: RawFrame, identity: str, setup: RenderSetup, outputs: tuple[str, ...]
) -> Picture:
    """Return the content of a frame's file from what was `rendered` of it; `outputs`: names of the table's."""
    (pixels, scale), rendition = made, setup.rendition
    names = outputs if rendition.balance is None else rendition.names
    pixels = raw_values(pixels, rendition.mosaic) if rendition.raw else pixels
    return Picture(pixels, rendition.space, Label(frame.shot, frame.exposure, setup.digest, identity), names, scale)


def _rendered(job: RenderJob) -> Any:
    """Return, in a worker, the picture of a frame, or what is wrong with its file."""
    setup = job.setup
    pictures = setup.rendition.balance is not None
    about = (setup.table, setup.digest, setup.backend, tuple(setup.engine.items()), pictures, setup.mix)
    table, renderer = _renderer(*about)
    frame = job.frame
    correction = None if setup.camera is None else correction_again(setup.camera)
    if isinstance(frame, Unread):
        try:
            require_same(frame.path, frame.digest)
            frame = read_raw(frame.path, table, replace(setup.known, correction=correction))
        except (L3Error, OSError) as error:
            return error if isinstance(error, L3Error) else InputFileError(str(error))
    elif correction is not None and frame.shading is None:
        frame = replace(frame, shading=correction.shading)  # its defects are corrected already
    made = rendered(renderer, frame, setup.rendition, job.scale, job.balance)
    picture = picture_of(made, frame, job.identity, setup, table.outputs)
    return picture if setup.suffix is None else picture_file(Path(f"frame{setup.suffix}"), picture)


@functools.lru_cache(1)
def _renderer(
    path: Path, digest: str, backend: str, engine: tuple[tuple[str, str | None], ...], pictures: bool, mix: Mix | None
) -> "tuple[TransformTable, Renderer]":
    """Return the table, of `pictures` X, Y, Z alone, mixed for a light, and what renders through it, made once a worker."""
    from l3cli.artifacts.store import load
    from l3cli.artifacts.table import TransformTable
    from l3cli.rendering.renderer import NoiseRenderer

    require_same(path, digest)
    table = load(TransformTable, path)
    table = mixed(table.pictured() if pictures else table, mix)
    return table, NoiseRenderer(backend, table, **dict(engine))


def while_reading(
    backend: str, engine: Mapping[str, str | None], suffix: str | None, scheduler: "Scheduler | None"
) -> contextlib.AbstractContextManager[None]:
    """Prepare, while a table is read, what this process renders and writes files of a suffix with. `engine`: options of the
    backend."""
    from l3cli.rendering.renderer import make_ready

    def work() -> None:
        if scheduler is None:
            make_ready(backend, **engine)
        if suffix is not None:
            BY_SUFFIX[suffix.lower()].make_ready()

    return BackgroundTask(work)


class Renderers:
    """Maker of renderers, which keeps the last one, for runs one after the other: to make one takes a while, and what OpenCL
    has built of it stays in memory."""

    def __init__(self) -> None:
        self._renderers: dict[Any, Renderer] = {}

    def of(self, setup: RenderSetup, table: "TransformTable") -> "Renderer":
        """Return the renderer of a run."""
        from l3cli.rendering.renderer import NoiseRenderer

        key = setup.digest, table.outputs, setup.backend, tuple(setup.engine.items()), setup.mix
        if key not in self._renderers:
            self._renderers = {key: NoiseRenderer(setup.backend, table, **setup.engine)}
        return self._renderers[key]

    def forget(self) -> None:
        """Drop all after an error: one may be in the middle of a frame."""
        self._renderers = {}


@contextlib.contextmanager
def executor_of(
    setup: RenderSetup, table: "TransformTable", scheduler: "Scheduler | None", renderers: Renderers
) -> "Iterator[Local | Remote]":
    """Return who renders: this process, or the workers of a scheduler."""
    from l3cli.parallel import workers

    if scheduler is None:
        yield Local(renderers.of(setup, table), setup)
    else:
        with workers(1, scheduler) as pool:
            known, correction = replace(setup.known, dark=None, correction=None), setup.known.correction
            shading = None if correction is None else correction.shading
            by_path = setup.known.dark is None and not setup.known.gains
            yield Remote(pool, replace(setup, known=known), by_path=by_path, shading=shading)
