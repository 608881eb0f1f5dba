"""The four stages and evaluation, as functions of files or artifacts, with the options of their commands by keyword."""

import functools
import inspect
from collections.abc import Callable, Sequence
from dataclasses import fields
from os import PathLike
from pathlib import Path
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar, get_args, get_origin, overload

from l3cli.api.artifacts import Name, file_of
from l3cli.artifacts import store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import suggestion
from l3cli.options.option import Given, Options, declarations
from l3cli.options.pipeline import CalibrateOptions, EvaluateOptions, SimulateOptions, TrainOptions
from l3cli.options.render import RenderOptions
from l3cli.recipes.builtin import find_recipe

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
    from l3cli.stages.training import whole

    return whole.train(_paths(training), Path(output), options)


@by_keyword(RenderOptions)
def render(table: Name | TransformTable, inputs: Name | Sequence[Name], output: Name, options: RenderOptions) -> int:
    """Render raw files or a sequence into a picture, numbered files, a folder or a video (`l3 render`); how many frames were
    left out. For arrays in memory there is `Renderer`."""
    from l3cli.stages.rendering import render as stage

    with file_of(table) as file:
        return stage.render(file, _paths(inputs), Path(output), options).failures


@by_keyword(EvaluateOptions)
def evaluate(table: Name | TransformTable, frames: Name, options: EvaluateOptions) -> dict[str, Any]:
    """Return the document of `l3 evaluate --json`: figures of a table on the frames of a training set that it has not
    seen."""
    from l3cli.stages import evaluation

    with file_of(table) as file:
        return evaluation.evaluate(file, Path(frames), options)


def _paths(given: Name | Sequence[Name]) -> tuple[Path, ...]:
    return tuple(map(Path, (given,) if isinstance(given, str | PathLike) else given))
