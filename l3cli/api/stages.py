"""Python functions that run the four stages and the evaluation, and that load and save artifacts.

The stages read and write files. An artifact in memory is first saved to a temporary file.
"""

import contextlib
import functools
import inspect
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import fields
from os import PathLike
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Concatenate, Generic, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, overload

from l3cli.artifacts import camera_recipe, store
from l3cli.artifacts.camera import CameraModel
from l3cli.artifacts.schema import Artifact
from l3cli.artifacts.table import TransformTable
from l3cli.artifacts.training_set import TrainingSet
from l3cli.errors import InputFileError, suggestion
from l3cli.options.commands import CalibrateOptions, EvaluateOptions, SimulateOptions, TrainOptions
from l3cli.options.option import Declaration, Given, Number, Options, declarations
from l3cli.options.render import RenderOptions
from l3cli.recipes.builtin import find_recipe
from l3cli.system.console import PythonWarnings
from l3cli.system.text import a

Name = str | PathLike[str]
LOADABLE: tuple[type[Artifact], ...] = (CameraModel, TrainingSet, TransformTable)


def load(path: Name) -> CameraModel | TransformTable | TrainingSet:
    """Load a camera model, a transform table or a training set.

    If you know which type of artifact the file contains, use `load_camera`, `load_table` or `load_training_set` instead:
    type checkers can then infer the type of the result.

    Parameters
    ----------
    path : str or path
        HDF5 file written by l3.

    Returns
    -------
    CameraModel, TransformTable or TrainingSet
        The artifact. A training set is loaded without its frames (see `load_training_set`).

    Raises
    ------
    InputFileError
        If the file is not an artifact of one of these types, or if it was modified after l3 wrote it.

    Examples
    --------
    >>> import l3cli as l3
    >>> type(l3.load("table.h5")).__name__
    'TransformTable'
    """
    with store.open_artifact(Path(path)) as root:
        kind = str(root.attrs["kind"])
    for cls in LOADABLE:
        if cls.kind == kind:
            return store.load(cls, Path(path))  # type: ignore[return-value]
    raise InputFileError(
        f'{path} contains {a(kind)}, which only "l3 train --merge" reads; pass a camera model, training set or transform '
        "table"
    )


def load_camera(camera: Name) -> CameraModel:
    """Load a camera model, or compute one from a camera recipe.

    Parameters
    ----------
    camera : str or path
        Camera model (.h5), camera recipe (.toml), or name of a built-in camera recipe, such as "bayer".

    Returns
    -------
    CameraModel
        The camera's filter array, responsivities, noise and optics.

    Raises
    ------
    InputFileError
        If the file is not a camera model, or if it was modified after l3 wrote it.
    RecipeError
        If the recipe has errors, or if no recipe with this name exists.

    Examples
    --------
    >>> import l3cli as l3
    >>> camera = l3.load_camera("bayer")
    >>> camera.channels
    ('r', 'g', 'b')
    >>> camera.cfa
    array([[1, 0],
           [2, 1]], dtype=uint8)
    """
    return camera_recipe.load_camera(find_recipe(str(camera), "cameras"))


def load_table(path: Name) -> TransformTable:
    """Load a transform table.

    Parameters
    ----------
    path : str or path
        Transform table written by `l3 train` (.h5).

    Returns
    -------
    TransformTable
        The transforms of all classes, and the camera for which they were trained.

    Raises
    ------
    InputFileError
        If the file is not a transform table, or if it was modified after l3 wrote it.

    Examples
    --------
    >>> import l3cli as l3
    >>> l3.load_table("table.h5").outputs
    ('X', 'Y', 'Z')
    """
    return store.load(TransformTable, Path(path))


def load_training_set(path: Name) -> TrainingSet:
    """Load the metadata of a training set, without its frames.

    Parameters
    ----------
    path : str or path
        Training set written by `l3 simulate` (.h5).

    Returns
    -------
    TrainingSet
        The camera, the outputs and the processing history. To iterate over the frames, use
        `l3cli.artifacts.training_set.open_training_set`.

    Raises
    ------
    InputFileError
        If the file is not a training set, or if it was modified after l3 wrote it.

    Examples
    --------
    >>> import l3cli as l3
    >>> l3.load_training_set("training.h5").outputs
    ('X', 'Y', 'Z')
    """
    return store.load(TrainingSet, Path(path))


