"""Rendering of frames to finished pictures, in this process or in workers on other machines.

Both use `PictureMaker`. If each picture is a separate file, workers also encode the files. They then usually read the frames
too, unless the frames must be measured or temporally filtered first.
"""

import functools
import itertools
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
from l3cli.rendering.polarisation import names_in_files
from l3cli.rendering.renderer import NoiseRenderer, Renderer
from l3cli.rendering.rendition import Rendition, frame_and_display, rendered
from l3cli.rendering.white.scene_white import WhiteBalance
from l3cli.stages.rendering.job import Job
from l3cli.stages.rendering.look import Look
from l3cli.stages.rendering.reading import FrameTask
from l3cli.system.files import require_same

if TYPE_CHECKING:
    from l3cli.frames.shading import Shading


@dataclass(frozen=True)
class RenderSetup:
    """Settings that all frames of a run share."""

    table: Path  # absolute path, because workers may have another working directory
    digest: str  # SHA-256 of the table
    backend: str
    engine: Mapping[str, str | None]  # options of the backend
    overrides: RawOverrides
    rendition: Rendition
    suffix: str | None  # suffix of the picture files; None if the frames do not become separate files
    camera: CameraFile | None = None  # camera model with the defects and the flat field to correct
    light_mix: Mix | None = None  # mixture of the table's illuminants whose transforms are used


def setup_of(job: Job, look: Look) -> RenderSetup:
    return RenderSetup(
        job.table_file.absolute(), job.digest, job.options.backend, job.engine, look.overrides, look.rendition,
        job.destination.file_suffix, job.camera, look.light_mix,
    )  # fmt: skip


class PictureMaker:
    """Renders the frames of a run to finished pictures, one after another."""

    def __init__(self, setup: RenderSetup, renderer: Renderer) -> None:
        self._setup, self._renderer = setup, renderer

    def pictures(self, tasks: Iterable[FrameTask]) -> Iterator[tuple[FrameTask, Picture]]:
        """Yield each frame with its picture, in order.

        While the caller processes a picture, the device already renders the next frame, unless exposures depend on outputs.
        """
        rendition = self._setup.rendition
        usual = rendition.balance
        for warps, run in itertools.groupby(tasks, key=lambda task: bool(_frame(task).warps)):
            if usual is None or rendition.is_linear or warps:
                for task in run:
                    pixels, scale = rendered(self._renderer, _frame(task), rendition, task.scale, task.balance)
                    yield task, self._picture(task, pixels, scale)
            else:
                yield from self._displayed(run, usual)

    def _displayed(self, tasks: Iterable[FrameTask], usual: WhiteBalance) -> Iterator[tuple[FrameTask, Picture]]:
        """Yield each frame with its encoded picture. `usual` is for frames without a white balance of their own."""
        started: deque[FrameTask] = deque()

        def displayed() -> Iterator[tuple[RawFrame, Display]]:
            for task in tasks:
                started.append(task)
                balance = task.balance or usual
                yield frame_and_display(self._renderer, _frame(task), self._setup.rendition, balance, task.scale)

        for pixels in self._renderer.pictures(displayed()):
            task = started.popleft()
            yield task, self._picture(task, upright(pixels, _frame(task).orientation), task.scale)

    def _picture(self, task: FrameTask, pixels: NDArray[Any], scale: float) -> Picture:
        frame, rendition = _frame(task), self._setup.rendition
        names = names_in_files(self._renderer.table.outputs) if rendition.balance is None else rendition.names
        values = raw_values(pixels, rendition.mosaic) if rendition.raw else pixels
        label = Label(frame.shot, frame.exposure, self._setup.digest, task.identity)
        return Picture(values, rendition.space, label, names, scale)


def _frame(task: FrameTask) -> RawFrame:
    assert task.frame is not None
    return task.frame


class LocalPictures:
    """Renders pictures in this process."""

    workers_read = False

    def __init__(self, setup: RenderSetup, renderer: Renderer) -> None:
        self.pictures = PictureMaker(setup, renderer).pictures


