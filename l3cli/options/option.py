"""An option, declared once: a field of a frozen dataclass, with a reader, a default and a help text; those that several
commands share.

From it follow the option of the command line (cli/options.py), the keyword of the Python call (api/stages.py), and its part
in the key of a run. Imported by every command before anything else: nothing here is slow to import.
"""

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from fractions import Fraction
from os import PathLike, fspath
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, dataclass_transform, get_args, get_origin

from l3cli import __version__
from l3cli.errors import RecipeError, shortened, suggestion
from l3cli.system.console import Console, Silent
from l3cli.system.files import sha256
from l3cli.system.text import LARGEST_WHOLE, Quantity

Name = str | PathLike[str]
TypeGiven = TypeVar("TypeGiven", contravariant=True)
TypeHeld = TypeVar("TypeHeld", covariant=True)
T = TypeVar("T")


class Given(Generic[TypeGiven, TypeHeld]):
    """Type of a field that takes values of one type and holds them as another: Given[Name | None, Path | None]."""

    if TYPE_CHECKING:  # a field is a plain attribute; type checkers infer the two types from these

        def __get__(self, options: object, owner: object) -> TypeHeld: ...
        def __set__(self, options: object, value: TypeGiven) -> None: ...


class Reader:
    """Reader of an option's value, from the text of the command line or from a Python value."""

    def read(self, given: Any) -> Any:
        """Return the value as it is held; ValueError, with the cure, if it is none."""
        raise NotImplementedError

    def written(self, held: Any) -> Any:
        """Return a value ready for JSON."""
        return str(held) if isinstance(held, Fraction | Path | range) else held


class Flag(Reader):
    """On or off."""

    def read(self, given: Any) -> bool:
        return bool(given)


class Text(Reader):
    """Any text."""

    def read(self, given: Any) -> str:
        if not isinstance(given, str):
            raise ValueError(f"{shortened(repr(given))} is not text")
        return given


class File(Reader):
    """Path of an input, whose reader checks it with a message and an exit code that fit."""

    def read(self, given: Any) -> Path:
        return Path(given)


class Output(File):
    """Path of a file or folder that is written."""


@dataclass(frozen=True)
class Recipe(File):
    """File of a recipe, or the name of one of the `kind` (a folder of configs/) that come with l3."""

    kind: str

    def read(self, given: Any) -> Path:
        from l3cli.recipes.builtin import find_recipe

        return find_recipe(fspath(given), self.kind)


class Choice(Reader):
    """One of several values. `gone`: words that were choices once, and what serves instead."""

    def __init__(self, *values: Any, gone: dict[str, str] | None = None) -> None:
        self.values, self.gone = values, gone or {}

    def read(self, given: Any) -> Any:
        if str(given) in self.gone:
            raise RecipeError(self.gone[str(given)])
        for value in self.values:
            if given in (value, str(value)):
                return value
        raise ValueError(f'"{shortened(str(given))}" is unknown; {suggestion(str(given), map(str, self.values))}')


class Number(Reader):
    """A number within a range, ends included, in a unit."""

    def __init__(self, least: float, most: float, unit: str = "", whole: bool = False) -> None:
        self._quantity = Quantity(least, most, unit, whole)

    def read(self, given: Any) -> Any:
        return self._quantity.read(str(given))


@dataclass(frozen=True)
class Declaration:
    """The declaration of an option."""

    default: Any
    help: str
    reader: Reader
    metavar: str | None = None
    flag: str | None = None  # name on the command line, if it is not that of the field
    several: bool = False  # whether it may be repeated
    bytes: bool = True  # whether the bytes of outputs depend on it
    shared: bool = False  # with other commands, after whose own options it is shown
    was: str | None = None  # its name in Python before

    def held(self, given: Any) -> Any:
        """Return a given value as it is held; None stands for the default."""
        given = self.default if given is None else given
        if given is None:
            return None
        if not self.several:
            return self.reader.read(given)
        return tuple(map(self.reader.read, (given,) if isinstance(given, str | PathLike) else given))