def save(artifact: CameraModel | TransformTable, path: Name) -> None:
    """Save a camera model or a transform table as an HDF5 file.

    An existing file is replaced. If an error occurs, the existing file stays unchanged and no partial file is left behind.

    Parameters
    ----------
    artifact : CameraModel or TransformTable
        The artifact to save.
    path : str or path
        Output file (.h5).

    Raises
    ------
    L3Error
        If the file cannot be written.

    Examples
    --------
    >>> import l3cli as l3
    >>> l3.save(l3.load_camera("bayer"), "my_camera.h5")
    """
    store.save(artifact, Path(path))


@contextlib.contextmanager
def file_of(given: Name | Artifact, kind: str | None = None) -> Iterator[Path]:
    """Context manager that yields a file path for an artifact, which may be a file or an object in memory.

    An artifact in memory is saved to a temporary file, which is deleted at the end of the `with` block.

    Parameters
    ----------
    given : str, path or Artifact
        A file or an artifact in memory. If `kind` is set, `given` may also be the name of a built-in recipe.
    kind : str, optional
        Type of the built-in recipes: a subfolder of configs/, such as "cameras".

    Yields
    ------
    Path
        File that contains the artifact or recipe.
    """
    if not isinstance(given, Artifact):
        yield Path(given) if kind is None else find_recipe(str(given), kind)
        return
    with tempfile.TemporaryDirectory(prefix="l3-") as folder:
        path = Path(folder, "artifact.h5")
        store.save(given, path)
        yield path


CONSOLE_ENTRY = """\
console : l3cli.system.console.Console, optional
    Object that receives progress and messages. [default: warnings become Python warnings, and everything else is
    discarded]"""

P = ParamSpec("P")
O = TypeVar("O", bound=Options)  # noqa: E741
A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")
R = TypeVar("R")


class by_keyword(Generic[P, O]):
    """Decorator that replaces a function's `options` parameter with one keyword parameter per command-line option.

    The keyword parameters appear in the signature and in the docstring, with the option's type and help text. An unknown
    keyword raises TypeError. Warnings become Python warnings unless the caller passes a `console`. The function runs with
    one BLAS thread, as the command does, because rounding depends on the number of threads.
    """

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
            import scipy.linalg  # noqa: F401 # loads scipy's BLAS: threadpool_limits affects only loaded libraries
            from threadpoolctl import threadpool_limits

            given += tuple(named.pop(each.name) for each in paths[len(given) :] if each.name in named)
            for name in named.keys() - declared.keys() - {"console"}:
                raise TypeError(f'{function.__name__} has no option "{name}"; {suggestion(name, declared)}')
            options = self._options(**{"console": PythonWarnings(), **named})
            with threadpool_limits(1, user_api="blas"):
                return function(*given, options)

        called.__signature__ = self._signature(paths, function)  # type: ignore[attr-defined]
        # Numpydoc expects the section "Other Parameters" between Returns and Raises.
        before, raises, after = (inspect.getdoc(function) or "").partition("Raises\n------")
        types = {each.name: _accepted_type(each.type) for each in fields(self._options)}
        listed = "\n".join(self._described(name, types[name], each) for name, each in declared.items())
        called.__doc__ = f"{before}Other Parameters\n----------------\n{listed}\n{CONSOLE_ENTRY}\n\n{raises}{after}"
        return called

    def _described(self, name: str, accepted: Any, declared: Declaration) -> str:
        """Return the numpydoc entry for an option: its name, type, range and unit, default value and help text."""
        facts = [_type_text(accepted)]
        if isinstance(declared.reader, Number):
            facts.append(str(declared.reader.quantity))
        facts.append("optional" if declared.default in (None, ()) else f"default {declared.default!r}")
        text = textwrap.fill(declared.help, 110, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False)
        return f"{name} : {', '.join(facts)}\n{text}"

    def _signature(self, paths: list[inspect.Parameter], function: Callable[..., Any]) -> inspect.Signature:
        options = (
            inspect.Parameter(
                each.name, inspect.Parameter.KEYWORD_ONLY, default=each.default, annotation=_accepted_type(each.type)
            )
            for each in fields(self._options)
        )
        return inspect.Signature([*paths, *options], return_annotation=function.__annotations__["return"])


