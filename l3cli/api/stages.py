"""The four stages and evaluation, as functions of files or artifacts, with the options of their commands by keyword;
and artifacts: read, written, and handed to stages, which take files."""

import contextlib
import functools
import inspect
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, get_args, get_origin, overload

from l3cli.artifacts import camera_recipe, store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import InputFileError, suggestion
from l3cli.options.commands import CalibrateOptions, EvaluateOptions, SimulateOptions, TrainOptions
from l3cli.options.option import Given, Options, declarations
from l3cli.options.render import RenderOptions
from l3cli.recipes.builtin import find_recipe
from l3cli.system.text import a

Name = str | PathLike[str]
KINDS: tuple[type[Artifact], ...] = (CameraModel, TrainingSet, TransformTable)


def load(path: Name) -> CameraModel | TransformTable | TrainingSet:
    """Return the artifact in a file of any kind: a camera model, a transform table, or the head of a training set. Where the
    kind is known, `load_camera`, `load_table` and `load_training_set` give its type. InputFileError if the file holds no
    artifact, or a byte has changed."""
    with store.open_artifact(Path(path)) as root:
        kind = str(root.attrs["kind"])
    for cls in KINDS:
        if cls.kind == kind:
            return store.load(cls, Path(path))  # type: ignore[return-value]
    raise InputFileError(
        f"{path} holds {a(kind)}, which only l3 train --merge reads; give a camera model, training set or table"
    )


def load_camera(camera: Name) -> CameraModel:
    """Return the camera model in a file, or of a camera recipe: its file (.toml), or the name of one that comes with l3.

    InputFileError if the file holds none or a byte has changed, RecipeError if the recipe cannot be.
    """
    return camera_recipe.load_camera(find_recipe(str(camera), "cameras"))


def load_table(path: Name) -> TransformTable:
    """Return the transform table in a file. InputFileError if it holds none, or a byte has changed."""
    return store.load(TransformTable, Path(path))


def load_training_set(path: Name) -> TrainingSet:
    """Return the head of the training set in a file: its camera, outputs and history. InputFileError if it holds none, or a
    byte has changed. Frames are read one by one through `l3cli.artifacts.training_set.open_training_set`."""
    return store.load(TrainingSet, Path(path))


def save(artifact: CameraModel | TransformTable, path: Name) -> None:
    """Write a camera model or a transform table, whole or not at all. L3Error if `path` cannot be written."""
    store.save(artifact, Path(path))


@contextlib.contextmanager
def file_of(given: Name | Artifact, kind: str | None = None) -> Iterator[Path]:
    """Yield the file of an artifact: the named one (a recipe of a `kind` also by its name), or one made for the while."""
    if not isinstance(given, Artifact):
        yield Path(given) if kind is None else find_recipe(str(given), kind)
        return
    with tempfile.TemporaryDirectory(prefix="l3-") as folder:
        path = Path(folder, "artifact.h5")
        store.save(given, path)
        yield path


P = ParamSpec("P")
O = TypeVar("O", bound=Options)  # noqa: E741
A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")
R = TypeVar("R")


class by_keyword(Generic[P, O]):
    """Decorator of a function of paths and options: it takes the options by keyword, under the types and with the texts of
    their declarations. BLAS computes in one thread, as in the command: the number of cores must not change how it rounds."""

    def __init__(self, options: Callable[P, O]) -> None:
        self._options: Any = options

    @overload
    def __call__(self, function: Callable[[A, B, O], R]) -> Callable[Concatenate[A, B, P], R]: ...
    @overload
    def __call__(self, function: Callable[[A, B, C, O], R]) -> Callable[Concatenate[A, B, C, P], R]: ...

    def __call__(self, function: Callable[..., Any]) -> Any:
        declared = declarations(self._options)
        *paths, _ = inspect.signature(function).parameters.values()

        @functools.wraps(function)
        def called(*given: Any, **named: Any) -> Any:
            import scipy.linalg  # noqa: F401 # whose BLAS is another one, which has to be there to be limited
            from threadpoolctl import threadpool_limits

            given += tuple(named.pop(each.name) for each in paths[len(given) :] if each.name in named)
            for name in named.keys() - declared.keys() - {"console"}:
                renamed = next((f'it is "{now}" now' for now, each in declared.items() if each.was == name), None)
                raise TypeError(f'{function.__name__} has no option "{name}"; {renamed or suggestion(name, declared)}')
            options = self._options(**named)
            with threadpool_limits(1, user_api="blas"):
                return function(*given, options)

        called.__signature__ = self._signature(paths, function)  # type: ignore[attr-defined]
        called.__doc__ = f"{inspect.getdoc(function)}\n\n" + "\n".join(
            f"{name}: {each.help}" for name, each in declared.items()
        )
        return called

    def _signature(self, paths: list[inspect.Parameter], function: Callable[..., Any]) -> inspect.Signature:
        options = (
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=each.default,
                annotation=get_args(each.type)[0] if get_origin(each.type) is Given else each.type,
            )
            for each in fields(self._options)
        )
        return inspect.Signature([*paths, *options], return_annotation=function.__annotations__["return"])


@by_keyword(CalibrateOptions)
def calibrate(measurements: Name | None, output: Name, options: CalibrateOptions) -> CameraModel:
    """Return the camera model of a measurement file, or (None) of raw photos of a chart, also written to `output` (`l3
    calibrate`)."""
    from l3cli.stages import calibration

    return calibration.calibrate(None if measurements is None else Path(measurements), Path(output), options)[0]


@by_keyword(SimulateOptions)
def simulate(scenes: Name, camera: Name | CameraModel, output: Name, options: SimulateOptions) -> TrainingSet:
    """Write the training set of a scene recipe and a camera, files or names of recipes that come with l3, or a camera model
    (`l3 simulate`); its head."""
    from l3cli.stages.simulation import simulate as stage

    with file_of(camera, "cameras") as file:
        stage.simulate(find_recipe(str(scenes), "scenes"), file, Path(output), options)
    return store.load(TrainingSet, Path(output))


@by_keyword(TrainOptions)
def train(training: Name | Sequence[Name], output: Name, options: TrainOptions) -> TransformTable:
    """Return the transform table learned from one or more training sets, also written to `output` (`l3 train`)."""
    from l3cli.stages.training import train as stage

    return stage.train(_paths(training), Path(output), options)


@by_keyword(RenderOptions)
def render(table: Name | TransformTable, inputs: Name | Sequence[Name], output: Name, options: RenderOptions) -> int:
    """Render raw files or a sequence into a picture, numbered files, a folder or a video (`l3 render`); how many frames were
    left out. For arrays in memory there is `Renderer`."""
    from l3cli.stages.rendering import render as stage

    with file_of(table) as file:
        return stage.render(file, _paths(inputs), Path(output), options).failures


@by_keyword(EvaluateOptions)
def evaluate(table: Name | TransformTable, frames: Name, options: EvaluateOptions) -> dict[str, Any]:
    """Return the document of `l3 evaluate --json`: figures of a table on frames of a training set not seen in training."""
    from l3cli.stages import evaluation

    with file_of(table) as file:
        return evaluation.evaluate(file, Path(frames), options)


def _paths(given: Name | Sequence[Name]) -> tuple[Path, ...]:
    return tuple(map(Path, (given,) if isinstance(given, str | PathLike) else given))