def option(default: Any, help: str, reader: Reader | None = None, **about: Any) -> Any:
    """Return the field of an option. `about`: the other attributes of Declaration; the type's reader without another."""
    return field(default=default, metadata={"option": (help, reader, about)})


def declarations(cls: "type[Options]") -> dict[str, Declaration]:
    """Return the options of a class by name, those of its own before those that commands share."""
    declared = {}
    for each in fields(cls):
        if "option" in each.metadata:
            help, reader, about = each.metadata["option"]
            declared[each.name] = Declaration(each.default, help, reader or _reader_of(each.type), **about)
    return dict(sorted(declared.items(), key=lambda item: item[1].shared))


def _reader_of(type: Any) -> Reader:
    """Return the reader of a plain type."""
    if get_origin(type) is Given:
        return _reader_of(get_args(type)[1])
    if get_origin(type) is Literal:
        return Choice(*get_args(type))
    if given := [each for each in get_args(type) if each not in (NoneType, Ellipsis)]:  # one or none, or a tuple
        return _reader_of(given[0])
    return {bool: Flag, str: Text, Path: File}[type]()


@dataclass_transform(kw_only_default=True)
def options(cls: type[T]) -> type[T]:
    """Make a frozen dataclass of a class of options. Type checkers do not hear of frozen: mypy would forget of inherited
    fields as what they hold their values."""
    return dataclass(frozen=True, kw_only=True)(cls)


_NOT_GIVEN: Any = None
_SILENT = Silent()


@options
class Options:
    """Options of a command. RecipeError if one has a value that cannot be."""

    console: Given[Console | None, Console] = _NOT_GIVEN  # on the command line by --quiet, --log and --json

    def __post_init__(self) -> None:
        object.__setattr__(self, "console", self.console or _SILENT)
        for name, declared in declarations(type(self)).items():
            try:
                object.__setattr__(self, name, declared.held(getattr(self, name)))
            except ValueError as error:
                raise RecipeError(f"‹{declared.flag or name}›: {error}") from None

    def chosen(self) -> dict[str, Any]:
        """Return the options that outputs depend on by name, ready for JSON, but for those that are None or off. Inputs are
        not among them: they count by their bytes."""
        declared = declarations(type(self)).items()
        held = {name: (each, getattr(self, name)) for name, each in declared if each.bytes and not _is_file(each)}
        return {name: each.reader.written(value) for name, (each, value) in held.items() if _is_chosen(value)}

    def inputs(self, all: bool = True) -> dict[str, tuple[Path, ...]]:
        """Return the paths of inputs among the options, by name; without `all` those that outputs depend on."""
        read = {
            name: getattr(self, name)
            for name, each in declarations(type(self)).items()
            if _is_file(each) and not isinstance(each.reader, Output) and (all or each.bytes)
        }
        return {name: held if isinstance(held, tuple) else (held,) for name, held in read.items() if held}

    def run_key(self, *facts: Any, files: Callable[[Path], Iterable[Path]] | None = None) -> str:
        """Return what tells a run from others: a digest of all that the bytes of its outputs depend on, the options with
        the `files` that they name, None: those of frames, and `facts` about its inputs."""
        from l3cli.io.sequences import frame_files

        named = self.inputs(all=False).items()
        inputs = {name: [sha256(file) for path in paths for file in (files or frame_files)(path)] for name, paths in named}
        about = [__version__, self.chosen(), inputs, *facts]
        return hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode()).hexdigest()


def _is_file(declared: Declaration) -> bool:
    return isinstance(declared.reader, File)


def _is_chosen(value: Any) -> bool:
    return value is not None and value is not False and value != ()


if TYPE_CHECKING:
    from l3cli.parallel.cluster import Scheduler

MOST_JOBS = 4096
PAIR = tuple[int, int]
OnePath = Given[Name | None, Path | None]