def _accepted_type(declared: Any) -> Any:
    return get_args(declared)[0] if get_origin(declared) is Given else declared


def _type_text(accepted: Any) -> str:
    """Write a type annotation as in numpydoc, for example `str | PathLike[str] | None` as "str or path"."""
    if get_origin(accepted) in (Union, UnionType):
        *others, last = [_type_text(each) for each in get_args(accepted) if each is not NoneType]
        return f"{', '.join(others)} or {last}" if others else last
    if get_origin(accepted) is Literal:
        return "{" + ", ".join(map(repr, get_args(accepted))) + "}"
    if get_origin(accepted) is tuple:
        return f"({', '.join(map(_type_text, get_args(accepted)))})"
    if get_origin(accepted) is Sequence:
        return f"sequence of {_type_text(get_args(accepted)[0])}"
    return "path" if get_origin(accepted) is PathLike else accepted.__name__


@by_keyword(CalibrateOptions)
def calibrate(measurements: Name | None, output: Name, options: CalibrateOptions) -> CameraModel:
    """Estimate a camera model from lab measurements or from raw photos of a ColorChecker, as `l3 calibrate` does.

    Parameters
    ----------
    measurements : str, path or None
        Measurement file (.toml), or None if you set `photos` instead.
    output : str or path
        Camera model to write (.h5).

    Returns
    -------
    CameraModel
        The camera model in `output`.

    Raises
    ------
    RecipeError
        If the measurement file contains an error, or if an option is invalid.
    InputFileError
        If a capture cannot be used.
    L3Error
        If `output` exists and `force` is not set, or if the model fails a check and `accept` is not set.

    Examples
    --------
    >>> import l3cli as l3
    >>> camera = l3.calibrate("lab/MEASUREMENTS.toml", "my_camera.h5")
    >>> camera.channels
    ('r', 'g', 'b')
    """
    from l3cli.stages import calibration

    return calibration.calibrate(None if measurements is None else Path(measurements), Path(output), options)[0]


@by_keyword(SimulateOptions)
def simulate(scenes: Name, camera: Name | CameraModel, output: Name, options: SimulateOptions) -> TrainingSet:
    """Simulate raw frames of many scenes and compute the ideal output for each frame, as `l3 simulate` does.

    Parameters
    ----------
    scenes : str or path
        Scene recipe (.toml), or name of a built-in scene recipe, such as "default" or "small".
    camera : str, path or CameraModel
        Camera model, camera recipe (.toml), or name of a built-in camera recipe.
    output : str or path
        Training set to write (.h5).

    Returns
    -------
    TrainingSet
        Metadata of the training set in `output`, without its frames.

    Raises
    ------
    RecipeError
        If a recipe contains an error, or if an option is invalid.
    InputFileError
        If the camera or a scene file cannot be used.
    L3Error
        If `output` exists and `force` is not set.

    Examples
    --------
    >>> import l3cli as l3
    >>> training = l3.simulate("unseen.toml", "camera.h5", "my_training.h5", seed=1)
    >>> training.outputs
    ('X', 'Y', 'Z')
    """
    from l3cli.stages.simulation import simulate as stage

    with file_of(camera, "cameras") as file:
        stage.simulate(find_recipe(str(_path(scenes)), "scenes"), file, Path(output), options)
    return store.load(TrainingSet, Path(output))


