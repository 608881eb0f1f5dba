"""The Python interface: the four stages, evaluation, artifacts, raw frames and a renderer, as `l3cli.NAME`.

    import l3cli as l3

    camera = l3.calibrate("lab/MEASUREMENTS.toml", "camera.h5")
    l3.simulate("default", camera, "training.h5", jobs=2)
    table = l3.train("training.h5", "table.h5", jobs=2)
    picture = l3.Renderer(table).picture(l3.read_raw("frame.dng", table))

Stages take paths or artifacts, write the file that the command of their name writes, byte for byte, and return its content.
They raise the errors of `l3cli.errors`: RecipeError (a wrong call or recipe), InputFileError, DeviceError, L3Error. They say
nothing unless they are given a `console` (`l3cli.stages.console.Console`).
"""

import contextlib
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from l3cli.artifacts import store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.correction import correction_of
from l3cli.errors import InputFileError, RecipeError
from l3cli.frame import RawFrame
from l3cli.io.raw import files as raw_files
from l3cli.io.raw.files import KnownBetter
from l3cli.recipes import find_recipe
from l3cli.rendering.balance import WhiteBalance
from l3cli.rendering.quiet import quiet_renderer
from l3cli.rendering.temporal.chunks import Chunks
from l3cli.rendering.temporal.filters import filters
from l3cli.stages.console import Console, Silent
from l3cli.stages.rendering.following import Following, shown_as
from l3cli.stages.rendering.rendition import OUTPUTS, Rendition, rendered

Name = str | PathLike[str]
KINDS: tuple[type[Artifact], ...] = (CameraModel, TrainingSet, TransformTable)


# ---------------------------------------------------------------------------------------------------------- artifacts


def load(path: Name) -> CameraModel | TransformTable | TrainingSet:
    """The artifact in a file: a camera model, a transform table, or the head of a training set (its frames are read one by
    one through `l3cli.artifacts.training_set.open_training_set`). InputFileError if it holds none, or a byte has changed."""
    with store.open_artifact(Path(path)) as root:
        kind = str(root.attrs["kind"])
    for cls in KINDS:
        if cls.kind == kind:
            return store.load(cls, Path(path))  # type: ignore[return-value]
    raise InputFileError(
        f"{path} holds {kind}, which only l3 train --merge reads; give a camera model, training set or table"
    )


def save(artifact: CameraModel | TransformTable, path: Name) -> None:
    """Write a camera model or a transform table, whole or not at all. L3Error if `path` cannot be written."""
    store.save(artifact, Path(path))


@contextlib.contextmanager
def _file(given: Name | Artifact, kind: str | None = None) -> Iterator[Path]:
    """The file of an artifact: the one that is named (a recipe of a `kind` also by its name), or one made for the while."""
    if not isinstance(given, Artifact):
        yield Path(given) if kind is None else find_recipe(str(given), kind)
        return
    with tempfile.TemporaryDirectory(prefix="l3-") as folder:
        path = Path(folder, "artifact.h5")
        store.save(given, path)
        yield path


# ------------------------------------------------------------------------------------------------------------- stages


def calibrate(
    measurements: Name | None, output: Name, *, photos: Sequence[Name] = (), light: str | None = None,
    export: Name | None = None, accept: bool = False, jobs: int = 1, force: bool = False, console: Console | None = None,
) -> CameraModel:  # fmt: skip
    """The camera model of a measurement file, or (None) of raw photos of a chart, also written to `output` (`l3 calibrate`).

    `photos`, `light`: instead of a measurement file, with a name such as "D65" or "3200K"; None: it is guessed.
    `export`: folder for what `l3 export` writes, and the offsets of photos. `accept`: take a model that
    predicts its charts badly.
    `force`: replace what is there.
    """
    from l3cli.stages import calibration

    camera, _ = calibration.calibrate(
        _optional(measurements),
        Path(output),
        console or Silent(),
        photos=tuple(map(Path, photos)),
        light=light,
        export=_optional(export),
        accept=accept,
        jobs=jobs,
        force=force,
    )
    return camera


def simulate(
    scenes: Name, camera: Name | CameraModel, output: Name, *, pictures: Name | None = None, dng: Name | None = None,
    resume: bool = False, skip_bad: bool = False, seed: int = 0, jobs: int = 1, force: bool = False,
    console: Console | None = None,
) -> TrainingSet:  # fmt: skip
    """Write the training set of a scene recipe and a camera (`l3 simulate`); its head.

    `scenes`, `camera`: files, or names of recipes that come with l3; `camera` also a camera model. `pictures`, `dng`:
    folders for raw and ideal frames. `resume`: go on where a run was stopped. `skip_bad`: leave out scenes that do not fit.
    """
    from l3cli.stages.simulation import simulate as stage

    with _file(camera, "cameras") as file:
        stage.simulate(
            find_recipe(str(scenes), "scenes"), file, Path(output), console or Silent(), pictures=_optional(pictures),
            dng=_optional(dng), resume=resume, skip_bad=skip_bad, seed=seed, jobs=jobs, force=force,
        )  # fmt: skip
    return store.load(TrainingSet, Path(output))


