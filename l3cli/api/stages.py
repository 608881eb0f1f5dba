"""The four stages and evaluation, as functions of files or artifacts."""

import functools
from collections.abc import Callable, Sequence
from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from l3cli.api.artifacts import Name, file_of
from l3cli.artifacts import store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import RecipeError
from l3cli.recipes.builtin import find_recipe
from l3cli.stages.console import Console, Silent

P = ParamSpec("P")
R = TypeVar("R")


def _in_one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """`function` while BLAS computes in one thread, as in the command: the number of cores must not change how it rounds."""

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        import scipy.linalg  # noqa: F401 # whose BLAS is another one, which has to be there to be limited
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@_in_one_blas_thread
def calibrate(
    measurements: Name | None, output: Name, *, photos: Sequence[Name] = (), light: str | None = None,
    export: Name | None = None, accept: bool = False, jobs: int = 1, force: bool = False, console: Console | None = None,
) -> CameraModel:  # fmt: skip
    """Return the camera model of a measurement file, or (None) of raw photos of a chart, also written to `output` (`l3
    calibrate`).

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


@_in_one_blas_thread
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

    with file_of(camera, "cameras") as file:
        stage.simulate(
            find_recipe(str(scenes), "scenes"), file, Path(output), console or Silent(), pictures=_optional(pictures),
            dng=_optional(dng), resume=resume, skip_bad=skip_bad, seed=seed, jobs=jobs, force=force,
        )  # fmt: skip
    return store.load(TrainingSet, Path(output))


@_in_one_blas_thread
def train(
    training: Name | Sequence[Name], output: Name, *, classes: Name | None = None, shares: Sequence[float] | None = None,
    seed: int = 0, jobs: int = 1, force: bool = False, console: Console | None = None,
) -> TransformTable:  # fmt: skip
    """Return the transform table learned from one or more training sets, also written to `output` (`l3 train`).

    `classes`: class recipe, a file or the name of one that comes with l3. `shares`: patches of each set in this proportion.
    """
    from l3cli.stages.training import whole

    sets = (training,) if isinstance(training, str | PathLike) else tuple(training)
    parts = None if shares is None else tuple(Fraction(share).limit_denominator(10**12) for share in shares)
    if parts is not None and (len(parts) != len(sets) or min(parts) < 0 or not any(parts)):
        raise RecipeError(f"{len(sets)} training sets need as many shares, none below zero and one above")
    recipe = None if classes is None else find_recipe(str(classes), "classes")
    return whole.train(
        tuple(map(Path, sets)), Path(output), console or Silent(), classes=recipe, shares=parts, seed=seed, jobs=jobs,
        force=force,
    )  # fmt: skip


@_in_one_blas_thread
def render(
    table: Name | TransformTable, inputs: Name | Sequence[Name], output: Name, *, console: Console | None = None,
    **options: Any,
) -> int:  # fmt: skip
    """Render raw files or a sequence into a picture, numbered files, a folder or a video (`l3 render`); how many frames were
    left out. `options` are those of `l3cli.stages.rendering.render.render`. For arrays in memory there is `Renderer`."""
    from l3cli.stages.rendering import render as stage

    files = (inputs,) if isinstance(inputs, str | PathLike) else tuple(inputs)
    with file_of(table) as file:
        return stage.render(file, tuple(map(Path, files)), Path(output), console or Silent(), **options).failures


@_in_one_blas_thread
def evaluate(
    table: Name | TransformTable, frames: Name, *, viewing: float = 50.0, border: int | None = None,
    pictures: Name | None = None, rivals: Sequence[Name] = (), backend: str = "opencl", force: bool = False,
    console: Console | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the document of `l3 evaluate --json`: figures of a table on the frames of a training set that it has not seen.

    `viewing`: samples a degree of S-CIELAB. `border`: pixels left out at each edge of a frame; None: those whose patch is
    not inside it. `pictures`: folder for ours, ideal, basic and error pictures. `rivals`: folders of sRGB pictures of the
    frames by other pipelines, in their order.
    """
    from l3cli.stages import evaluation

    with file_of(table) as file:
        return evaluation.evaluate(
            file,
            Path(frames),
            console or Silent(),
            backend=backend,
            viewing=viewing,
            border=border,
            pictures=_optional(pictures),
            rivals=tuple(map(Path, rivals)),
            force=force,
        )


def _optional(path: Name | None) -> Path | None:
    return None if path is None else Path(path)
