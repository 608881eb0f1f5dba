"""Options that several commands share, each declared once."""

import functools
import importlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from l3cli.cli.results import JSON, recorded
from l3cli.cli.terminal import ErrorsOnly, Terminal, with_options
from l3cli.errors import shortened
from l3cli.system.files import protecting
from l3cli.system.numbers import LARGEST_WHOLE, NoSuchNumber, Quantity

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from l3cli.stages.console import Console

F = TypeVar("F", bound=Callable[..., Any])

FILE = click.Path(path_type=Path, readable=False)  # the reader checks it, with a message and an exit code that fit


class RecipeFile(click.Path):
    """A recipe: a file, or the name of one of the `kind` (a folder of configs/) that come with l3."""

    def __init__(self, kind: str) -> None:
        super().__init__(path_type=Path, readable=False)
        self.kind = kind

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        from l3cli.recipes.builtin import find_recipe

        return find_recipe(os.fspath(value), self.kind)

    def names(self) -> Iterable[str]:
        """The recipes that come with l3."""
        from l3cli.recipes.builtin import known_recipes

        return known_recipes(self.kind)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list["CompletionItem"]:
        """Names and, beside them, files: bash completes no files where anything else is offered."""
        from click.shell_completion import CompletionItem

        names = [name for name in self.names() if name.startswith(incomplete)]
        if not names:
            return super().shell_complete(ctx, param, incomplete)
        visible = (each for each in os.scandir() if each.name.startswith(incomplete) and not each.name.startswith("."))
        files = [each.name + "/" * each.is_dir() for each in visible]
        return [CompletionItem(each) for each in (*names, *sorted(files))]


CAMERA = RecipeFile("cameras")
MOST_JOBS = 4096


class Number(click.ParamType):
    """A number within a declared range, of a declared unit."""

    name = "number"

    def __init__(self, least: float, most: float, unit: str = "", whole: bool = False) -> None:
        self._quantity = Quantity(least, most, unit, whole)

    def convert(self, value: Any, parameter: click.Parameter | None, context: click.Context | None) -> float:
        return self.read(value, parameter, context) if isinstance(value, str) else value

    def read(self, text: str, parameter: click.Parameter | None = None, context: click.Context | None = None) -> float:
        """The number in `text`, an int where the number must be whole."""
        try:
            return self._quantity.read(text)
        except NoSuchNumber as error:
            self.fail(str(error), parameter, context)


def output(what: str, required: bool = True) -> Callable[[F], F]:
    """-o/--output FILE."""
    return click.option("-o", "--output", type=FILE, required=required, metavar="FILE", help=f"{what}.")


force = click.option("--force", is_flag=True, help="Replace the output if it exists.")
LOG = "l3cli.log"  # in a context's meta: the path of --log