class RemotePictures:
    """Renders pictures in workers on other machines, which also encode the files if each picture is a separate file.

    Parameters
    ----------
    pool : WorkerPool
        The workers.
    setup : RenderSetup
        Settings of the run. The dark frame and the corrections are not sent to the workers.
    """

    def __init__(self, pool: WorkerPool, setup: RenderSetup) -> None:
        overrides = setup.overrides
        self.workers_read = overrides.dark is None and not overrides.gains
        self._pool, self._setup = pool, replace(setup, overrides=replace(overrides, dark=None, correction=None))
        self._shading = None if overrides.correction is None else overrides.correction.shading

    def pictures(self, tasks: Iterable[FrameTask]) -> Iterator[tuple[FrameTask, Any]]:
        """Yield each frame in order, with its result: a picture, the bytes of a file, or the error in the raw file."""
        sent: deque[FrameTask] = deque()

        def jobs() -> Iterator[tuple[RenderSetup, FrameTask]]:
            for task in tasks:
                sent.append(replace(task, frame=None))
                yield self._setup, _without_shading(task, self._shading)

        for picture in self._pool(_made_by_worker, jobs(), _is_made):
            yield sent.popleft(), picture


def _without_shading(task: FrameTask, shading: "Shading | None") -> FrameTask:
    """Remove the camera model's shading from a frame before it is sent to a worker.

    The shading is larger than the frame itself, so workers read it from the file of the camera model.
    """
    if task.frame is None or shading is None or task.frame.shading is not shading:
        return task
    return replace(task, frame=replace(task.frame, shading=None))


def _made_by_worker(job: tuple[RenderSetup, FrameTask]) -> Any:
    """Render a frame in a worker, and return the picture, the bytes of its file, or the error in the raw file."""
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


def _is_made(job: tuple[RenderSetup, FrameTask], made: Any) -> bool:
    """Return whether a result from another machine has the type and size that `_made_by_worker` returns."""
    setup, task = job
    if isinstance(made, L3Error):
        return True
    if setup.suffix is not None:
        return isinstance(made, bytes) and len(made) > 0
    rendition, pixels = setup.rendition, made.pixels
    of_frame = True
    if task.frame is not None:
        rows, cols = upright(task.frame.values, task.frame.orientation).shape
        # Pictures of polarisation are wider than the frame, because a colour bar, and perhaps more panels, are beside it.
        width_fits = pixels.shape[1] == cols if rendition.polarisation is None else pixels.shape[1] > cols
        of_frame = pixels.shape[0] == rows and width_fits
    return isinstance(made, Picture) and of_frame and (rendition.raw or 8 * pixels.itemsize == rendition.bits)


def _read_by_worker(task: FrameTask, setup: RenderSetup, table: TransformTable) -> FrameTask:
    """Add the frame and the camera model's corrections to a task, in a worker.

    If the task contains no frame, the frame is read and corrected. Otherwise only the shading of the camera model is added,
    because defects have already been corrected.
    """
    correction = None if setup.camera is None else correction_again(setup.camera)
    if task.frame is None:
        assert task.reference.source is not None
        source = task.reference.source.absolute()
        require_same(source, task.digest)
        return replace(task, frame=read_raw(source, table, replace(setup.overrides, correction=correction)))
    if correction is not None and task.frame.shading is None:  # defects were corrected before the frame was sent
        return replace(task, frame=replace(task.frame, shading=correction.shading))
    return task


@functools.lru_cache(1)
def _renderer_of_worker(
    path: Path, digest: str, backend: str, engine: tuple[tuple[str, str | None], ...], pictures: bool, light_mix: Mix | None
) -> tuple[TransformTable, Renderer]:
    """Return the table and its renderer, which a worker creates once and uses for all frames."""
    require_same(path, digest)
    loaded = load(TransformTable, path)
    table = mixed(loaded.pictured() if pictures else loaded, light_mix)
    return table, NoiseRenderer(backend, table, **dict(engine))


class Renderers:
    """Cache of the latest renderer, which is reused for the next clip if the settings are the same.

    Creating a renderer takes time, and OpenCL never frees compiled programs.
    """

    def __init__(self) -> None:
        self._renderers: dict[Any, Renderer] = {}

    def of(self, setup: RenderSetup, table: TransformTable) -> Renderer:
        """Return the renderer for the settings of a run."""
        key = setup.digest, table.outputs, setup.backend, tuple(setup.engine.items()), setup.light_mix
        if key not in self._renderers:
            self._renderers = {key: NoiseRenderer(setup.backend, table, **setup.engine)}
        return self._renderers[key]

    def forget(self) -> None:
        """Empty the cache. After an error, the renderer may be in the middle of a frame."""
        self._renderers = {}


@contextmanager
def picture_makers(job: Job, look: Look, renderers: Renderers) -> Iterator[LocalPictures | RemotePictures]:
    """Context manager that yields the object that renders a run's pictures, in this process or in workers."""
    setup = setup_of(job, look)
    if job.scheduler is None:
        yield LocalPictures(setup, renderers.of(setup, look.table))
    else:
        with workers(1, job.scheduler) as pool:
            yield RemotePictures(pool, setup)