class Pair(Reader):
    """Two whole numbers with a separator between them, such as ROW,COL."""

    def __init__(self, shape: str, separator: str, number: Number) -> None:
        self._shape, self._separator, self._number = shape, separator, number

    def read(self, given: Any) -> tuple[int, int]:
        text = given if isinstance(given, str) else self._separator.join(map(str, given))
        first, has_separator, second = text.partition(self._separator)
        try:
            if has_separator:
                return self._number.read(first), self._number.read(second)
        except ValueError as error:
            raise ValueError(f'"{shortened(text)}" is not {self._shape}: {error}') from None
        raise ValueError(f'"{shortened(text)}" is not {self._shape}')


LEVEL = Number(0, 65535, "DN")
SITE = Pair("ROW,COL", ",", Number(0, 65535, "rows or columns", whole=True))


class Shard(Pair):
    """I/N, a part of a work divided into several."""

    def __init__(self) -> None:
        super().__init__("I/N, such as 1/4", "/", Number(0, 1_000_000, "shards", whole=True))

    def read(self, given: Any) -> tuple[int, int]:
        index, count = super().read(given)
        if not 1 <= index <= count:
            most = max(count, 1)
            raise ValueError(f"{index}/{count}: shards count from 1/{most} to {most}/{most}")
        return index, count


@options
class BackendOptions(Options):
    """Choice of what renders."""

    backend: Literal["opencl", "reference"] = option(
        "opencl", "Render on an OpenCL device, or by numpy in float64.", shared=True
    )


@options
class DeviceOptions(Options):
    """Choice of an OpenCL device and of kernels for it."""

    device: str | None = option(
        None,
        'OpenCL device, by part of its name or number of "l3 bench" [default: L3_DEVICE].',
        metavar="NAME|INDEX",
        shared=True,
    )
    variant: Literal["processor", "graphics"] | None = option(
        None, "Kernels for a processor or a graphics card [default: by the device's type].", shared=True
    )


@options
class SeedOptions(Options):
    """Choice of random numbers."""

    seed: int = option(0, "Seed of the random numbers.", Number(0, LARGEST_WHOLE, whole=True), metavar="N", shared=True)


@options
class SchedulerOptions(Options):
    """Choice of workers on other machines."""

    scheduler: str | None = option(
        None, "Run on the workers of this dask scheduler, tcp://HOST:PORT.", metavar="ADDRESS", bytes=False, shared=True
    )
    tls_ca: OnePath = option(
        None, "Authority that signed the scheduler's certificate (tls://…).", metavar="PEM", bytes=False, shared=True
    )
    tls_cert: OnePath = option(None, "Certificate to show to the scheduler.", metavar="PEM", bytes=False, shared=True)
    tls_key: OnePath = option(None, "Key of ‹tls_cert›.", metavar="PEM", bytes=False, shared=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheduler is None and (self.tls_ca or self.tls_cert or self.tls_key):
            raise RecipeError("‹tls_ca›, ‹tls_cert› and ‹tls_key› go with ‹scheduler›")

    def cluster(self) -> "Scheduler | None":
        """Return the scheduler, None without one; errors as of Scheduler."""
        if self.scheduler is None:
            return None
        from l3cli.parallel.cluster import Scheduler

        return Scheduler(self.scheduler, self.tls_ca, self.tls_cert, self.tls_key, self.console.warn)


@options
class JobsOptions(Options):
    """Choice of how many processes work."""

    jobs: int = option(
        1, "Number of processes to use.", Number(1, MOST_JOBS, whole=True), metavar="N", bytes=False, shared=True
    )


@options
class WorkerOptions(JobsOptions, SchedulerOptions):
    """Choice of processes, on this machine or on others."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheduler is not None and self.jobs > 1:
            raise RecipeError("‹jobs› is the number of processes here; leave it out with ‹scheduler›")


@options
class ForceOptions(Options):
    """Choice of what may be replaced."""

    force: bool = option(False, "Replace the output if it exists.", bytes=False, shared=True)