def _log(context: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    context.meta[LOG] = path


def _console(context: click.Context, parameter: click.Parameter, quiet: bool) -> "Console":
    console: Console = ErrorsOnly() if quiet else Terminal()
    if context.meta[LOG] is not None:
        from l3cli.stages.log import Logged

        console = Logged(console, context.meta[LOG], context.info_name or "l3", with_options)
    return recorded(console)


_QUIET = click.option(
    "--quiet", "console", is_flag=True, callback=_console, help="Print no messages on stderr but errors.",
)  # fmt: skip
_LOG = click.option(
    "--log", type=FILE, metavar="FILE", is_eager=True, expose_value=False, callback=_log,
    help="Also append all messages to FILE, with time, level and command.",
)  # fmt: skip


_JSON = click.option(  # results.begin has seen it already
    JSON, "as_json", is_flag=True, expose_value=False,
    help="Print results, warnings, times and digests as one JSON object on stdout.",
)  # fmt: skip


def quiet(command: F) -> F:
    """--quiet, --log FILE and --json: how a command speaks, all as one parameter `console`."""
    return _LOG(_QUIET(_JSON(command)))


SHARD = Number(0, 1_000_000, "shards", whole=True)


def shard(context: Any, parameter: Any, text: str | None) -> tuple[int, int] | None:
    """Callback of --shard, which reads "I/N" with 1 ≤ I ≤ N."""
    if text is None:
        return None
    first, has_separator, second = text.partition("/")
    if not has_separator:
        raise click.BadParameter(f'"{shortened(text)}" is not I/N, such as 1/4')
    try:
        index, count = int(SHARD.read(first)), int(SHARD.read(second))
    except click.BadParameter as error:
        raise click.BadParameter(f'"{shortened(text)}" is not I/N, such as 1/4: {error.message}') from None
    if not 1 <= index <= count:
        raise click.BadParameter(f"{text}: shards count from 1/{max(count, 1)} to {max(count, 1)}/{max(count, 1)}")
    return index, count


seed = click.option(
    "--seed",
    type=Number(0, LARGEST_WHOLE, whole=True),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of the random numbers.",
)
device = click.option(
    "--device", metavar="NAME|INDEX", help='OpenCL device, by part of its name or number of "l3 bench" [default: L3_DEVICE].'
)
variant = click.option(
    "--variant",
    type=click.Choice(["processor", "graphics"]),
    help="Kernels for a processor or a graphics card [default: by the device's type].",
)
backend = click.option(
    "--backend",
    type=click.Choice(["opencl", "reference"]),
    default="opencl",
    show_default=True,
    help="Render on an OpenCL device, or by numpy in float64.",
)
jobs = click.option(
    "--jobs",
    type=Number(1, MOST_JOBS, whole=True),
    default=1,
    show_default=True,
    metavar="N",
    help="Number of processes to use.",
)
_ADDRESS = click.option("--scheduler", metavar="ADDRESS", help="Run on the workers of this dask scheduler, tcp://HOST:PORT.")
_CA = click.option("--tls-ca", type=FILE, metavar="PEM", help="Authority that signed the scheduler's certificate (tls://…).")
_CERTIFICATE = click.option("--tls-cert", type=FILE, metavar="PEM", help="Certificate to show to the scheduler.")
_KEY = click.option("--tls-key", type=FILE, metavar="PEM", help="Key of --tls-cert.")


def scheduler(command: Callable[..., Any]) -> Callable[..., Any]:
    """--scheduler ADDRESS and its TLS files, all as one parameter `scheduler`; a decorator above --jobs and --quiet."""

    @functools.wraps(command)
    def called(
        scheduler: str | None, tls_ca: Path | None, tls_cert: Path | None, tls_key: Path | None, **others: Any
    ) -> Any:
        console: Console = others["console"]
        click.get_current_context().with_resource(protecting(filter(None, [tls_ca, tls_cert, tls_key])))
        if scheduler is None:
            if tls_ca or tls_cert or tls_key:
                raise click.UsageError("--tls-ca, --tls-cert and --tls-key go with --scheduler")
            return command(scheduler=None, **others)
        if others.get("jobs", 1) > 1:
            raise click.UsageError("--jobs is the number of processes here; leave it out with --scheduler")
        from l3cli.parallel.cluster import Scheduler

        return command(scheduler=Scheduler(scheduler, tls_ca, tls_cert, tls_key, console.warn), **others)

    return _ADDRESS(_CA(_CERTIFICATE(_KEY(called))))


def _mode(name: str, module: str, what: str) -> Callable[[F], F]:
    """A flag under which the whole command runs within the block that `module` has of its name."""

    def enter(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
        if wanted:
            context.with_resource(getattr(importlib.import_module(module), name)())

    return click.option(f"--{name.replace('_', '-')}", is_flag=True, expose_value=False, callback=enter, help=what)


trust = _mode(
    "trust", "l3cli.system.limits",
    "Decode raw, image, MATLAB and video files in this process, not in an isolated one with limits.",
)  # fmt: skip
dry_run = _mode(
    "dry_run", "l3cli.stages.plan",
    "Check everything that is checked before work, say what would be read and made, and write nothing.",
)  # fmt: skip
