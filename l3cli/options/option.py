"""Declare options, and define the options that several commands share.

Each option is declared once, as a field of a frozen dataclass with a reader, a default and a help text. From this
declaration, l3 derives the command-line option (cli/options.py) and the keyword of the Python function (api/stages.py). The
values of the options are also part of the key by which `--resume` recognises a run. Every command imports this module, so it
must not import modules that load slowly.
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
TypeStored = TypeVar("TypeStored", covariant=True)
T = TypeVar("T")


class Given(Generic[TypeGiven, TypeStored]):
    """Annotation for a field that accepts values of one type and stores another type.

    For example, a field annotated as Given[Name | None, Path | None] accepts a string, a path or None, and stores a path or
    None.
    """

    if TYPE_CHECKING:  # only for type checkers; at run time, the field is an ordinary attribute

        def __get__(self, options: object, owner: object) -> TypeStored: ...
        def __set__(self, options: object, value: TypeGiven) -> None: ...


class Reader:
    """Base class of readers, which check the value of an option and convert it to the stored type.

    Values from the command line are text. Values from Python can have any type.
    """

    def read(self, given: Any) -> Any:
        """Check a value, and return the value to store.

        Raises ValueError if the value is invalid. The message explains how to correct it.
        """
        raise NotImplementedError

    def written(self, stored: Any) -> Any:
        """Convert a stored value to a JSON type."""
        return str(stored) if isinstance(stored, Fraction | Path | range) else stored


class Flag(Reader):
    """A flag, which is on (True) or off (False)."""

    def read(self, given: Any) -> bool:
        return bool(given)


class Text(Reader):
    """Arbitrary text."""

    def read(self, given: Any) -> str:
        if not isinstance(given, str):
            raise ValueError(f"{shortened(repr(given))} is not text; pass a string")
        return given


class File(Reader):
    """Path of an input file.

    The reader does not check whether the file exists, because l3 reports a missing file more precisely when it opens it.
    """

    def read(self, given: Any) -> Path:
        return Path(given)


class Output(File):
    """Path of an output file or folder."""


@dataclass(frozen=True)
class Recipe(File):
    """A recipe: the path of a file, or the name of a built-in recipe in the subfolder `kind` of configs/."""

    kind: str

    def read(self, given: Any) -> Path:
        from l3cli.recipes.builtin import find_recipe

        return find_recipe(fspath(given), self.kind)


class Choice(Reader):
    """One of several permitted values, which can also be written as text, such as "16" for 16."""

    def __init__(self, *values: Any) -> None:
        self.values = values

    def read(self, given: Any) -> Any:
        for value in self.values:
            if given in (value, str(value)):
                return value
        raise ValueError(f'"{shortened(str(given))}" is unknown; {suggestion(str(given), map(str, self.values))}')


class Number(Reader):
    """A number in a given unit, within a range that includes both limits."""

    def __init__(self, least: float, most: float, unit: str = "", whole: bool = False) -> None:
        self.quantity = Quantity(least, most, unit, whole)

    def read(self, given: Any) -> Any:
        return self.quantity.read(str(given))


@dataclass(frozen=True)
class Declaration:
    """How an option is declared."""

    default: Any
    help: str
    reader: Reader
    metavar: str | None = None
    flag: str | None = None  # name on the command line, if it differs from the field name
    several: bool = False  # whether the option may be repeated
    bytes: bool = True  # whether the option affects the bytes of outputs
    shared: bool = False  # whether several commands have the option; --help lists shared options last

    def stored(self, given: Any) -> Any:
        """Convert a value to the type that is stored. None stands for the default.

        The result is a tuple if the option may be repeated, and None if the default is also None.
        """
        given = self.default if given is None else given
        if given is None:
            return None
        if not self.several:
            return self.reader.read(given)
        return tuple(map(self.reader.read, (given,) if isinstance(given, str | PathLike) else given))


def option(default: Any, help: str, reader: Reader | None = None, **about: Any) -> Any:
    """Declare an option as a dataclass field.

    Parameters
    ----------
    default : Any
        Default value, as a user would write it. For an option that is off by default, use None: any other default, even 0,
        affects `Options.run_key`.
    help : str
        Help text for the command line and for the docstring.
    reader : Reader, optional
        Reader that checks and converts the value. [default: determined by the field type]
    **about
        Other attributes of Declaration.
    """
    return field(default=default, metadata={"option": (help, reader, about)})


def declarations(cls: "type[Options]") -> dict[str, Declaration]:
    """Return the declarations of a command's options by name, with the shared options last."""
    declared = {}
    for each in fields(cls):
        if "option" in each.metadata:
            help, reader, about = each.metadata["option"]
            declared[each.name] = Declaration(each.default, help, reader or _reader_of(each.type), **about)
    return dict(sorted(declared.items(), key=lambda item: item[1].shared))