@by_keyword(TrainOptions)
def train(training: Name | Sequence[Name], output: Name, options: TrainOptions) -> TransformTable:
    """Train a transform table on one or more training sets, as `l3 train` does.

    Parameters
    ----------
    training : str, path or sequence of str or path
        Training sets (.h5), all for the same camera.
    output : str or path
        Transform table to write (.h5).

    Returns
    -------
    TransformTable
        The transform table in `output`.

    Raises
    ------
    RecipeError
        If the class recipe contains an error, or if an option is invalid.
    InputFileError
        If a training set cannot be used, or if the training sets have different cameras or outputs.
    L3Error
        If `output` exists and `force` is not set.

    Examples
    --------
    >>> import l3cli as l3
    >>> table = l3.train("training.h5", "my_table.h5", classes="classes.toml")
    >>> table.outputs
    ('X', 'Y', 'Z')
    """
    from l3cli.stages.training import train as stage

    return stage.train(_paths(training), Path(output), options)[0]


@by_keyword(RenderOptions)
def render(table: Name | TransformTable, inputs: Name | Sequence[Name], output: Name, options: RenderOptions) -> int:
    """Render raw files or a sequence to pictures or a video, as `l3 render` does.

    To render arrays in memory, use `Renderer`.

    Parameters
    ----------
    table : str, path or TransformTable
        Transform table of the camera.
    inputs : str, path or sequence of str or path
        Raw files, or one sequence. A sequence is a folder, a pattern such as "a_%04d.tif", a file that contains several
        frames, or a video.
    output : str or path
        Output picture, pattern of numbered pictures such as "a_%04d.png", folder or video.

    Returns
    -------
    int
        Number of frames that were skipped because they could not be read. Always 0 unless `skip_bad` is set.

    Raises
    ------
    RecipeError
        If an option is invalid, or if the output does not fit the inputs.
    InputFileError
        If an input or the table cannot be used.
    DeviceError
        If the OpenCL device does not work.
    L3Error
        If `output` exists and `force` is not set.

    Examples
    --------
    >>> import l3cli as l3
    >>> l3.render("table.h5", "unseen/00000_composition-5-0_raw.tif", "my_picture.png", exposure="+1EV")
    0
    """
    from l3cli.stages.rendering import render as stage

    with file_of(table) as file:
        return stage.render(file, _paths(inputs), Path(output), options).failures


@by_keyword(EvaluateOptions)
def evaluate(table: Name | TransformTable, frames: Name, options: EvaluateOptions) -> dict[str, Any]:
    """Evaluate a table on simulated frames that were not used to train it, as `l3 evaluate` does.

    Parameters
    ----------
    table : str, path or TransformTable
        Transform table to evaluate.
    frames : str or path
        Training set (.h5) of the same camera. l3 warns if the table was trained on this set.

    Returns
    -------
    dict
        The document that `l3 evaluate --json` prints, without its entry "run". "pipelines" lists the names of the
        evaluated pipelines: "ours" for the table, followed by the baselines. The entries "frames" (metrics of each frame),
        "mean" (mean metrics), "by_level", "by_illuminant" and "standards" contain metrics under these names.

    Raises
    ------
    RecipeError
        If an option is invalid.
    InputFileError
        If a file cannot be used.
    L3Error
        If the folder `pictures` is not empty and `force` is not set.

    Examples
    --------
    >>> import l3cli as l3
    >>> found = l3.evaluate("table.h5", "unseen.h5")
    >>> found["mean"]["ours"]["mean_delta_e"] < found["mean"]["basic"]["mean_delta_e"]
    True
    """
    from l3cli.stages import evaluation

    with file_of(table) as file:
        return evaluation.evaluate(file, _path(frames), options)[0]


def _paths(given: Name | Sequence[Name]) -> tuple[Path, ...]:
    return tuple(map(_path, [given] if isinstance(given, str | PathLike) or not isinstance(given, Iterable) else given))


def _path(given: Name) -> Path:
    """Convert a path. Raise TypeError, with the remedy, if an artifact or an array is given instead."""
    if isinstance(given, str | PathLike):
        return Path(given)
    remedy = "; save the artifact with l3cli.save, and give the path of its file" if isinstance(given, Artifact) else ""
    raise TypeError(f"expected a path, but got an object of type {type(given).__name__}{remedy}")
