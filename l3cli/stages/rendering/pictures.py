"""The step from a measured frame to its finished picture, in this process or on the workers of other machines.

Both go through `PictureMaker.pictures`. A worker also reads the file, if the frame was not measured here, and encodes the
picture's file.
"""

import functools
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from l3cli.artifacts.store import load
from l3cli.artifacts.table import TransformTable
from l3cli.errors import InputFileError, L3Error
from l3cli.frames.correction import CameraFile, correction_again
from l3cli.frames.frame import RawFrame, upright
from l3cli.io.pictures.dng import raw_values
from l3cli.io.pictures.registry import Label, Picture, picture_file
from l3cli.io.raw.files import RawOverrides, read_raw
from l3cli.parallel import WorkerPool, workers
from l3cli.rendering.conditions import Mix, mixed
from l3cli.rendering.display import Display
from l3cli.rendering.renderer import NoiseRenderer, Renderer
from l3cli.rendering.rendition import Rendition, frame_and_display, rendered
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look
from l3cli.stages.rendering.reading import FrameTask
from l3cli.system.files import require_same

if TYPE_CHECKING:
    from l3cli.frames.shading import Shading


@dataclass(frozen=True)
class RenderSetup:
    """Settings that all frames of a run share."""

    table: Path  # absolute, because workers open it
    digest: str  # SHA-256 of the table
    backend: str
    engine: Mapping[str, str | None]  # options of the backend
    overrides: RawOverrides
    rendition: Rendition
    suffix: str | None  # suffix of the picture files; None if pixels are wanted
    camera: CameraFile | None = None  # camera model whose defects and flat field are corrected
    light_mix: Mix | None = None  # lights of the table


def setup_of(job: Job, look: Look) -> RenderSetup:
    """Return the settings of a run."""
    return RenderSetup(
        job.table_file.absolute(), job.digest, job.options.backend, job.engine, look.overrides, look.rendition,
        job.destination.file_suffix, job.camera, look.light_mix,
    )  # fmt: skip


class PictureMaker:
    """Makes the pictures of frames."""

    def __init__(self, setup: RenderSetup, renderer: Renderer) -> None:
        self._setup, self._renderer = setup, renderer

    def pictures(self, tasks: Iterable[FrameTask]) -> Iterator[tuple[FrameTask, Picture]]:
        """Yield each frame with its picture, in order.

        If the exposures are known beforehand, the device computes the next picture while the caller uses one.
        """
        rendition = self._setup.rendition
        usual = rendition.balance
        if usual is None or rendition.is_linear:
            for task in tasks:
                pixels, scale = rendered(self._renderer, _frame(task), rendition, task.scale, task.balance)
                yield task, self._picture(task, pixels, scale)
            return
        started: deque[FrameTask] = deque()

        def displayed() -> Iterator[tuple[RawFrame, Display]]:
            for task in tasks:
                started.append(task)
                yield frame_and_display(self._renderer, _frame(task), rendition, task.balance or usual, task.scale)

        for pixels in self._renderer.pictures(displayed()):
            task = started.popleft()
            yield task, self._picture(task, upright(pixels, _frame(task).orientation), task.scale)

    def _picture(self, task: FrameTask, pixels: NDArray[Any], scale: float) -> Picture:
        frame, rendition = _frame(task), self._setup.rendition
        names = self._renderer.table.outputs if rendition.balance is None else rendition.names
        values = raw_values(pixels, rendition.mosaic) if rendition.raw else pixels
        label = Label(frame.shot, frame.exposure, self._setup.digest, task.identity)
        return Picture(values, rendition.space, label, names, scale)


def _frame(task: FrameTask) -> RawFrame:
    assert task.frame is not None
    return task.frame


class LocalPictures:
    """Makes pictures in this process."""

    workers_read = False

    def __init__(self, setup: RenderSetup, renderer: Renderer) -> None:
        self.pictures = PictureMaker(setup, renderer).pictures