def _reader_of(type: Any) -> Reader:
    """Return the default reader for a field annotation."""
    if get_origin(type) is Given:
        return _reader_of(get_args(type)[1])
    if get_origin(type) is Literal:
        return Choice(*get_args(type))
    if given := [each for each in get_args(type) if each not in (NoneType, Ellipsis)]:  # the type is optional, or a tuple
        return _reader_of(given[0])
    return {bool: Flag, str: Text, Path: File}[type]()


@dataclass_transform(kw_only_default=True)
def options(cls: type[T]) -> type[T]:
    """Class decorator that turns an options class into a frozen dataclass with keyword-only arguments.

    Type checkers are not told that it is frozen, because mypy would then ignore the types of inherited Given fields.
    """
    return dataclass(frozen=True, kw_only=True)(cls)


_NOT_GIVEN: Any = None
_SILENT = Silent()


@options
class Options:
    """Base class for the options of a command.

    The constructor checks and converts all values, and raises RecipeError if one is invalid. If `console` is None, messages
    are discarded.
    """

    console: Given[Console | None, Console] = _NOT_GIVEN  # on the command line, set by --quiet, --log and --json

    def __post_init__(self) -> None:
        object.__setattr__(self, "console", self.console or _SILENT)
        for name, declared in declarations(type(self)).items():
            try:
                object.__setattr__(self, name, declared.stored(getattr(self, name)))
            except ValueError as error:
                raise RecipeError(f"‹{declared.flag or name}›: {error}") from None

    def chosen(self) -> dict[str, Any]:
        """Return the options that affect the bytes of outputs, as JSON types.

        Options that are None or off are omitted. Input files are omitted too, because `run_key` identifies them by their
        content.
        """
        declared = declarations(type(self)).items()
        stored = {name: (each, getattr(self, name)) for name, each in declared if each.bytes and not _is_file(each)}
        return {name: each.reader.written(value) for name, (each, value) in stored.items() if _is_chosen(value)}

    def inputs(self, all: bool = True) -> dict[str, tuple[Path, ...]]:
        """Return the input files by option name.

        If `all` is False, options that do not affect the bytes of outputs are omitted.
        """
        read = {
            name: getattr(self, name)
            for name, each in declarations(type(self)).items()
            if _is_file(each) and not isinstance(each.reader, Output) and (all or each.bytes)
        }
        return {name: stored if isinstance(stored, tuple) else (stored,) for name, stored in read.items() if stored}

    def run_key(self, *facts: Any, files: Callable[[Path], Iterable[Path]] | None = None) -> str:
        """Return a digest of everything that affects the bytes of a run's outputs.

        The digest depends on the version of l3, the options, the contents of the input files, and `facts`.

        Parameters
        ----------
        *facts
            Inputs of the run that are not options, as JSON types.
        files : callable, optional
            Function that takes the path in an option and lists the files to which it refers. [default: the files of a frame
            sequence]

        Returns
        -------
        str
            SHA-256 digest in hexadecimal.
        """
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
    """Two whole numbers, as text such as "2,0" or as a tuple."""

    def __init__(self, shape: str, separator: str, number: Number) -> None:
        self._shape, self._separator, self._number = shape, separator, number

    def read(self, given: Any) -> tuple[int, int]:
        text = given if isinstance(given, str) else self._separator.join(map(str, given))
        first, has_separator, second = text.partition(self._separator)
        try:
            if has_separator:
                return self._number.read(first), self._number.read(second)
        except ValueError as error:
            raise ValueError(f'"{shortened(text)}" does not have the form {self._shape}: {error}') from None
        raise ValueError(f'"{shortened(text)}" does not have the form {self._shape}')