def train(
    training: Name | Sequence[Name], output: Name, *, classes: Name | None = None, shares: Sequence[float] | None = None,
    seed: int = 0, jobs: int = 1, force: bool = False, console: Console | None = None,
) -> TransformTable:  # fmt: skip
    """The transform table learned from one or more training sets, also written to `output` (`l3 train`).

    `classes`: class recipe, a file or the name of one that comes with l3. `shares`: patches of each set in this proportion.
    """
    from l3cli.stages.training import whole

    sets = (training,) if isinstance(training, str | PathLike) else tuple(training)
    parts = None if shares is None else tuple(Fraction(share).limit_denominator(10**12) for share in shares)
    if parts is not None and (len(parts) != len(sets) or min(parts) < 0 or not any(parts)):
        raise RecipeError(f"{len(sets)} training sets need as many shares, none below zero and one above")
    recipe = None if classes is None else find_recipe(str(classes), "classes")
    with _one_blas_thread():
        return whole.train(
            tuple(map(Path, sets)), Path(output), console or Silent(), classes=recipe, shares=parts, seed=seed, jobs=jobs,
            force=force,
        )  # fmt: skip


def render(
    table: Name | TransformTable, inputs: Name | Sequence[Name], output: Name, *, console: Console | None = None,
    **options: Any,
) -> int:  # fmt: skip
    """Render raw files or a sequence into a picture, numbered files, a folder or a video (`l3 render`); how many frames were
    left out. `options` are those of `l3cli.stages.rendering.render.render`. For arrays in memory there is `Renderer`."""
    from l3cli.stages.rendering import render as stage

    files = (inputs,) if isinstance(inputs, str | PathLike) else tuple(inputs)
    with _file(table) as file, _one_blas_thread():
        return stage.render(file, tuple(map(Path, files)), Path(output), console or Silent(), **options).failures