class RemotePictures:
    """Makes pictures on workers of other machines. If each frame becomes a file, workers make the content of the file.

    Parameters
    ----------
    pool : WorkerPool
    setup : RenderSetup
        The dark frame, the gains of frames and the corrections are not sent to workers.
    """

    def __init__(self, pool: WorkerPool, setup: RenderSetup) -> None:
        overrides = setup.overrides
        self.workers_read = overrides.dark is None and not overrides.gains
        self._pool, self._setup = pool, replace(setup, overrides=replace(overrides, dark=None, correction=None))
        self._shading = None if overrides.correction is None else overrides.correction.shading

    def pictures(self, tasks: Iterable[FrameTask]) -> Iterator[tuple[FrameTask, Any]]:
        """Yield each frame in order, with its picture, the content of its file, or the error in its input."""
        sent: deque[FrameTask] = deque()

        def jobs() -> Iterator[tuple[RenderSetup, FrameTask]]:
            for task in tasks:
                sent.append(replace(task, frame=None))
                yield self._setup, _without_shading(task, self._shading)

        for picture in self._pool(_made_by_worker, jobs()):
            yield sent.popleft(), picture


def _without_shading(task: FrameTask, shading: "Shading | None") -> FrameTask:
    """Return the frame without the camera model's shading, which is larger than the frame and which workers know."""
    if task.frame is None or shading is None or task.frame.shading is not shading:
        return task
    return replace(task, frame=replace(task.frame, shading=None))


def _made_by_worker(job: tuple[RenderSetup, FrameTask]) -> Any:
    """Return the picture of a frame, the content of its file, or the error in its input. This runs in a worker."""
    setup, sent = job
    table, renderer = _renderer_of_worker(
        setup.table,
        setup.digest,
        setup.backend,
        tuple(setup.engine.items()),
        setup.rendition.balance is not None,
        setup.light_mix,
    )
    try:
        task = _read_by_worker(sent, setup, table)
    except (L3Error, OSError) as error:
        return error if isinstance(error, L3Error) else InputFileError(str(error))
    ((_, picture),) = PictureMaker(setup, renderer).pictures([task])
    return picture if setup.suffix is None else picture_file(Path(f"frame{setup.suffix}"), picture)


def _read_by_worker(task: FrameTask, setup: RenderSetup, table: TransformTable) -> FrameTask:
    """Return the frame, read from its file if it was not sent, with the corrections of the camera model."""
    correction = None if setup.camera is None else correction_again(setup.camera)
    if task.frame is None:
        assert task.reference.source is not None
        source = task.reference.source.absolute()
        require_same(source, task.digest)
        return replace(task, frame=read_raw(source, table, replace(setup.overrides, correction=correction)))
    if correction is not None and task.frame.shading is None:  # defects were corrected before it was sent
        return replace(task, frame=replace(task.frame, shading=correction.shading))
    return task


@functools.lru_cache(1)
def _renderer_of_worker(
    path: Path, digest: str, backend: str, engine: tuple[tuple[str, str | None], ...], pictures: bool, light_mix: Mix | None
) -> tuple[TransformTable, Renderer]:
    """Return the table and its renderer. A worker makes them once for all frames."""
    require_same(path, digest)
    loaded = load(TransformTable, path)
    table = mixed(loaded.pictured() if pictures else loaded, light_mix)
    return table, NoiseRenderer(backend, table, **dict(engine))


class Renderers:
    """Keeps the last renderer for the next clip, because making one takes a while and OpenCL never frees what it builds."""

    def __init__(self) -> None:
        self._renderers: dict[Any, Renderer] = {}

    def of(self, setup: RenderSetup, table: TransformTable) -> Renderer:
        """Return the renderer of a run."""
        key = setup.digest, table.outputs, setup.backend, tuple(setup.engine.items()), setup.light_mix
        if key not in self._renderers:
            self._renderers = {key: NoiseRenderer(setup.backend, table, **setup.engine)}
        return self._renderers[key]

    def forget(self) -> None:
        """Drop the renderer, because after an error it may be in the middle of a frame."""
        self._renderers = {}


@contextmanager
def picture_makers(job: Job, look: Look, renderers: Renderers) -> Iterator[LocalPictures | RemotePictures]:
    """Yield the object that makes the pictures of a run, in this process or on the workers of a scheduler."""
    setup = setup_of(job, look)
    if job.scheduler is None:
        yield LocalPictures(setup, renderers.of(setup, look.table))
    else:
        with workers(1, job.scheduler) as pool:
            yield RemotePictures(pool, setup)