LEVEL = Number(0, 65535, "DN")
SITE = Pair("ROW,COL", ",", Number(0, 65535, "rows or columns", whole=True))


class Shard(Pair):
    """Shard I/N of a run, where N is the number of shards, and I is the number of this shard, from 1 to N."""

    def __init__(self) -> None:
        super().__init__("I/N, such as 1/4", "/", Number(0, 1_000_000, "shards", whole=True))

    def read(self, given: Any) -> tuple[int, int]:
        index, count = super().read(given)
        if not 1 <= index <= count:
            most = max(count, 1)
            raise ValueError(f"shard {index}/{count} does not exist; use a shard from 1/{most} to {most}/{most}")
        return index, count


@options
class BackendOptions(Options):
    """Option that selects the rendering backend."""

    backend: Literal["opencl", "reference"] = option(
        "opencl", "Render with OpenCL, or with numpy in float64 (slow).", shared=True
    )


@options
class DeviceOptions(Options):
    """Options for the OpenCL device and its kernels."""

    device: str | None = option(
        None,
        'OpenCL device: part of its name, or its number in the list that "l3 bench --list" prints [default: the environment '
        "variable L3_DEVICE].",
        metavar="NAME|INDEX",
        shared=True,
    )
    variant: Literal["processor", "graphics"] | None = option(
        None, "Kernels for processors or for graphics cards [default: depends on the device type].", shared=True
    )


@options
class SeedOptions(Options):
    """Option for the seed of the random numbers."""

    seed: int = option(0, "Seed of the random numbers.", Number(0, LARGEST_WHOLE, whole=True), metavar="N", shared=True)


@options
class SchedulerOptions(Options):
    """Options for workers on other machines. The TLS options require a scheduler."""

    scheduler: str | None = option(
        None, "Run on the workers of this dask scheduler (tcp://HOST:PORT).", metavar="ADDRESS", bytes=False, shared=True
    )
    tls_ca: OnePath = option(
        None,
        "tls:// only: certificate of the authority that signed the scheduler's certificate.",
        metavar="PEM",
        bytes=False,
        shared=True,
    )
    tls_cert: OnePath = option(
        None, "tls:// only: certificate that this machine presents.", metavar="PEM", bytes=False, shared=True
    )
    tls_key: OnePath = option(None, "tls:// only: private key of ‹tls_cert›.", metavar="PEM", bytes=False, shared=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheduler is None and (self.tls_ca or self.tls_cert or self.tls_key):
            raise RecipeError(
                "‹tls_ca›, ‹tls_cert› and ‹tls_key› need ‹scheduler›; set ‹scheduler› to the tls:// address of the scheduler"
            )

    def cluster(self) -> "Scheduler | None":
        """Return the scheduler, or None if no address is set.

        Raises L3Error if the address or a TLS file cannot be used.
        """
        if self.scheduler is None:
            return None
        from l3cli.parallel.cluster import Scheduler

        return Scheduler(self.scheduler, self.tls_ca, self.tls_cert, self.tls_key, self.console.warn)


@options
class JobsOptions(Options):
    """Option for the number of processes."""

    jobs: int = option(1, "Number of processes.", Number(1, MOST_JOBS, whole=True), metavar="N", bytes=False, shared=True)


@options
class WorkerOptions(JobsOptions, SchedulerOptions):
    """Options for processes on this machine and for workers on other machines. A run can use only one of the two."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheduler is not None and self.jobs > 1:
            raise RecipeError("‹jobs› applies only to processes on this machine; remove ‹jobs› if you use ‹scheduler›")


@options
class ForceOptions(Options):
    """Option that allows the command to replace existing outputs."""

    force: bool = option(False, "Replace the output if it exists.", bytes=False, shared=True)