def evaluate(
    table: Name | TransformTable, frames: Name, *, viewing: float = 50.0, border: int | None = None,
    pictures: Name | None = None, backend: str = "opencl", force: bool = False, console: Console | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The document of `l3 evaluate --json`: figures of a table on the frames of a training set that it has not seen.

    `viewing`: samples a degree of S-CIELAB. `border`: pixels left out at each edge of a frame; None: those whose patch is
    not inside it. `pictures`: folder for ours, ideal, basic and error pictures.
    """
    from l3cli.stages import evaluation

    with _file(table) as file:
        return evaluation.evaluate(
            file,
            Path(frames),
            console or Silent(),
            backend=backend,
            viewing=viewing,
            border=border,
            pictures=_optional(pictures),
            force=force,
        )


def _one_blas_thread() -> Any:
    """While it lasts BLAS computes in one thread, as in the command: the number of cores must not change how it rounds."""
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1, user_api="blas")


def _optional(path: Name | None) -> Path | None:
    return None if path is None else Path(path)


# ---------------------------------------------------------------------------------------------------------- rendering


def read_raw(
    path: Name, sensor: TransformTable | CameraModel, *, black_level: float | None = None, white_level: float | None = None,
    phase: tuple[int, int] | None = None, size: tuple[int, int] | None = None, packing: str | None = None,
    stride: int | None = None, exposure: float | None = None, camera: CameraModel | None = None,
) -> RawFrame:  # fmt: skip
    """The raw frame in a file of any format that `l3 render` reads, `values` (row, col) in DN.

    `black_level`, `white_level` (DN), `phase` (CFA row and column of the first pixel), `exposure` (s): known better than
    the file says; `size` (rows, columns), `packing`, `stride` (bytes): of headerless files. `camera`: model whose defects
    and flat field are corrected. InputFileError if it cannot be read, or has another CFA than the `sensor`.
    """
    correction = None if camera is None else correction_of(camera)
    known = KnownBetter(black_level, white_level, phase, size, packing, stride, exposure, correction=correction)
    return raw_files.read_raw(Path(path), sensor, known)


class Renderer:
    """Renders frames through a table, one or thousands, from any number of threads (one at a time is at work).

    A frame is what `read_raw` gives, or an array (row, col) of uint16 at the table's black and white level whose first pixel
    has CFA site (0, 0). `backend`: "opencl" or "reference"; `device`, `variant`: of "opencl", as the command's options.
    """

    def __init__(
        self, table: Name | TransformTable, *, backend: str = "opencl", device: str | None = None, variant: str | None = None
    ) -> None:
        self.table = table if isinstance(table, TransformTable) else store.load(TransformTable, Path(table))
        chosen = {name: value for name, value in {"device": device, "variant": variant}.items() if value is not None}
        self._renderer, self._backend, self._chosen = quiet_renderer(backend, self.table, **chosen), backend, chosen
        self._alone = threading.Lock()

    def picture(
        self, frame: RawFrame | NDArray[np.uint16], *, exposure: float | None = None, white: str | None = None,
        space: str = "srgb", bits: int = 8,
    ) -> NDArray[Any]:  # fmt: skip
        """The picture, upright, (row, col, 3): what `l3 render` writes of the frame. uint8 or uint16 by `bits`; with 32
        float32, linear and not clipped.

        `exposure`: factor of Y, None: the frame's 99th percentile is shown white. `white`: name ("D50", "3200K") or "x,y" of
        the scene's white, "camera" as the file states it, "auto" estimated on the frame, "ROW,COL" or "ROW,COL,SIZE" of a
        grey in the picture, None: the table's. `space`: "srgb", "display-p3", "rec2020" or, linear, "acescg", "xyz".
        RecipeError unless the table's outputs are X, Y, Z, InputFileError if the white cannot be taken from the frame.
        """
        return next(self.pictures([frame], exposure=exposure, white=white, space=space, bits=bits))

    def pictures(
        self, frames: Iterable[RawFrame | NDArray[np.uint16]], *, exposure: float | None = None, white: str | None = None,
        space: str = "srgb", bits: int = 8,
    ) -> Iterator[NDArray[Any]]:  # fmt: skip
        """`picture` of each frame, in order, as they are asked for; each has its automatic exposure."""
        rendition, source = shown_as(self.table, exposure, white, space, bits)
        for each in frames:
            frame = self._frame(each)
            measured = source.white(frame) if source else None
            yield self._pixels(frame, rendition, exposure or 0.0, measured.balance if measured else None)

    def sequence(
        self, rate: Fraction | None, *, exposure: float | None = None, white: str | None = None, space: str = "srgb",
        bits: int = 8, temporal: bool = False,
    ) -> Callable[[RawFrame | NDArray[np.uint16]], NDArray[Any]]:  # fmt: skip
        """What makes the `picture` of each frame of a sequence, called with one after the other. Exposure and white that are
        measured follow at `rate` (frames/s), as in `l3 render` of a sequence; None: they stay those of the first frame that
        it is called with, and the others may come in any order, from any thread. `temporal`: frames come in their order, and
        share what is not noise, as in `l3 render --temporal`; RecipeError if the table does not know its camera's noise."""
        rendition, source = shown_as(self.table, exposure, white, space, bits)
        quiet = Chunks(filters(self._backend, self.table, **self._chosen)) if temporal else None
        following = Following(self.table, rendition, source, rate, quiet)

        def picture(given: RawFrame | NDArray[np.uint16]) -> NDArray[Any]:
            frame, scale, balance = following.shown(self._frame(given))
            return self._pixels(frame, rendition, scale, balance)

        return picture

    def outputs(self, frame: RawFrame | NDArray[np.uint16]) -> NDArray[np.float32]:
        """The table's outputs, upright, (row, col, output); 1 is `table.output_unit` cd s/m²."""
        return self._pixels(self._frame(frame), OUTPUTS, 0.0, None)

    def labels(self, frame: RawFrame | NDArray[np.uint16]) -> NDArray[np.integer]:
        """The class (row, col) of every pixel, as the sensor lies."""
        with self._alone:
            return self._renderer.labels(self._frame(frame))

    def _pixels(self, frame: RawFrame, rendition: Rendition, scale: float, balance: WhiteBalance | None) -> NDArray[Any]:
        with self._alone:
            pixels: NDArray[Any] = rendered(self._renderer, frame, rendition, scale, balance=balance).pixels
        return pixels

    def _frame(self, given: RawFrame | NDArray[np.uint16]) -> RawFrame:
        if isinstance(given, RawFrame):
            return given
        if given.dtype not in (np.uint8, np.uint16):
            raise InputFileError(f"an array of {given.dtype} is no raw frame; give DN as uint16")
        return raw_files.frame_of("the array", {"values": given}, self.table, KnownBetter())
